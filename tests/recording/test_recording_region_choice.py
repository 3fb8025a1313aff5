"""The choice of targets by agreement with the accelerometer: what moves on its own is passed over."""

import shutil
from types import SimpleNamespace

import numpy as np
import pytest

import midspan
from midspan.calibration.camera.view import judged_by
from midspan.errors import NoAgreementError, UntrustedError
from midspan.recording.calibrate import calibrate_and_track
from midspan.recording.tracking.track import track
from midspan.records import PixelTrack, PixelTranslation, Region, Status
from midspan.report.report import report_html
from midspan.simulate.scene.disturbances import Car, Foliage, Water
from midspan.vision.candidates import Candidate
from midspan.vision.region_choice import TRIAL_PLACES, Agreement, judged, trial_places
from midspan.vision.roi import RegionChoice
from recording_edits import acceleration, append, set_keys, write_acceleration

LEAVES, WATER = Region(0, 0, 150, 96), Region(0, 104, 110, 60)


def river(rng):
    """Leaves, water and a car with more contrast than the wall, which is left free in the right third only."""
    leaves, water = rng.spawn(2)
    return (
        Foliage(LEAVES, std_dn=22.0, rng=leaves),
        Water(WATER, std_dn=25.0, rng=water),
        Car(top_px=168, height_px=30, width_px=80, period_s=5.0),
    )


@pytest.fixture(scope="module")
def site(simulated):
    return simulated("river", seed=3, duration_s=30.0, camera={"size_px": (200, 256), "disturbances": river})


@pytest.fixture(scope="module")
def calibrated(site):
    return calibrate_and_track(midspan.open_recording(site))


def overlaps(region, other):
    across = min(region.x + region.width, other.x + other.width) - max(region.x, other.x)
    down = min(region.y + region.height, other.y + other.height) - max(region.y, other.y)
    return across > 0 and down > 0


def share_inside(region, other):
    across = min(region.x + region.width, other.x + other.width) - max(region.x, other.x)
    down = min(region.y + region.height, other.y + other.height) - max(region.y, other.y)
    return max(across, 0) * max(down, 0) / (region.width * region.height)


def test_the_wall_is_taken_although_leaves_water_and_cars_have_more_contrast(calibrated):
    calibration, tracking = calibrated
    region = calibration.camera.region
    assert not overlaps(region, WATER)
    # A few columns of leaves at the region's edge do no harm to a correlation over all of it.
    assert share_inside(region, LEAVES) < 0.15
    # A car that covers a fifth of the region for a third of the time is seen by the noise in mm, which stays that of a
    # place without one: some 0.004 px.
    assert share_inside(region, Region(0, 168, 256, 30)) < 0.25
    assert calibration.camera.noise_std_px < 0.006
    # The picture alone predicts less noise elsewhere: that is what makes these decoys.
    sharpest = min(tracking.choice.candidates, key=lambda c: c.predicted_std_px)
    assert sharpest.region != region
    assert overlaps(sharpest.region, LEAVES) or overlaps(sharpest.region, WATER)
    assert 1e3 * calibration.camera.scale.value_m_per_px == pytest.approx(-1.5, rel=3e-3)


@pytest.mark.usefixtures("undrawn")
def test_every_place_has_a_verdict_and_the_report_shows_map_and_table(site, calibrated):
    _, tracking = calibrated
    assert all(candidate.verdict for candidate in tracking.choice.candidates)
    assert tracking.choice.candidates[0].verdict.startswith("taken: fits the accelerometer")
    assert "compared with the accelerometer" in tracking.choice.reasons[0]
    page = report_html(midspan.estimate(midspan.open_recording(site)))
    assert 'alt="Choice of the region"' in page
    assert page.count("could not be tracked") + page.count("moves on its own") >= 1
    assert "taken: fits the accelerometer" in page


def test_the_automatic_targets_are_as_many_as_asked_for_and_lie_apart(site, tmp_path):
    folder = shutil.copytree(site, tmp_path / "site")
    set_keys(folder, "camera", automatic_targets=2)
    calibration, tracking = calibrate_and_track(midspan.open_recording(folder))
    tracking.close()
    regions = [target.region for target in calibration.camera.targets]
    assert len(regions) == 2
    assert not overlaps(*regions)
    for region in regions:
        assert not overlaps(region, WATER)
        assert share_inside(region, LEAVES) < 0.15


def test_without_motion_to_judge_by_the_picture_decides_and_says_so(site, tmp_path):
    folder = shutil.copytree(site, tmp_path / "site")
    time, _ = acceleration(folder)
    write_acceleration(folder, time, 0.05 + 2.5e-3 * np.random.default_rng(0).standard_normal(len(time)))
    alone = track(folder)
    with pytest.raises(midspan.UntrustedError):
        midspan.calibrate(midspan.open_recording(folder))
    assert alone.tracking.choice.region == alone.region


def test_the_trial_looks_where_the_calibration_window_is(site, tmp_path):
    folder = shutil.copytree(site, tmp_path / "site")
    append(folder, "[calibration]\nwindow_s = [8.0, 30.0]")
    calibration, tracking = calibrate_and_track(midspan.open_recording(folder))
    tracking.close()
    assert not overlaps(calibration.camera.region, WATER)
    assert 1e3 * calibration.camera.scale.value_m_per_px == pytest.approx(-1.5, rel=3e-3)


def candidate(number, fixed=True, std_px=0.01):
    row = PixelTranslation(0, 0.0, 0.0, 1e-4, 1e-4, 1.0, Status.TRACKING)
    gap = 0.01 if fixed else 0.5
    return Candidate(Region(100 * number, 0, 64, 64), std_px, PixelTrack.stack([row]), 1.0, gap, fixed)


def choice_of(candidates):
    first = next(c.region for c in candidates if c.fixed)
    empty = np.empty((0, 0))
    return RegionChoice((first,), ("the sharpest",), empty, empty.astype(int), empty.astype(int), tuple(candidates))


def fits(std_mm):
    return Agreement(1e-3 * std_mm, False, f"fits with {std_mm} mm")


REFUSED = Agreement(np.inf, True, "No agreement between image and accelerometer")
UNDECIDED = Agreement(np.inf, False, "Too little motion to calibrate the scale factor")


@pytest.mark.parametrize(("error", "contradicts"), [(NoAgreementError, True), (UntrustedError, False)])
def test_a_place_contradicts_by_the_kind_of_the_refusal_whatever_its_words(error, contradicts, monkeypatch):
    def refused(*_, **__):
        raise error("Any words")

    monkeypatch.setattr("midspan.calibration.camera.view.camera_pair", refused)
    found = judged_by(SimpleNamespace(exposure_s=None, clocks_open=True), None)
    assert (found.contradicts, found.std_m) == (contradicts, np.inf)


def test_the_place_with_the_least_noise_in_millimetres_wins_whatever_most_of_the_picture_does():
    leaves, wall, sign = candidate(0), candidate(1, fixed=False), candidate(2, fixed=False)
    found = {leaves.region: REFUSED, wall.region: fits(0.02), sign.region: fits(0.01)}
    choice = judged(choice_of([leaves, wall, sign]), found, 1)
    assert choice.regions == (sign.region,)
    assert choice.candidates[0].region == sign.region
    both = judged(choice_of([leaves, wall, sign]), found, 3)
    assert both.regions == (sign.region, wall.region)


def test_a_place_before_which_things_pass_gives_way_to_a_slightly_noisier_one_that_is_always_seen():
    road, wall = candidate(0), candidate(1)
    passed = Agreement(0.010e-3, False, "fits", missed=0.15)
    choice = judged(choice_of([road, wall]), {road.region: passed, wall.region: fits(0.015)}, 2)
    assert choice.regions == (wall.region, road.region)


def test_a_place_that_fits_ten_times_worse_is_not_taken_even_when_more_are_wanted():
    wall, half = candidate(0), candidate(1)
    choice = judged(choice_of([wall, half]), {wall.region: fits(0.01), half.region: fits(0.2)}, 2)
    assert choice.regions == (wall.region,)
    assert "moves on its own" in choice.candidates[1].verdict


def test_where_nothing_fits_the_pictures_order_stands_without_what_contradicts():
    leaves, wall = candidate(0), candidate(1)
    choice = judged(choice_of([leaves, wall]), {leaves.region: REFUSED, wall.region: UNDECIDED}, 1)
    assert choice.regions == (wall.region,)
    assert "could not decide" in choice.reasons[0]
    # Where everything contradicts, the calibration itself will say so.
    assert judged(choice_of([leaves]), {leaves.region: REFUSED}, 1).regions == (leaves.region,)


def test_outsiders_are_tried_too_lest_most_of_the_picture_be_leaves():
    ranked = [*(candidate(k) for k in range(8)), *(candidate(k, fixed=False) for k in range(8, 12))]
    places = trial_places(ranked)
    assert len(places) == TRIAL_PLACES
    assert sum(not place.fixed for place in places) == 2
