"""Reference frames replaced by the number of matches."""

import numpy as np
import pytest
from reference_scenes import REGION, swept, track

from midspan.errors import UsageError
from midspan.papers.printed.updating import UpdatingSettings, UpdatingTracker, match_threshold, moving_average
from midspan.vision.tracker import open_tracker

# Half a minute from dawn to dusk, in five frames a second.
DAY_DEG = 60.0 * -np.cos(np.pi * np.arange(150) / 150)
QUICK = {"threshold_frames": 10, "average_frames": 3}


@pytest.fixture(scope="module")
def day():
    return swept(1, DAY_DEG)


def test_the_moving_average_and_the_printed_threshold_are_those_of_the_equations() -> None:
    matches = [30.0, 34.0, 26.0, 30.0, 99.0, 99.0]
    printed = UpdatingSettings(literal=True, threshold_frames=4)
    # Mean 30, standard deviation √8.
    assert match_threshold(matches, printed) == pytest.approx(30.0 - 3.0 * np.sqrt(8.0))
    assert moving_average(matches[:4], 3) == pytest.approx(30.0)


def test_as_printed_scattered_matches_never_fall_below_the_threshold_and_with_the_floor_they_do() -> None:
    scattered = [5.0, 20.0, 12.0, 31.0, 9.0, 3.0, 25.0, 14.0]
    assert match_threshold(scattered, UpdatingSettings(literal=True, threshold_frames=8)) < 0.0
    assert match_threshold(scattered, UpdatingSettings(threshold_frames=8)) == 10.0


def test_in_steady_light_the_reference_stays_and_the_track_is_the_fixed_trackers() -> None:
    frames, _ = swept(2, np.full(40, 30.0))
    for literal in (True, False):
        updating = UpdatingTracker(frames[0], REGION, UpdatingSettings(tracker="template", literal=literal, **QUICK))
        xy, _ = track(updating, frames)
        fixed, _ = track(open_tracker("template", frames[0], REGION), frames)
        np.testing.assert_array_equal(xy, fixed)
        assert updating.state.updates == 0


def test_a_turning_light_loses_a_fixed_reference_and_not_one_that_is_replaced(day) -> None:
    frames, moved = day
    fixed, _ = track(open_tracker("template", frames[0], REGION), frames)
    assert np.isnan(fixed[:, 0]).mean() > 0.4
    settings = UpdatingSettings(tracker="template", least_matches=50.0, **QUICK)
    updating = UpdatingTracker(frames[0], REGION, settings)
    xy, std = track(updating, frames)
    assert not np.isnan(xy).any()
    assert 2 <= updating.state.updates <= 28  # the published test of 210 s had 28
    # What light does to shading is a part of the error that no bookkeeping takes away.
    assert np.sqrt(np.mean((xy - moved) ** 2)) < 0.25
    assert std[-1].min() > 3 * std[5].max()  # errors add up from reference to reference, and that is said


def test_matches_of_features_are_counted_and_replace_the_reference_too(day) -> None:
    frames, moved = day
    updating = UpdatingTracker(frames[0], REGION, UpdatingSettings(**QUICK))
    xy, _ = track(updating, frames[:90])
    assert updating.state.updates >= 1
    assert not np.isnan(xy).any()
    assert min(updating.state.current.matches) >= 3.0  # numbers of matches, not shares
    assert np.sqrt(np.mean((xy - moved[:90]) ** 2)) < 0.5


def test_when_the_light_comes_back_so_does_the_first_frame() -> None:
    there = -50.0 + 70.0 * np.arange(60) / 60
    frames, moved = swept(3, np.concatenate([there, there[::-1], np.full(25, -50.0)]))
    settings = UpdatingSettings(tracker="template", least_matches=80.0, **QUICK)
    updating = UpdatingTracker(frames[0], REGION, settings)
    xy, _ = track(updating, frames)
    assert updating.state.updates >= 2
    assert updating.state.current.number == 0
    # The noise of one frame, and nothing that had added up before.
    assert np.abs((xy - moved)[-10:]).max() < 0.05


def test_a_tracker_restored_from_its_state_goes_on_alike(day) -> None:
    frames, _ = day
    settings = UpdatingSettings(tracker="template", least_matches=50.0, **QUICK)
    whole = UpdatingTracker(frames[0], REGION, settings)
    track(whole, frames[:80])
    assert whole.state.updates > 0
    other = UpdatingTracker(frames[0], REGION, settings)
    other.restore(whole.state)
    np.testing.assert_array_equal(track(other, frames[80:110])[0], track(whole, frames[80:110])[0])


@pytest.mark.parametrize("wrong", [{"tracker": "surf"}, {"threshold_frames": 1}, {"sigmas": -1.0}])
def test_settings_out_of_range_are_refused(wrong) -> None:
    with pytest.raises(UsageError):
        UpdatingSettings(**wrong)
