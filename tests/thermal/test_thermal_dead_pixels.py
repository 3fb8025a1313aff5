"""Dead pixels of a thermal camera: found among moving scenes, filled so that what is left is the scene."""

import numpy as np
import pytest

from midspan.thermal.dead_pixels import filled, stuck_pixels


def slope(rows=20, columns=24):
    y, x = np.mgrid[:rows, :columns]
    return (10.0 + 0.3 * x - 0.2 * y).astype(np.float32)


def film(rng, frames=32, step=0.0):
    """A scene that moves over the sensor with 0.05 K of noise, (frames, 40, 50) in °C, in numbers of this step."""
    moved = rng.integers(-3, 4, (frames, 2))
    texture = np.kron(rng.normal(15.0, 1.5, (12, 14)), np.ones((4, 4)))
    stack = np.stack([texture[4 + y : 44 + y, 3 + x : 53 + x] for y, x in moved]) + rng.normal(
        0, 0.05, (frames, 40, 50)
    )
    return (np.round(stack / step) * step if step else stack).astype(np.float32)


@pytest.mark.parametrize("hole", [np.s_[7, 9], np.s_[7, :], np.s_[5:9, 6:10]], ids=["pixel", "row", "block"])
def test_a_hole_in_a_plane_is_filled_with_the_plane(hole):
    dead = np.zeros((20, 24), dtype=bool)
    dead[hole] = True
    found = filled(np.where(dead, np.nan, slope()), dead)
    # A block is filled from its edge inwards, from one side: 0.36 K a pixel, and its middle is 2 px from its edge.
    atol = 0.72 if dead[5:9, 6:10].all() else 1e-4
    np.testing.assert_allclose(found[:, 1:-1], slope()[:, 1:-1], atol=atol)
    np.testing.assert_array_equal(found[~dead], slope()[~dead])


def test_a_single_pixel_is_filled_with_the_cubic_that_its_rows_and_columns_follow():
    y, x = np.mgrid[:20, :24]
    cubic = (0.01 * (x - 9.0) ** 3 + 0.02 * (y - 8.0) ** 3 + 0.1 * x * y).astype(np.float32)
    dead = np.zeros((20, 24), dtype=bool)
    dead[10, 12] = True
    assert filled(cubic, dead)[10, 12] == pytest.approx(cubic[10, 12], abs=1e-4)


def test_dead_columns_at_the_edge_take_what_lies_beside_them():
    dead = np.zeros((20, 24), dtype=bool)
    dead[:, :3] = True
    found = filled(slope(), dead)
    assert np.isfinite(found).all()
    assert np.abs(found - slope())[:, :3].max() < 3 * (0.3 + 0.2)  # three pixels, each from together with and below


@pytest.mark.parametrize("step", [0.0, 0.01, 0.04], ids=["floats", "0.01 K", "0.04 K"])
def test_pixels_stuck_at_the_scenes_own_temperature_are_found_and_no_others(step):
    stack = film(np.random.default_rng(1), step=step)
    wrong = np.zeros(stack.shape[1:], dtype=bool)
    wrong[5::11, 4::9] = True
    stack[:, wrong] = 15.0
    np.testing.assert_array_equal(stuck_pixels(stack), wrong)


def test_a_hot_pixel_with_noise_of_its_own_is_found():
    rng = np.random.default_rng(2)
    stack = film(rng)
    stack[:, 20, 30] = 60.0 + rng.normal(0.0, 0.5, len(stack))
    assert np.argwhere(stuck_pixels(stack)).tolist() == [[20, 30]]


def test_nothing_is_stuck_where_the_whole_picture_is_coarse_saturated_or_at_rest():
    stack = film(np.random.default_rng(3))
    for seen in (np.round(stack), np.clip(stack, 14.5, 15.5), np.repeat(stack[:1], 32, axis=0), stack[:8] * 0 + 15.0):
        assert not stuck_pixels(seen).any()
