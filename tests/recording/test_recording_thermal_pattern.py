"""What a thermal camera's fixed pattern does to a scale factor: stated no larger than it is, by a quiet structure."""

import numpy as np

import midspan

SIDE_PX, CANVAS_PX, REGION = 84, 128, [16, 16, 52, 52]
SCALE_MM_PER_PX, RATE_HZ, DURATION_S = -2.0, 8.0, 30.0
NOISE_K, PATTERN_K, CONTRAST_K = 0.05, 0.03, 0.45


def wall(rng, down_px):
    """A periodic texture of CONTRAST_K like 1/f through a sharp lens (0.4 px), moved down by each translation."""
    f = np.hypot(*np.meshgrid(np.fft.fftfreq(CANVAS_PX), np.fft.fftfreq(CANVAS_PX)))
    shape = np.exp(-2.0 * (np.pi * 0.4 * f) ** 2) / np.maximum(f, 1 / 12) * (f > 0) * (f < 0.5)
    spectrum = np.fft.fft2(rng.normal(size=(CANVAS_PX, CANVAS_PX))) * shape
    spectrum *= CONTRAST_K / np.std(np.fft.ifft2(spectrum).real)
    down = np.fft.fftfreq(CANVAS_PX)[:, None]
    for y in down_px:
        yield np.fft.ifft2(spectrum * np.exp(-2j * np.pi * down * y)).real[20 : 20 + SIDE_PX, 20 : 20 + SIDE_PX]


def filmed(folder, seed, rms_px=0.2):
    """A recording of a wall that moves by two sines, seen with the tracker for grey levels."""
    rng = np.random.default_rng(seed)
    folder.mkdir()
    hertz, size = np.array([0.9, 2.3]), rms_px * 1e-3 * SCALE_MM_PER_PX * np.array([1.2, 0.75])
    stamps, frames_s = np.arange(0.0, DURATION_S, 0.01), np.arange(0.5, DURATION_S - 0.5, 1 / RATE_HZ)
    turn = 2 * np.pi * hertz
    moved_m = np.sin(np.outer(frames_s, turn)) @ size
    acceleration = -np.sin(np.outer(stamps, turn)) @ (size * turn**2) + 5e-4 * rng.normal(size=len(stamps))
    table = np.column_stack((stamps, acceleration))
    np.savetxt(folder / "accel.csv", table, fmt="%.6f", delimiter=",", header="time_s,accel", comments="")
    pattern = PATTERN_K * rng.normal(size=(SIDE_PX, SIDE_PX))
    film = [20.0 + scene + pattern for scene in wall(rng, 1e3 * moved_m / SCALE_MM_PER_PX)]
    film = np.array(film, dtype=np.float32) + np.float32(NOISE_K) * rng.normal(size=np.shape(film)).astype(np.float32)
    np.savez(folder / "infrared.npz", celsius=film)
    (folder / "recording.toml").write_text(
        f"""
[accelerometer]
file = "accel.csv"
time = "time_s"
value = "accel"
unit = "m/s^2"
[infrared]
file = "infrared.npz"
rate_hz = {RATE_HZ}
start_s = 0.5
roi = {REGION}
direction = "y"
tracker = "features"
temperature_range_c = [18.0, 22.0]
"""
    )
    return folder


def test_a_fine_scene_is_not_taken_for_a_strong_pattern(tmp_path):
    z = []
    for seed in range(4):
        scale = midspan.calibrate(midspan.open_recording(filmed(tmp_path / str(seed), seed))).infrared.scale
        error = 1e3 * scale.value_m_per_px / SCALE_MM_PER_PX - 1.0
        std = float(np.sqrt(scale.variance)) / abs(scale.value_m_per_px)
        # The finest detail of the scene is 0.06 K: taken for pattern it would be a share of 6 %.
        assert 0.003 < std < 0.04
        z.append(error / std)
    # Four draws of variance 1: their mean square exceeds 2.4 once in twenty.
    assert np.mean(np.square(z)) < 2.4
