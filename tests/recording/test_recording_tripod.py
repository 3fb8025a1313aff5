"""A camera on a tripod that looks at the structure: the sign turns, and the fixed background is not the target."""

import numpy as np
import pytest
from scipy import ndimage

import midspan

RATE_HZ, FRAME_HZ, LENGTH_S = 100.0, 8.0, 30.0
MM_PER_PX, NOISE_MM_S2, NOISE_DN = 1.5, 3.0, 1.0
# Rows of the image that show the structure, of SHAPE; the rest is what is behind and in front of it.
SHAPE, DECK = (200, 280), slice(60, 140)


def displacement_mm(at_s):
    """Of the structure, upwards: two modes and a slow load."""
    return (
        1.6 * np.sin(2 * np.pi * 1.1 * at_s) + 0.7 * np.sin(2 * np.pi * 2.9 * at_s + 1.0)
        + 2.0 * np.sin(2 * np.pi * 0.05 * at_s)
    )  # fmt: skip


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A recording whose accelerometer reads +1 g at rest."""
    folder = tmp_path_factory.mktemp("tripod")
    rng = np.random.default_rng(5)
    at_s = np.arange(round(LENGTH_S * RATE_HZ)) / RATE_HZ
    step = 1e-3
    upwards = (displacement_mm(at_s + step) - 2 * displacement_mm(at_s) + displacement_mm(at_s - step)) / step**2
    accel = upwards + 9806.65 + rng.normal(0.0, NOISE_MM_S2, len(at_s))
    np.savez(folder / "accel.npz", time_s=at_s, accel=1e-3 * accel)

    def texture(shape):
        return 120 + 60 * ndimage.gaussian_filter(rng.standard_normal(shape), 1.5, mode="wrap") / 0.19

    behind, deck = texture(SHAPE), np.fft.fft2(texture((128, SHAPE[1])))
    frame_s = np.arange(round(LENGTH_S * FRAME_HZ)) / FRAME_HZ
    frames = np.empty((len(frame_s), *SHAPE), dtype=np.uint8)
    for n, one_s in enumerate(frame_s):
        # Up is towards smaller rows: the structure moves by -d / scale px in the image.
        moved = np.fft.ifft2(ndimage.fourier_shift(deck, (-displacement_mm(one_s) / MM_PER_PX, 0.0))).real
        picture = behind.copy()
        picture[DECK] = moved[: DECK.stop - DECK.start]
        frames[n] = np.clip(picture + rng.normal(0.0, NOISE_DN, SHAPE), 0, 255).round()
    np.savez(folder / "camera.npz", frames=frames, time_s=frame_s)
    (folder / "recording.toml").write_text(
        '[accelerometer]\nfile = "accel.npz"\ntime = "time_s"\nvalue = "accel"\nunit = "m/s^2"\n'
        '[camera]\nfile = "camera.npz"\ndirection = "y"\nexposure_s = 0.0001\n'
    )
    return folder


def test_a_tripods_scale_is_negative_where_the_accelerometer_points_up_and_its_region_lies_on_the_structure(folder):
    result = midspan.estimate(midspan.open_recording(folder))
    found = result.calibration.camera
    # Five of its own standard deviations: the sign is what matters, a wrong one is some hundreds off.
    assert abs(1e3 * found.scale.value_m_per_px + MM_PER_PX) < 5e3 * np.sqrt(found.scale.variance)
    rows = range(max(found.region.y, DECK.start), min(found.region.y + found.region.height, DECK.stop))
    # Places lie on a coarse grid: what of the background is left in one must be too little to slow the motion down.
    assert len(rows) > 0.75 * found.region.height
    # The displacement has the accelerometer's sign, and counts from the first frame.
    table = result.to_pandas()
    assert table["status"].eq("tracking").mean() > 0.95
    truth = displacement_mm(table.index.to_numpy()) - displacement_mm(0.0)
    error = table["displacement_mm"].to_numpy() - truth
    assert np.std(error) < 0.02
    assert np.mean(np.abs(error) < 1.96 * table["displacement_std_mm"]) > 0.6
