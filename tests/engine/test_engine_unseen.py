"""Events of a camera that gives no pictures, or none that tell anything."""

from dataclasses import replace
from types import SimpleNamespace

import pytest

from midspan.engine.sensors import Unseen
from midspan.engine.tracking import TargetTracking
from midspan.records import PixelTranslation, Region, Status
from midspan.vision.target import lost

STEP_S = 0.1


def found(number, reason, step_s=STEP_S):
    """What is found in a frame: the target, or why it is not."""
    stamp = round(1e9 * step_s * number)
    if reason == "":
        return PixelTranslation(stamp, 1.0, 2.0, 1e-4, 1e-4, 1.0, Status.TRACKING)
    return lost(stamp) if reason == "lost" else replace(lost(stamp), unseen=reason)


def events_of(reasons, left_out=(), step_s=STEP_S):
    """The events of frames with these reasons, without some of them."""
    known, events = Unseen(), []
    for number, reason in enumerate(reasons):
        if number not in left_out:
            one = found(number, reason, step_s)
            known, reported = known.after(one.time_ns, (one,), step_s, "camera")
            events += reported
    return events


def test_frames_that_are_missing_are_a_gap():
    (event,) = events_of([""] * 100, left_out=range(40, 70))
    assert (event.kind, event.time_ns) == ("gap", 3_900_000_000)
    assert event.text == "camera: no frames for 3.1 s."
    # Two lost frames are no gap yet, as of the accelerometer.
    assert events_of([""] * 100, left_out=(50,)) == []


@pytest.mark.parametrize("reason", ["dark", "frozen", "lost"])
def test_a_while_without_the_target_is_an_event_with_its_time_and_length(reason):
    begun, ended = events_of([""] * 40 + [reason] * 50 + [""] * 30)
    assert (begun.kind, begun.time_ns) == (reason, 4_000_000_000)
    assert "from 4.000 s on" in begun.text
    assert (ended.kind, ended.time_ns) == ("seen", 9_000_000_000)
    assert ended.text.endswith("no measurement for 5.0 s.")
    # It is reported when it has lasted for long enough, also where it never ends; a few frames are not.
    assert [event.kind for event in events_of([""] * 40 + [reason] * 31)] == [reason]
    assert events_of([""] * 40 + [reason] * 30) == []
    assert events_of([""] * 40 + [reason] * 25 + [""] * 40) == []


def test_a_few_frames_of_a_slow_camera_are_no_loss():
    # One frame in two seconds: five of them, which last 8 s, are not five intervals.
    assert events_of(["", *["lost"] * 5, ""], step_s=2.0) == []
    assert [event.kind for event in events_of(["", *["lost"] * 6, "", ""], step_s=2.0)] == ["lost", "seen"]


def test_another_reason_that_lasts_is_reported():
    events = events_of([""] * 10 + ["lost"] * 40 + ["dark"] * 40 + [""] * 2)
    assert [(event.kind, event.time_ns / 1e9) for event in events] == [("lost", 1.0), ("dark", 5.0), ("seen", 9.0)]
    assert events[-1].text.endswith("no measurement for 8.0 s.")


def test_at_dusk_what_goes_to_and_fro_is_one_loss():
    (begun, ended) = events_of([""] * 10 + ["lost", "dark", "dark"] * 40 + [""] * 2)
    assert (begun.time_ns, ended.time_ns) == (1_000_000_000, 13_000_000_000)


def test_a_frozen_picture_that_the_codec_makes_anew_now_and_then_stays_frozen():
    (begun, ended) = events_of([""] * 30 + (["frozen"] * 14 + [""]) * 5 + [""] * 20)
    assert (begun.kind, begun.time_ns) == ("frozen", 3_000_000_000)
    # The last frame of the codec's is the first of the moving picture.
    assert (ended.kind, ended.time_ns) == ("seen", 3_000_000_000 + 74 * 100_000_000)


def test_a_target_that_is_seen_is_enough():
    known, events = Unseen(), []
    for number in range(50):
        both = (found(number, ""), found(number, "lost"))
        known, reported = known.after(both[0].time_ns, both, STEP_S, "camera")
        events += reported
    assert events == []
    # Two that are not seen, each for a reason of its own.
    for number in range(50, 100):
        both = (found(number, "frozen"), found(number, "lost"))
        known, reported = known.after(both[0].time_ns, both, STEP_S, "camera")
        events += reported
    assert [event.kind for event in events] == ["lost"]


def test_an_unchanged_region_of_a_compressed_film_is_not_called_a_repeated_frame():
    chain = SimpleNamespace(
        name="1", region=Region(0, 0, 64, 64), tracker=None, frozen_frames=15, picture=None, light=None
    )
    (compressed,) = TargetTracking(chain).warnings("y", compressed=True)
    (plain,) = TargetTracking(chain).warnings("y")
    assert "compression drops small changes" in compressed
    assert "repeat the previous image" not in compressed
    assert "15 frames repeat the previous image" in plain
    assert compressed.code == plain.code == "frozen"
