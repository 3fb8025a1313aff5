"""Storey model, outdoor table and footbridge of Ma, Choi, Liu and Sohn (doi 10.1016/j.autcon.2022.104338), as films."""

import numpy as np
import pytest

from midspan.evaluate.papers import camera_alone, fused, recorded_frames
from midspan.simulate.scenarios.papers import FilmSettings, film, write_recording
from midspan.vision.tracker import tracker_settings

CUT = {
    "indoor": FilmSettings(10.0, 10.0, ("sine", "sweep")),
    "outdoor": FilmSettings(10.0, 10.0, ("sine", "sweep")),
    "footbridge-phase": FilmSettings(12.0, 10.0, ("jumping", "crossing")),
}
FRAMES = 2 * 10.0 * 9.99
# An rms over n frames scatters by 1 / sqrt(2 n) of itself: the goals hold for the mean of many.
SCATTER = 1.0 / np.sqrt(2.0 * FRAMES)
GOALS_MM = {"indoor": 0.015 * 2.11 / 2.289, "outdoor": 0.16, "footbridge-phase": 0.007}


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    known = {}

    def make(name, *, compressed=False):
        if (name, compressed) not in known:
            scene = film(name, CUT[name])
            folder = write_recording(scene, tmp_path_factory.mktemp("papers") / name, compressed=compressed)
            known[name, compressed] = scene, folder, recorded_frames(folder)
        return known[name, compressed]

    return make


@pytest.fixture(scope="module")
def alone(recorded):
    known = {}

    def run(name, tracker, *, compressed=False, **values):
        key = name, tracker, compressed, *values
        if key not in known:
            scene, _, frames = recorded(name, compressed=compressed)
            settings = tracker_settings(tracker, **values)
            known[key] = camera_alone(scene, frames, tracker=tracker, settings=settings)
        return known[key]

    return run


# The window far away is a facade that repeats: the published rejection alone may lose it, so ours is compared there.
@pytest.mark.parametrize(("name", "literal"), [("indoor", True), ("outdoor", False), ("footbridge-phase", True)])
def test_the_hybrid_halves_the_error_of_feature_matching(alone, name, literal):
    hybrid, features = alone(name, "hybrid"), alone(name, "features", literal=literal)
    assert hybrid.lost == features.lost == 0
    # Published: 53 % lower at most indoors, 73 % on the bridge (table 7).
    assert hybrid.mean_mm < 0.5 * features.mean_mm


@pytest.mark.parametrize("name", CUT)
def test_registration_is_near_the_bound_and_never_below_it(recorded, alone, name):
    scene, _, _ = recorded(name)
    bound_mm = scene.bound_px * scene.scene.scale_mm_per_px
    found = alone(name, "registration")
    assert found.lost == 0
    assert found.mean_mm > bound_mm * (1.0 - 3.0 * SCATTER)
    assert found.mean_mm < GOALS_MM[name] * (1.0 + 2.0 * SCATTER)


@pytest.mark.parametrize("name", CUT)
def test_hybrid_and_the_adaptive_filter_stay_below_the_published_error(recorded, alone, name):
    scene, folder, _ = recorded(name)
    found = fused(scene, folder, tracker="hybrid", methods=("adaptive-kalman",))["adaptive-kalman"]
    assert found.mean_mm < scene.scene.published_mm
    # Acceleration is added information: between the frames, too, the error stays below the frames' own.
    assert found.mean_mm < alone(name, "hybrid").mean_mm


def test_compression_sets_the_floor_for_every_tracker(alone):
    errors = [alone("footbridge-phase", name, compressed=True).mean_mm for name in ("registration", "template")]
    lossless = alone("footbridge-phase", "registration").mean_mm
    # 0.035 mm is the goal at crf 20: 0.026 px. What the codec took away no estimator gives back, so both agree.
    assert max(errors) < 0.035 * (1.0 + 2.0 * SCATTER)
    assert min(errors) > 2.0 * lossless
    assert errors[0] == pytest.approx(errors[1], rel=0.15)


def test_films_are_the_same_again_and_the_video_is_lossless(recorded):
    scene, _, frames = recorded("outdoor")
    short = FilmSettings(2.0, 3.5, ("sweep",))
    assert np.array_equal(film("outdoor", short).frames, film("outdoor", short).frames)
    assert all(np.array_equal(frame.pixels, pixels) for frame, pixels in zip(frames, scene.frames, strict=True))
    assert np.allclose([frame.time_ns for frame in frames], 1e9 * scene.stamps_s, atol=1.0)
    # The texture's contrast gives the bound that the scene asks for; noise that changes with it leaves 4 %.
    assert scene.bound_px == pytest.approx(scene.scene.bound_px, rel=0.04)
