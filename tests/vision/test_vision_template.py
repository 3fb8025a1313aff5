import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from midspan.errors import DataError, UsageError
from midspan.records import Prediction, Region, Status
from midspan.vision.template import TemplateSettings, TemplateTracker
from midspan.vision.tracker import open_tracker

SIDE = 200
REGION = Region(68, 70, 64, 64)
NOISE = 1.5
NOISE_WITH_ROUNDING = np.sqrt(NOISE**2 + 1.0 / 12.0)
# Low-discrepancy positions over ±1 px in both axes: all sub-pixel phases evenly.
POSITIONS = [((k * 0.618) % 1 * 2 - 1, (k * 0.414) % 1 * 2 - 1) for k in range(60)]


@pytest.fixture(scope="module")
def scene(make_scene):
    return make_scene(1)


@pytest.fixture(scope="module")
def start(make_frame, camera):
    def run(scene, *, rng=None, region=REGION, settings=None):
        image = scene.image(SIDE, SIDE)
        pixels = image if rng is None else camera(image, rng, NOISE)
        return open_tracker("template", make_frame(pixels), region, settings)

    return run


def errors(tracker, make_frame, images, positions):
    found = [tracker.push(make_frame(image, k + 1)) for k, image in enumerate(images)]
    error = np.array([(f.x_px, f.y_px) for f in found]) - np.array(positions)
    variance = np.array([(f.variance_x_px2, f.variance_y_px2) for f in found])
    return error, variance


@pytest.mark.parametrize("size", [48, 64, 128])
@pytest.mark.parametrize("seed", [1, 2])
def test_the_systematic_error_stays_below_a_thousandth_of_a_pixel_at_every_phase(
    make_scene, make_frame, start, seed, size
):
    scene = make_scene(seed)
    positions = [(k / 20, (7 * k % 20) / 20) for k in range(21)]
    tracker = start(scene, region=Region(30, 30, size, size))
    images = [scene.image(SIDE, SIDE, *p) for p in positions]
    # The goal is 0.003 px; the quintic spline leaves 0.0007 px with texture up to 0.35 cycles/px.
    assert np.abs(errors(tracker, make_frame, images, positions)[0]).max() < 0.001


def test_aliased_texture_still_stays_below_a_thousandth_of_a_pixel(make_scene, make_frame, start):
    # A sharp lens (0.6 px) lets texture beyond the Nyquist frequency through: no interpolation is exact then.
    scene = make_scene(3, highest=1.3, waves=500, lens_px=0.6)
    positions = [(k / 20, (7 * k % 20) / 20) for k in range(21)]
    images = [scene.image(SIDE, SIDE, *p) for p in positions]
    assert np.abs(errors(start(scene), make_frame, images, positions)[0]).max() < 0.001


def test_scatter_is_near_the_cramer_rao_bound_and_the_reported_deviation_is_the_error(
    make_scene, make_frame, camera, start
):
    scatter, reported, true = [], [], []
    for seed in range(3):
        scene = make_scene(10 + seed, highest=1.3, waves=400, lens_px=0.6)
        rng = np.random.default_rng(seed)
        bound = scene.bound(SIDE, SIDE, REGION, NOISE_WITH_ROUNDING)
        images = [camera(scene.image(SIDE, SIDE, *p), rng, NOISE) for p in POSITIONS]
        for _ in range(8):  # the reference's noise is an error that all frames share: several references average it
            error, variance = errors(start(scene, rng=rng), make_frame, images, POSITIONS)
            scatter.append(error.std(axis=0) / bound)
            reported.append(variance)
            true.append(error**2)
    # 180 frames on two axes: the ratio itself carries ±4 %.
    assert np.mean(scatter) < 1.15
    assert 0.8 < np.sqrt(np.mean(reported) / np.mean(true)) < 1.3


def test_weak_texture_reports_its_larger_error(make_scene, make_frame, camera, start):
    scene = make_scene(20, rms=4.0, highest=1.3, waves=400, lens_px=0.6)
    rng = np.random.default_rng(20)
    images = [camera(scene.image(SIDE, SIDE, *p), rng, NOISE) for p in POSITIONS]
    runs = [errors(start(scene, rng=rng), make_frame, images, POSITIONS) for _ in range(8)]
    true = np.sqrt(np.mean([e**2 for e, _ in runs]))
    # At 1.5 DN of noise on 4 DN of texture the bound is 0.014 px, twenty-fifty times that of strong texture.
    assert 0.01 < true < 0.05
    assert 0.8 < np.sqrt(np.mean([v for _, v in runs])) / true < 1.3


def test_gain_and_level_do_not_change_the_result(scene, make_frame, start):
    image = scene.image(SIDE, SIDE, 0.37, -0.61)
    plain = start(scene).push(make_frame(image, 1))
    changed = start(scene).push(make_frame(0.6 * image + 20.0, 1))
    # ZNCC does not know them; float32 pixels leave 1e-5 px.
    assert changed.x_px == pytest.approx(plain.x_px, abs=2e-5)
    assert changed.y_px == pytest.approx(plain.y_px, abs=2e-5)
    assert changed.quality == pytest.approx(plain.quality, abs=1e-6)


@pytest.mark.parametrize("dtype", [np.uint16, np.float32, np.float64])
def test_all_types_of_pixels_give_the_same_translation(scene, make_frame, dtype):
    # Large level, small contrast, as in thermal counts: 16 bit with 0.01 DN of the 8 bit scale a count.
    images = [(20_000 + 100 * scene.image(SIDE, SIDE, d, -d)).astype(dtype) for d in (0.0, 0.4)]
    found = TemplateTracker(make_frame(images[0]), REGION, TemplateSettings()).push(make_frame(images[1], 1))
    assert found.x_px == pytest.approx(0.4, abs=0.001)
    assert found.y_px == pytest.approx(-0.4, abs=0.001)


@pytest.mark.parametrize(
    ("place", "prediction"),
    [
        ((30.4, -25.2), None),
        ((30.4, -25.2), Prediction(29.0, -26.0, 0.7, 0.7)),
        ((30.4, -25.2), Prediction(20.0, -15.0, 6.0, 6.0)),
        ((-55.3, 50.7), Prediction(-40.0, 40.0, 10.0, 10.0)),
        ((-55.3, 50.7), Prediction(-40.0, 40.0, np.inf, np.inf)),
        ((10.2, 9.7), Prediction(-12.0, -14.0, 0.5, 0.5)),  # sure of itself and wrong
        ((1.6, 1.6), Prediction(-2.0, 4.0, 0.1, 0.1)),  # the peak lies on the rim of the window: it is moved
    ],
)
def test_a_large_jump_is_found(scene, make_frame, start, place, prediction):
    found = start(scene).push(make_frame(scene.image(SIDE, SIDE, *place), 1), prediction)
    assert found.status is Status.TRACKING
    assert (found.x_px, found.y_px) == pytest.approx(place, abs=0.001)


def test_twenty_black_frames_are_lost_and_the_target_is_found_again_far_away(scene, make_frame, start):
    tracker = start(scene)
    for k in range(20):
        found = tracker.push(make_frame(np.zeros((SIDE, SIDE)), k + 1))
        assert found.status is Status.LOST
        assert np.isnan([found.x_px, found.y_px, found.variance_x_px2, found.variance_y_px2]).all()
        assert found.quality == 0.0
    found = tracker.push(make_frame(scene.image(SIDE, SIDE, -58.3, 55.2), 21))
    assert found.status is Status.TRACKING
    assert (found.x_px, found.y_px) == pytest.approx((-58.3, 55.2), abs=0.001)


@pytest.mark.parametrize("level", [0.0, 255.0, np.nan])
def test_a_frame_without_contrast_is_lost(scene, make_frame, start, level):
    assert start(scene).push(make_frame(np.full((SIDE, SIDE), level), 1)).status is Status.LOST


def test_a_target_that_leaves_the_image_is_lost(scene, make_frame, start):
    assert start(scene).push(make_frame(scene.image(SIDE, SIDE, 90.0, 0.0), 1)).status is Status.LOST


def test_another_scene_is_lost(scene, make_scene, make_frame, start):
    assert start(scene).push(make_frame(make_scene(99).image(SIDE, SIDE), 1)).status is Status.LOST


@pytest.mark.parametrize("share", [0.02, 0.05, 0.2, 0.5])
def test_an_object_in_front_widens_the_deviation_or_loses_the_target(scene, make_frame, camera, start, share):
    rng = np.random.default_rng(5)
    side = int(64 * np.sqrt(share))
    errors_in_sigma = []
    for k in range(30):
        image = camera(scene.image(SIDE, SIDE, 0.3, -0.4), rng, NOISE)
        y, x = rng.integers(0, 64 - side, 2)
        image[REGION.y + y :, REGION.x + x :][:side, :side] = 230
        found = start(scene).push(make_frame(image, k + 1))
        if found.status is Status.TRACKING:
            errors_in_sigma.append((found.x_px - 0.3) / np.sqrt(found.variance_x_px2))
            errors_in_sigma.append((found.y_px + 0.4) / np.sqrt(found.variance_y_px2))
    # The error is systematic, not normal: at least the deviation must be of its size.
    assert np.sqrt(np.mean(np.square(errors_in_sigma or [0.0]))) < 2.0


def test_a_few_pixels_without_value_do_no_harm_in_reference_or_frame(scene, make_frame):
    images = [scene.image(SIDE, SIDE, d, d) for d in (0.0, 0.3)]
    for image in images:
        image[90, 95] = np.nan
        image[100:102, 110] = np.inf
    found = TemplateTracker(make_frame(images[0]), REGION, TemplateSettings()).push(make_frame(images[1], 1))
    # Three of 4096 pixels are replaced by their neighbours' mean, wrong by some 10 DN each.
    assert (found.x_px, found.y_px) == pytest.approx((0.3, 0.3), abs=0.005)


def test_texture_is_required(make_frame, camera):
    rng = np.random.default_rng(0)
    stripes = 120 + 30 * np.sin(0.3 * np.arange(SIDE)) * np.ones((SIDE, 1))
    flat = np.full((SIDE, SIDE), 100.0)
    for image in (flat, camera(flat, rng, NOISE), camera(stripes, rng, NOISE)):
        with pytest.raises(UsageError, match=r"camera\.roi must hold texture .* gradients of .* noise"):
            open_tracker("template", make_frame(image), REGION)


def test_another_size_of_frame_is_an_error_that_names_both(scene, make_frame, start):
    with pytest.raises(DataError, match=r"200x200 px.*frame 3 has 100x90 px"):
        start(scene).push(make_frame(np.zeros((90, 100)), 3))


def test_a_region_at_the_border_is_matched_by_its_inner_part(scene, make_frame, start):
    found = start(scene, region=Region(0, 0, 64, 64)).push(make_frame(scene.image(SIDE, SIDE, 2.4, 3.3), 1))
    assert (found.x_px, found.y_px) == pytest.approx((2.4, 3.3), abs=0.001)
    with pytest.raises(UsageError, match="away from the border"):
        start(scene, region=Region(0, 0, 15, 64))


def test_a_tracker_restored_from_its_state_gives_the_same_values(scene, make_frame, start):
    images = [scene.image(SIDE, SIDE, 3.0 * k, -1.7 * k) for k in range(10)]
    tracker = start(scene)
    whole = [tracker.push(make_frame(image, k)) for k, image in enumerate(images)]
    first = start(scene)
    for k in range(5):
        first.push(make_frame(images[k], k))
    second = open_tracker("template", first.reference, first.region, TemplateSettings())
    second.restore(first.state)
    assert [second.push(make_frame(images[k], k)) for k in range(5, 10)] == whole[5:]
    assert tracker.region_now == Region(REGION.x + 27, REGION.y - 15, 64, 64)


def test_a_fast_steady_motion_is_followed_by_its_speed(scene, make_frame, start):
    # 6 px a frame is beyond the nearest search window, 15 frames go 90 px along the diagonal.
    tracker = start(scene, region=Region(20, 20, 64, 64), settings=TemplateSettings(search_px=8.0))
    for k in range(15):
        found = tracker.push(make_frame(scene.image(SIDE, SIDE, 6.0 * k, 5.5 * k), k))
        assert (found.x_px, found.y_px) == pytest.approx((6.0 * k, 5.5 * k), abs=0.001)


@settings(max_examples=20, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(dx=st.integers(-40, 40), dy=st.integers(-40, 40), predicted=st.booleans())
def test_a_shift_by_whole_pixels_shifts_the_result_by_exactly_as_much(scene, make_frame, dx, dy, predicted):
    def tracked(pixels, prediction):
        tracker = TemplateTracker(make_frame(reference), REGION, TemplateSettings())
        return tracker.push(make_frame(pixels, 1), prediction)

    image = scene.image(300, 300, 0.4, 0.3)
    reference = scene.image(300, 300)[50:250, 50:250]
    here = image[50:250, 50:250]
    there = image[50 - dy : 250 - dy, 50 - dx : 250 - dx]
    first = tracked(here, Prediction(0.0, 0.0, 0.5, 0.5) if predicted else None)
    second = tracked(there, Prediction(dx, dy, 0.5, 0.5) if predicted else None)
    # The same pixels go through the same arithmetic; only adding the whole shift rounds.
    assert second.x_px - dx == pytest.approx(first.x_px, abs=1e-12)
    assert second.y_px - dy == pytest.approx(first.y_px, abs=1e-12)
    assert second.variance_x_px2 == first.variance_x_px2


@pytest.mark.parametrize(
    "wrong",
    [
        {"smoothing_px": -0.1},
        {"smoothing_px": 9.0},
        {"search_px": 0.0},
        {"min_correlation": 1.0},
        {"bias_floor_px": np.nan},
    ],
)
def test_settings_outside_their_range_are_refused(wrong):
    with pytest.raises(UsageError, match=next(iter(wrong))):
        TemplateSettings(**wrong)
