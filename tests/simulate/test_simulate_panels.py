"""Parts of the picture at other distances, water, and motion along both axes."""

import numpy as np
import pytest

from midspan.records import Region
from midspan.simulate.motion.motion import Rest, Sines
from midspan.simulate.scenarios.stage import stage
from midspan.simulate.scenarios.table import SCENARIOS
from midspan.simulate.scene.camera import Camera, View
from midspan.simulate.scene.disturbances import Panel, Water
from midspan.simulate.scene.texture import textured_scene

REGION = Region(8, 12, 40, 32)
INSIDE = np.s_[12:44, 8:48]


@pytest.fixture(scope="module")
def scenes():
    wall, sign = np.random.default_rng(0).spawn(2)
    return textured_scene("natural", (64, 72), rng=wall), textured_scene("natural", (32, 40), rng=sign)


def test_a_panel_moves_further_by_its_nearness_and_the_rest_is_untouched(scenes):
    wall, sign = scenes
    view = View(wall, -1e-3, "y", panels=(Panel(REGION, sign, 2.0),))
    image = view.mean_image(Rest(1.5e-3), 0.0)
    np.testing.assert_array_equal(image[INSIDE], sign.render(0.0, -3.0))
    plain = View(wall, -1e-3, "y").mean_image(Rest(1.5e-3), 0.0)
    outside = np.ones(image.shape, dtype=bool)
    outside[INSIDE] = False
    np.testing.assert_array_equal(image[outside], plain[outside])


def test_a_panel_adds_its_own_motion_and_follows_a_rolling_shutter_by_its_rows(scenes):
    wall, sign = scenes
    own = Sines([0.7], [1.0])
    camera = Camera(exposure_s=0.0, readout_s=0.1)
    image = View(wall, -1e-3, "y", camera, panels=(Panel(REGION, sign, 1.0, own),)).mean_image(Rest(), 0.2)
    row = 20
    moment = 0.2 + 0.1 * row / 63
    expected = sign.render(0.0, float(own.displacement(np.array([moment]))[0]))
    # The row as it was at its own moment; rendering at one moment or at nine equal ones differs by rounding only.
    np.testing.assert_allclose(image[row, 8:48], expected[row - 12], atol=1e-2)


def test_motion_along_both_axes_is_a_translation_along_both(scenes):
    wall, _ = scenes
    image = View(wall, -1e-3, "y", Camera(exposure_s=0.0), across=Rest(2e-3)).mean_image(Rest(1e-3), 0.0)
    np.testing.assert_allclose(image, wall.render(-2.0, -1.0), atol=1e-3)


def test_water_has_the_contrast_that_was_asked_for_and_does_not_stand_still():
    water = Water(REGION, std_dn=20.0, rng=np.random.default_rng(1))
    pictures = []
    for time_s in np.linspace(0.0, 20.0, 60):
        image = np.zeros((64, 72), dtype=np.float32)
        water.disturb(image, float(time_s))
        pictures.append(image[INSIDE].astype(np.float64))
        assert np.all(image[:12] == 0.0)
    # Twelve waves over 60 moments: the standard deviation scatters by some 5 %.
    assert np.std(pictures) == pytest.approx(20.0, rel=0.15)
    assert abs(np.corrcoef(pictures[0].ravel(), pictures[3].ravel())[0, 1]) < 0.7


def test_two_axes_have_columns_of_acceleration_and_truth_for_both():
    staged = stage(SCENARIOS["two-axes"], 0)
    down, across = staged.truth_mm(), staged.truth_mm(staged.across)
    np.testing.assert_array_equal(down[:, 0], across[:, 0])
    assert abs(np.corrcoef(down[:, 1], across[:, 1])[0, 1]) < 0.5
    # Both channels have their own noise and the same bias.
    both = (staged.acceleration().value, staged.acceleration(across=True).value)
    for value, motion in zip(both, (staged.motion, staged.across), strict=True):
        noise = value - motion.acceleration(down[:, 0]) - 0.05
        assert np.std(noise) == pytest.approx(2.5e-3, rel=0.05)


def test_a_seed_gives_the_same_recording_whether_or_not_there_is_a_second_axis():
    # The scenarios that were there before must not change under anybody's feet.
    first = stage(SCENARIOS["footbridge"], 5)
    assert first.truth_mm()[1000, 1] == pytest.approx(stage(SCENARIOS["two-axes"], 5).motion.displacement(
        np.array([10.0]))[0] * 1e3 - 1e3 * first.zero_m(), abs=1e-9)  # fmt: skip
