"""The zero of a camera: the instant of the target's own rows, and the noise of the first frames."""

import numpy as np
import pytest

import midspan
from repeats import slow

SIDE, RATE_HZ, SCALE_MM_PX, LENGTH_S = 48, 12.0, 2.0, 40.0
SIZE_MM, HERTZ = np.array([4.0, 2.0]), np.array([1.1, 2.9])


def write(folder, seed, *, readout_s=0.0, noisy_s=0.0):
    """A film of waves that move down row by row; returns the displacement from an instant on (mm, s)."""
    rng = np.random.default_rng(seed)
    swell = rng.uniform(0.05, 0.1, 2)

    def at(time):
        # Started at full speed.
        parts = (
            SIZE_MM
            * np.sin(2 * np.pi * np.multiply.outer(time, HERTZ) + np.pi)
            * (1.0 + 0.3 * np.cos(2 * np.pi * np.multiply.outer(time, swell)))
        )
        return parts.sum(axis=-1)

    fine = np.arange(-0.02, LENGTH_S + 0.02, 1e-3)
    time = np.arange(0.0, LENGTH_S, 0.01)
    accel = 1e-3 * np.interp(time, fine[1:-1], np.diff(at(fine), 2) / 1e-6) + rng.normal(0.0, 2e-3, len(time))
    np.savetxt(folder / "a.csv", np.column_stack((time, accel)), "%.9f", ",", header="time_s,value", comments="")
    stamps = np.arange(0.5, LENGTH_S - 0.5, 1.0 / RATE_HZ)
    rows, columns = np.arange(SIDE), np.arange(SIDE)
    waves = rng.normal(0.0, 0.45, (25, 2))
    phase = rng.uniform(0.0, 6.28, 25)
    across = np.exp(1j * np.multiply.outer(waves[:, 1], columns)) * np.exp(1j * phase)[:, None]
    film = []
    for stamp in stamps:
        down = rows - at(stamp + readout_s * rows / (SIDE - 1)) / SCALE_MM_PX
        picture = np.real(np.exp(1j * np.multiply.outer(down, waves[:, 0])) @ across)
        noise = rng.normal(0.0, 30.0 if stamp < noisy_s else 2.0, picture.shape)
        film.append(np.clip(np.rint(128 + 10.0 * picture + noise), 0, 255))
    np.save(folder / "camera.npy", np.array(film, dtype=np.uint8))
    (folder / "recording.toml").write_text(
        '[accelerometer]\nfile = "a.csv"\nunit = "m/s^2"\n'
        f'[camera]\nfile = "camera.npy"\nrate_hz = {RATE_HZ}\nstart_s = {stamps[0]}\ndirection = "y"\n'
        f"roi = [8, 8, 32, 32]\nreadout_s = {readout_s}\n"
    )
    return lambda instants, zero_s: at(instants) - at(np.array([zero_s]))


@pytest.mark.parametrize("method", ["smoother", *slow("kalman")])
def test_the_zero_is_that_of_the_target_s_rows_in_the_first_frame(method, tmp_path):
    moved = write(tmp_path, 1, readout_s=0.03)
    result = midspan.estimate(tmp_path, method=method)
    row_s = 0.03 * 23.5 / (SIDE - 1)
    error = result.displacement_mm - moved(result.time_s, 0.5 + row_s)
    # The middle of what a random target shows lies within two rows of its region's, which at 60 mm/s are 0.08 mm.
    assert abs(np.mean(error)) < 3.0 * result.metadata()["zero_std_mm"] + 0.08
    # From the stamp on it would be ten times as far off.
    assert abs(np.mean(result.displacement_mm - moved(result.time_s, 0.5))) > 0.5


@pytest.mark.parametrize("seed", [0, *slow(1, 2)])
def test_the_zero_holds_the_noise_of_the_first_frames(tmp_path, seed):
    moved = write(tmp_path, seed, noisy_s=15.0)
    result = midspan.estimate(tmp_path)
    assert any("first frames are far noisier" in line for line in result.warnings)
    error = result.displacement_mm - moved(result.time_s, 0.5)
    assert abs(np.mean(error)) < 3.0 * result.metadata()["zero_std_mm"]


def test_frames_that_are_all_alike_leave_the_zero_as_it_is(tmp_path):
    write(tmp_path, 4)
    result = midspan.estimate(tmp_path)
    assert result.calibration.camera.apart_std_m == 0.0
    assert not any("noisier" in line for line in result.warnings)
