import math

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter, map_coordinates, spline_filter

from midspan.errors import DataError, UsageError
from midspan.records import Frame, Prediction, Region, Status
from midspan.simulate.scene.camera import Camera, cramer_rao_std_px
from midspan.simulate.scene.texture import textured_scene
from midspan.vision.registration import RegistrationSettings, RegistrationTracker
from repeats import slow

SIDE, SIZE = 200, 128
REGION = Region(36, 36, SIZE, SIZE)
CAMERA = Camera()
NEAR = Prediction(0.0, 0.0, 0.4, 0.4)
ROWS, COLUMNS = np.mgrid[:SIDE, :SIDE] - (36 + SIZE / 2 - 0.5)
NAMES = ("natural", "blocks", "facade", "weak")


@pytest.fixture(scope="module")
def scenes():
    return {name: textured_scene(name, (SIDE, SIDE), rng=np.random.default_rng(11)) for name in NAMES}


@pytest.fixture(scope="module")
def learned_trackers(scenes):
    return {name: started(scenes[name], np.random.default_rng(21)) for name in NAMES}


def picture(index, pixels):
    return Frame(time_ns=index * 33_000_000, pixels=pixels, index=index)


LEARN_FRAMES = RegistrationSettings().learn_frames


def started(scene, rng, *, region=REGION, settings=None, learned=50):
    """A tracker that has seen its learning frames, all within ±0.6 px of the reference."""
    tracker = RegistrationTracker(
        picture(0, CAMERA.expose(scene.render(0, 0), rng=rng)), region, settings or RegistrationSettings()
    )
    for k, (x, y) in enumerate(rng.uniform(-0.6, 0.6, (learned, 2))):
        tracker.push(picture(k + 1, CAMERA.expose(scene.render(x, y), rng=rng)), NEAR)
    return tracker


def turned(image, roll_rad, zoom):
    """The image turned and enlarged about the region's middle."""
    a, b = 1 + zoom, roll_rad
    middle = 36 + SIZE / 2 - 0.5
    x, y = (a * COLUMNS + b * ROWS) / (a * a + b * b), (a * ROWS - b * COLUMNS) / (a * a + b * b)
    spline = spline_filter(image.astype(np.float64), 5, mode="mirror")
    return map_coordinates(spline, [y + middle, x + middle], order=5, prefilter=False, mode="mirror")


def covered(image, rows, columns):
    image = image.copy()
    image[36 + rows[0] : 36 + rows[1], 36 + columns[0] : 36 + columns[1]] = 200.0
    return image


DISTURBED = {
    "ramp of 30 %": lambda im: im * (1 + 0.3 * COLUMNS / (SIZE / 2)),
    "shadow of 40 % over half": lambda im: im * np.where(COLUMNS > 3, 0.6, 1.0),
    "gain 0.6 and 20 DN": lambda im: 0.6 * im + 20,
    "object over the left 40 %": lambda im: covered(im, (0, SIZE), (0, 51)),
    "object over the middle 40 %": lambda im: covered(im, (24, 104), (24, 104)),
    "roll of half a degree": lambda im: turned(im, np.deg2rad(0.5), 0.0),
    "zoom of 0.3 %": lambda im: turned(im, 0.0, 0.003),
}


@pytest.mark.parametrize("what", DISTURBED)
@pytest.mark.parametrize("name", ["natural", "blocks", "facade"])
def test_one_disturbance_leaves_less_than_five_thousandths_of_a_pixel(scenes, learned_trackers, name, what):
    # Frames without noise, so that what is left is the disturbance's own: what a frame at the same place without it
    # gives is taken off, because the noise of reference and template is common to both.
    tracker = learned_trackers[name]
    begin = tracker.state
    errors = []
    for k, (x, y) in enumerate(np.random.default_rng(3).uniform(-0.05, 0.05, (4, 2))):
        found = []
        for image in (scenes[name].render(x, y), DISTURBED[what](scenes[name].render(x, y)).astype(np.float32)):
            tracker.restore(begin)
            found.append(tracker.push(picture(k + 99, image), NEAR))
        assert found[1].status is Status.TRACKING
        # Turning is about the region's middle in the image: the translation itself turns by 0.05 px × 0.5°.
        errors.append((found[1].x_px - found[0].x_px, found[1].y_px - found[0].y_px))
        assert found[1].variance_y_px2 > 0.9 * found[0].variance_y_px2
    tracker.restore(begin)
    assert np.sqrt(np.mean(np.square(errors), axis=0)).max() < 0.0025


@pytest.mark.parametrize(("name", "limit"), [("natural", 0.001), ("blocks", 0.001), ("weak", 0.003)])
def test_the_systematic_error_stays_below_a_thousandth_of_a_pixel_at_every_phase(scenes, name, limit):
    scene = scenes[name]
    tracker = RegistrationTracker(picture(0, scene.render(0, 0)), REGION, RegistrationSettings(learn_frames=0))
    positions = [(k / 20, (7 * k % 20) / 20) for k in range(21)]
    found = [tracker.push(picture(k + 1, scene.render(x, y))) for k, (x, y) in enumerate(positions)]
    assert np.abs(np.array([(f.x_px, f.y_px) for f in found]) - positions).max() < limit


def test_an_aliased_template_is_resolved_by_frames_at_many_places(scenes):
    scene, rng = scenes["facade"], np.random.default_rng(9)
    tracker = RegistrationTracker(picture(0, scene.render(0, 0)), REGION, RegistrationSettings(learn_frames=0))
    places = np.array([(k / 20 - 0.5, (7 * k % 20) / 20 - 0.5) for k in range(20)])

    def error():
        found = [tracker.push(picture(k + 1, scene.render(*p)), NEAR) for k, p in enumerate(places)]
        return np.array([(f.x_px, f.y_px) for f in found]) - places

    single = np.abs(error()).max()
    tracker.learn([picture(k + 1, scene.render(*p)) for k, p in enumerate(rng.uniform(-0.5, 0.5, (48, 2)))])
    resolved = error()
    assert single > 0.0015
    # The mean is the zero, which is the reference frame's own and keeps its aliasing.
    assert np.abs(resolved - resolved.mean(axis=0)).max() < 0.001


@pytest.mark.parametrize(
    ("name", "limit"), [("natural", 1.25), ("weak", 1.5), *slow(("blocks", 1.25), ("facade", 1.5))]
)
def test_scatter_is_near_the_cramer_rao_bound_and_the_reported_deviation_is_the_error(scenes, name, limit):
    scene, rng = scenes[name], np.random.default_rng(5)
    bound = np.array(cramer_rao_std_px(scene, CAMERA, region=REGION))
    scatter, reported, true = [], [], []
    for _ in range(5):  # the reference's noise is an error that all frames share: several references average it
        tracker = started(scene, rng)
        places = rng.uniform(-0.6, 0.6, (24, 2))
        found = [
            tracker.push(picture(k + 60, CAMERA.expose(scene.render(*p), rng=rng)), NEAR) for k, p in enumerate(places)
        ]
        error = np.array([(f.x_px, f.y_px) for f in found]) - places
        scatter.append((error.var(axis=0, ddof=1) / bound**2).mean())
        reported.append([(f.variance_x_px2, f.variance_y_px2) for f in found])
        true.append(error**2)
    # 120 frames on two axes: the ratio itself carries ±5 %; the goal of 1.2 is the benchmark's, with more frames.
    assert np.sqrt(np.mean(scatter)) < limit
    # Five references on two axes: ten values of the zero's error: the ratio carries ±15 % together with the goal's 25
    # %.
    assert 0.7 < np.sqrt(np.mean(reported) / np.mean(true)) < 1.45


@pytest.mark.parametrize("name", NAMES)
def test_a_learned_template_makes_no_step(scenes, learned_trackers, name):
    tracker = learned_trackers[name]
    first = RegistrationTracker(tracker.reference, REGION, RegistrationSettings(learn_frames=0))
    rng = np.random.default_rng(31)
    images = [CAMERA.expose(scenes[name].render(*p), rng=rng) for p in rng.uniform(-0.6, 0.6, (40, 2))]
    before, after = (
        np.array([(f.x_px, f.y_px) for f in (t.push(picture(k + 99, im), NEAR) for k, im in enumerate(images))])
        for t in (first, tracker)
    )
    # Both have the same zero. What is left of one frame's difference is averaged over the 48 frames that the zero was
    # carried over with and over 40 here: its standard deviation is the root of 1/48 + 1/40, twice that is allowed.
    moved = after - before
    assert np.all(np.abs(moved.mean(axis=0)) < 2.0 * math.sqrt(1 / 48 + 1 / 40) * moved.std(axis=0))


def test_the_frames_learned_from_keep_their_mean_place(scenes):
    scene, rng = scenes["natural"], np.random.default_rng(8)
    images = [CAMERA.expose(scene.render(*p), rng=rng) for p in rng.uniform(-0.6, 0.6, (30, 2))]
    frames = [picture(k + 1, image) for k, image in enumerate(images)]
    reference = picture(0, CAMERA.expose(scene.render(0, 0), rng=rng))
    tracker = RegistrationTracker(reference, REGION, RegistrationSettings(learn_frames=0))
    before = [tracker.push(frame, NEAR) for frame in frames]
    tracker.learn(frames)
    after = [tracker.push(frame, NEAR) for frame in frames]
    step = np.mean([(a.x_px - b.x_px, a.y_px - b.y_px) for a, b in zip(after, before, strict=True)], axis=0)
    # One zero: a tenth of a frame's own noise, and less than that, since the very frames are compared.
    assert np.all(np.abs(step) < 0.1 * np.array(cramer_rao_std_px(scene, CAMERA, region=REGION)))


@pytest.mark.parametrize("name", ["natural", "facade"])
def test_frames_at_one_place_only_are_averaged(scenes, name):
    scene, rng = scenes[name], np.random.default_rng(4)
    settings = RegistrationSettings(learn_frames=8)
    tracker = RegistrationTracker(picture(0, CAMERA.expose(scene.render(0, 0), rng=rng)), REGION, settings)
    for k in range(40):
        tracker.push(picture(k + 1, CAMERA.expose(scene.render(0, 0), rng=rng)), NEAR)
    assert tracker.state.learned is not None
    assert tracker.state.samples is not None  # it goes on learning until the structure moves
    places = rng.uniform(-0.5, 0.5, (20, 2))
    found = [
        tracker.push(picture(k + 50, CAMERA.expose(scene.render(*p), rng=rng)), NEAR) for k, p in enumerate(places)
    ]
    error = np.array([(f.x_px, f.y_px) for f in found]) - places
    bound = np.array(cramer_rao_std_px(scene, CAMERA, region=REGION))
    # What is aliased in the façade stays: a single frame errs by up to 3 bounds.
    assert np.all(error.std(axis=0) < (4.0 if name == "facade" else 1.6) * bound)


def test_learning_needs_frames_that_show_the_target(scenes):
    tracker = RegistrationTracker(picture(0, scenes["natural"].render(0, 0)), REGION, RegistrationSettings())
    with pytest.raises(DataError, match="at least 5 frames"):
        tracker.learn([picture(k + 1, np.zeros((SIDE, SIDE))) for k in range(8)])


@pytest.mark.parametrize("side", [32, 128, 512])
def test_the_kernels_of_a_large_region_stay_within_their_memory(side):
    rng = np.random.default_rng(6)
    image = gaussian_filter(rng.normal(0, 400, (side + 60, side + 60)), 1.2)
    tracker = RegistrationTracker(picture(0, 120 + image), Region(30, 30, side, side), RegistrationSettings())
    assert 0 < tracker.kernel_bytes <= 96 << 20


def test_kernels_that_gave_way_to_others_are_made_again_alike(scenes, monkeypatch):
    scene = scenes["natural"]
    images = [scene.render(0.07 * k, -0.05 * k) for k in range(30)]

    def tracked():
        tracker = RegistrationTracker(picture(0, images[0]), REGION, RegistrationSettings(learn_frames=0))
        return [tracker.push(picture(k + 1, image)) for k, image in enumerate(images * 2)]

    whole = tracked()
    monkeypatch.setattr("midspan.vision.registration.KERNEL_BYTES", 4 * 12 * SIZE * SIZE)  # four phases
    assert tracked() == whole


def test_a_target_that_leaves_the_image_is_lost_and_found_again(scenes):
    scene = scenes["natural"]
    tracker = RegistrationTracker(picture(0, scene.render(0, 0)), Region(10, 60, 64, 64), RegistrationSettings())
    statuses = []
    for k in range(60):
        # It goes out to the left for good at 80 px, then is back.
        image = np.roll(scene.render(0, 0), -round(80 * min(k, 20) / 20), axis=1) if k < 40 else scene.render(0.3, 0.2)
        image[:, SIDE - 80 :] = image[:, SIDE - 80 :] if k >= 40 else 90.0
        found = tracker.push(picture(k + 1, image))
        statuses.append(found.status)
    assert set(statuses[14:40]) == {Status.LOST}
    assert (found.x_px, found.y_px) == pytest.approx((0.3, 0.2), abs=0.002)


@pytest.mark.parametrize("place", [(13.4, -12.2), (-9.3, 10.7)])
@pytest.mark.parametrize("prediction", [None, Prediction(12.0, -9.0, 6.0, 6.0), Prediction(0.0, 0.0, 0.2, 0.2)])
def test_a_large_jump_is_found_whatever_was_predicted(scenes, place, prediction):
    scene = scenes["natural"]
    tracker = RegistrationTracker(picture(0, scene.render(0, 0)), Region(60, 60, 64, 64), RegistrationSettings())
    found = tracker.push(picture(1, scene.render(*place)), prediction)
    assert found.status is Status.TRACKING
    assert (found.x_px, found.y_px) == pytest.approx(place, abs=0.002)


@pytest.mark.parametrize("level", [0.0, 255.0, np.nan])
def test_frames_without_contrast_are_lost_and_the_target_is_found_again(scenes, level):
    scene = scenes["natural"]
    tracker = RegistrationTracker(picture(0, scene.render(0, 0)), Region(60, 60, 64, 64), RegistrationSettings())
    for k in range(5):
        found = tracker.push(picture(k + 1, np.full((SIDE, SIDE), level)))
        assert found.status is Status.LOST
        assert np.isnan([found.x_px, found.y_px, found.variance_x_px2, found.variance_y_px2]).all()
    found = tracker.push(picture(9, scene.render(-11.3, 12.2)))
    assert (found.x_px, found.y_px) == pytest.approx((-11.3, 12.2), abs=0.002)


@pytest.mark.parametrize("name", NAMES)
def test_another_scene_is_lost(scenes, name):
    tracker = RegistrationTracker(picture(0, scenes["natural"].render(0, 0)), REGION, RegistrationSettings())
    other = textured_scene(name, (SIDE, SIDE), rng=np.random.default_rng(77)).render(0.3, 0.2)
    assert tracker.push(picture(1, other)).status is Status.LOST


def test_all_types_of_pixels_give_the_same_translation(scenes):
    scene = scenes["natural"]
    for dtype in (np.uint16, np.float32, np.float64):
        images = [(20_000 + 100 * scene.render(d, -d).astype(np.float64)).astype(dtype) for d in (0.0, 0.4)]
        tracker = RegistrationTracker(picture(0, images[0]), REGION, RegistrationSettings())
        found = tracker.push(picture(1, images[1]))
        assert (found.x_px, found.y_px) == pytest.approx((0.4, -0.4), abs=0.001)


def test_a_tracker_restored_from_its_state_gives_the_same_values(scenes):
    scene, rng = scenes["natural"], np.random.default_rng(2)
    images = [CAMERA.expose(scene.render(0.3 * k, -0.17 * k), rng=rng) for k in range(24)]
    settings = RegistrationSettings(learn_frames=8)
    tracker = RegistrationTracker(picture(0, images[0]), REGION, settings)
    whole = [tracker.push(picture(k, image)) for k, image in enumerate(images)]
    for cut in (5, 16):  # before and after the template has been learned
        first = RegistrationTracker(picture(0, images[0]), REGION, settings)
        for k in range(cut):
            first.push(picture(k, images[k]))
        second = RegistrationTracker(first.reference, first.region, settings)
        second.restore(first.state)
        assert [second.push(picture(k, images[k])) for k in range(cut, 24)] == whole[cut:]


def test_texture_is_required():
    flat = np.full((SIDE, SIDE), 100.0)
    noisy = CAMERA.expose(flat.astype(np.float32), rng=np.random.default_rng(0))
    for image in (flat, noisy):
        with pytest.raises(UsageError, match=r"camera\.roi must hold texture"):
            RegistrationTracker(picture(0, image), REGION, RegistrationSettings())


def test_another_size_of_frame_is_an_error_that_names_both(scenes):
    tracker = RegistrationTracker(picture(0, scenes["natural"].render(0, 0)), REGION, RegistrationSettings())
    with pytest.raises(DataError, match=r"200x200 px.*frame 3 has 100x90 px"):
        tracker.push(picture(3, np.zeros((90, 100))))


@pytest.mark.parametrize(
    "wrong",
    [{"smoothing_px": 9.0}, {"search_px": 0.0}, {"min_share": 1.0}, {"bias_floor_px": np.nan}, {"learn_frames": -1}],
)
def test_settings_outside_their_range_are_refused(wrong):
    with pytest.raises(UsageError, match=next(iter(wrong))):
        RegistrationSettings(**wrong)


@pytest.mark.parametrize("upright", [False, True])
def test_a_cable_before_a_plain_sky_is_as_exact_as_its_texture_allows(upright):
    # Texture in one row of blocks does not tell a shift from roll, zoom and ramps: fitted together, they make the
    # translation twice as noisy as it need be.
    rng = np.random.default_rng(4)
    texture = gaussian_filter(rng.normal(0.0, 1.0, (220, 220)), 1.5)
    far = np.clip(np.abs(np.arange(220.0) - 110.0) - 6.0, 0.0, None)
    band = np.exp(-0.5 * (far / 1.5) ** 2)
    spectrum = np.fft.fft2(40.0 * texture / texture.std() * (band[None, :] if upright else band[:, None]))
    down, across = np.fft.fftfreq(220)[:, None], np.fft.fftfreq(220)[None, :]
    angle = 0.3 * np.arange(60)
    moved = np.column_stack((1.3 * np.sin(1.2 * angle), 1.7 * np.sin(0.8 * angle)))

    def seen(k):
        turned_by = np.exp(-2j * np.pi * (down * moved[k, 1] + across * moved[k, 0]))
        clean = 128.0 + np.fft.ifft2(spectrum * turned_by).real[10:210, 10:210]
        return picture(k, np.clip(np.rint(clean + rng.normal(0.0, 2.0, clean.shape)), 0, 255).astype(np.uint8))

    tracker = RegistrationTracker(seen(0), REGION, RegistrationSettings(learn_frames=0))
    rows = [tracker.push(seen(k)) for k in range(60)][1:]
    error = np.array([(row.x_px, row.y_px) for row in rows]) - moved[1:]
    stated = np.sqrt(np.median([(row.variance_x_px2, row.variance_y_px2) for row in rows], axis=0))
    # Cramér-Rao bound of one frame with nothing but the translation unknown; small blocks lose a tenth of the slopes.
    clean = 40.0 * texture / texture.std() * (band[None, :] if upright else band[:, None])
    slopes = np.gradient(clean[46:174, 46:174])[::-1]
    bound = 2.0 / np.sqrt([np.sum(slope**2) for slope in slopes])
    assert np.all(np.std(error, axis=0) < 1.5 * bound)
    assert np.all(np.std(error, axis=0) < 1.3 * stated)
    # The reference's noise, as large as a frame's, is the mean of all: 3.5 of it for two axes.
    assert np.all(np.abs(np.mean(error, axis=0)) < 3.5 * stated)


@pytest.mark.parametrize(("roll", "zoom"), [(2e-4, 0.0), (0.0, 2e-4), (-1.5e-4, 1e-4)])
@pytest.mark.parametrize("light", [(1.0, 0.0, 0.0), (1.06, 3.0, 0.02)])
def test_the_whole_window_tells_roll_and_zoom_from_light(scenes, roll, zoom, light):
    # Without noise every part of the linear model is there to the second order: what the picture was turned by, and
    # nothing of gain, level and a ramp of gain across the window.
    clean = scenes["natural"].render(0, 0).astype(np.float64)
    core = RegistrationTracker(picture(0, clean.astype(np.float32)), REGION, RegistrationSettings()).core
    gain, level, ramp = light
    seen = turned(clean, roll, zoom) * (gain + ramp * COLUMNS / SIZE) + level
    found = core.pose_in((seen - np.mean(clean)).astype(np.float32), (REGION.x, REGION.y), (0.0,) * 4, True)
    assert found is not None
    # 1e-4 px, and at the window's corners 90 px away 5e-4 px, far below any camera's noise.
    assert max(abs(found.x_px), abs(found.y_px)) < (1e-5 if light == (1.0, 0.0, 0.0) else 1e-3)
    assert (found.roll_rad, found.zoom) == pytest.approx((roll, zoom), abs=1e-6 if light == (1.0, 0.0, 0.0) else 1e-5)
