"""A displacement sensor that averages: its exposure is found where it is not declared, and is no gain."""

import numpy as np
import pytest

import midspan
from midspan.calibration.whitening import integrated
from recording_edits import set_keys, write_displacement
from repeats import slow

EXPOSURE_S, NOISE_MM = 0.09, 0.1


def write(folder, seed, exposure_s, length_s=60.0, rate_hz=10.0, skew=0.0, early_s=0.0):
    """A recording of three modes averaged exactly over an exposure; returns its truth as a function of s, mm.

    skew: by how much the sensor's clock loses on the accelerometer's, s/s; early_s: by how much its stamps are early.
    """
    rng = np.random.default_rng(seed)
    size, hertz = np.array([3.0, 2.0, 0.8]), np.array([0.5, 1.3, 2.9]) + rng.normal(0, 0.05, 3)
    phase = rng.uniform(0, 6.28, 3)

    def moved(time, shrunk=1.0):
        return np.sin(2 * np.pi * np.outer(time, hertz) + phase) @ (size * shrunk)

    time, met = np.arange(0.0, length_s, 0.01), np.arange(0.503, length_s - 0.5, 1.0 / rate_hz)
    accel = 1e-3 * moved(time, -((2 * np.pi * hertz) ** 2)) + rng.normal(0.0, 2e-3, len(time))
    height = moved(met * (1.0 + skew), np.sinc(hertz * exposure_s)) + rng.normal(0.0, NOISE_MM, len(met))
    write_displacement(folder, (time, accel), (met - early_s, height))
    return moved


def too_strong(folder, times):
    """The accelerometer of a recording reads this many times too much of the fastest mode."""
    rows = np.loadtxt(folder / "a.csv", delimiter=",", skiprows=1)
    time = rows[:, 0]
    fast = np.fft.rfft(rows[:, 1])
    fast[np.fft.rfftfreq(len(time), 0.01) > 2.2] *= times
    rows[:, 1] = np.fft.irfft(fast, len(time))
    np.savetxt(folder / "a.csv", rows, "%.9f", ",", header="time_s,value", comments="")


@pytest.mark.parametrize("declared", [False, *slow(True)])
@pytest.mark.parametrize("seed", [0, *slow(1)])
def test_the_band_holds_beside_a_sensor_that_averages(declared, tmp_path, seed):
    moved = write(tmp_path, seed, EXPOSURE_S)
    if declared:
        set_keys(tmp_path, "displacement", exposure_s=EXPOSURE_S)
    result = midspan.estimate(tmp_path)
    found = result.calibration
    # The noise leaves 3 % of the exposure.
    assert found.displacement.exposure_s == pytest.approx(EXPOSURE_S, rel=0.1)
    assert found.accelerometer_scale == pytest.approx(1.0, abs=4.0 * found.accelerometer_scale_std)
    assert any("averages over" in line for line in result.warnings) is not declared
    error = result.displacement_mm - moved(result.time_s)
    assert np.mean(np.abs(error) < 1.96 * result.displacement_std_mm) > 0.85


@pytest.mark.parametrize("declared", [True, *slow(False)])
@pytest.mark.parametrize("seed", [0, *slow(1)])
def test_an_average_over_a_period_of_the_motion(declared, tmp_path, seed):
    # 0.36 s are 1.04 periods of the fastest mode, of which 4 % are left, turned round.
    moved = write(tmp_path, seed, 0.36, length_s=120.0, rate_hz=2.5)
    if declared:
        set_keys(tmp_path, "displacement", exposure_s=0.36)
    result = midspan.estimate(tmp_path)
    found = result.calibration
    assert found.displacement.exposure_s == pytest.approx(0.36, rel=0.05)
    assert found.accelerometer_scale == pytest.approx(1.0, abs=4.0 * found.accelerometer_scale_std)
    error = result.displacement_mm - moved(result.time_s)
    assert np.mean(np.abs(error) < 1.96 * result.displacement_std_mm) > 0.85
    # Of 2.6 mm rms, with a noise of 0.1 mm.
    assert np.sqrt(np.mean(error**2)) < 0.1


def test_a_response_is_averaged_exactly():
    time = np.arange(0.0, 20.0, 0.002)
    for hertz, exposure in ((0.5, 0.4), (2.0, 0.5), (4.0, 0.5)):
        omega = 2 * np.pi * hertz
        path = integrated(np.column_stack((time, -(omega**2) * np.sin(omega * time), np.ones(len(time)))))
        met = np.linspace(5.0, 15.0, 300)
        # Second differences take out the unknown start, a straight line.
        seen, whole = (np.diff(path.at(met, one), 2) for one in (exposure, 0.0))
        shrunk = seen @ whole / (whole @ whole)
        # Linear interpolation between samples leaves (omega dt)²/12, 2e-4 at most.
        assert shrunk == pytest.approx(np.sinc(hertz * exposure), abs=3e-4)


@pytest.mark.parametrize("seed", [0, *slow(1, 2)])
def test_a_sensor_that_does_not_average_has_no_exposure(tmp_path, seed):
    write(tmp_path, seed, 0.0)
    assert midspan.calibrate(tmp_path).displacement.exposure_s == 0.0


def test_it_is_stored_and_read_again(tmp_path):
    write(tmp_path, 1, EXPOSURE_S)
    own = midspan.calibrate(tmp_path)
    again = midspan.load_calibration(own.save(tmp_path / "calibration.json")).displacement
    assert again.exposure_s == pytest.approx(own.displacement.exposure_s)


def test_an_offset_is_found_beside_a_sensor_that_averages(tmp_path):
    moved = write(tmp_path, 0, EXPOSURE_S)
    set_keys(tmp_path, "displacement", estimate_offset=True)
    result = midspan.estimate(tmp_path)
    assert result.calibration.displacement.exposure_s == pytest.approx(EXPOSURE_S, rel=0.1)
    error = result.displacement_mm - moved(result.time_s)
    assert np.mean(np.abs(error) < 1.96 * result.displacement_std_mm) > 0.85


@pytest.mark.parametrize("seed", [0, *slow(1)])
def test_it_is_exact_for_fast_motion_too(tmp_path, seed):
    # Half a period of the fastest mode: the first term is 1.23 of what averaging takes there, of the slowest 1.01.
    moved = write(tmp_path, seed, 0.17, rate_hz=5.0)
    set_keys(tmp_path, "displacement", exposure_s=0.17)
    calibration = midspan.calibrate(tmp_path)
    for given in (None, calibration):
        for method in ("smoother", "kalman"):
            result = midspan.estimate(tmp_path, calibration=given, method=method)
            assert not any("clock" in line or "shifted" in line or "belong" in line for line in result.warnings)
            error = result.displacement_mm - moved(result.time_s)
            assert np.mean(np.abs(error) < 1.96 * result.displacement_std_mm) > 0.88
            assert np.max(np.abs(error) / result.displacement_std_mm) < 5.0


def test_a_shape_that_the_motion_excludes_is_not_in_the_band(tmp_path):
    # Over 0.25 s of a mode at 2.9 Hz: a mounting would have to resonate at 3.1 Hz.
    moved = write(tmp_path, 1, 0.25, rate_hz=3.7)
    result = midspan.estimate(tmp_path)
    error = result.displacement_mm - moved(result.time_s)
    assert any("averages over" in line and "resonat" not in line for line in result.warnings)
    assert np.mean(np.abs(error) < 1.96 * result.displacement_std_mm) > 0.85
    # All that the average takes was in every row, 0.6 mm.
    assert np.mean(result.displacement_std_mm) < 3.0 * np.std(error)


def test_zero_declares_that_it_does_not_average(tmp_path):
    write(tmp_path, 0, EXPOSURE_S)
    set_keys(tmp_path, "displacement", exposure_s=0.0)
    assert midspan.calibrate(tmp_path).displacement.exposure_s == 0.0


def test_an_accelerometer_that_resonates_on_its_mount_looks_the_same_and_is_in_the_band(tmp_path):
    """Of the fastest mode it reads 10 % too much."""
    moved = write(tmp_path, 0, 0.0)
    too_strong(tmp_path, 1.1)
    result = midspan.estimate(tmp_path)
    error = result.displacement_mm - moved(result.time_s)
    assert any("resonating accelerometer mount" in line for line in result.warnings)
    assert np.mean(np.abs(error) < 1.96 * result.displacement_std_mm) > 0.85


@pytest.mark.parametrize(("exposure_s", "times"), [(0.0, 1.1), (EXPOSURE_S, 1.0)])
def test_an_exposure_that_a_slow_sensor_explains_as_well_is_in_the_band_alone(exposure_s, times, tmp_path):
    """With a clock of its own nothing tells whether the sensor averages, follows slowly, or the accelerometer errs."""
    moved = write(tmp_path, 0, exposure_s, early_s=0.012)
    too_strong(tmp_path, times)
    set_keys(tmp_path, "displacement", estimate_offset=True)
    result = midspan.estimate(tmp_path)
    found = result.calibration
    assert found.displacement.exposure_s == 0.0
    assert any("cannot distinguish these" in line for line in result.warnings)
    # An average over 90 ms, or a tenth too much, leaves 2 to 3 % of the gain open.
    assert found.accelerometer_scale == pytest.approx(1.0, abs=3.0 * found.accelerometer_scale_std)
    error = result.displacement_mm - moved(result.time_s)
    assert np.mean(np.abs(error) < 1.96 * result.displacement_std_mm) > 0.85


def test_a_clock_at_another_rate_is_no_exposure(tmp_path):
    # Late by up to 50 ms, 25 ms to each side of the offset, which blurs the motion as an average over 45 ms does.
    write(tmp_path, 0, 0.0, length_s=500.0, skew=100e-6)
    set_keys(tmp_path, "displacement", estimate_offset=True)
    found = midspan.calibrate(tmp_path)
    assert found.displacement.exposure_s == 0.0
    # It was 0.974 ± 0.004.
    assert found.accelerometer_scale == pytest.approx(1.0, abs=3.0 * found.accelerometer_scale_std)
