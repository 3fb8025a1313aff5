"""Sensors that contradict each other: the right value, a band that holds the error, or a refusal with its cause.

Recordings are written from physics: a sum of tones, its acceleration exact.
"""

import contextlib
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.signal import butter, lfilter

import midspan
from midspan.calibration.displacement.wrong_values import WrongValues
from midspan.cli.main import run
from midspan.errors import UntrustedError
from midspan.notices import Severity
from midspan.recording.estimate import refuse_unsettled
from midspan.records import Event
from repeats import slow

TONES_HZ, SHARE = np.array([0.7, 1.9, 4.1]), np.array([0.6, 0.3, 0.1])
SLOW_HZ = np.array([0.25])
WAVELENGTH_M = 299792458.0 / 77e9


class Structure:
    """A motion of tones with an rms in mm, and its acceleration in m/s²."""

    def __init__(self, seed, rms_mm=3.0, hertz=TONES_HZ):
        self.rng = np.random.default_rng(seed)
        size = SHARE[: len(hertz)]
        self.size_mm = rms_mm * size / np.sqrt(0.5 * np.sum(size**2))
        self.turn = 2.0 * np.pi * hertz
        self.phase = np.random.default_rng(1000 + seed).uniform(0.0, 2.0 * np.pi, len(hertz))

    def moved_mm(self, time_s):
        return np.sin(np.multiply.outer(time_s, self.turn) + self.phase) @ self.size_mm

    def write(self, folder, length_s=60.0):
        time_s = np.arange(0.0, length_s, 0.01)
        value = -1e-3 * np.sin(np.multiply.outer(time_s, self.turn) + self.phase) @ (self.size_mm * self.turn**2)
        value += self.rng.normal(0.03, 5e-3, len(time_s))
        table(folder / "accel.csv", "time_s,accel", time_s, value)
        return '[accelerometer]\nfile = "accel.csv"\nunit = "m/s^2"\n'

    def displacement(self, folder, time_s, value_mm, length_s=60.0):
        """A recording with a displacement sensor of 0.1 mm noise whose values at stamps are given."""
        text = self.write(folder, length_s)
        table(folder / "disp.csv", "time_s,mm", time_s, value_mm)
        (folder / "recording.toml").write_text(f'{text}[displacement]\nfile = "disp.csv"\nvalue = "mm"\nunit = "mm"\n')
        return folder

    def noisy_mm(self, time_s):
        return self.moved_mm(time_s) + self.rng.normal(0.0, 0.1, len(time_s))


def table(file, head, *columns):
    np.savetxt(file, np.column_stack(columns), "%.9f", ",", header=head, comments="")


STAMPS = np.arange(0.3, 59.7, 0.1)


def held(result, error_mm, least=0.88, worst=5.0):
    """Whether the band holds the errors: nine of ten rows in that of 95 %, and none far outside."""
    ratio = np.abs(error_mm) / result.displacement_std_mm
    assert np.mean(ratio < 1.96) > least
    assert np.max(ratio) < worst
    assert not [line for line in result.warnings if line.severity is Severity.SERIOUS]


@pytest.mark.parametrize("late_s", [1.5, *slow(2.0)])
def test_a_step_of_the_clock_beyond_what_is_corrected_is_refused_and_named(late_s, tmp_path, capsys):
    site = Structure(1, 5.6, SLOW_HZ)
    value = site.noisy_mm(STAMPS + np.where(STAMPS > 30.0, late_s, 0.0))
    folder = site.displacement(tmp_path, STAMPS, value)
    assert run(["estimate", str(folder), "-o", str(tmp_path / "r.csv")]) == 4
    said = capsys.readouterr().err
    assert "the best explanation is a clock step" in said
    assert "Cut the recording where the clock steps" in said


@pytest.mark.parametrize("late_s", [1.0, *slow(0.2)])
def test_a_step_that_is_corrected_leaves_its_deviation_in_the_band(late_s, tmp_path):
    site = Structure(2, 5.6, SLOW_HZ)
    value = site.noisy_mm(STAMPS + np.where(STAMPS > 30.0, late_s, 0.0))
    result = midspan.estimate(site.displacement(tmp_path, STAMPS, value))
    held(result, result.displacement_mm - site.moved_mm(result.time_s))


def test_two_steps_of_a_clock_soon_after_each_other_are_corrected(tmp_path):
    site, stamps = Structure(1), np.arange(0.3, 99.7, 0.1)
    shown = stamps + 0.2 * (stamps > 70.0) + 0.3 * (stamps > 85.0)
    result = midspan.estimate(site.displacement(tmp_path, shown, site.noisy_mm(stamps), 100.0))
    assert [event.kind for event in result.events].count("clock") == 2
    assert all("ms were added to its time stamps" in event.text for event in result.events if event.kind == "clock")
    held(result, result.displacement_mm - site.moved_mm(result.time_s))


@pytest.mark.parametrize("share", [0.4, *slow(0.3)])
def test_a_crowd_of_outliers_to_one_side_is_named_and_left_out(share, tmp_path):
    site = Structure(2)
    value = site.noisy_mm(STAMPS)
    value += (site.rng.random(len(STAMPS)) < share) * site.rng.uniform(3.0, 10.0, len(STAMPS))
    result = midspan.estimate(site.displacement(tmp_path, STAMPS, value))
    assert any(line.code == "outliers" and "contradict" in line for line in result.warnings)
    held(result, result.displacement_mm - site.moved_mm(result.time_s))


@pytest.mark.parametrize(
    ("seed", "share"),
    [
        (31, 0.35),
        *slow((32, 0.15), (31, 0.15), (31, 0.25), (32, 0.25), (32, 0.35), (33, 0.15), (33, 0.25), (33, 0.35)),
    ],
)
def test_outliers_anywhere_cost_no_more_than_the_values_that_they_replace(seed, share, tmp_path):
    # Some of them agree by chance with each other, or nearly with the motion.
    site = Structure(seed)
    value, wrong = site.noisy_mm(STAMPS), site.rng.random(len(STAMPS)) < share
    value[wrong] = site.rng.uniform(-20.0, 20.0, np.count_nonzero(wrong))
    result = midspan.estimate(site.displacement(tmp_path, STAMPS, value), method="smoother")
    error = result.displacement_mm - site.moved_mm(result.time_s)
    held(result, error)
    assert not {event.kind for event in result.events} & {"clock", "level_shift", "acceleration", "reacquired"}
    good = tmp_path / "good"
    good.mkdir()
    site = Structure(seed)
    least = midspan.estimate(site.displacement(good, STAMPS[~wrong], site.noisy_mm(STAMPS)[~wrong]), method="smoother")
    without = least.displacement_mm - site.moved_mm(least.time_s)
    # Two draws of one error about a zero of one instant; outliers that remain may look like a slow error of the sensor,
    # which takes half of what its values say of slow motion. A value taken wrongly leads rows away by ten deviations.
    assert np.std(error) < 1.6 * np.std(without)


@pytest.mark.parametrize(
    ("wrong", "method"),
    [
        ([0], "lag"),
        ([0, 2, 7], "kalman"),
        *slow(([0], "kalman"), ([0, 2, 7], "lag"), ([0, 3, 5], "kalman"), ([0, 3, 5], "lag")),
    ],
)
@pytest.mark.parametrize("seed", [41, 42, *slow(43, 44)])
def test_rows_that_are_due_before_the_first_values_are_decided_hold_what_they_may_be(wrong, method, tmp_path, seed):
    site = Structure(seed, 4.0)
    value = site.moved_mm(STAMPS) + site.rng.normal(0.0, 0.5, len(STAMPS))
    value[wrong] += site.rng.uniform(-20.0, 20.0, len(wrong))
    folder = tmp_path / f"{seed}"
    folder.mkdir()
    result = midspan.estimate(site.displacement(folder, STAMPS, value), method=method)
    held(result, result.displacement_mm - site.moved_mm(result.time_s))


@pytest.mark.parametrize(
    ("first", "last", "off_mm"), [(0, 8, 15.0), (0, 15, np.nan), *slow((0, 6, 15.0), (6, 21, 5.0))]
)
@pytest.mark.parametrize("seed", [51, *slow(52)])
def test_first_values_that_are_wrong_do_not_make_the_zero_of_the_record(first, last, off_mm, seed, tmp_path):
    # nan: each of them is anywhere. All rows were off by the offset at a stated 0.1 mm.
    site = Structure(seed)
    value = site.noisy_mm(STAMPS)
    value[first:last] += site.rng.uniform(-25.0, 25.0, last - first) if np.isnan(off_mm) else off_mm
    result = midspan.estimate(site.displacement(tmp_path, STAMPS, value), method="smoother")
    held(result, result.displacement_mm - site.moved_mm(result.time_s))
    assert any(event.kind == "rejected" for event in result.events)


def noisy_for_a_while(site, seed):
    """A displacement sensor whose noise is five times as large from 20 to 35 s."""
    rng = np.random.default_rng(seed)
    return site.noisy_mm(STAMPS) + np.where((STAMPS > 20.0) & (STAMPS < 35.0), rng.normal(0.0, 0.5, len(STAMPS)), 0.0)


def off_for_a_while(site, seed):
    """A displacement sensor that is 8 mm off from 30 to 34 s."""
    return site.noisy_mm(STAMPS) + np.where((STAMPS > 30.0) & (STAMPS < 34.0), 8.0, 0.0)


@pytest.mark.parametrize("seed", [21, *slow(22, 23)])
@pytest.mark.parametrize("fault", [noisy_for_a_while, off_for_a_while])
def test_a_sensor_that_is_noisy_or_off_its_place_for_a_while_is_no_crowd_of_outliers(fault, seed, tmp_path):
    site = Structure(seed)
    result = midspan.estimate(site.displacement(tmp_path, STAMPS, fault(site, seed)), method="smoother")
    held(result, result.displacement_mm - site.moved_mm(result.time_s))
    assert not [event for event in result.events if "left out" in event.text]


@pytest.mark.parametrize("seed", [24, *slow(25)])
def test_good_values_are_kept_where_the_accelerometer_is_noisy_for_a_while(seed, tmp_path):
    site = Structure(seed)
    folder = site.displacement(tmp_path, STAMPS, site.noisy_mm(STAMPS))
    time_s, value = np.loadtxt(folder / "accel.csv", delimiter=",", skiprows=1).T
    value += np.where((time_s > 25.0) & (time_s < 33.0), np.random.default_rng(seed).normal(0.0, 0.25, len(value)), 0.0)
    table(folder / "accel.csv", "time_s,accel", time_s, value)
    result = midspan.estimate(folder, method="smoother")
    assert not [event for event in result.events if "left out" in event.text]
    # Of what the sensor alone leaves of the motion there: a mean of its values over the accelerometer's noisy time.
    assert np.max(np.abs(result.displacement_mm - site.moved_mm(result.time_s))) < 1.5


@pytest.mark.parametrize(("step_s", "method"), [(0.3, "smoother"), (1.0, "kalman"), *slow((10.0, "smoother"))])
def test_an_accelerometers_clock_that_steps_forward_is_named_by_its_gap(step_s, method, tmp_path, capsys):
    site = Structure(26)
    folder = site.displacement(tmp_path, STAMPS, site.noisy_mm(STAMPS))
    time_s, value = np.loadtxt(folder / "accel.csv", delimiter=",", skiprows=1).T
    table(folder / "accel.csv", "time_s,accel", time_s + np.where(time_s > 30.0, step_s, 0.0), value)
    assert run(["estimate", str(folder), "--method", method, "-o", str(tmp_path / "r.csv")]) == 4
    said = capsys.readouterr().err
    assert f"accelerometer: its time stamps have a gap of {step_s:.4g} s" in said
    assert "its clock stepped forward and no sample is missing" in said


@pytest.mark.parametrize("gap_s", [0.3, *slow(2.0)])
def test_samples_that_are_missing_are_no_step_of_a_clock(gap_s, tmp_path):
    site = Structure(27)
    folder = site.displacement(tmp_path, STAMPS, site.noisy_mm(STAMPS))
    time_s, value = np.loadtxt(folder / "accel.csv", delimiter=",", skiprows=1).T
    kept = (time_s < 30.0) | (time_s > 30.0 + gap_s)
    table(folder / "accel.csv", "time_s,accel", time_s[kept], value[kept])
    result = midspan.estimate(folder)
    held(result, result.displacement_mm - site.moved_mm(result.time_s))


@pytest.mark.parametrize("seed", [28, *slow(29)])
def test_a_causal_method_that_followed_most_of_very_many_outliers_is_refused(seed, tmp_path, capsys):
    site = Structure(seed)
    wrong = site.rng.uniform(size=len(STAMPS)) < 0.45
    value = site.noisy_mm(STAMPS) + np.where(wrong, site.rng.uniform(6.0, 12.0, len(STAMPS)), 0.0)
    folder = site.displacement(tmp_path, STAMPS, value)
    refused = run(["estimate", str(folder), "--method", "kalman", "-o", str(tmp_path / "r.csv")]) == 4
    said = capsys.readouterr().err
    assert (
        not refused
        or "of its values contradict the acceleration" in said
        or "the accelerometer would have shown" in said
    )
    if not refused:
        result = midspan.estimate(folder, method="kalman")
        # A tenth of a second before the motion is acquired anew some rows may be farther off.
        held(result, result.displacement_mm - site.moved_mm(result.time_s), worst=8.0)


def test_a_sensor_that_follows_late_is_no_low_pass_in_the_accelerometers_logger(tmp_path):
    """A low-pass of second order at 2 Hz in the displacement sensor: it delays, which a logger's cannot make of it."""
    site = Structure(30)
    fine_s = np.arange(-5.0, 60.0, 1e-3)
    late = lfilter(*butter(2, 2.0, fs=1000.0), site.moved_mm(fine_s))
    folder = site.displacement(tmp_path, STAMPS, np.interp(STAMPS, fine_s, late) + site.rng.normal(0, 0.1, len(STAMPS)))
    with pytest.raises(midspan.UntrustedError) as refused:
        midspan.estimate(folder)
    assert "logger" not in str(refused.value)
    assert "a lag of the displacement sensor" in str(refused.value)


def test_a_sensor_that_is_frozen_from_the_start_begins_where_it_is_free(tmp_path):
    site = Structure(1)
    value = site.noisy_mm(STAMPS)
    value[STAMPS < 6.0] = value[STAMPS < 6.0][0] + 5.0
    result = midspan.estimate(site.displacement(tmp_path, STAMPS, value))
    assert result.time_s[0] == pytest.approx(6.0, abs=0.2)
    held(result, result.displacement_mm - site.moved_mm(result.time_s))


def test_a_sensor_that_is_stuck_with_its_noise_leads_no_row_away(tmp_path):
    site = Structure(1)
    stuck = (STAMPS > 15.0) & (STAMPS < 40.0)
    value = np.where(stuck, site.moved_mm(np.array([15.0])), site.moved_mm(STAMPS))
    value += site.rng.normal(0.0, 0.1, len(value))
    result = midspan.estimate(site.displacement(tmp_path, STAMPS, value))
    held(result, result.displacement_mm - site.moved_mm(result.time_s))


def radar(folder, site, range_mm):
    """A recording with a radar of one bin; range_mm: of time."""
    frame_s = np.arange(0.0, 30.0, 0.01)
    noise = site.rng.normal(0.0, 20.0, (2, len(frame_s)))
    z = 1000.0 * np.exp(4e-3j * np.pi * range_mm(frame_s) / WAVELENGTH_M) + noise[0] + 1j * noise[1]
    np.save(folder / "iq.npy", z.astype(np.complex64)[:, None, None])
    sensors = site.write(folder, 30.0) + '[radar]\nfile = "iq.npy"\nrate_hz = 100.0\ncarrier_hz = 77e9\n'
    (folder / "recording.toml").write_text(f"{sensors}[calibration]\nwindow_s = [0.0, 20.0]\n")
    return folder


def test_a_factor_that_no_fixed_target_has_is_refused(tmp_path, capsys):
    site = Structure(1)
    folder = radar(tmp_path, site, lambda t: site.moved_mm(t) / 0.9)
    assert run(["estimate", str(folder), "-o", str(tmp_path / "r.csv")]) == 4
    assert "must be 1 or more for a fixed target" in capsys.readouterr().err


def test_a_radar_that_the_acceleration_contradicts_is_refused_with_the_time(tmp_path, capsys):
    site = Structure(2)
    folder = radar(tmp_path, site, lambda t: site.moved_mm(t + (t > 25.0)))
    assert run(["estimate", str(folder), "-o", str(tmp_path / "r.csv")]) == 4
    said = capsys.readouterr().err
    assert "contradict" in said
    # Within 4 s of the step.
    assert any(f"at {second}." in said for second in (24, 25, 26, 27, 28))


@pytest.mark.parametrize(
    ("kind", "share", "is_refused"),
    [("acceleration", 0.25, True), ("acceleration", 0.0, False), ("spike", 0.25, False)],
)
def test_an_acceleration_called_wrong_among_many_outliers_is_refused(kind, share, is_refused):
    # Two outliers that agree look like it: rows were 33 to 49 mm off at a stated 0.5, with exit code 0.
    stamps = np.arange(1200, dtype=np.int64) * 100_000_000
    crowd, held = np.split(stamps, [round(share * len(stamps))])
    wrong = {"displacement": WrongValues(held[:5], crowd)}
    first = SimpleNamespace(wrong=wrong, series=[{"displacement": SimpleNamespace(time_ns=stamps)}])
    found = SimpleNamespace(events=[Event(int(stamps[600]), kind, "")])
    with pytest.raises(UntrustedError, match="25 % of its values") if is_refused else contextlib.nullcontext():
        refuse_unsettled(first, found)
