"""The clock offset of a displacement sensor: right, or refused with the reason, never wrong with a narrow band."""

import re

import numpy as np
import pytest

import midspan
from midspan.errors import UntrustedError
from midspan.simulate.motion.motion import Sines, random_motion
from recording_edits import set_keys, write_displacement
from repeats import slow

NOISE_MM, ACCELERATION_NOISE = 0.1, 5e-3


def bridge(seed):
    """2 mm near 0.15 Hz, 1.2 mm near 2.1 Hz, 0.2 mm near 5.3 Hz, each of five lines within some percent."""
    rng = np.random.default_rng(seed)
    lines = [
        (size / np.sqrt(5.0) * rng.uniform(0.6, 1.4), f * (1.0 + 0.02 * rng.uniform(-1, 1)) + 0.02 * rng.uniform(-1, 1))
        for f, size in ((0.15, 2e-3), (2.1, 1.2e-3), (5.3, 2e-4))
        for _ in range(5)
    ]
    return Sines(*np.array(lines).T, phase_rad=rng.uniform(0, 2 * np.pi, len(lines)))


def broad(seed):
    return random_motion((0.3, 5.0), 1e-3, rng=np.random.default_rng(seed), flat="velocity")


def tone(seed, frequency=2.0):
    return Sines(np.array([2e-3]), np.array([frequency]), phase_rad=np.random.default_rng(seed).uniform(0, 6.28, 1))


@pytest.fixture
def site(tmp_path):
    def opened(
        motion, *, late=0.0, factor=1.0, ppm=0.0, rate_hz=7.3, length=60.0, max_offset_s=0.5, gain=True, **displacement
    ):
        """A recording whose readings must be multiplied by `factor` and whose clock must be set on by `late` s."""
        rng = np.random.default_rng(7)
        time, met = np.arange(0.0, length, 0.01), np.arange(0.03, length - 0.3, 1.0 / rate_hz)
        accel = motion.acceleration(time) + 0.05 + ACCELERATION_NOISE * rng.standard_normal(len(time))
        value = (1e3 * motion.displacement(met) + NOISE_MM * rng.standard_normal(len(met))) / factor
        stamps = (met - late) / (1.0 + 1e-6 * ppm)
        write_displacement(tmp_path, (time, accel), (stamps, value))
        set_keys(tmp_path, "accelerometer", estimate_scale=gain)
        set_keys(tmp_path, "displacement", **displacement)
        set_keys(tmp_path, "calibration", max_offset_s=max_offset_s)
        return midspan.open_recording(tmp_path)

    return opened


@pytest.mark.parametrize(
    ("motion", "late", "scale"),
    [(bridge, -1.5, True), (bridge, 0.6, False), *slow((bridge, 0.6, True), (broad, 1.8, True), (bridge, 9.0, True))],
)
def test_an_offset_beyond_the_largest_is_refused_and_names_it(motion, late, scale, site):
    recording = site(motion(5), late=late, estimate_offset=True, estimate_scale=scale)
    with pytest.raises(UntrustedError, match=r"calibration\.max_offset_s") as caught:
        midspan.calibrate(recording)
    if abs(late) < 5.0:
        # As far as is looked beyond, the right one is reported.
        reported = re.search(r"by ([+-]\S+) s, but only", str(caught.value))
        assert reported is not None
        assert float(reported[1]) == pytest.approx(late, abs=0.02)


@pytest.mark.parametrize("scale", [False, True])
def test_where_too_little_is_left_to_look_farther_off_it_is_reported(scale, site):
    # Of 22 readings fewer than the 20 that are needed keep from both ends what is looked beyond.
    sway = random_motion((0.06, 0.2), 10e-3, rng=np.random.default_rng(5))
    short = midspan.calibrate(site(sway, rate_hz=0.5, length=45.0, estimate_offset=True, estimate_scale=scale))
    assert [line for line in short.warnings if "no clock offset beyond" in line]
    long = midspan.calibrate(site(sway, length=45.0, estimate_offset=True, estimate_scale=scale))
    assert not [line for line in long.warnings if "no clock offset beyond" in line]


@pytest.mark.parametrize(("late", "largest"), [(0.499, 0.5), (9.0, 20.0), *slow((-0.49, 0.5), (7.0, 10.0))])
def test_an_offset_near_the_largest_is_found_in_a_short_recording_too(late, largest, site):
    found = midspan.calibrate(site(broad(6), late=late, max_offset_s=largest, estimate_offset=True))
    offset = found.displacement.offset
    assert offset.value_s == pytest.approx(late, abs=4.0 * np.sqrt(offset.variance))
    assert np.sqrt(offset.variance) < 2e-3
    # A quarter of a minute is searched at most, and says so.
    assert any("were searched" in line for line in found.warnings) == (largest > 15.0)


@pytest.mark.parametrize("frequency", [2.0, *slow(3.0)])
def test_a_single_tone_tells_no_clock_offset(frequency, site):
    with pytest.raises(UntrustedError, match=r"offset is ambiguous.*single tone"):
        midspan.calibrate(site(tone(3, frequency), late=0.23, estimate_offset=True))


def test_a_single_tone_with_the_offset_next_to_none_is_taken_as_it_is(site):
    # On one clock the offset a period away is no objection.
    assert not midspan.calibrate(site(tone(3), noise_time_s=0)).warnings


WIDE = pytest.mark.xfail(
    reason="a scale a third off is reported as a quarter here: the apparent factor is not yet exact"
)


@pytest.mark.parametrize("factor", [1.05, pytest.param(1.3, marks=WIDE), *slow(0.96)])
def test_a_scale_that_is_not_quite_right_is_reported_and_stands_in_the_band(factor, site):
    motion = bridge(8)
    found = midspan.estimate(site(motion, factor=factor, gain=False))
    assert any("follows the accelerometer with a factor" in line for line in found.warnings)
    assert found.calibration.displacement.relative_std == pytest.approx(abs(factor - 1.0), abs=0.02)
    error = found.displacement_mm - 1e3 * motion.displacement(found.time_s)
    error -= error.mean()
    assert np.mean(np.abs(error) < 1.96 * found.displacement_std_mm) > 0.9


@pytest.mark.parametrize("factor", [0.96, *slow(1.05)])
def test_the_gain_is_the_accelerometers_where_the_sensors_unit_is_right(factor, site):
    # The same recording: the sensor measures 1 / factor of what the accelerometer says.
    motion = bridge(8)
    found = midspan.estimate(site(motion, factor=factor))
    assert any("the accelerometer's gain relative to this sensor is" in line for line in found.warnings)
    known = found.calibration
    assert known.accelerometer_scale == pytest.approx(factor, abs=4.0 * known.accelerometer_scale_std)
    error = factor * found.displacement_mm - 1e3 * motion.displacement(found.time_s)
    assert np.mean(np.abs(error) < 1.96 * factor * found.displacement_std_mm) > 0.9


@pytest.mark.parametrize("seed", [0, *slow(1, 2, 3)])
def test_a_scale_that_is_right_is_not_reported(site, seed):
    found = midspan.calibrate(site(bridge(seed), noise_time_s=0))
    assert not found.warnings
    assert found.displacement.scale_std == 0.0


def test_a_clock_that_differs_widens_the_scale_or_is_refused(site):
    for late in (0.004, 0.02):
        try:
            found = midspan.calibrate(site(bridge(9), late=late, factor=2.0, estimate_scale=True)).displacement
        except UntrustedError as error:
            assert "clock differs" in str(error)  # noqa: PT017
            assert late == 0.02
        else:
            assert found.scale == pytest.approx(2.0, abs=3.0 * found.scale_std)


def test_a_clock_that_runs_apart_does_not_take_from_the_scale(site):
    recording = site(bridge(2), ppm=400.0, length=240.0, factor=-2.0, estimate_scale=True, estimate_offset=True)
    found = midspan.calibrate(recording).displacement
    # 48 ms either way at 2.1 Hz would take a tenth off the regression.
    assert found.scale == pytest.approx(-2.0, abs=2.0 * found.scale_std)
    assert found.relative_std < 0.05


@pytest.mark.parametrize(("share", "offset"), [(0.0, True), (0.03, False), *slow((0.03, True), (0.1, True))])
def test_a_quiet_recording_is_not_refused(share, offset, site):
    loud = bridge(4)
    quiet = Sines(share * loud.amplitude_m, loud.frequency_hz, phase_rad=loud.phase_rad)
    found = midspan.calibrate(site(quiet, estimate_offset=offset))
    assert found.displacement.offset.value_s == pytest.approx(0.0, abs=0.03)
    assert not [line for line in found.warnings if "factor" in line or "Set displacement.estimate_offset" in line]


@pytest.mark.parametrize(("factor", "offset"), [(-25.4, False), (-0.04, True)])
def test_a_reversed_sign_is_reported_before_any_clock(factor, offset, site):
    with pytest.raises(UntrustedError, match="sign is reversed: with the opposite sign and multiplied by"):
        midspan.calibrate(site(bridge(3), factor=factor, estimate_offset=offset))


def test_an_accelerometer_whose_clock_runs_away_by_a_day_is_estimated_up_to_there(site, tmp_path):
    site(broad(1))
    table = np.loadtxt(tmp_path / "a.csv", delimiter=",", skiprows=1)
    table[4000:, 0] += 86_400.0
    np.savetxt(tmp_path / "a.csv", table, delimiter=",", header="time_s,accel", comments="", fmt="%.9g")
    result = midspan.estimate(tmp_path)
    assert 39.0 < result.time_s[-1] < 60.0
    assert "gap" in {event.kind for event in result.events}
