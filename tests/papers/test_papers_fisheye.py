"""The vision camera of paper 001 as filmed, by a fisheye lens: against OpenCV, and estimated with the lens and without.

The frames are cut around the target, with a principal point that lies as far from it as in the whole frames.
"""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from scipy.ndimage import map_coordinates

import midspan
from midspan.papers.scenes import PUBLISHED
from midspan.records import Region
from midspan.simulate.scenarios.write import write
from midspan.simulate.scene.fisheye import bent_scene
from recording_edits import set_keys

SCENARIO = PUBLISHED["001-fisheye"]
FX, FY, CX, CY = SCENARIO.camera.fisheye.matrix
LIT, ROI = Region(50, 40, 128, 128), Region(82, 72, 64, 64)
CUT = SCENARIO.camera.fisheye.lit.x - LIT.x, SCENARIO.camera.fisheye.lit.y - LIT.y
LENS = replace(SCENARIO.camera.fisheye, matrix=(FX, FY, CX - CUT[0], CY - CUT[1]), size_px=(220, 240), lit=LIT, roi=ROI)


def shown(x, y):
    """Places (…, 2) in px that OpenCV gives to places of the ideal pinhole picture."""
    fx, fy, cx, cy = LENS.matrix
    rays = np.stack([(x - cx) / fx, (y - cy) / fy], axis=-1)
    matrix = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
    return cv2.fisheye.distortPoints(rays.reshape(-1, 1, 2), matrix, np.array(LENS.distortion)).reshape(rays.shape)


def scale_mm_per_px(folder):
    """The scale factor that is calibrated in the recording, and its standard deviation."""
    scale = midspan.calibrate(folder).camera.scale
    return 1e3 * scale.value_m_per_px, 1e3 * scale.variance**0.5


def test_the_frames_move_as_opencv_says():
    y, x = np.mgrid[54:154, 64:164].astype(float)
    ideal_x, ideal_y = LENS.ideal(x, y)
    np.testing.assert_allclose(shown(ideal_x, ideal_y), np.stack([x, y], axis=-1), atol=1e-8)
    scene = bent_scene(LENS, rng=np.random.default_rng(2))
    came_from = shown(ideal_x - 4.2, ideal_y + 1.7) - (LIT.x, LIT.y)
    expected = map_coordinates(scene.render(0.0, 0.0), (came_from[..., 1], came_from[..., 0]), order=5)
    rendered = scene.render(4.2, -1.7)[14:114, 14:114]
    # The spline through the pixels errs by 0.17 DN; with the middle's translation all over it is 0.72 DN.
    assert np.sqrt(np.mean((rendered - expected) ** 2)) < 0.3


def test_its_scale_factor_is_right_with_the_lens_and_a_quarter_off_without(tmp_path):
    short = replace(SCENARIO, duration_s=10.0, camera=replace(SCENARIO.camera, rate_hz=15.0, fisheye=LENS))
    folder = write("cut", tmp_path / "cut", seed=1, scenarios={"cut": short})
    with_lens, with_std = scale_mm_per_px(folder)
    set_keys(folder, "camera", lens=None)
    without, without_std = scale_mm_per_px(folder)
    true = SCENARIO.camera.scale_mm_per_px
    assert abs(with_lens - true) < 3 * with_std < 0.01 * abs(true)
    assert abs(without - true) > 30 * without_std
    # Without the lens it is divided by OpenCV's slope at the target, which changes by 2 % from its middle to a corner.
    x, y = LENS.ideal(np.array(ROI.x + 31.5), np.array(ROI.y + 31.5))
    slope = (shown(x + 0.5, y) - shown(x - 0.5, y))[0]
    assert without == pytest.approx(true / slope, rel=5e-3)
