"""A camera on a tripod that looks at the structure: the sign turns, and the fixed background is not the target."""

import re

import numpy as np
import pytest
from scipy import ndimage

import midspan

RATE_HZ, FRAME_HZ, LENGTH_S = 100.0, 8.0, 30.0
MM_PER_PX, NOISE_MM_S2, NOISE_DN = 1.5, 3.0, 1.0
# Rows of the image that show the structure, of SHAPE; the rest is what is behind and in front of it.
SHAPE, DECK = (200, 280), slice(60, 140)


# Frequencies of a structure under traffic, Hz.
TRAFFIC_HZ = np.array([0.83, 1.1, 1.37, 1.71, 2.03, 2.45, 2.9])


def traffic_mm(at_s):
    """Of the structure, upwards, under traffic that never repeats."""
    return 0.8 * np.sin(2 * np.pi * np.multiply.outer(at_s, TRAFFIC_HZ) + 1.9 * np.arange(7) ** 2).sum(axis=-1)


def displacement_mm(at_s):
    """Of the structure, upwards: two modes and a slow load."""
    return (
        1.6 * np.sin(2 * np.pi * 1.1 * at_s) + 0.7 * np.sin(2 * np.pi * 2.9 * at_s + 1.0)
        + 2.0 * np.sin(2 * np.pi * 0.05 * at_s)
    )  # fmt: skip


def record(folder, motion_mm, *, late_s=0.0, behind_share=1.0):
    """A recording whose accelerometer reads +1 g at rest.

    late_s: how long the film begins after its times say; behind_share: contrast of the background, of the structure's.
    """
    rng = np.random.default_rng(5)
    at_s = np.arange(round((LENGTH_S + late_s) * RATE_HZ)) / RATE_HZ
    step = 1e-3
    upwards = (motion_mm(at_s + step) - 2 * motion_mm(at_s) + motion_mm(at_s - step)) / step**2
    accel = upwards + 9806.65 + rng.normal(0.0, NOISE_MM_S2, len(at_s))
    np.savez(folder / "accel.npz", time_s=at_s, accel=1e-3 * accel)

    def texture(shape):
        return 120 + 45 * ndimage.gaussian_filter(rng.standard_normal(shape), 1.5, mode="wrap") / 0.19

    behind, deck = texture(SHAPE), np.fft.fft2(texture((128, SHAPE[1])))
    frame_s = np.arange(round(LENGTH_S * FRAME_HZ)) / FRAME_HZ
    frames = np.empty((len(frame_s), *SHAPE), dtype=np.uint8)
    for n, one_s in enumerate(frame_s + late_s):
        # Up is towards smaller rows: the structure moves by -d / scale px in the image.
        moved = np.fft.ifft2(ndimage.fourier_shift(deck, (-motion_mm(one_s) / MM_PER_PX, 0.0))).real
        picture = 120 + behind_share * (behind - 120)
        picture[DECK] = moved[: DECK.stop - DECK.start]
        frames[n] = np.clip(picture + rng.normal(0.0, NOISE_DN, SHAPE), 0, 255).round()
    np.savez(folder / "camera.npz", frames=frames, time_s=frame_s)
    (folder / "recording.toml").write_text(
        '[accelerometer]\nfile = "accel.npz"\ntime = "time_s"\nvalue = "accel"\nunit = "m/s^2"\n'
        '[camera]\nfile = "camera.npz"\ndirection = "y"\nexposure_s = 0.0001\n'
    )
    return folder


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A film on the accelerometer's clock."""
    return record(tmp_path_factory.mktemp("tripod"), displacement_mm)


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


@pytest.mark.parametrize("late_s", [1.1, 14.0])
def test_the_region_lies_on_the_structure_although_the_film_begins_later_than_its_times_say(tmp_path, late_s):
    found = midspan.calibrate(record(tmp_path, traffic_mm, late_s=late_s, behind_share=0.5)).camera
    assert abs(found.offset.value_s - late_s) < 5.0 * np.sqrt(found.offset.variance)
    assert abs(1e3 * found.scale.value_m_per_px + MM_PER_PX) < 5e3 * np.sqrt(found.scale.variance)


def test_a_refusal_names_the_region_that_was_chosen_and_how_to_look_at_it(folder, tmp_path):
    accel = dict(np.load(folder / "accel.npz"))
    accel["accel"] = np.random.default_rng(0).normal(9.8, 1e-3, len(accel["accel"]))
    np.savez(tmp_path / "accel.npz", **accel)
    for name in ("camera.npz", "recording.toml"):
        (tmp_path / name).symlink_to(folder / name)
    with pytest.raises(midspan.UntrustedError) as refused:
        midspan.calibrate(tmp_path)
    assert re.search(r"\[\d+, \d+, 64, 64\].* chosen.* --picture", refused.value.more)
