"""Frames that show nothing: every tracker says LOST (or tells its error honestly), and finds the target again."""

import numpy as np
import pytest

from midspan.records import Frame, Prediction, Region, Status
from midspan.simulate.scene.camera import Camera
from midspan.simulate.scene.texture import textured_scene
from midspan.vision.tracker import TRACKERS, open_tracker

REGION, BAD, COUNT = Region(60, 48, 64, 64), range(8, 14), 22
FAR_PX = 75.0


def away(scene, camera, rng):
    return camera.expose(scene.render(FAR_PX, 0.0), rng=rng)


def exposed(factor):
    return lambda scene, camera, rng: camera.expose((factor * scene.render(0.0, 0.0)).astype(np.float32), rng=rng)


def constant(value, dtype=np.uint8):
    return lambda scene, camera, rng: np.full((scene.rows, scene.columns), value, dtype=dtype)


def grey_noise(scene, camera, rng):
    return camera.expose(np.full((scene.rows, scene.columns), 128, dtype=np.float32), rng=rng)


def half_without_values(scene, camera, rng):
    pixels = camera.expose(scene.render(0.0, 0.0), rng=rng).astype(np.float32)
    pixels[60:100] = np.nan
    return pixels


MAKERS = {
    "black": constant(0),
    "dark with noise": exposed(0.0),
    "nearly dark": exposed(0.01),
    "white": constant(255),
    "overexposed six times": exposed(6.0),
    "grey": constant(128),
    "grey with noise": grey_noise,
    "target out of the image": away,
    "no values": constant(np.nan, np.float32),
    "half without values": half_without_values,
    "infinite": constant(np.inf, np.float32),
}

# With a prediction a tracker looks near the expected place only; these could tempt it there.
LED = ("overexposed six times", "target out of the image")


@pytest.fixture(scope="module")
def wall():
    rng = np.random.default_rng(5)
    scene = textured_scene("natural", (160, 200), rng=rng, reach_px=80.0)
    path = 0.4 * np.sin(0.5 * np.arange(COUNT))
    return scene, path, [Camera().expose(scene.render(0.0, float(y)), rng=rng) for y in path]


@pytest.mark.parametrize(("case", "predicted"), [*((case, False) for case in MAKERS), *((case, True) for case in LED)])
@pytest.mark.parametrize("name", TRACKERS)
def test_a_frame_without_the_target_gives_no_wrong_number_and_the_target_is_found_again(wall, name, case, predicted):
    scene, path, good = wall
    rng = np.random.default_rng(9)
    pictures = [MAKERS[case](scene, Camera(), rng) if k in BAD else picture for k, picture in enumerate(good)]
    kind = np.float32 if any(picture.dtype.kind == "f" for picture in pictures) else np.uint8
    frames = [Frame(100_000_000 * k, picture.astype(kind), k) for k, picture in enumerate(pictures)]
    tracker = open_tracker(name, frames[0], REGION)
    rows = [
        tracker.push(frame, Prediction(0.0, float(y), 0.05, 0.05) if predicted else None)
        for frame, y in zip(frames, path, strict=True)
    ]
    for k in BAD:
        if rows[k].status == Status.LOST:
            assert np.isnan([rows[k].x_px, rows[k].y_px, rows[k].variance_x_px2, rows[k].variance_y_px2]).all()
            continue
        # What is found all the same must not be further off than five of its standard deviations.
        where = (FAR_PX, 0.0) if case == "target out of the image" else (0.0, 0.0)
        off = np.hypot(rows[k].x_px - where[0], rows[k].y_px - where[1])
        assert off < 5.0 * np.sqrt(rows[k].variance_x_px2 + rows[k].variance_y_px2)
    # A finite recovery: at the second good frame at the latest.
    for k in range(BAD.stop + 1, COUNT):
        assert rows[k].status != Status.LOST
        assert abs(rows[k].y_px - path[k]) < 0.1
