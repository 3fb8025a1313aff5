"""Real images of a rotating mechanism (github.com/dicengine/dice), compared with the tracks of that program."""

import os
from pathlib import Path

import numpy as np
import pytest

from midspan.records import Frame, Region, Status
from midspan.vision.tracker import open_tracker

DATA = Path(os.environ.get("MIDSPAN_DATA", Path(__file__).parents[3] / "shared" / "data")) / "dice-simple-tracking"

pytestmark = pytest.mark.skipif(not DATA.is_dir(), reason=f"the images of dice-simple-tracking are not at {DATA}")


@pytest.fixture(scope="module")
def frames():
    import cv2

    paths = sorted(DATA.glob("images/mechanism_*.tif"))
    return [
        Frame(33_000_000 * k, np.asarray(cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)), k)
        for k, path in enumerate(paths)
    ]


def seen_by_translation(image, region, centre, angle):
    """Translation that least squares sees in `region` when the image turns by `angle` about `centre`."""
    gy, gx = np.gradient(image.astype(float))
    part = np.s_[region.y : region.y + region.height, region.x : region.x + region.width]
    g = np.stack([gx[part], gy[part]])
    y, x = np.mgrid[part]
    x, y = x - centre[0], y - centre[1]
    moved = np.stack([(np.cos(angle) - 1) * x - np.sin(angle) * y, np.sin(angle) * x + (np.cos(angle) - 1) * y])
    return np.linalg.solve(np.einsum("ahw,bhw->ab", g, g), np.einsum("ahw,bhw,bhw->a", g, g, moved))


@pytest.mark.parametrize(
    ("target", "region"), [(0, Region(320, 190, 44, 44)), (1, Region(247, 390, 24, 31)), (2, Region(244, 25, 44, 36))]
)
def test_translation_agrees_with_the_other_program_while_the_target_turns_little(frames, target, region):
    gold = np.genfromtxt(DATA / "gold" / f"DICe_solution_{target}.txt", delimiter=",", names=True)
    centre = (gold["COORDINATE_X"][0], gold["COORDINATE_Y"][0])
    little = np.flatnonzero(np.abs(gold["ROTATION_Z"]) < 0.02)
    tracker = open_tracker("template", frames[0], region)
    found = [tracker.push(frames[k]) for k in little]
    assert all(f.status is Status.TRACKING for f in found)
    expected = [
        np.array([gold["DISPLACEMENT_X"][k], gold["DISPLACEMENT_Y"][k]])
        + seen_by_translation(frames[0].pixels, region, centre, gold["ROTATION_Z"][k])
        for k in little
    ]
    error = np.array([(f.x_px, f.y_px) for f in found]) - expected
    # That program fits rotation on polygons and states 0.005 to 0.01 px; our window turns by up to 0.02 rad, 0.4 px at
    # its corners, which it can only average.
    assert np.sqrt(np.mean(error**2)) < 0.02
    deviation = np.sqrt([(f.variance_x_px2, f.variance_y_px2) for f in found])
    assert np.all(np.abs(error) < 3 * deviation + 0.01)
