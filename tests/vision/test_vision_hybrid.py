import functools
import math

import numpy as np
import pytest

from midspan.errors import DataError, UsageError
from midspan.records import Prediction, Region, Status
from midspan.vision.hybrid import HybridTracker, PhaseSettings, PhaseTracker
from midspan.vision.tracker import open_tracker

SIDE = 168
REGION = Region(52, 52, 64, 64)
NOISE = 1.5
NOISE_WITH_ROUNDING = np.sqrt(NOISE**2 + 1.0 / 12.0)


@pytest.fixture(scope="module")
def scene(make_scene):
    return make_scene(4, highest=0.5, waves=300, lens_px=0.6)


@pytest.fixture(scope="module")
def start(scene, make_frame, camera):
    def make(kind=HybridTracker, seed=0, where=scene, **values):
        reference = camera(where.image(SIDE, SIDE), np.random.default_rng(seed), NOISE)
        return kind(make_frame(reference), REGION, PhaseSettings(**values))

    return make


def motion(count, amplitude):
    k = np.arange(count)
    return np.stack([0.6 * amplitude * np.sin(0.83 * k), amplitude * np.sin(0.57 * k)], axis=1)


@pytest.fixture(scope="module")
def film(scene, make_frame, camera):
    def make(positions, seed=1, first=0, where=scene):
        rng = np.random.default_rng(seed)
        return [make_frame(camera(where.image(SIDE, SIDE, *p), rng, NOISE), first + k) for k, p in enumerate(positions)]

    return make


@pytest.fixture(scope="module")
def learning(film):
    return film(motion(60, 2.7), seed=8)


def results(tracker, frames, positions=None, *, std=None, seed=2):
    """Translations (n, 2), their variances and statuses; with `std`, predictions that are off by as much."""
    rng = np.random.default_rng(seed)
    rows = []
    for k, item in enumerate(frames):
        near = None
        if std is not None:
            near = Prediction(*(positions[k] + rng.normal(0, std, 2)), std, std)
        rows.append(tracker.push(item, near))
    place = np.array([(r.x_px, r.y_px) for r in rows])
    return place, np.array([(r.variance_x_px2, r.variance_y_px2) for r in rows]), [r.status for r in rows]


@pytest.mark.parametrize("std", [None, 0.3])
def test_thirty_pixels_of_motion_are_followed_without_one_wrap(start, film, learning, scene, std):
    tracker = start()
    tracker.learn(learning)
    positions = motion(40, 30.0)
    found, _, statuses = results(tracker, film(positions), positions, std=std)
    assert set(statuses) == {Status.TRACKING}
    # One wrap would be an error of some 5 px; noise of reference and frame, and a bias of 0.3 of that, is left.
    bound = scene.bound(SIDE, SIDE, REGION, NOISE_WITH_ROUNDING)
    assert np.all(np.sqrt(np.mean((found - positions) ** 2, axis=0)) < 3.0 * bound)
    assert np.abs(found - positions).max() < 0.03
    # The prediction is good enough for phase alone; without one, matching finds the place in every frame.
    assert tracker.state.matched_frames == (40 if std is None else 0)


def test_reported_deviation_is_the_error(start, film, learning):
    errors, reported = [], []
    positions = motion(15, 3.0)
    frames = film(positions)
    for seed in range(8):  # the reference's noise is an error that all frames share
        tracker = start(seed=seed + 20)
        tracker.learn(learning)
        found, variance, _ = results(tracker, frames, positions, std=0.3)
        errors.append((found - positions) ** 2)
        reported.append(variance)
    # Eight references and two axes carry ±18 % on their own.
    assert 0.8 < np.sqrt(np.mean(reported) / np.mean(errors)) < 1.3


def test_a_doubtful_prediction_is_matched_first_and_gives_the_same(start, film, learning):
    positions = motion(10, 9.0)
    frames = film(positions)
    tracker = start()
    tracker.learn(learning)
    before = tracker.state
    exact, _, _ = results(tracker, frames, positions, std=0.1)
    assert tracker.state.matched_frames == 0
    tracker.restore(before)
    rows = [
        tracker.push(item, Prediction(x + 2.5, y - 2.0, 1.5, 1.5))
        for item, (x, y) in zip(frames, positions, strict=True)
    ]
    doubtful = np.array([(r.x_px, r.y_px) for r in rows])
    assert tracker.state.matched_frames == 10
    # The same region and the same pixels; residuals next to half a pixel may round either way.
    assert doubtful == pytest.approx(exact, abs=0.01)


def test_the_bound_of_the_residual_decides_between_the_branches(start):
    tracker = start()
    limit = (math.pi * min(abs(g) for g in tracker.phase_gain_px_per_rad) - 0.5) / 3.0
    assert not tracker.could_wrap(Prediction(0.0, 0.0, 0.99 * limit, 0.99 * limit))
    assert tracker.could_wrap(Prediction(0.0, 0.0, 1.01 * limit, 1.01 * limit))
    assert tracker.could_wrap(None)


def test_gains_before_and_after_learning_agree_with_the_closed_form_of_a_plane_wave_pair(start, film, make_frame):
    # Two waves, one along each axis, of 0.2 and 0.16 cycles/px: the gain is -1 / (2 π f).
    y, x = np.mgrid[0:SIDE, 0:SIDE]

    class Waves:
        def image(self, columns, rows, dx=0.0, dy=0.0):
            return 120 + 40 * np.cos(2 * np.pi * 0.2 * (x - dx) + 0.3) + 40 * np.cos(2 * np.pi * 0.16 * (y - dy) + 0.5)

    expected = (-1 / (2 * np.pi * 0.2), -1 / (2 * np.pi * 0.16))
    tracker = start(PhaseTracker, where=Waves())
    assert tracker.phase_gain_px_per_rad == pytest.approx(expected, rel=0.02)  # noise turns the reference's own slope
    tracker.learn(film(motion(60, 0.45), where=Waves()))
    assert tracker.phase_gain_px_per_rad == pytest.approx(expected, rel=0.008)  # the pair's ripple, chosen by R²


def test_learning_from_a_given_translation_takes_over_its_unit_along_its_axis(start, film):
    # A translation reported 5 % too large must come back 5 % too large, along its axis only.
    positions = motion(60, 0.45)
    frames = film(positions)
    announced = start(PhaseTracker)
    announced.learn(frames, 1.05 * positions[:, 1], direction="y")
    found, _, _ = results(announced, film(positions, seed=5))
    slopes = [np.polyfit(positions[:, k], found[:, k], 1)[0] for k in (0, 1)]
    # 60 frames of 0.004 px over 0.19 and 0.32 px rms: 0.3 % for the slopes here, and as much for those learned.
    assert slopes == pytest.approx([1.0, 1.05], abs=0.012)


def test_an_axis_without_motion_keeps_its_gain_and_the_other_is_learned(start, film):
    tracker = start()
    before = tracker.phase_gain_px_per_rad
    model = tracker.learn(film(motion(60, 0.4) * [0.0, 1.0]))
    assert tracker.phase_gain_px_per_rad[0] == before[0]
    assert math.isnan(model.r_squared[0])
    assert model.r_squared[1] > 0.999


def test_active_pixels_keep_half_of_the_information_and_more_than_a_few(start, learning):
    tracker = start()
    tracker.learn(learning)
    for mask in (tracker.active_pixels.x, tracker.active_pixels.y):
        assert mask.shape == (64, 64)
        assert mask.sum() > 0.1 * mask.size


def test_motion_across_the_axis_does_not_move_it(start, film, learning):
    tracker = start()
    tracker.learn(learning)
    across = np.linspace(-0.5, 0.5, 11)
    frames = film([(d, 0.0) for d in across])
    y = np.array([tracker.push(f, Prediction(0.0, 0.0, 0.2, 0.2)).y_px for f in frames])
    # Noise of one frame is 0.003 px; with the filters of one axis alone the leak was 0.02 px and more.
    assert abs(np.polyfit(across, y, 1)[0]) < 0.006


def test_gain_and_offset_of_brightness_leave_the_phase_alone(start, scene, make_frame):
    tracker = start(PhaseTracker)
    image = scene.image(SIDE, SIDE, 0.2, -0.3)
    plain = tracker.push(make_frame(image), Prediction(0.0, 0.0, 0.2, 0.2))
    dim = tracker.push(make_frame(0.6 * image + 20.0), Prediction(0.0, 0.0, 0.2, 0.2))
    assert (dim.x_px, dim.y_px) == pytest.approx((plain.x_px, plain.y_px), abs=1e-5)


@pytest.mark.parametrize("share", [0.1, 0.3])
def test_what_stands_before_the_target_does_not_move_it(start, scene, make_frame, camera, learning, share):
    tracker = start()
    tracker.learn(learning)
    rng = np.random.default_rng(6)
    positions = motion(12, 0.9)
    found = []
    for k, place in enumerate(positions):
        image = scene.image(SIDE, SIDE, *place)
        image[REGION.y : REGION.y + REGION.height, REGION.x + 9 : REGION.x + 9 + round(64 * share)] = 40.0
        found.append(tracker.push(make_frame(camera(image, rng, NOISE), k), Prediction(*place, 0.3, 0.3)))
    error = np.array([(f.x_px, f.y_px) for f in found]) - positions
    sigma = np.sqrt([(f.variance_x_px2, f.variance_y_px2) for f in found])
    # The plain mean would be off by 0.1 px; fewer pixels, and those at the edge, cost less than a hundredth.
    assert np.sqrt(np.mean(error**2)) < 0.02
    assert np.sqrt(np.mean((error / sigma) ** 2)) < 2.0


@pytest.mark.parametrize("kind", [PhaseTracker, HybridTracker])
def test_black_frames_are_lost_and_the_target_is_found_again_elsewhere(start, film, make_frame, kind):
    tracker = start(kind)
    black = make_frame(np.zeros((SIDE, SIDE), dtype=np.uint8), 1)
    lost = tracker.push(black)
    assert lost.status is Status.LOST
    assert math.isnan(lost.y_px)
    found = tracker.push(film([(14.0, -18.3)], first=2)[0])
    assert found.status is Status.TRACKING
    assert (found.x_px, found.y_px) == pytest.approx((14.0, -18.3), abs=0.03)


def test_phase_alone_loses_a_jump_that_the_hybrid_follows(start, film):
    jump = film([(0.0, 14.0)])[0]
    phase, hybrid = start(PhaseTracker).push(jump), start(HybridTracker).push(jump)
    assert phase.status is Status.LOST
    assert hybrid.y_px == pytest.approx(14.0, abs=0.03)


def test_a_restored_tracker_goes_on_alike(start, film, learning):
    frames = film(motion(6, 4.0))
    one, two = start(), start()
    one.learn(learning)
    for item in frames[:3]:
        one.push(item)
    two.restore(one.state)
    assert [one.push(f) for f in frames[3:]] == [two.push(f) for f in frames[3:]]


@pytest.mark.parametrize("values", [{"form": "gradient"}, {"weighted": False}, {"active_pixels": "amplitude"}])
def test_the_conventional_forms_measure_too_but_worse(start, film, learning, values):
    positions = motion(15, 3.0)
    frames = film(positions)
    usual, compared = start(), start(functools.partial(open_tracker, "hybrid"), **values)
    usual.learn(learning)
    compared.learn(learning)
    rms = [np.sqrt(np.mean((results(t, frames, positions, std=0.3)[0] - positions) ** 2)) for t in (usual, compared)]
    assert rms[1] < 0.05
    assert rms[1] > 0.9 * rms[0]


def test_wrong_sizes_and_settings_are_refused(start, make_frame):
    tracker = start()
    with pytest.raises(DataError, match="168x168"):
        tracker.push(make_frame(np.zeros((100, 90), dtype=np.uint8)))
    with pytest.raises(DataError, match="at least 5 frames"):
        tracker.learn([make_frame(np.zeros((SIDE, SIDE), dtype=np.uint8))] * 8)
    for values in ({"form": "x"}, {"least_information": 1.5}, {"matcher": "hybrid"}, {"spacing": 3.0}):
        with pytest.raises(UsageError):
            PhaseSettings(**values)
    with pytest.raises(UsageError, match="texture"):
        HybridTracker(make_frame(np.full((SIDE, SIDE), 90, dtype=np.uint8)), REGION, PhaseSettings())
