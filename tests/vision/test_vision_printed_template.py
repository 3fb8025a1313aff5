"""The template tracker as printed, against equation 2 in plain NumPy and SciPy's spline."""

import numpy as np
import pytest
from numpy.lib.stride_tricks import sliding_window_view
from scipy.interpolate import RectBivariateSpline
from scipy.optimize import minimize

from midspan.errors import UsageError
from midspan.papers.printed.template import spline_peak, zncc_matrix
from midspan.records import Prediction, Region, Status
from midspan.vision.template import TemplateSettings
from midspan.vision.tracker import open_tracker, tracker_settings

SIDE, NOISE = 160, 1.5
REGION = Region(60, 56, 40, 48)
POSITIONS = [((k * 0.618) % 1 * 24 - 12, (k * 0.414) % 1 * 24 - 12) for k in range(20)]


@pytest.fixture(scope="module")
def film(make_scene, make_frame, camera):
    scene, rng = make_scene(3, highest=1.3, waves=300, lens_px=0.6), np.random.default_rng(5)

    def make(positions):
        images = (camera(scene.image(SIDE, SIDE, *place), rng, NOISE) for place in positions)
        return [make_frame(image, k) for k, image in enumerate(images)]

    return make


@pytest.fixture(scope="module")
def start(film):
    first = film([(0.0, 0.0)])[0]

    def make(**values):
        return open_tracker("template", first, REGION, TemplateSettings(literal=True, **values))

    return make


def equation_2(image, template):
    """ZNCC (rows - h + 1, columns - w + 1) of every subset of an image, as printed."""
    subsets = sliding_window_view(np.asarray(image, dtype=float), template.shape)
    free = subsets - subsets.mean(axis=(2, 3), keepdims=True)
    own = template - template.mean()
    return np.einsum("yxij,ij->yx", free, own) / np.sqrt(np.einsum("yxij,yxij->yx", free, free) * np.sum(own**2))


def interpolated(matrix):
    """Row and column of the largest value of FITPACK's bicubic spline through a matrix, near its largest entry."""
    spline = RectBivariateSpline(np.arange(matrix.shape[0]), np.arange(matrix.shape[1]), matrix, s=0)
    start = np.unravel_index(np.argmax(matrix), matrix.shape)

    def slopes(at):
        return -np.array([spline(*at, dx=1)[0, 0], spline(*at, dy=1)[0, 0]])

    return minimize(lambda at: -spline(*at)[0, 0], start, jac=slopes, method="BFGS", options={"gtol": 1e-11}).x


def test_the_matrix_is_equation_2():
    rng = np.random.default_rng(1)
    image, template = rng.normal(100.0, 20.0, (45, 52)), rng.normal(100.0, 20.0, (11, 14))
    found = zncc_matrix(image - 100.0, template - template.mean())
    # Double precision: 1e-16 of the sums over 45 by 52 pixels, relative to those over 11 by 14.
    np.testing.assert_allclose(found, equation_2(image, template), atol=1e-13)


def test_a_constant_subset_correlates_with_nothing():
    image = np.zeros((30, 30))
    image[:, 20:] = np.random.default_rng(2).normal(size=(30, 10))
    template = image[5:13, 21:29]
    found = zncc_matrix(image, template - template.mean())
    assert np.all(found[:, :12] == 0.0)
    assert found[5, 21] == pytest.approx(1.0, abs=1e-12)


def test_each_frame_is_equation_2_with_scipys_spline(film, start):
    tracker = start()
    first = np.asarray(tracker.reference.pixels, dtype=float)
    template = first[REGION.y : REGION.y + REGION.height, REGION.x : REGION.x + REGION.width]
    for frame, truth in zip(film(POSITIONS), POSITIONS, strict=True):
        row, column = interpolated(equation_2(frame.pixels, template))
        found = tracker.push(frame)
        # Two splines with other ends, 30 entries away; 1e-15 of the matrix, whose curvature is some 0.1 a px².
        assert (found.x_px, found.y_px) == pytest.approx((column - REGION.x, row - REGION.y), abs=1e-7)
        # Pixels alias and the spline pulls to whole entries: that is the method's own error.
        assert (found.x_px, found.y_px) == pytest.approx(truth, abs=0.1)


def test_a_whole_pixel_is_found_to_the_digit(start, make_frame):
    tracker = start()
    moved = np.roll(tracker.reference.pixels, (5, -7), axis=(0, 1))
    found = tracker.push(make_frame(moved, 1))
    # The entries on both sides differ, so that the maximum of the spline lies a little together with the entry.
    still = tracker.push(tracker.reference)
    assert (found.x_px + 7.0, found.y_px - 5.0) == pytest.approx((still.x_px, still.y_px), abs=1e-3)
    assert found.quality == pytest.approx(still.quality, abs=1e-4)


def test_frames_stand_alone_and_predictions_move_nothing(film, start):
    one, other, frames = start(), start(), film(POSITIONS[:6])
    forwards = [one.push(frame) for frame in frames]
    backwards = [other.push(frame, Prediction(30.0, -20.0, 0.1, 0.1)) for frame in frames[::-1]]
    assert forwards == backwards[::-1]


def test_beyond_the_matrix_and_without_values_the_target_is_lost(film, start, make_frame):
    frames = film([(12.0, 0.0), (2.0, 0.0)])
    tracker = start(search_px=6.0)
    found = [tracker.push(frame) for frame in frames]
    assert [one.status for one in found] == [Status.LOST, Status.TRACKING]
    assert tracker.push(make_frame(np.full((SIDE, SIDE), np.nan), 2)).status is Status.LOST
    assert start(search_px=16.0).push(frames[0]).status is Status.TRACKING


def test_no_correlation_is_too_small_as_printed(start, make_frame):
    # The guarded tracker refuses what only noise correlates with; the printed one takes the largest entry as it comes.
    noise = make_frame(np.random.default_rng(8).normal(120.0, 30.0, (SIDE, SIDE)), 1)
    guarded = open_tracker("template", start().reference, REGION)
    assert guarded.push(noise).status is Status.LOST
    assert start(search_px=40.0).push(noise).status is Status.TRACKING


def test_the_reported_deviation_is_that_of_the_noise(film, start):
    # The same place again and again: what differs is the frames' noise alone.
    tracker = start()
    found = [tracker.push(frame) for frame in film([(3.3, -2.6)] * 60)]
    scatter = np.std([(one.x_px, one.y_px) for one in found], axis=0)
    reported = np.sqrt(np.mean([(one.variance_x_px2, one.variance_y_px2) for one in found], axis=0))
    # The residual holds the template's noise and what the interpolation loses, too: it may be reported, not less.
    assert np.all(reported > scatter)
    assert np.all(reported < 4.0 * scatter)


def test_a_ridge_has_no_maximum():
    assert spline_peak(np.outer(np.ones(9), np.cos(np.linspace(-1.0, 1.0, 9)))) is None
    bell = np.exp(-0.5 * ((np.arange(31)[:, None] - 14.3) / 3.0) ** 2 - 0.5 * ((np.arange(41) - 20.2) / 4.0) ** 2)
    # The slope of an even cubic spline errs by √3 / 216 of the fourth derivative (3 / σ⁴, σ of three entries) at most:
    # over the curvature 1 / σ² that is 0.0027 entries.
    assert spline_peak(bell) == pytest.approx((20.2, 14.3, 1.0), abs=3e-3)


def test_the_settings_are_those_of_the_file():
    assert tracker_settings("template", literal=True).literal
    with pytest.raises(UsageError, match="literal must be true or false"):
        tracker_settings("template", literal=1)
