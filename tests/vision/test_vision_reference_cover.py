"""Bodies in front of a target: distinguished from light, measured past, nothing learned of them, and no step when they
go."""

import numpy as np
import pytest
from reference_scenes import RATE_HZ, REGION, Body, crossed, shaded, swept, track

from midspan import _core
from midspan.records import Frame
from midspan.vision.reference.tracker import KeyFrameTracker


@pytest.fixture(scope="module")
def still():
    return swept(1, np.full(220, 30.0))


@pytest.fixture(scope="module")
def sweep():
    turn = np.arange(600) / 600
    return swept(4, -60.0 * np.cos(np.pi * turn), 1.0 - 0.65 * np.sin(np.pi * turn) ** 4)


def gone(body):
    """The first frame in which nothing of the body is seen."""
    return round((body.start_s + body.crossing_s + body.parked_s) * RATE_HZ) + 2


def test_cells_agree_by_their_correlation_and_a_flat_or_a_strange_one_does_not() -> None:
    rng = np.random.default_rng(0)
    cell = np.repeat(np.arange(36), 400)
    expected = rng.normal(0.0, 10.0, cell.size).astype(np.float32)
    seen = expected + rng.normal(0.0, 2.0, cell.size).astype(np.float32)
    seen[cell == 3] = 7.0
    seen[cell == 5] = rng.normal(0.0, 10.0, 400)
    seen[cell == 8] += 50.0  # the level is free
    agreed = _core.cell_agreement(seen, seen - expected, cell, 36)
    # A fifth of the contrast and four times the noise are forgiven: of a flat cell 1 - 1 / 1.36 is left.
    assert agreed[3] == pytest.approx(1.0 - 1.0 / 1.36, abs=0.03)
    assert agreed[5] < 0.2
    assert np.delete(agreed, (3, 5)).min() > 0.9


@pytest.mark.parametrize(
    "body",
    [
        Body(0.1, 6.0, 0.6, kind="even"),
        Body(0.2, 6.0, 4.0),
        Body(0.4, 6.0, 20.0, kind="wall"),
        Body(0.4, 6.0, 4.0, 10.0, with_target=True),
        Body(0.6, 6.0, 2.0, 20.0),
    ],
    ids=lambda body: f"{body.kind}-{100 * body.share:.0f}-{body.crossing_s}-{body.parked_s}",
)
def test_in_steady_light_a_body_leaves_nothing_behind(still, body) -> None:
    frames, moved = still
    tracker = KeyFrameTracker(frames[0], REGION)
    events = []
    xy, std = track(tracker, crossed(frames, moved, body), events)
    error = np.abs(xy - moved)
    assert np.isfinite(error[gone(body) :]).all()
    assert error[gone(body) :].max() < 0.03  # noise of one frame: 0.003 px
    seen = np.isfinite(error)
    assert error[seen].max() < 0.1
    assert np.mean(error[seen] < 1.96 * std[seen]) > 0.93
    assert tracker.key_frames == 1
    kinds = [event.kind for event in events]
    assert set(kinds) == {"hidden", "seen"}
    assert kinds[-1] == "seen"


@pytest.mark.parametrize(
    "body",
    [Body(0.2, 35.0, 4.0), Body(0.4, 35.0, 4.0, kind="even"), Body(0.2, 35.0, 4.0, 30.0, with_target=True)],
    ids=["crosses", "even", "parks"],
)
def test_while_the_light_swings_a_body_makes_no_key_frames_of_itself(sweep, body) -> None:
    frames, moved = sweep
    tracker = KeyFrameTracker(frames[0], REGION)
    xy, std = track(tracker, crossed(frames, moved, body))
    error = np.abs(xy - moved)
    assert not np.isnan(error).any()
    assert np.mean(error < 1.96 * std) > 0.93
    assert tracker.key_frames <= 9
    # Key frames of what is left of the target bridge half a minute of the sweep: a quarter of all its light.
    assert error[gone(body) :].max() < 0.15
    assert error.max() < 0.35
    assert np.abs((xy - moved)[-10:].mean(axis=0)).max() < 0.05


def test_a_body_that_stays_for_ever_is_reported_and_the_rest_of_the_target_measured_with_a_larger_error(still) -> None:
    frames, moved = still
    body = Body(0.4, 6.0, 4.0, leaves=False)
    tracker = KeyFrameTracker(frames[0], REGION)
    events = []
    xy, std = track(tracker, crossed(frames, moved, body), events)
    assert [event.kind for event in events] == ["hidden"]
    assert "%" in events[0].text
    error = np.abs(xy - moved)[60:]
    assert np.nanmax(error) < 0.1
    assert np.nanmean(error < 1.96 * std[60:]) > 0.93
    assert np.nanmedian(std[60:]) > 5 * np.median(std[10:28])


def test_something_that_covers_all_of_the_target_is_a_loss_and_not_a_key_frame(still) -> None:
    frames, moved = still
    lorry = Body(1.0, 8.0, 10.0, kind="wall")
    tracker = KeyFrameTracker(frames[0], REGION)
    xy, _ = track(tracker, crossed(frames, moved, lorry))
    error = np.abs(xy - moved)
    assert np.isnan(error[55:75]).any()
    assert np.nanmax(error) < 0.3
    assert tracker.key_frames == 1
    assert np.nanmax(error[gone(lorry) :]) < 0.03


def test_key_frames_of_another_picture_that_faded_in_and_moved_off_are_dropped_when_the_first_is_back() -> None:
    frames, moved = swept(1, np.full(330, 30.0))
    number = np.arange(330)
    share = np.clip(np.minimum((number - 40) / 80, (240 - number) / 40), 0.0, 1.0)
    off = np.round(8.0 * np.clip((number - 120) / 80, 0.0, 1.0)).astype(int)
    faded = []
    for frame, place, part, columns in zip(frames, moved, share, off, strict=True):
        other = np.roll(shaded(71, place, np.deg2rad(30.0), 1.0), columns, axis=1)
        pixels = np.clip(np.rint((1.0 - part) * frame.pixels + part * other), 0, 255).astype(np.uint8)
        faded.append(Frame(frame.time_ns, pixels, frame.index))
    tracker = KeyFrameTracker(frames[0], REGION)
    events = []
    xy, _ = track(tracker, faded, events)
    # A change of all the target at once is what light does: it is followed, and put right with an event.
    assert np.abs(xy - moved)[200:230].max() > 5.0
    dropped = [event for event in events if "dropped" in event.text]
    assert len(dropped) == 1
    back = round(dropped[0].time_ns / 1e9 * RATE_HZ) + 1
    assert np.abs(xy - moved)[back:].max() < 0.03


@pytest.mark.parametrize("cut", [33, 60, 90])
def test_a_tracker_restored_while_something_is_in_front_goes_on_alike(still, cut: int) -> None:
    frames, moved = still
    seen = crossed(frames, moved, Body(0.4, 6.0, 4.0, 6.0))
    whole, _ = track(KeyFrameTracker(frames[0], REGION), seen[:110])
    first, other = KeyFrameTracker(frames[0], REGION), KeyFrameTracker(frames[0], REGION)
    track(first, seen[:cut])
    other.restore(first.state)
    np.testing.assert_array_equal(track(other, seen[cut:110])[0], whole[cut:])


def test_a_tracker_restored_from_an_abandoned_future_knows_nothing_of_it(still) -> None:
    frames, moved = still
    seen = crossed(frames, moved, Body(0.4, 6.0, 4.0, 6.0))
    whole, reported = KeyFrameTracker(frames[0], REGION), []
    track(whole, seen[:60], reported)
    assert [event.kind for event in reported] == ["hidden"]
    tracker = KeyFrameTracker(frames[0], REGION)
    track(tracker, seen[:60])
    state = tracker.state
    track(tracker, frames[60:70], reported)  # without the body: it is reported to have gone
    assert reported[-1].kind == "seen"
    tracker.restore(state)
    np.testing.assert_array_equal(tracker.state.appearance.doubtful, whole.state.appearance.doubtful)
    assert tracker.state.appearance.doubtful.any()
    one, other = [], []
    np.testing.assert_array_equal(track(tracker, seen[60:110], one), track(whole, seen[60:110], other))
    assert one == other
