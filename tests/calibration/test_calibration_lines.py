"""Narrow lines of the acceleration that a slower sensor does not show: found, taken out, never taken for motion."""

import numpy as np
import pytest
from calibration_cases import broadband, tones

import midspan
from midspan.calibration.lines import Shown, unconfirmed_lines
from midspan.recording.streams.recording import Recording
from midspan.records import NANOSECONDS
from midspan.settings.stored.calibration import calibration_from_dict
from midspan.signals.lines import Line, without_lines
from midspan.simulate.motion.motion import random_motion

TIME_S = np.arange(6000) / 100.0
TIME_NS = np.rint(TIME_S * NANOSECONDS).astype(np.int64)
# A machine at 99.6 Hz that 100 samples a second show at 0.4 Hz; its displacement would be 13 mm rms.
HUM_HZ, HUM_M_S2 = 0.4, 0.12


def moving(seed, std_m=3e-3):
    """Motion of 0.9 to 8 Hz: next to nothing at the machine's alias."""
    return random_motion((0.9, 8.0), std_m, rng=np.random.default_rng(seed), flat="velocity")


def hum(seed=5):
    """Its speed follows its load: the phase walks by one radian in a minute."""
    walk = np.cumsum(np.random.default_rng(seed).normal(0, 0.013, len(TIME_S)))
    return HUM_M_S2 * np.sin(2 * np.pi * HUM_HZ * TIME_S + walk)


def felt(motion, added=0.0, seed=0):
    """Samples (n, 2) of an accelerometer of 2 mm/s²."""
    noise = np.random.default_rng(seed).normal(0, 2e-3, len(TIME_S))
    return np.column_stack((TIME_S, motion.acceleration(TIME_S) + 0.05 + noise + added))


def seen(motion, rate_hz=10.0, noise_m=1e-4, offset_s=0.2, factor=-700.0):
    """A sensor on a clock of its own, with a factor of its own."""
    time_s = np.arange(1.0, 59.0, 1.0 / rate_hz)
    noise = np.random.default_rng(9).normal(0, noise_m, len(time_s))
    return Shown(time_s - offset_s, factor * (motion.displacement(time_s) + noise))


def test_a_line_that_the_sensor_does_not_show_is_found_with_its_size():
    motion = moving(1)
    (line,) = unconfirmed_lines(felt(motion, hum()), seen(motion))
    assert line.low_hz < HUM_HZ < line.high_hz
    assert line.width_hz < 0.7
    assert line.taken_out
    # What swings about its frequency is not all among the ordinates that stand out.
    assert line.std_m_s2 == pytest.approx(HUM_M_S2 / np.sqrt(2), rel=0.1)


def test_second_differences_of_a_range_tell_the_same():
    motion, time_s = moving(1), np.arange(1.0, 59.0, 0.02)
    place = motion.displacement(time_s) + np.random.default_rng(9).normal(0, 1e-5, len(time_s))
    second = Shown(time_s[1:-1], place[2:] - 2 * place[1:-1] + place[:-2], lag_s=0.02)
    (line,) = unconfirmed_lines(felt(motion, hum()), second)
    assert line.low_hz < HUM_HZ < line.high_hz


@pytest.mark.parametrize("seed", range(4))
def test_tones_and_broad_motion_of_the_structure_are_no_lines(seed):
    for motion in (broadband(seed), moving(seed), tones(seed, (2e-3, 0.7), (5e-4, 2.3), (1e-4, 4.1))):
        assert unconfirmed_lines(felt(motion, seed=seed), seen(motion)) == ()


def test_a_mode_that_an_averaging_sensor_hides_is_no_line():
    """A mean over 0.4 s has nothing of 2.5 Hz and a fifth of the amplitude of 2.1 Hz."""
    motion, exposure_s = tones(3, (2e-3, 0.7), (1e-3, 2.3), (1e-3, 2.5)), 0.4
    time_s = np.arange(1.0, 59.0, 0.1)
    inside = np.add.outer(time_s, np.linspace(-0.5, 0.5, 41) * exposure_s)
    noise = np.random.default_rng(9).normal(0, 1e-5, len(time_s))
    shown = Shown(time_s, motion.displacement(inside).mean(axis=1) + noise)
    assert unconfirmed_lines(felt(motion), shown) == ()


@pytest.mark.parametrize("seed", [15, 21, 24, 25])
def test_steps_of_a_clock_and_gaps_make_no_lines(seed):
    rng = np.random.default_rng(seed)
    mode_hz = rng.uniform([0.6, 1.5, 2.6], [1.5, 2.6, 4.2])
    # Three modes of 1 to 2 % of damping are as wide as this, and come and go.
    parts = [random_motion((0.985 * f, 1.015 * f), 2e-3 * mode_hz[0] / f, rng=rng, lines=60) for f in mode_hz]
    time_s = np.arange(1.0, 59.0, 0.1)
    moved = sum(one.displacement(time_s) for one in parts) + rng.normal(0, 2e-4, len(time_s))
    samples = np.column_stack(
        (TIME_S, sum(one.acceleration(TIME_S) for one in parts) + rng.normal(0, 2e-3, len(TIME_S)))
    )
    ahead_s = np.where(time_s > 25.0, 0.12, 0.0) - np.where(time_s > 40.0, 0.19, 0.0)
    assert not unconfirmed_lines(samples, Shown(time_s + ahead_s, moved))
    seen = (time_s < 25.0) | (time_s > 31.0)
    assert not unconfirmed_lines(samples, Shown(time_s[seen], moved[seen]))


def test_a_sensor_of_something_else_tells_no_lines():
    assert unconfirmed_lines(felt(moving(1), hum()), seen(moving(2))) == ()


def test_taking_a_line_out_leaves_other_motion():
    motion = tones(2, (2e-3, 1.0), (1e-3, 2.2))
    true = motion.acceleration(TIME_S)
    left = without_lines(TIME_NS, true + hum(), [Line(0.3, 0.5, 0.08)]) - true
    inner = slice(500, -500)
    # The band resolves 5 s; its skirts hold a few percent of what swings as this does.
    assert np.std(left[inner]) < 0.08 * HUM_M_S2
    plain = without_lines(TIME_NS, true, [Line(0.3, 0.5, 0.08)])
    assert np.max(np.abs(plain - true)[inner]) < 0.01 * np.std(true)


def test_missing_samples_stay_missing():
    value = hum()
    value[100:120] = np.nan
    left = without_lines(TIME_NS, value, [Line(0.3, 0.5, 0.08)])
    assert np.array_equal(np.isnan(left), np.isnan(value))
    assert without_lines(TIME_NS, value, [Line(0.3, 0.5, 0.08, taken_out=False)]) is value


def recorded(folder, added, noise_m=2e-4):
    """A recording with a displacement sensor, and its motion."""
    motion = moving(1, std_m=2e-3)
    rows, time_s = felt(motion, added), np.arange(1.0, 59.0, 0.1)
    value = motion.displacement(time_s) + np.random.default_rng(9).normal(0, noise_m, len(time_s))
    np.savetxt(folder / "accel.csv", rows, "%.9f", ",", header="time_s,a", comments="")
    table = np.column_stack((time_s, 1e3 * value))
    np.savetxt(folder / "moved.csv", table, "%.9f", ",", header="time_s,d", comments="")
    (folder / "recording.toml").write_text(
        '[accelerometer]\nfile = "accel.csv"\ntime = "time_s"\nvalue = "a"\nunit = "m/s^2"\n'
        '[displacement]\nfile = "moved.csv"\ntime = "time_s"\nvalue = "d"\nunit = "mm"\n'
    )
    return motion


def errors(result, motion):
    """Error and deviation of the rows, mm."""
    return result.displacement_mm - 1e3 * motion.displacement(result.time_s), result.displacement_std_mm


def test_a_recording_with_a_line_is_as_good_as_one_without_but_at_its_ends(tmp_path):
    motion = recorded(tmp_path, hum())
    calibration = midspan.calibrate(tmp_path)
    assert [line.taken_out for line in calibration.lines] == [True]
    assert any(line.code == "accelerometer-line" for line in calibration.warnings)
    error, std = errors(midspan.estimate(tmp_path, calibration=calibration), motion)
    inner = slice(1000, -1000)
    # Without the line 0.05 mm; with it as noise of the acceleration 0.16 mm and more.
    assert np.std(error[inner]) < 0.1
    assert np.mean(std[inner]) < 0.13
    assert np.mean(np.abs(error) < 1.96 * std) > 0.93
    # Where the band does not resolve the line, the rows say so.
    assert np.mean(std[:200]) > 1.3 * np.mean(std[inner])


def test_a_stored_calibration_keeps_its_lines_and_rows_are_the_same(tmp_path):
    recorded(tmp_path, hum())
    calibration = midspan.calibrate(tmp_path)
    again = calibration_from_dict(calibration.to_dict())
    assert again.lines == calibration.lines
    one, other = (midspan.estimate(tmp_path, calibration=each, given=False) for each in (calibration, again))
    # Metres are stored as millimetres: the last digit.
    assert np.allclose(one.displacement_mm, other.displacement_mm, rtol=0, atol=1e-9)


def test_a_recording_without_a_line_has_none(tmp_path):
    recorded(tmp_path, 0.0)
    assert midspan.calibrate(tmp_path).lines == ()


def test_where_a_line_stays_in_as_live_the_band_holds_it(tmp_path, monkeypatch):
    motion = recorded(tmp_path, hum())
    calibration = midspan.calibrate(tmp_path)
    monkeypatch.setattr(Recording, "without_lines", lambda recording, lines: recording)
    error, std = errors(midspan.estimate(tmp_path, calibration=calibration, method="kalman"), motion)
    assert np.mean(np.abs(error) < 1.96 * std) > 0.93
    assert np.max(np.abs(error) / std) < 5.0
