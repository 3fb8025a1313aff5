"""A camera whose ratio to the accelerometer depends on frequency: its exposure, a tower that leans, a logger."""

import numpy as np
import pytest

import midspan
from recording_edits import set_keys
from repeats import slow

RATE_HZ, LENGTH_S, SCALE_MM_PX, CANVAS = 10.0, 40.0, -2.0, 96
GRAVITY_M_S2 = 9.80665


def write(folder, seed, *, exposure_s=0.0, slope=0.0, late_hz=np.inf, resonance_hz=np.inf):
    """A camera recording whose motion is a sum of sines; returns its truth as a function of s, mm.

    late_hz: of a low-pass in the logger, a cascade of four first-order ones without their delay at 0 Hz; resonance_hz:
    of a bracket below the accelerometer.
    """
    rng = np.random.default_rng(seed)
    f = np.concatenate([mode + 0.02 * mode * rng.normal(size=8) for mode in (0.6, 1.5, 2.6, 3.6)])
    s = 2j * np.pi * f
    c = 3.0 / f * (rng.normal(size=len(f)) + 1j * rng.normal(size=len(f))) / np.sqrt(16.0)

    def at(time, amplitude):
        return (np.exp(np.outer(np.ravel(time), s)) @ amplitude).real.reshape(np.shape(time))

    time, met = np.arange(0.0, LENGTH_S, 0.01), np.arange(0.503, LENGTH_S - 0.5, 1.0 / RATE_HZ)
    logger = (np.exp(s / (2 * np.pi * late_hz)) / (1.0 + s / (2 * np.pi * late_hz))) ** 4
    logger = logger / (1.0 + (s / (2 * np.pi * resonance_hz)) ** 2)
    accel = 1e-3 * at(time, c * (s**2 - GRAVITY_M_S2 * slope) * logger) + rng.normal(0.0, 2e-3, len(time)) + 0.05
    np.savetxt(folder / "a.csv", np.column_stack((time, accel)), "%.9f", ",", header="time_s,value", comments="")

    turns = np.fft.fftfreq(CANVAS)
    radius = np.hypot(turns[:, None], turns[None, :])
    blur = np.exp(-2 * (0.8 * np.pi * radius) ** 2) / np.maximum(radius, 1 / 24) * (radius > 0)
    texture = np.fft.fft2(rng.normal(size=(CANVAS, CANVAS))) * blur
    texture *= 30.0 / np.std(np.fft.ifft2(texture).real)
    within = ((np.arange(7) + 0.5) / 7 - 0.5) * exposure_s
    moved_px = at(met[:, None] + within, c) / SCALE_MM_PX
    stack = []
    for row in moved_px:
        shift = np.exp(-2j * np.pi * np.multiply.outer(turns, row)).mean(axis=1)
        film = np.fft.ifft2(texture * shift[:, None]).real[16:-16, 16:-16]
        stack.append(np.clip(np.rint(110 + film + rng.normal(0, 1.5, film.shape)), 0, 255))
    np.save(folder / "camera.npy", np.array(stack, dtype=np.uint8))
    (folder / "recording.toml").write_text(
        '[accelerometer]\nfile = "a.csv"\nunit = "m/s^2"\n'
        f'[camera]\nfile = "camera.npy"\nrate_hz = {RATE_HZ}\nstart_s = {met[0]}\ndirection = "y"\n'
    )
    return lambda time: at(time, c) - at(met[:1], c)


def held(folder, truth, **estimated):
    """Estimate, and check scale factor and band; returns the result."""
    result = midspan.estimate(folder, **estimated)
    scale = result.calibration.camera.scale
    assert abs(1e3 * scale.value_m_per_px - SCALE_MM_PX) < 3.0 * 1e3 * np.sqrt(scale.variance)
    z = (result.displacement_mm - truth(result.time_s)) / result.displacement_std_mm
    assert np.mean(np.abs(z) < 1.96) > 0.85
    assert np.max(np.abs(z)) < 8.0
    return result


def error_mm(result, truth):
    return float(np.sqrt(np.mean((result.displacement_mm - truth(result.time_s)) ** 2)))


@pytest.mark.parametrize("method", ["kalman", *slow("smoother")])
def test_an_exposure_that_was_not_declared(method, tmp_path):
    truth = write(tmp_path, 1, exposure_s=0.06)
    result = held(tmp_path, truth, method=method)
    assert result.calibration.camera.exposure_s == pytest.approx(0.06, rel=0.05)
    assert any("declare exposure_s" in line for line in result.warnings)
    again = midspan.load_calibration(result.calibration.save(tmp_path / "calibration.json"))
    assert again.camera.exposure_s == pytest.approx(result.calibration.camera.exposure_s)
    # Declared, it is the same.
    set_keys(tmp_path, "camera", exposure_s=0.06)
    reported = held(tmp_path, truth, method=method)
    assert reported.calibration.camera.exposure_s == 0.0
    assert not any("exposure" in line for line in reported.warnings)
    assert error_mm(result, truth) < 1.3 * error_mm(reported, truth)


@pytest.mark.parametrize("broken", [{"resonance_hz": 27.0}, *slow({"exposure_s": 0.03})])
def test_an_exposure_and_an_accelerometer_that_errs_alike_are_both_in_the_band(broken, tmp_path):
    # Both make 3.6 Hz 1.9 % smaller together with the acceleration; no likelihood tells them apart.
    truth = write(tmp_path, 1, **broken)
    result = held(tmp_path, truth)
    assert result.calibration.camera.exposure_s == 0.0
    assert any("cannot distinguish these" in line for line in result.warnings)
    # The scale factor lies between what both would make it, half a per cent apart at most.
    assert abs(1e3 * result.calibration.camera.scale.value_m_per_px / SCALE_MM_PX - 1.0) < 5e-3


def test_a_tower_that_leans(tmp_path):
    truth = write(tmp_path, 2, slope=1.5 / 30)
    result = held(tmp_path, truth)
    assert result.calibration.slope == pytest.approx(1.5 / 30, rel=0.15)
    assert any("tilt" in line for line in result.warnings)
    assert result.calibration.to_dict()["accelerometer"]["slope_rad_m"] == result.calibration.slope
    # Gravity is out of the estimate as well: on a beam of the same motion the error is as large.
    own = error_mm(result, truth)
    upright = write(tmp_path, 2)
    assert own < 1.3 * error_mm(held(tmp_path, upright), upright)


def test_a_logger_that_delays_fast_motion(tmp_path):
    truth = write(tmp_path, 3, late_hz=20.0)
    result = held(tmp_path, truth)
    assert any("low-pass" in line for line in result.warnings)
    # The clock offset is that of slow motion.
    assert abs(result.calibration.camera.offset.value_s) < 1e-3


def test_nothing_of_it_is_seen_where_nothing_is(tmp_path):
    truth = write(tmp_path, 4)
    result = held(tmp_path, truth)
    assert result.calibration.camera.exposure_s == 0.0
    assert result.calibration.slope == 0.0
    assert not result.warnings
