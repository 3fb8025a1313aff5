"""A displacement sensor whose clock runs at another rate than the accelerometer's, or is apart from it unasked."""

import numpy as np
import pytest

import midspan
from midspan.errors import UntrustedError
from recording_edits import set_keys, write_displacement
from repeats import slow

LENGTH_S, NOISE_MM, RATE_HZ = 150.0, 0.3, 10.0


def write(folder, *, ppm=0.0, late_s=0.0, length_s=LENGTH_S, seed=1, start_s=0.0):
    """A sensor of 10 Hz whose clock gains `ppm` since 0 s and shows `late_s` more than the accelerometer's.

    The motion is sixty lines from 0.15 to 1.5 Hz, 5 mm rms; returns it, mm, as a function of s.
    """
    rng = np.random.default_rng(seed)
    hertz, phase = rng.uniform(0.15, 1.5, 60), rng.uniform(0.0, 2.0 * np.pi, 60)
    size_mm = 5.0 * np.sqrt(2.0 / 60.0)

    def moved(time_s, gain=1.0):
        return np.real(np.exp(2j * np.pi * np.outer(time_s, hertz)) @ (size_mm * np.exp(1j * phase) * gain))

    time, met = np.arange(0.0, length_s, 0.02), np.arange(start_s, length_s, 1.0 / RATE_HZ)
    accel = 1e-3 * moved(time, -((2.0 * np.pi * hertz) ** 2)) + 0.02 + rng.normal(0.0, 4e-3, len(time))
    value = moved(met) + rng.normal(0.0, NOISE_MM, len(met))
    write_displacement(folder, (time, accel), (met * (1.0 + 1e-6 * ppm) + late_s, value))
    return moved


def errors(result, moved):
    """Error (mm, rms, without its mean) of a result, and the share inside its band."""
    inner = (result.time_s > result.time_s[0] + 2.0) & (result.time_s < result.time_s[-1] - 2.0)
    error = (result.displacement_mm - moved(result.time_s))[inner]
    error -= error.mean()
    return np.std(error), np.mean(np.abs(error) < 1.96 * result.displacement_std_mm[inner])


@pytest.fixture(scope="module")
def even_mm(tmp_path_factory):
    """The error (mm) of the same recording with a clock that runs at the accelerometer's rate."""
    folder = tmp_path_factory.mktemp("even")
    moved = write(folder)
    result = midspan.estimate(folder)
    assert not any("clock" in line.code for line in result.warnings)
    return errors(result, moved)[0]


# A logger, two bad ones, and a wearable's 30 s an hour.
@pytest.mark.parametrize(
    ("ppm", "method", "asked"),
    [(8300.0, "smoother", None), (-1000.0, "kalman", True), *slow((200.0, "smoother", None))],
)
def test_a_clock_of_another_rate_costs_nothing(ppm, method, asked, even_mm, tmp_path):
    moved = write(tmp_path, ppm=ppm)
    set_keys(tmp_path, "displacement", estimate_offset=asked)
    result = midspan.estimate(tmp_path, method=method)
    rms_mm, inside = errors(result, moved)
    if method == "smoother":
        # The rate is known to some ppm, which moves the ends by 0.5 ms: nothing together with the sensor's noise.
        assert rms_mm < 1.05 * even_mm
    # A cubic through the readings keeps their noise, 0.28 mm.
    assert rms_mm < 0.8 * NOISE_MM
    assert 0.9 < inside < 0.99
    known = result.calibration.displacement
    # Seconds that are lacking for each second of the sensor's own; 40 ppm are five deviations of this record's.
    assert known.clock_rate == pytest.approx(-1e-6 * ppm / (1.0 + 1e-6 * ppm), abs=40e-6)
    assert any("ppm" in line and line.code == "clock-corrected" for line in result.warnings)


def test_a_calibration_read_back_has_the_rate(tmp_path):
    write(tmp_path, ppm=1000.0)
    found = midspan.calibrate(tmp_path)
    own = midspan.estimate(tmp_path, calibration=found)
    again = midspan.estimate(tmp_path, calibration=midspan.load_calibration(found.save(tmp_path / "calibration.json")))
    assert np.allclose(own.displacement_mm, again.displacement_mm, atol=1e-6)


def test_one_clock_that_is_said_and_cannot_be_is_refused_with_the_rate(tmp_path):
    write(tmp_path, ppm=1000.0)
    set_keys(tmp_path, "displacement", estimate_offset=False)
    with pytest.raises(UntrustedError, match=r"clock drifts by \+1\d\d\d ± \d+ ppm .*estimate_offset"):
        midspan.estimate(tmp_path)


@pytest.mark.parametrize("set_s", [0.005])
def test_a_clock_that_is_set_once_has_no_other_rate(set_s, tmp_path):
    write(tmp_path)
    time, value = np.loadtxt(tmp_path / "d.csv", delimiter=",", skiprows=1).T
    table = np.column_stack((time - np.where(time > 0.5 * LENGTH_S, set_s, 0.0), value))
    np.savetxt(tmp_path / "d.csv", table, "%.9f", ",", header="time_s,value", comments="")
    try:
        found = midspan.calibrate(tmp_path)
    except UntrustedError as error:
        # Half of what it was set by either way.
        assert "clock" in str(error) and "ppm" not in str(error)  # noqa: PT017, PT018
    else:
        assert found.displacement.clock_rate == 0.0


@pytest.mark.parametrize("late_s", [0.0024])
def test_clocks_that_differ_are_brought_together_without_being_asked(late_s, even_mm, tmp_path):
    moved = write(tmp_path, late_s=late_s)
    result = midspan.estimate(tmp_path)
    offset = result.calibration.displacement.offset
    # time on the accelerometer's clock = time on the other sensor's clock + time_offset_s
    assert offset.value_s == pytest.approx(-late_s, abs=5.0 * np.sqrt(offset.variance))
    assert 0.0 < np.sqrt(offset.variance) < 1e-3
    rms_mm, inside = errors(result, moved)
    assert rms_mm < 1.05 * even_mm
    assert 0.9 < inside < 0.99
    assert [line.severity for line in result.warnings if "clock" in line.code] == ["note"]
