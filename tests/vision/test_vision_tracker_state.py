"""The state of every tracker: one built anew goes on from it exactly as the old one, whatever had happened."""

import pickle
from dataclasses import astuple, replace
from itertools import cycle

import numpy as np
import pytest
from moving_dots import Dots, Pull, filmed
from reference_scenes import REGION, Body, crossed, swept

from midspan.papers.printed.updating import UpdatingSettings, UpdatingTracker
from midspan.records import Prediction, Status
from midspan.vision.reference.policy import KeyFrameSettings
from midspan.vision.reference.tracker import KeyFrameTracker
from midspan.vision.tracker import TRACKERS, open_tracker
from repeats import slow

# Before, in and after the dark second; the first frame and the last dark one besides.
CUTS, ALL_CUTS = (17, 31, 45), (1, 17, 31, 34, 45)


def wall():
    """Light that turns by 80 degrees in 12 s, a dark second and a body that hides a third; 60 frames and the region."""
    frames, moved = swept(1, np.linspace(-50.0, 30.0, 60))
    frames = crossed(frames, moved, Body(0.35, 8.0, 3.0))
    black = [replace(f, pixels=np.zeros_like(f.pixels)) if 30 <= f.index < 35 else f for f in frames]
    return black, REGION


def dots():
    """A row of dots that is pulled and released by more than half their spacing a frame: the tracker is confused."""
    scene = Dots(columns=960, texture=6.0)
    frames, _ = filmed(scene, Pull(), 55)
    return frames, scene.region(0)


@pytest.fixture(scope="module")
def films():
    return {"wall": wall(), "dots": dots()}


def opened(name):
    """What opens the tracker called so, which may be a rule for the reference frame with a tracker inside."""
    rule, _, inner = name.rpartition(" ")
    if rule == "updating":
        settings = UpdatingSettings(inner, threshold_frames=10, average_frames=3, least_matches=50.0)
        return lambda frame, region: UpdatingTracker(frame, region, settings)
    if rule:
        keys = KeyFrameSettings(inner, heat=rule == "heat", most=3, overlap_frames=5)
        return lambda frame, region: KeyFrameTracker(frame, region, keys)
    return lambda frame, region: open_tracker(inner, frame, region)


NAMES = [(name, film) for name in TRACKERS for film in ("wall", "dots")]
NAMES += [(name, "wall") for name in ("keys template", "keys features", "keys registration", "keys hybrid")]
NAMES += [(name, "wall") for name in ("heat template", "updating template", "updating features")]


@pytest.mark.parametrize("cuts", [CUTS, *slow((ALL_CUTS,))])
@pytest.mark.parametrize(("name", "film"), NAMES)
def test_a_tracker_built_anew_goes_on_from_a_state_to_the_last_bit(films, name, film, cuts):
    frames, region = films[film]
    make = opened(name)
    guesses = cycle([None, None, Prediction(0.0, 0.0, 5.0, 5.0)]) if film == "wall" else cycle([None])
    reported = [(frame, guess) for frame, guess in zip(frames, guesses, strict=False)]
    old, states, rows = make(frames[0], region), {}, []
    for k, (frame, guess) in enumerate(reported):
        if k in cuts:
            states[k] = old.state
        rows.append(old.push(frame, guess))
    assert {row.status for row in rows} == {Status.TRACKING, Status.LOST}
    for cut, state in states.items():
        new = make(frames[0], region)
        # Written and read, as a checkpoint is: nothing is shared with the old one, and no code is in it.
        new.restore(pickle.loads(pickle.dumps(state)))
        later = [new.push(frame, guess) for frame, guess in reported[cut:]]
        np.testing.assert_equal([astuple(row) for row in later], [astuple(row) for row in rows[cut:]])
        assert new.region_now == old.region_now
