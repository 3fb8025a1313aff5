"""Phase and hybrid as printed, against the paper's steps in plain NumPy and closed cases."""

import math

import numpy as np
import pytest
from scipy.signal import butter, sosfiltfilt

from midspan.errors import DataError, UsageError
from midspan.papers.printed.phase import PrintedHybridTracker, PrintedPhaseTracker, by_ratio, by_threshold
from midspan.records import Prediction, Region, Status
from midspan.signals.band_pass import band_passed
from midspan.vision.active_pixels import by_amplitude
from midspan.vision.hybrid import HybridTracker, PhaseSettings
from midspan.vision.tracker import open_tracker, tracker_settings
from plain_phase import active_pixels, existing_flow, filtered, flow_terms, local_phase, phase_variation

SIDE, NOISE, RATE_HZ = 128, 1.5, 1e9 / 33e6
REGION = Region(40, 40, 40, 40)
BOX = (40, 40, 40, 40)
BAND = (0.3, 3.0)
# Pixels are filtered in single precision: 6e-8 of some 300 grey levels, in phases of some 30 grey levels' amplitude.
SINGLE_PX = 2e-6


@pytest.fixture(scope="module")
def scene(make_scene):
    return make_scene(4, highest=0.5, waves=300, lens_px=0.6)


@pytest.fixture(scope="module")
def film(scene, make_frame, camera):
    def make(positions, seed=1, where=scene):
        rng = np.random.default_rng(seed)
        return [make_frame(camera(where.image(SIDE, SIDE, *p), rng, NOISE), k) for k, p in enumerate(positions)]

    return make


@pytest.fixture(scope="module")
def learning(film):
    """Frames that move along y by up to 4 px, near 1 Hz, and that translation as an accelerometer would show it."""
    y = 4.0 * np.sin(2 * np.pi * 1.1 * np.arange(150) / RATE_HZ)
    return film(np.column_stack((0.0 * y, y))), y + 0.01 * np.random.default_rng(3).standard_normal(150)


@pytest.fixture(scope="module")
def start(film):
    def make(kind=PrintedHybridTracker, **values):
        return kind(film([(0.0, 0.0)], seed=0)[0], REGION, PhaseSettings(literal=True, matcher="template", **values))

    return make


@pytest.fixture(scope="module")
def taught(start, learning):
    frames, y = learning
    tracker = start()
    tracker.learn(frames, y, direction="y", band_hz=BAND)
    return tracker


def test_the_threshold_is_that_of_a_search_over_all_of_them():
    rng = np.random.default_rng(0)
    wanted = rng.standard_normal(80)
    phase = np.outer(wanted, rng.normal(0.0, 1.0, 700)) + rng.normal(0.0, 2.0, (80, 700)) * rng.uniform(0.1, 3.0, 700)
    phase, wanted = phase - phase.mean(axis=0), wanted - wanted.mean()
    found, (active, ratio, r_squared) = by_threshold(phase, wanted), active_pixels(phase, wanted)
    assert np.array_equal(found.active, active)
    # Two orders of the same sums in double precision.
    assert (found.gain_px_per_rad, found.r_squared) == pytest.approx((ratio, r_squared), rel=1e-9)
    given = by_ratio(phase, wanted, active)
    assert (given.gain_px_per_rad, given.r_squared) == pytest.approx((ratio, r_squared), rel=1e-12)


def test_the_band_pass_is_scipys_column_by_column():
    values = np.random.default_rng(1).standard_normal((60, 1500))
    sections = butter(4, [0.3, 3.0], "bandpass", fs=10.0, output="sos")
    assert band_passed(values, 10.0, BAND) == pytest.approx(sosfiltfilt(sections, values, axis=0), abs=1e-12)
    assert band_passed(values[:, 0], 10.0, (0.0, 3.0)) == pytest.approx(
        sosfiltfilt(butter(4, 3.0, fs=10.0, output="sos"), values[:, 0]), abs=1e-12
    )


def test_learning_is_the_papers_steps_on_the_moved_region(taught, learning):
    frames, y = learning
    matcher = open_tracker("template", taught.reference, REGION)
    found = [matcher.push(frame) for frame in frames]
    places = [(round(one.x_px), round(one.y_px)) for one in found]
    first = taught.reference.pixels
    phase = [phase_variation(f.pixels, first, BOX, place, 1) for f, place in zip(frames, places, strict=True)]
    residual = y - [place[1] for place in places]
    active, ratio, r_squared = active_pixels(
        filtered(np.array(phase), RATE_HZ, BAND), filtered(residual, RATE_HZ, BAND)
    )
    assert max(abs(place[1]) for place in places) == 4  # large motion was there to be taken off
    model = taught.model
    assert np.array_equal(model.mask("y", (40, 40)).ravel(), active)
    assert model.r_squared[1] == pytest.approx(r_squared, abs=1e-6)
    assert model.gains_px_per_rad[1] == pytest.approx(ratio, rel=1e-6)
    assert taught.learns_by_acceleration
    # The other axis is none of the paper's: it stays as the reference shows it.
    assert math.isnan(model.r_squared[0])


@pytest.mark.parametrize("values", [{}, {"form": "gradient"}])
def test_each_frame_is_measured_as_equations_14_to_19_say(start, learning, film, values):
    frames, y = learning
    tracker = start(**values)
    tracker.learn(frames, y, direction="y", band_hz=BAND)
    gain, active = tracker.phase_gain_px_per_rad[1], tracker.model.mask("y", (40, 40)).ravel()
    first, positions = tracker.reference.pixels, np.array([(0.2, 6.3 * np.sin(0.7 * k)) for k in range(12)])
    rng, matched = np.random.default_rng(2), 0
    for frame, (_, truth) in zip(film(positions, seed=9), positions, strict=True):
        std = 0.3 if frame.index % 3 else 4.0  # every third prediction is too vague for phase alone
        prediction = Prediction(0.0, truth + min(std, 1.0) * rng.standard_normal(), 2.0, std)
        place = round(prediction.y_px)
        if not 3.0 * std + 0.5 < math.pi * abs(gain):  # equation 16, over |α|
            place, matched = round(truth), matched + 1
        mean = np.mean(phase_variation(frame.pixels, first, BOX, (0, place), 1)[active])
        rest = gain * mean
        if values:
            shifted = np.roll(frame.pixels, -place, axis=0)
            rest = existing_flow(shifted, first, BOX, 1, active)
        # Slopes next to zero raise single precision's errors in equation 3.
        assert tracker.push(frame, prediction).y_px == pytest.approx(place + rest, abs=1e-3 if values else SINGLE_PX)
    assert tracker.state.matched_frames == matched == 4


def test_the_existing_flow_is_equation_3_in_a_region_that_stays(start, film):
    tracker = start(PrintedPhaseTracker, form="gradient", active_pixels="amplitude")
    assert not tracker.learns_by_acceleration
    first = tracker.reference.pixels
    active = by_amplitude(np.abs(local_phase(first, BOX, 1))).ravel()
    for frame in film([(0.0, 0.2), (0.0, -0.4)], seed=5):
        found = tracker.push(frame, Prediction(0.0, 30.0, 0.1, 0.1))  # a prediction moves nothing
        assert found.y_px == pytest.approx(existing_flow(frame.pixels, first, BOX, 1, active), abs=1e-3)


@pytest.mark.parametrize(
    ("values", "least"),
    [
        ({}, 0.0),
        ({"min_slope_rad_px": 0.5}, 0.5),
        ({"literal": False}, 0.1),
        ({"literal": False, "min_slope_rad_px": 0.0}, 0.0),
    ],
)
def test_the_least_slope_is_the_settings(film, values, least):
    # As a recording's [camera.tracker_settings] gives them; the existing flow of the paper is the first.
    chosen = {"literal": True, "form": "gradient", "active_pixels": "all", "matcher": "template"} | values
    tracker = open_tracker("phase", film([(0.0, 0.0)], seed=0)[0], REGION, tracker_settings("phase", **chosen))
    (frame,) = film([(0.1, 0.3)], seed=6)
    slope, change = flow_terms(frame.pixels, tracker.reference.pixels, BOX, 1)
    steep = np.abs(slope) >= least
    assert np.count_nonzero(steep) < len(slope) or least == 0.0
    expected = np.mean(-change[steep] / slope[steep])
    # Single precision in slopes next to zero where there is no limit, see above.
    assert tracker.push(frame).y_px == pytest.approx(expected, abs=1e-3 if least == 0.0 else 1e-5)


@pytest.mark.parametrize("slope", [-0.1, 4.0])
def test_a_least_slope_beyond_what_phases_have_is_refused(slope):
    with pytest.raises(UsageError, match="min_slope_rad_px must be from 0 to below"):
        PhaseSettings(form="gradient", min_slope_rad_px=slope)


class Waves:
    """A wave along each axis, of 0.2 and 0.16 cycles/px."""

    def image(self, columns, rows, dx=0.0, dy=0.0):
        y, x = np.mgrid[0:rows, 0:columns]
        across = 40 * np.cos(2 * np.pi * 0.2 * (x - dx) + 0.3)
        return 120 + across + 40 * np.cos(2 * np.pi * 0.16 * (y - dy) + 0.5)


def test_the_gain_of_a_wave_is_its_closed_form_and_takes_over_the_unit_of_what_was_felt(film):
    waves, y = Waves(), 0.45 * np.sin(2 * np.pi * 1.1 * np.arange(150) / RATE_HZ)
    frames = film(np.column_stack((0.0 * y, y)), where=waves)
    reference = film([(0.0, 0.0)], 0, waves)[0]
    for unit in (1.0, 1.05):
        tracker = PrintedPhaseTracker(reference, REGION, PhaseSettings(literal=True, matcher="template"))
        tracker.learn(frames, unit * y, direction="y", band_hz=BAND)
        # The pair of filters is no exact quadrature: its ripple is below 1 %.
        assert tracker.phase_gain_px_per_rad[1] == pytest.approx(-unit / (2 * np.pi * 0.16), rel=0.01)
        assert tracker.model.r_squared[1] > 0.999


def test_phase_alone_wraps_where_the_hybrid_does_not(start, learning, film):
    frames, y = learning
    phase, hybrid = start(PrintedPhaseTracker), start()
    for tracker in (phase, hybrid):
        tracker.learn(frames, y, direction="y", band_hz=BAND)
    far = film([(0.0, 9.0)])[0]
    assert abs(phase.push(far, Prediction(0.0, 9.0, 0.1, 0.1)).y_px - 9.0) > 3.0
    assert hybrid.push(far, Prediction(0.0, 9.0, 0.1, 0.1)).y_px == pytest.approx(9.0, abs=0.05)


def test_until_it_has_learned_the_matcher_measures(start, film):
    tracker, matcher = start(), open_tracker("template", film([(0.0, 0.0)], seed=0)[0], REGION)
    for frame in film([(0.0, 0.0), (0.3, 5.2), (0.1, -7.7)]):
        assert tracker.push(frame) == matcher.push(frame)
    assert tracker.push(film([(0.0, 0.0)])[0]).status is Status.TRACKING


def test_nothing_is_dropped_nor_taken_back(taught, film):
    # A thing before a fifth of the region moves the printed mean; the default leaves its pixels out.
    plain = HybridTracker(taught.reference, REGION, PhaseSettings())
    frame = film([(0.0, 0.3)], seed=4)[0]
    frame.pixels[40:80, 44:52] = 40
    near = Prediction(0.0, 0.0, 0.2, 0.2)
    assert abs(taught.push(frame, near).y_px - 0.3) > 2.0 * abs(plain.push(frame, near).y_px - 0.3)


@pytest.mark.parametrize("choice", ["amplitude", "all"])
def test_other_pixels_get_a_gain_of_their_own(start, learning, taught, choice):
    frames, y = learning
    tracker = start(active_pixels=choice)
    tracker.learn(frames, y, direction="y", band_hz=BAND)
    active = tracker.model.mask("y", (40, 40))
    first = np.abs(local_phase(tracker.reference.pixels, BOX, 1))
    assert np.array_equal(active, by_amplitude(first) if choice == "amplitude" else np.ones((40, 40), dtype=bool))
    # The selected pixels have the largest R² of all sets by correlation, to which "all" belongs.
    assert tracker.model.r_squared[1] < taught.model.r_squared[1]


def test_the_default_keeps_all_pixels_where_it_is_asked_to(start, learning, film):
    frames, _ = learning
    tracker = HybridTracker(film([(0.0, 0.0)], seed=0)[0], REGION, PhaseSettings(active_pixels="all"))
    tracker.learn(frames)
    assert tracker.model.mask("y", (40, 40)).all()


def test_a_restored_tracker_measures_alike(taught, start, film):
    other = start()
    other.restore(taught.state)
    for frame in film([(0.0, 1.4), (0.0, 2.9)], seed=6):
        assert other.push(frame, Prediction(0.0, 2.0, 1.0, 0.4)) == taught.push(frame, Prediction(0.0, 2.0, 1.0, 0.4))


def test_too_few_frames_for_the_band_are_refused_and_features_match_by_default(start, learning):
    frames, y = learning
    with pytest.raises(DataError, match="at least 30 frames"):
        start().learn(frames[:20], y[:20], direction="y", band_hz=BAND)
    assert tracker_settings("hybrid", literal=True).matched_by == "features"
    assert tracker_settings("hybrid").matched_by == "template"
