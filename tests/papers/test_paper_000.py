"""Storey model, outdoor table and footbridge of Ma, Choi, Liu and Sohn (doi 10.1016/j.autcon.2022.104338), as films."""

from dataclasses import replace

import numpy as np
import pytest

from midspan.calibration.camera.best_range import printed_band
from midspan.papers.filming import CALIBRATION, PAPER_SCENES, FilmSettings, film, write_recording
from midspan.papers.films import Way, calibration_frames, frames_of, mean_mm, run_film
from midspan.progress import silent
from midspan.recording.calibrate import calibrate_and_track
from midspan.recording.estimate import estimate
from midspan.recording.streams.recording import open_recording
from midspan.recording.tracking.opening import open_tracking
from midspan.sources.camera.formats import open_frames
from midspan.sources.camera.frames import FrameRequest
from midspan.vision.tracker import open_tracker, tracker_settings
from plain_phase import active_pixels, double_integral, filtered, least_squares, phase_variation
from repeats import slow

CUT = {
    "indoor": FilmSettings(10.0, 10.0, ("sine", "sweep")),
    "outdoor": FilmSettings(10.0, 10.0, ("sine", "sweep")),
    "footbridge-phase": FilmSettings(12.0, 10.0, ("jumping", "crossing")),
}
# The table outdoors moves as the one indoors.
SCENES = ["indoor", "footbridge-phase", *slow("outdoor")]
FRAMES = 2 * 10.0 * 9.99
# An rms over n frames scatters by 1 / sqrt(2 n) of itself: the goals hold for the mean of many.
SCATTER = 1.0 / np.sqrt(2.0 * FRAMES)
GOALS_MM = {"indoor": 0.015 * 2.11 / 2.289, "outdoor": 0.16, "footbridge-phase": 0.007}


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    known = {}

    def make(name, *, compressed=False, noisy=False):
        key = name, compressed, noisy
        if key not in known:
            # The noise of the paper's own errors asks for a longer calibration.
            noise = {"calibration_s": 30.0, "noise": PAPER_SCENES[name].noise} if noisy else {}
            scene = film(name, replace(CUT[name], **noise))
            folder = write_recording(scene, tmp_path_factory.mktemp("papers") / name, compressed=compressed)
            known[key] = scene, folder
        return known[key]

    return make


@pytest.fixture(scope="module")
def runs(recorded):
    """A tracker with our calibration, fused by a method; its camera alone has the true scale factor."""
    known = {}

    def make(name, tracker, *, method="kalman", compressed=False, **values):
        key = name, tracker, method, compressed, *values
        if key not in known:
            scene, folder = recorded(name, compressed=compressed)
            known[key] = run_film(scene, folder, Way(tracker, method, settings=values))
        return known[key]

    return make


@pytest.fixture(scope="module")
def alone(runs):
    """Error in mm of a tracker alone."""
    return lambda *names, **values: mean_mm(runs(*names, **values).track.errors_mm())


# The window far away is a facade that repeats: the published rejection alone may lose it, so ours is compared there.
@pytest.mark.parametrize(("name", "literal"), [("indoor", True), ("footbridge-phase", True), *slow(("outdoor", False))])
def test_the_hybrid_is_far_below_feature_matching(runs, alone, name, literal):
    assert runs(name, "hybrid").track.lost == runs(name, "features", literal=literal).track.lost == 0
    # Published: 53 % lower at most indoors, 73 % on the bridge (table 7). Both tracks have the true scale factor: one
    # fitted to the matches is pulled to zero by mismatches, once a part of the gain. Without it, 1.5 at least.
    assert alone(name, "features", literal=literal) > 1.5 * alone(name, "hybrid")


@pytest.mark.parametrize("name", SCENES)
def test_registration_is_near_the_bound_and_never_below_it(recorded, runs, alone, name):
    scene, _ = recorded(name)
    bound_mm = scene.bound_px * scene.scene.scale_mm_per_px
    assert runs(name, "registration").track.lost == 0
    assert alone(name, "registration") > bound_mm * (1.0 - 3.0 * SCATTER)
    assert alone(name, "registration") < GOALS_MM[name] * (1.0 + 2.0 * SCATTER)


@pytest.mark.parametrize("name", SCENES)
def test_hybrid_and_the_adaptive_filter_stay_below_the_published_error(recorded, runs, alone, name):
    scene, _ = recorded(name)
    fused_mm = mean_mm(runs(name, "hybrid", method="adaptive-kalman").fused_mm)
    assert fused_mm < scene.scene.published_mm
    # Acceleration is added information: between the frames, too, the error stays below the frames' own.
    assert fused_mm < alone(name, "hybrid")


def test_compression_sets_the_floor_for_every_tracker(alone):
    errors = [alone("footbridge-phase", name, compressed=True) for name in ("registration", "template")]
    lossless = alone("footbridge-phase", "registration")
    # 0.035 mm is the goal at crf 20: 0.026 px. What the codec took away no estimator gives back, so both agree.
    assert max(errors) < 0.035 * (1.0 + 2.0 * SCATTER)
    assert min(errors) > 2.0 * lossless
    assert errors[0] == pytest.approx(errors[1], rel=0.15)


def test_films_are_the_same_again_and_the_video_is_lossless(recorded):
    scene, folder = recorded("indoor")
    request = FrameRequest(times=folder / "camera_times.csv")
    frames = list(open_frames(folder / "camera.mkv", request).frames())
    short = FilmSettings(2.0, 3.5, ("sweep",))
    assert np.array_equal(film("indoor", short).frames, film("indoor", short).frames)
    assert all(np.array_equal(frame.pixels, pixels) for frame, pixels in zip(frames, scene.frames, strict=True))
    assert np.allclose([frame.time_ns for frame in frames], 1e9 * scene.stamps_s, atol=1.0)
    # The texture's contrast gives the bound that the scene asks for; noise that changes with it leaves 4 %.
    assert scene.bound_px == pytest.approx(scene.scene.bound_px, rel=0.04)


@pytest.fixture(scope="module")
def printed(recorded):
    """Error of the camera alone (mm, each excitation's without its mean), calibration and tracker of a printed form."""
    known = {}

    def run(name, *, noisy=False, **values):
        key = name, noisy, *values.values()
        if key not in known:
            scene, folder = recorded(name, noisy=noisy)
            camera = {"tracker": "hybrid", "tracker_settings": {"literal": True} | values}
            recording = open_recording(folder, camera=camera, fusion={"method": "kalman"})
            calibration, tracking = calibrate_and_track(recording)
            series = estimate(recording, calibration, method="kalman", tracking=tracking).measured[0]
            seen = np.interp(series.time_ns / 1e9, scene.stamps_s + scene.time_offset_s, scene.seen_m())
            after = series.time_ns / 1e9 > scene.spans[CALIBRATION][1]
            assert np.isfinite(series.value_m).all()
            error_mm = 1e3 * float(np.std((series.value_m - seen)[after]))
            known[key] = error_mm, calibration.camera, tracking.targets[0].tracker
        return known[key]

    return run


@pytest.mark.parametrize("name", ["indoor", "footbridge-phase"])
def test_both_scale_factors_are_those_of_the_papers_steps_in_plain_numpy(recorded, printed, name):
    scene, _ = recorded(name)
    count = calibration_frames(scene)
    frames, axis = frames_of(scene)[:count], "xy".index(scene.scene.direction)
    _, calibrated, tracker = printed(name)
    # Step 1 by feature matching; the displacement that the accelerometer shows at the frames.
    matcher = open_tracker("features", frames[0], scene.region, tracker_settings("features", literal=True))
    found = np.array([(one.x_px, one.y_px) for one in map(matcher.push, frames)])
    series = scene.acceleration
    time_s = series.time_ns[series.time_ns < 1e9 * scene.spans[CALIBRATION][1]] / 1e9
    felt = double_integral(time_s, series.value[: len(time_s)])
    felt = np.interp(scene.stamps_s[:count] + calibrated.offset.value_s, time_s, felt)
    rate_hz = 1.0 / float(np.median(np.diff(scene.stamps_s)))
    band = printed_band(1.0 / rate_hz)
    alpha = calibrated.scale.value_m_per_px
    if name == "indoor":
        # Step 2. People who jump at 2.1 Hz leave next to nothing below 1 Hz, where the printed band ends.
        ratio, _ = least_squares(filtered(found[:, axis], rate_hz, band), filtered(felt, rate_hz, band))
        assert alpha == pytest.approx(ratio, rel=0.01)
    # Step 3 on every fourth pixel in both directions, which the plain search can do in a second.
    region = (scene.region.x, scene.region.y, scene.region.width, scene.region.height)
    thin = np.zeros((region[3], region[2]), dtype=bool)
    thin[::4, ::4] = True

    def phases(places):
        pixels = (frame.pixels for frame in frames)
        first = frames[0].pixels
        phase = [phase_variation(p, first, region, at, axis) for p, at in zip(pixels, places, strict=True)]
        return filtered(np.array(phase), rate_hz, band)

    places = np.rint(found).astype(int)
    residual = filtered(felt - alpha * places[:, axis], rate_hz, band)
    moved = phases(places)
    active = tracker.model.mask(scene.scene.direction, (region[3], region[2])).ravel()
    # The region moves by 40 times what is left of the motion in the band: α and clock must be the same to the digit.
    beta, r_squared = least_squares(moved[:, active].mean(axis=1), residual)
    assert calibrated.phase_scale_m_per_rad == pytest.approx(beta, rel=0.01)
    assert r_squared == pytest.approx(tracker.model.r_squared[axis], abs=0.005)
    thinned = active_pixels(moved[:, thin.ravel()], residual)
    assert r_squared > thinned[2] > 0.95
    if name == "indoor":
        # Figure 9: with the large motion in the picture the same pixels' phase wraps, and no line is left.
        still = phases(np.zeros_like(places))[:, active].mean(axis=1)
        assert least_squares(still, filtered(felt, rate_hz, band))[1] < 0.3


def test_a_calibration_that_is_given_teaches_the_same_tracker(recorded, printed):
    _, folder = recorded("indoor")
    recording = open_recording(folder, camera={"tracker": "hybrid", "tracker_settings": {"literal": True}})
    _, known, own = printed("indoor")
    given = open_tracking(recording.cameras[0], known, silent).targets[0].tracker
    assert given.phase_gain_px_per_rad == own.phase_gain_px_per_rad
    assert np.array_equal(given.active_pixels.x, own.active_pixels.x)


@pytest.mark.parametrize("name", ["indoor", *slow("footbridge-phase", "outdoor")])
def test_the_order_of_the_pixel_sets_is_that_of_figure_14_and_tables_4_and_6(printed, name):
    kinds = ("correlation", "amplitude", "all")
    selected, amplitude, whole = (printed(name, noisy=name == "footbridge-phase", active_pixels=kind) for kind in kinds)
    axis = "xy".index(selected[1].direction)
    r_squared = [one[2].model.r_squared[axis] for one in (selected, amplitude, whole)]
    # The selected pixels and those of large amplitude differ in the third digit.
    assert r_squared[2] < min(r_squared[:2])
    assert r_squared[0] > 0.95
    # All pixels: worst. The other two differ by less than ten seconds of calibration leave open: R² of 0.997 over 100
    # frames gives a ratio of 0.5 %, and the choice of pixels follows the same noise.
    assert max(selected[0], amplitude[0]) < whole[0]
    assert selected[0] < 1.3 * amplitude[0]
