"""The lens: both models against formulas written here and against OpenCV, translations and predictions, refusals."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from lens_cases import FISHEYE, IMAGES, PINHOLE, SIZE, Scene, ideal_translation, places, poses
from midspan.errors import DataError, UntrustedError, UsageError
from midspan.records import Event, Frame, PixelTrack, PixelTranslation, Prediction, Region, Status
from midspan.vision.checkerboard import Board, calibrate_lens, find_board, is_new
from midspan.vision.lens import (
    Lens,
    bent,
    check_lens,
    ideal_gain,
    lens_warnings,
    shown_prediction,
    straight,
)
from midspan.vision.tracker import open_tracker

CASES = {"pinhole": PINHOLE, "fisheye": FISHEYE}
# A wide action camera at 1920 x 1080 px: 90° across, k1 = -0.3.
ACTION = Lens("pinhole", (960.0, 960.0, 959.5, 539.5), (-0.3, 0.1, 0.0, 0.0), (1920, 1080))
RIM = Region(1829, 508, 64, 64)  # its middle 901 px from the principal point, at the right rim


def lens(name, **changed):
    return Lens(**{"model": name, **CASES[name], "size": SIZE, **changed})


def track(x, y, variance_x=1e-4, variance_y=4e-4):
    """Translations as a tracker gives them, one for each pair of x and y; their references' variances are half."""
    found = []
    for k, (a, b) in enumerate(zip(np.atleast_1d(x).astype(float), np.atleast_1d(y).astype(float), strict=True)):
        status = Status.TRACKING if np.isfinite(a + b) else Status.LOST
        halves = {"reference_variance_x_px2": 0.5 * variance_x, "reference_variance_y_px2": 0.5 * variance_y}
        found.append(PixelTranslation(k, a, b, variance_x, variance_y, 1.0, status, strength=100.0, **halves))
    return found


def corrected(found, region, lens):
    """The block of the ideal translations."""
    return PixelTrack.stack([ideal_translation(one, region, lens) for one in found])


def ideal_of(model, x, y):
    """Places of rays in the ideal picture."""
    fx, fy, cx, cy = CASES[model]["matrix"]
    return np.column_stack((fx * x + cx, fy * y + cy))


@pytest.mark.parametrize("model", CASES)
def test_the_model_is_its_published_formula(model):
    rng = np.random.default_rng(1)
    x, y = rng.uniform(-0.5, 0.5, (2, 300))
    shown = np.column_stack(places(model, CASES[model], x, y))
    # 1e-9 px: the same sums in another order.
    assert bent(ideal_of(model, x, y), lens(model))[0] == pytest.approx(shown, abs=1e-9)
    # The inverse of the formula, solved to rounding.
    assert straight(shown, lens(model))[0] == pytest.approx(ideal_of(model, x, y), abs=1e-8)


@pytest.mark.parametrize("model", CASES)
def test_there_and_back_over_the_whole_picture(model):
    x, y = np.meshgrid(np.linspace(0, SIZE[0] - 1, 33), np.linspace(0, SIZE[1] - 1, 25))
    shown = np.column_stack((x.ravel(), y.ravel()))
    ideal, slope = straight(shown, lens(model))
    assert np.isfinite(ideal).all()
    back, back_slope = bent(ideal, lens(model))
    assert back == pytest.approx(shown, abs=1e-8)
    assert np.einsum("nij,njk->nik", slope, back_slope) == pytest.approx(np.tile(np.eye(2), (len(x.ravel()), 1, 1)))


@pytest.mark.parametrize("model", CASES)
def test_derivatives_are_those_of_the_places(model):
    shown = np.array([[40.0, 30.0], [331.0, 236.0], [600.0, 400.0]])
    _, slope = straight(shown, lens(model))
    for axis, step in enumerate(np.eye(2) * 1e-4):
        ahead, behind = (straight(shown + sign * step, lens(model))[0] for sign in (1, -1))
        # Central differences of 1e-4 px err by rounding, 1e-8 px / 1e-4 px.
        assert slope[:, :, axis] == pytest.approx((ahead - behind) / 2e-4, abs=1e-6)


RATIONAL = (0.4, 0.1, 0.001, -0.002, 0.02, 0.7, 0.3, 0.05)


@pytest.mark.parametrize(
    "distortion", [PINHOLE["distortion"], RATIONAL, (*RATIONAL, 0.003, -0.001, 0.002, 0.001)], ids=len
)
def test_opencv_distorts_a_pinhole_alike(distortion):
    own = lens("pinhole", distortion=distortion)
    fx, fy, cx, cy = own.matrix
    matrix = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1.0]])
    rays = np.random.default_rng(2).uniform(-0.5, 0.5, (100, 2))
    theirs, _ = cv2.projectPoints(
        np.column_stack((rays, np.ones(100))), np.zeros(3), np.zeros(3), matrix, np.array(distortion)
    )
    assert bent(ideal_of("pinhole", *rays.T), own)[0] == pytest.approx(theirs[:, 0], abs=1e-9)


def test_opencv_undistorts_a_fisheye_alike():
    fx, fy, cx, cy = FISHEYE["matrix"]
    matrix = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1.0]])
    shown = np.random.default_rng(3).uniform((100, 80), (540, 400), (100, 2))
    stop = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 100, 1e-14)
    theirs = cv2.fisheye.undistortPoints(
        shown[:, None], matrix, np.array(FISHEYE["distortion"]), P=matrix, criteria=stop
    )
    assert straight(shown, lens("fisheye"))[0] == pytest.approx(theirs[:, 0], abs=1e-6)


@pytest.mark.parametrize("model", CASES)
def test_a_track_is_corrected_to_the_motion_of_the_rays(model):
    region = Region(500, 60, 64, 48)
    own = lens(model)
    middle = np.array([531.5, 83.5])
    fx, fy, cx, cy = own.matrix
    # True motion in the ideal picture; its image by the formula in NumPy is what a tracker would have seen.
    start = straight(middle, own)[0][0]
    ideal = np.random.default_rng(4).uniform(-20.0, 20.0, (50, 2))
    rays = (start + ideal - (cx, cy)) / (fx, fy)
    seen = np.column_stack(places(model, CASES[model], *rays.T)) - middle
    found = corrected(track(*seen.T), region, own)
    assert np.column_stack((found.x_px, found.y_px)) == pytest.approx(ideal, abs=1e-8)
    back = [shown_prediction(Prediction(x, y, 1.0, 1.0), region, own) for x, y in ideal]
    assert np.array([(b.x_px, b.y_px) for b in back]) == pytest.approx(seen, abs=1e-8)


def test_nothing_moves_without_distortion():
    plain = lens("pinhole", distortion=(0.0, 0.0, 0.0, 0.0))
    given = track([0.0, 3.5, -7.25], [0.0, -1.5, 12.0])
    found = corrected(given, Region(10, 400, 40, 40), plain)
    given = PixelTrack.stack(given)
    assert found.x_px == pytest.approx(given.x_px, abs=1e-11)
    assert found.y_px == pytest.approx(given.y_px, abs=1e-11)
    assert found.variance_x_px2 == pytest.approx(given.variance_x_px2)
    assert found.variance_y_px2 == pytest.approx(given.variance_y_px2)


def test_the_zero_stays_zero_to_the_last_digit():
    found = corrected(track(0.0, 0.0), RIM, ACTION)
    assert (found.x_px[0], found.y_px[0]) == (0.0, 0.0)


def test_variances_are_those_of_corrected_noisy_tracks():
    rng = np.random.default_rng(5)
    n = 20_000
    noisy = track(9.0 + rng.normal(0, 0.01, n), -4.0 + rng.normal(0, 0.02, n))
    corner = Region(1700, 900, 64, 64)
    found = corrected(noisy, corner, ACTION)
    # A variance of n draws is known to √(2/n) = 1 %; three times that.
    assert np.var(found.x_px) / found.variance_x_px2[0] == pytest.approx(1.0, abs=0.03)
    assert np.var(found.y_px) / found.variance_y_px2[0] == pytest.approx(1.0, abs=0.03)
    assert found.variance_x_px2[0] > 1.2 * 1e-4


# Region, local scale along and across the radius, and the largest error of a straight line over 30 px along it.
COSTS = [
    (Region(928, 508, 64, 64), 1.0, 1.0, 0.0004),
    (Region(1408, 508, 64, 64), 1.286, 1.087, 0.128),
    (RIM, 1.324, 1.290, 0.28),
]


@pytest.mark.parametrize(("region", "along", "across", "bend"), COSTS, ids=["middle", "halfway", "rim"])
def test_what_an_action_camera_costs_without_its_lens(region, along, across, bend):
    """The figures of the documentation: local scale, and what is not proportional over a travel of 30 px."""
    travel, still = np.linspace(-15.0, 15.0, 301), np.zeros(301)
    slope = straight(np.array([region.x + 31.5, region.y + 31.5]), ACTION)[1][0]
    # The table gives three digits.
    assert (slope[0, 0], slope[1, 1]) == pytest.approx((along, across), abs=1e-3)
    ideal = corrected(track(travel, still), region, ACTION).x_px
    gain = float(ideal @ travel / (travel @ travel))
    assert np.abs(travel - ideal / gain).max() == pytest.approx(bend, rel=0.03, abs=1e-4)
    ideal = corrected(track(still, travel), region, ACTION).y_px
    gain = float(ideal @ travel / (travel @ travel))
    assert np.abs(travel - ideal / gain).max() < 0.0015


def test_the_middle_of_a_region_stands_for_it_to_a_third_of_a_percent():
    x, y = np.meshgrid(np.arange(64.0), np.arange(64.0))
    places_of_region = np.column_stack((RIM.x + x.ravel(), RIM.y + y.ravel()))
    middle = straight(np.array([RIM.x + 31.5, RIM.y + 31.5]), ACTION)[1][0]
    # What a tracker sees is the mean of the pixels' own motions, hence of the inverse derivatives.
    mean = np.linalg.inv(straight(places_of_region, ACTION)[1]).mean(axis=0)
    assert mean[0, 0] * middle[0, 0] == pytest.approx(1.0, abs=4e-3)
    assert mean[1, 1] * middle[1, 1] == pytest.approx(1.0, abs=1e-3)


def test_places_beyond_the_model_are_lost_not_nonsense():
    # r (1 - 0.3 r²) grows up to r = 1.054, where its value is 0.703: 675 px of the 960 to the rim.
    limited = Lens("pinhole", (960.0, 960.0, 959.5, 539.5), (-0.3, 0.0, 0.0, 0.0), (1920, 1080))
    region = Region(1548, 508, 64, 64)  # its middle at 620 px from the principal point
    found = corrected(track([0.0, 30.0, 60.0, np.nan], [0.0, 0.0, 0.0, 0.0]), region, limited)
    assert found.status.tolist() == [Status.TRACKING, Status.TRACKING, Status.LOST, Status.LOST]
    assert np.isnan(found.x_px[2:]).all()
    assert np.isnan(found.variance_y_px2[2:]).all()
    assert found.quality[2] == 0.0
    # Near the limit the variance grows without bound.
    near = corrected(track([0.0, 54.0], [0.0, 0.0]), region, limited).variance_x_px2
    assert near[1] > 10.0 * near[0]
    with pytest.raises(UsageError, match="lens model is not valid"):
        check_lens(limited, RIM, 1920, 1080)


def test_places_outside_the_frame_are_lost():
    found = corrected(track([0.0, 200.0], [0.0, 0.0]), RIM, ACTION)
    assert found.status.tolist() == [Status.TRACKING, Status.LOST]


@pytest.mark.parametrize("angle_deg", [10.0, 60.0, 84.0])
def test_a_fisheye_reaches_85_degrees(angle_deg):
    wide = Lens("fisheye", (300.0, 300.0, 499.5, 499.5), (0.0, 0.0, 0.0, 0.0), (1000, 1000))
    radius = 300.0 * np.radians(angle_deg)
    place = straight(np.array([499.5 + radius, 499.5]), wide)[0][0]
    assert place == pytest.approx([499.5 + 300.0 * np.tan(np.radians(angle_deg)), 499.5], rel=1e-9)
    beyond = 499.5 + 300.0 * np.radians(86.0)
    assert np.isnan(straight(np.array([beyond, 499.5]), wide)[0]).all()


def test_a_translation_and_its_prediction_are_the_same_place():
    (seen,) = track(8.0, -5.0)
    found = ideal_translation(seen, RIM, ACTION)
    # Along an axis both variances grow by the same factor: the local scale of about 1.3, squared.
    assert found.reference_variance_x_px2 / found.variance_x_px2 == pytest.approx(0.5)
    assert found.reference_variance_y_px2 / found.variance_y_px2 == pytest.approx(0.5)
    assert (found.time_ns, found.strength, found.status) == (seen.time_ns, seen.strength, seen.status)
    there = shown_prediction(Prediction(found.x_px, found.y_px, 1.3, 1.3), RIM, ACTION)
    assert (there.x_px, there.y_px) == pytest.approx((8.0, -5.0), abs=1e-9)
    # 1.3 ideal px are about one px of the frame at the rim.
    assert (there.std_x_px, there.std_y_px) == pytest.approx((1.0, 1.0), abs=0.05)
    assert shown_prediction(Prediction(np.nan, 0.0, 1.0, 1.0), RIM, ACTION) is None
    assert shown_prediction(None, RIM, ACTION) is None
    assert ideal_translation(seen, RIM, None) is seen


def test_events_of_a_frame_are_kept_where_the_model_does_not_reach():
    reported = (Event(0, "reference", "new key frame"),)
    found = ideal_translation(replace(track(200.0, 0.0)[0], events=reported), RIM, ACTION)
    assert (found.status, found.events, found.strength) == (Status.LOST, reported, 0.0)


def test_a_phase_gain_is_that_of_the_ideal_camera():
    rng = np.random.default_rng(6)
    frame = Frame(0, cv2.GaussianBlur(rng.uniform(0, 255, (480, 640)), (0, 0), 1.5).astype(np.uint8))
    region = Region(500, 380, 64, 64)
    gain = open_tracker("phase", frame, region).phase_gain_px_per_rad
    slope = straight(np.array([531.5, 411.5]), lens("pinhole"))[1][0]
    ratio = np.array(ideal_gain(gain, region, lens("pinhole"))) / np.array(gain)
    assert ratio == pytest.approx(np.diag(slope))
    assert ideal_gain(gain, region, None) == gain


def test_frames_of_another_size_are_refused_with_both_sizes():
    small = Lens("pinhole", (900.0, 900.0, 320.0, 240.0), (0.0, 0.0, 0.0, 0.0), (640, 480))
    with pytest.raises(UsageError, match=r"640x480 px.*1920x1080 px.*midspan lens"):
        check_lens(small, RIM, 1920, 1080)


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"model": "fish"}, "'fisheye'"),
        ({"matrix": (900.0, 900.0, 320.0)}, "fx, fy, cx, cy"),
        ({"matrix": (-900.0, 900.0, 320.0, 240.0)}, "positive"),
        ({"matrix": (900.0, 900.0, np.nan, 240.0)}, "finite"),
        ({"distortion": (0.1, 0.1)}, "4 or 5 or 8 or 12"),
        ({"size": (640, 0)}, "width and height"),
    ],
)
def test_a_lens_that_cannot_be_is_refused(changed, words):
    with pytest.raises(UsageError, match=words):
        lens("pinhole", **changed)


def test_a_region_beyond_the_boards_is_reported():
    covered = lens("pinhole", covered_px=200.0)
    assert lens_warnings(Region(300, 200, 64, 64), covered) == []
    (line,) = lens_warnings(Region(560, 20, 64, 64), covered)
    assert "200 px" in line


# Checkerboards.


@pytest.fixture(scope="module", params=list(CASES))
def boards(request):
    """Twelve pictures of a board with the corners found in them, and the corners' true places."""
    model = request.param
    distance = (330.0, 480.0) if model == "pinhole" else (200.0, 320.0)
    scene, rng = Scene(model, CASES[model]), np.random.default_rng(7)
    there = poses(scene, 12, 8, tilt=35.0 if model == "pinhole" else 25.0, distance_mm=distance)
    found = [find_board(scene.picture(pose, rng), Board()) for pose in there]
    pairs = [(view, scene.corners(pose)) for view, pose in zip(found, there, strict=True) if view is not None]
    return model, [view for view, _ in pairs], [true for _, true in pairs]


def either_way(view, true):
    """Found minus true corners; a board turned by half a turn may be numbered from its other end."""
    return min((view - true, view[::-1] - true), key=lambda off: float(np.abs(off).max()))


def test_corners_are_found_to_a_few_hundredths_of_a_pixel(boards):
    _, views, true = boards
    assert len(views) >= 10
    off = np.array([either_way(view, known) for view, known in zip(views, true, strict=True)])
    # Gradients are taken over windows in which a distorted board is not quite straight: 0.07 px at 20 px a square.
    assert np.sqrt(np.mean(np.sum(off**2, axis=2))) < 0.07
    assert np.abs(off.mean(axis=(0, 1))).max() < 0.01


def test_the_lens_comes_back_from_pictures_of_a_board(boards):
    model, views, _ = boards
    fit = calibrate_lens(views, Board(), SIZE, model)
    true = lens(model)
    assert fit.rms_px < 0.07
    # Focal lengths within four of the fit's own standard deviations (and 0.3 %, should those be far too large).
    for found, known in zip(fit.lens.matrix[:2], true.matrix[:2], strict=True):
        assert abs(found / known - 1.0) < min(4.0 * fit.focal_std, 3e-3)
    assert fit.lens.matrix[2:] == pytest.approx(true.matrix[2:], abs=0.7)
    # What counts is the correction: local scale where boards were seen, within 1 %.
    x, y = np.meshgrid(np.linspace(120, 520, 9), np.linspace(90, 390, 7))
    where = np.column_stack((x.ravel(), y.ravel()))
    ratio = straight(where, fit.lens)[1] / straight(where, true)[1][:, [0, 1], [0, 1]][:, :, None]
    assert ratio[:, [0, 1], [0, 1]] == pytest.approx(np.ones((len(where), 2)), abs=0.01)


def test_exact_corners_give_the_exact_lens(boards):
    model, _, true = boards
    fit = calibrate_lens(true, Board(), SIZE, model)
    # OpenCV takes corners as float32 (1e-5 px at 500) and stops at its own tolerance.
    assert fit.lens.matrix == pytest.approx(CASES[model]["matrix"], abs=2e-3)
    assert fit.lens.distortion == pytest.approx(CASES[model]["distortion"], abs=2e-4)
    assert fit.rms_px < 1e-3


def noisy(scene, count, seed, std=0.05, **kind):
    rng = np.random.default_rng(seed)
    return [scene.corners(pose) + rng.normal(0, std, (54, 2)) for pose in poses(scene, count, seed, **kind)]


@pytest.fixture(scope="module")
def pinhole_scene():
    return Scene("pinhole", PINHOLE)


def test_the_stated_deviation_of_the_focal_length_is_the_scatter_over_repeats(pinhole_scene):
    views = noisy(pinhole_scene, 10, 9, std=0.0)
    rng = np.random.default_rng(10)
    fits = [calibrate_lens([v + rng.normal(0, 0.1, v.shape) for v in views], Board(), SIZE) for _ in range(24)]
    scatter = np.std([fit.lens.matrix[0] / 520.0 for fit in fits], ddof=1)
    # 24 draws know a standard deviation to 15 %; three times that. The stated one is the larger of fx's and fy's.
    assert np.median([fit.focal_std for fit in fits]) / scatter == pytest.approx(1.0, abs=0.45)


def test_too_few_views_are_refused(pinhole_scene):
    with pytest.raises(UntrustedError, match=r"Only 7 different views.*at least 8.*inner corners"):
        calibrate_lens(noisy(pinhole_scene, 7, 11), Board(), SIZE)


def test_boards_that_all_face_the_camera_are_refused(pinhole_scene):
    with pytest.raises(UntrustedError, match=r"focal length.*Tilt"):
        calibrate_lens(noisy(pinhole_scene, 12, 12, tilt=0.5, distance_mm=(400.0, 401.0)), Board(), SIZE)


def test_corners_that_fit_no_lens_are_refused(pinhole_scene):
    with pytest.raises(UntrustedError, match=r"px rms; at most 1 px"):
        calibrate_lens(noisy(pinhole_scene, 12, 13, std=2.0), Board(), SIZE)


def test_one_wrong_view_is_left_out_and_reported(pinhole_scene):
    views = noisy(pinhole_scene, 12, 14)
    views[3] = views[3] + np.random.default_rng(15).normal(0, 5.0, (54, 2))
    fit = calibrate_lens(views, Board(), SIZE)
    assert fit.boards == 11
    assert any("1 of 12 views" in line for line in fit.warnings)
    assert fit.lens.matrix[:2] == pytest.approx(PINHOLE["matrix"][:2], rel=0.005)


def test_boards_in_the_middle_only_are_reported(pinhole_scene):
    views = [view for view in noisy(pinhole_scene, 40, 16) if np.abs(view - (319.5, 239.5)).max() < 215][:12]
    fit = calibrate_lens(views, Board(), SIZE)
    assert any("edge is not covered" in line for line in fit.warnings)
    assert fit.lens.covered_px < 300.0


def test_the_same_view_twice_counts_once(pinhole_scene):
    (view,) = noisy(pinhole_scene, 1, 17)
    assert is_new(view, [], SIZE)
    assert not is_new(view + 3.0, [view], SIZE)
    assert not is_new(view[::-1], [view], SIZE)
    assert is_new(view + 30.0, [view], SIZE)


def test_a_board_of_two_corners_is_refused():
    with pytest.raises(UsageError, match="inner corners"):
        Board(columns=2)


def test_a_picture_without_a_board_gives_nothing():
    assert find_board(np.random.default_rng(18).integers(0, 255, (120, 160), dtype=np.uint8), Board()) is None


def test_frames_that_change_size_stop_every_tracker_with_both_sizes():
    rng = np.random.default_rng(19)
    image = cv2.GaussianBlur(rng.uniform(0, 255, (480, 640)), (0, 0), 1.5).astype(np.uint8)
    tracker = open_tracker("template", Frame(0, image), Region(300, 200, 64, 64))
    with pytest.raises(DataError, match=r"640x480.*320x240"):
        tracker.push(Frame(1, np.ascontiguousarray(image[::2, ::2]), 1))


def test_the_formulas_of_this_file_have_both_models():
    assert set(IMAGES) == set(CASES)
