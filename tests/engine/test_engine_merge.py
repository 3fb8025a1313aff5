"""The order of time of several streams: whatever the interleaving and the cutting; late, doubled and silent ones."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from midspan.engine.merge import Merge
from midspan.errors import UsageError
from midspan.records import Arrival, ClockOffset, Complete, Event, Frame, Readings, Tick

MS = 1_000_000
PIXELS = np.zeros((2, 2), dtype=np.uint8)


def readings(times_ms):
    times = np.asarray(times_ms, dtype=np.int64)
    return Readings(times * MS, np.column_stack((times, -times)).astype(np.float64))


def frame(time_ms):
    return Frame(time_ms * MS, PIXELS)


def flat(arrivals):
    """One row for each reading, frame and event that was given out; readings between two others in order of time."""
    rows, between = [], []
    for arrival in arrivals:
        record = arrival.record
        if not isinstance(record, Readings):
            rows, between = [*rows, *sorted(between, key=lambda row: row[1])], []
        if isinstance(record, Readings):
            between += [
                (arrival.stream, int(t) // MS, float(v))
                for t, v in zip(record.time_ns, record.value[:, 0], strict=True)
            ]
        elif isinstance(record, Event):
            rows.append((arrival.stream, record.time_ns // MS, record.kind))
        else:
            rows.append((arrival.stream, record.time_ns // MS, None))
    return [*rows, *sorted(between, key=lambda row: row[1:2])]


def counts(stream):
    """What is counted of a stream."""
    return (stream.name, stream.newest_ns, stream.used, stream.late, stream.disordered, stream.lost)


def pushed(merge, *records):
    return flat([arrival for record in records for arrival in merge.push(record)])


def arrivals(stream, records):
    return [Arrival(stream, number, record) for number, record in enumerate(records)]


@st.composite
def recordings(draw):
    """Three streams' records in their order, with faults, and an interleaving of them."""
    streams = {}
    for name in ("accel", "level"):
        times = draw(st.lists(st.integers(0, 60), min_size=1, max_size=25))
        times = times if draw(st.booleans()) else sorted(set(times))
        cuts = sorted(draw(st.lists(st.integers(0, len(times)), max_size=4)))
        streams[name] = [readings(piece) for piece in np.split(np.array(times), cuts)]
    streams["camera"] = [frame(t) for t in draw(st.lists(st.integers(0, 60), min_size=1, max_size=12))]
    turns = draw(st.permutations([name for name, records in streams.items() for _ in records]))
    return streams, turns


@given(recordings())
@settings(max_examples=200, deadline=None)
def test_the_order_depends_on_neither_interleaving_nor_cutting(case):
    streams, turns = case

    def run(order, whole):
        merge = Merge(("accel", "level", "camera"), math.inf, math.inf)
        waiting = {name: iter(arrivals(name, records)) for name, records in streams.items()}
        out = []
        for name in order:
            arrival = next(waiting[name])
            rows = len(arrival.record.time_ns) if isinstance(arrival.record, Readings) else 0
            pieces = [arrival]
            if not whole and rows:
                parts = [
                    Readings(arrival.record.time_ns[k : k + 1], arrival.record.value[k : k + 1]) for k in range(rows)
                ]
                pieces = [Arrival(name, arrival.sequence, piece) for piece in parts]
            for piece in pieces:
                # The state is all there is: another merge goes on from it.
                after = Merge(("accel", "level", "camera"), math.inf, math.inf)
                after.restore(merge.state)
                merge = after
                out += merge.push(piece)
        return flat(out + merge.finish()), merge.state.streams

    first, health = run(turns, whole=True)
    assert [row[1] for row in first] == sorted(row[1] for row in first)
    in_turn = [name for name, records in streams.items() for _ in records]
    for order in (turns, in_turn):
        again, the_same = run(order, whole=False)
        assert again == first
        assert [counts(one) for one in the_same] == [counts(one) for one in health]
    # Nothing is lost but what is out of order, and that is counted.
    for stream in health:
        given_out = [row for row in first if row[0] == stream.name and not isinstance(row[2], str)]
        stamps = [t for r in streams[stream.name] for t in np.atleast_1d(r.time_ns)]
        assert len(given_out) == stream.used
        assert stream.used + stream.disordered == len(stamps)
        assert [row[1] for row in given_out] == sorted({row[1] for row in given_out})


def test_a_block_is_cut_where_a_frame_belongs():
    merge = Merge(("accel", "camera"))
    assert pushed(merge, Arrival("accel", 0, readings(range(0, 50, 10)))) == []
    assert pushed(merge, Arrival("camera", 0, frame(20))) == [
        ("accel", 0, 0.0),
        ("accel", 10, 10.0),
        ("accel", 20, 20.0),
        ("camera", 20, None),
    ]
    assert flat(merge.finish()) == [("accel", 30, 30.0), ("accel", 40, 40.0)]


def test_a_stream_is_waited_for_until_it_is_late_and_then_left_out():
    merge = Merge(("accel", "camera"), lateness_s=0.5)
    pushed(merge, Arrival("accel", 0, readings(range(0, 400, 10))), Arrival("camera", 0, frame(0)))
    # 400 ms behind is in time.
    assert ("camera", 33, None) in pushed(merge, Arrival("camera", 1, frame(33)))
    out = pushed(merge, Arrival("accel", 1, readings(range(400, 1000, 10))))
    assert out[-1] == ("accel", 490, 490.0)
    assert merge.state.streams[1].newest_ns < merge.state.released_ns
    assert pushed(merge, Arrival("camera", 2, frame(400)), Arrival("camera", 3, frame(433))) == []
    assert merge.state.streams[1].late == 2
    # What is not late is used, between the readings where it belongs.
    out = pushed(merge, Arrival("camera", 4, frame(505)))
    assert out == [("camera", 490, "late"), ("accel", 500, 500.0), ("camera", 505, None)]
    assert merge.state.streams[1].newest_ns >= merge.state.released_ns


def test_a_block_that_is_late_in_part_loses_that_part_only():
    merge = Merge(("accel", "level"), lateness_s=0.1)
    pushed(merge, Arrival("accel", 0, readings(range(0, 300, 10))))
    out = pushed(merge, Arrival("level", 0, readings([150, 180, 195, 205])))
    assert [row for row in out if row[0] == "level"] == [
        ("level", 190, "late"),
        ("level", 195, 195.0),
        ("level", 205, 205.0),
    ]
    assert (merge.state.streams[1].late, merge.state.streams[1].used) == (2, 2)


def test_a_silent_stream_is_out_until_it_returns():
    merge = Merge(("accel", "camera"), lateness_s=math.inf, silent_s=5.0)
    out = pushed(merge, Tick(0), Arrival("accel", 0, readings([0, 10])), Arrival("camera", 0, frame(0)))
    assert out == [("accel", 0, 0.0), ("camera", 0, None)]
    assert pushed(merge, Arrival("camera", 1, frame(20)), Arrival("camera", 2, frame(40)))[0] == ("accel", 10, 10.0)
    assert pushed(merge, Tick(5000 * MS)) == []
    assert pushed(merge, Arrival("camera", 3, frame(60)), Tick(5001 * MS)) == [
        ("accel", 10, "silent"),
        ("camera", 20, None),
        ("camera", 40, None),
        ("camera", 60, None),
    ]
    assert merge.state.streams[0].out
    out = pushed(merge, Arrival("accel", 1, readings([50, 70, 80])), Arrival("camera", 4, frame(90)))
    assert out == [("accel", 60, "late"), ("accel", 60, "returned"), ("accel", 70, 70.0), ("accel", 80, 80.0)]
    assert not merge.state.streams[0].out


def test_nobody_is_silent_while_the_process_was_stopped():
    """Ticks a minute apart: what was sent meanwhile is still on its way, and comes in the order that it was sent in."""
    merge = Merge(("accel", "camera"), lateness_s=0.02, silent_s=5.0)
    out = pushed(merge, Tick(0), Arrival("accel", 0, readings([0, 10])), Arrival("camera", 0, frame(10)))
    for k in range(1, 100):
        out += pushed(merge, Tick((60_000 + k) * MS), Arrival("accel", k, readings([10 * k + 10])))
        out += pushed(merge, Arrival("camera", k, frame(10 * k + 10)))
    assert all(not isinstance(what, str) for _, _, what in out)
    assert sum(stream == "camera" for stream, _, _ in out) >= 98
    # From here on they are silent.
    assert [what for _, _, what in pushed(merge, *(Tick((60_000 + 1000 * k) * MS) for k in range(8)))].count(
        "silent"
    ) == 2


@pytest.mark.parametrize("first", ["accel", "camera"])
def test_what_goes_on_after_the_process_was_stopped_is_no_clock_set_ahead(first):
    """Senders that keep nothing: after a stop of 40 s their stamps go on 40 s later, whichever comes first."""
    merge = Merge(("accel", "camera"), lateness_s=0.02, silent_s=5.0)
    out = pushed(merge, Tick(0), Arrival("accel", 0, readings([0, 10])), Arrival("camera", 0, frame(10)))
    other = Merge(("accel", "camera"), lateness_s=0.02, silent_s=5.0)
    other.restore(merge.state)
    out = pushed(other, Tick(40_000 * MS))
    for k in range(1, 200):
        both = [
            Arrival("accel", k, readings([40_000 + 10 * k])),
            Arrival("camera", k, frame(40_000 + 10 * k)),
        ]
        out += pushed(other, Tick((40_000 + 10 * k) * MS), *(both if first == "accel" else both[::-1]))
    assert all(not isinstance(what, str) for _, _, what in out)
    assert sum(stream == "accel" for stream, _, _ in out) >= 198
    # A clock that is set ahead while somebody listens is one still.
    pushed(other, Arrival("accel", 200, readings([90_000])))
    assert other.state.streams[0].disordered == 1


def test_faults_within_a_stream_are_events_at_their_place():
    merge = Merge(("accel",))
    out = pushed(merge, Arrival("accel", 0, readings([0, 10, 10, 20, 5, 6, 30])), Arrival("accel", 3, readings([40])))
    assert out == [
        ("accel", 0, 0.0),
        ("accel", 10, 10.0),
        ("accel", 10, "doubled"),
        ("accel", 20, 20.0),
        ("accel", 20, "backwards"),
        ("accel", 30, 30.0),
        ("accel", 30, "lost"),
        ("accel", 40, 40.0),
    ]
    assert (merge.state.streams[0].disordered, merge.state.streams[0].lost) == (3, 2)


def test_stamps_that_are_no_times_and_streams_far_ahead_harm_nobody():
    merge = Merge(("accel", "camera"), silent_s=1.0)
    far = Readings(np.array([0, 2**63 - 1, -(2**63), 10 * MS], dtype=np.int64), np.zeros((4, 2)))
    out = pushed(
        merge, Arrival("accel", 0, far), Arrival("camera", 0, frame(3_600_000)), Arrival("camera", 1, frame(10))
    )
    assert [row[2] for row in out] == ["ahead", 0.0, "stamp", 0.0, None]
    assert merge.state.streams[1].newest_ns == 10 * MS


def test_an_offset_holds_from_its_stamp_on():
    merge = Merge(("accel", "camera"), math.inf)
    offset = ClockOffset("camera", 7 * MS, from_ns=20 * MS)
    out = pushed(
        merge, offset, *(Arrival("camera", k, frame(10 * k)) for k in range(5)), Arrival("accel", 0, readings([100]))
    )
    assert [row[1] for row in out] == [0, 10, 27, 37, 47]
    # One that lets the clock run back leaves out what is no later than what came.
    out = pushed(
        merge, ClockOffset("camera", -20 * MS, 50 * MS), *(Arrival("camera", k, frame(10 * k)) for k in range(5, 8))
    )
    assert [row[1:] for row in out] == [(47, "backwards"), (50, None)]


def test_offsets_that_are_still_to_come_are_all_kept():
    merge = Merge(("accel", "camera"), math.inf)
    offsets = [ClockOffset("camera", add * MS, start * MS) for add, start in ((20, 1000), (10, 0), (15, 700))]
    frames = [Arrival("camera", k, frame(time)) for k, time in enumerate((500, 600, 800, 1200))]
    out = pushed(merge, *offsets, *frames, Arrival("accel", 0, readings([2000])))
    assert [row[1] for row in out] == [510, 610, 815, 1220]
    # Readings of one block, cut where an offset ends.
    merge = Merge(("accel", "level"), math.inf)
    offsets = [replace(one, stream="level") for one in offsets]
    block = Arrival("level", 0, readings([500, 600, 800, 1200]))
    out = pushed(merge, *offsets, block, Arrival("accel", 0, readings([2000])))
    assert [row[1:] for row in out] == [(510, 500.0), (610, 600.0), (815, 800.0), (1220, 1200.0)]


def test_what_is_complete_waits_for_nobody():
    merge = Merge(("accel", "level", "camera"), math.inf, math.inf)
    pushed(merge, Arrival("accel", 0, readings(range(0, 100, 10))), Arrival("level", 0, readings([0, 15])))
    assert pushed(merge, Arrival("camera", 0, frame(20)))[-1] == ("level", 15, 15.0)
    assert pushed(merge, Complete(20 * MS)) == [("accel", 20, 20.0), ("camera", 20, None)]
    after = Merge(("accel", "level", "camera"), math.inf, math.inf)
    after.restore(merge.state)
    # Of a stamp that is complete nothing more may come.
    out = pushed(after, Arrival("camera", 1, frame(40)), Arrival("level", 1, readings([18])), Complete(40 * MS))
    assert ("camera", 40, None) in out
    assert after.state.streams[1].late == 1
    assert not any(after.state.held[1:])


def sent(stamp_ms, *, accel_ms=0, camera_ms=0, from_ms=10_000, to_ms=30_000, cut=1):
    """Records at their true times: two streams whose clocks are set at `from_ms` by so much, and ticks."""
    items = [(float(time), Tick(time * MS)) for time in range(0, to_ms, 500)]
    for name, step_ms, late in (("accel", accel_ms, 0.1), ("camera", camera_ms, 50.2)):
        for k, time in enumerate(range(0, to_ms, stamp_ms[name])):
            own = time + (step_ms if time >= from_ms else 0)
            items.append((time + late, Arrival(name, k, readings([own]) if name == "accel" else frame(own))))
    return [item for _, item in sorted(items, key=lambda pair: pair[0])]


@pytest.mark.parametrize("step_ms", [-60_000, -3_000, 60_000])
@pytest.mark.parametrize("name", ["accel", "camera"])
def test_a_clock_that_is_set_for_good_costs_seconds_and_the_stream_goes_on(name, step_ms):
    merge = Merge(("accel", "camera"), lateness_s=0.5)
    out = []
    for item in sent({"accel": 100, "camera": 200}, **{f"{name}_ms": step_ms}):
        out += merge.push(item)
        if isinstance(item, Tick):
            other = Merge(("accel", "camera"), lateness_s=0.5)
            other.restore(merge.state)
            merge = other
    rows = flat(out + merge.finish())
    own = [(t, what) for stream, t, what in rows if stream == name]
    kinds = [what for _, what in own if isinstance(what, str)]
    assert kinds == ["ahead" if step_ms > 0 else "backwards", "clock"]
    # Its interval is known exactly here: each record has the true time again.
    given = np.array([t for t, what in own if not isinstance(what, str)])
    step = {"accel": 100, "camera": 200}[name]
    missing = np.setdiff1d(np.arange(0, 30_000, step), given)
    assert np.isin(given, np.arange(0, 30_000, step)).all()
    # Two seconds, and a tick until they are seen to have passed.
    assert 2000 <= len(missing) * step <= 3000
    assert missing[0] == 10_000
    # The other stream loses nothing, and nobody is out; the camera is behind by its delay.
    others = [what for stream, _, what in rows if stream != name]
    assert not any(isinstance(what, str) for what in others)
    assert not any(one.out for one in merge.state.streams)


@pytest.mark.parametrize("seed", range(5))
def test_where_a_block_is_cut_has_no_effect_on_a_clock_that_is_set(seed):
    rng = np.random.default_rng(seed)
    stamps = np.concatenate((np.arange(0, 8000, 10), np.arange(3000, 9000, 10), np.arange(40_000, 47_000, 10)))
    cuts = np.sort(rng.integers(0, len(stamps), 40))
    found = []
    for pieces in (np.split(stamps, np.arange(100, len(stamps), 100)), np.split(stamps, cuts)):
        merge, out, done = Merge(("accel",)), [], 0
        for number, piece in enumerate(pieces):
            # A tick at each true second, between the same two readings in both ways.
            for part in np.split(piece, np.arange(-done % 100, len(piece), 100)):
                if done % 100 == 0 and len(part):
                    out += merge.push(Tick(10 * done * MS))
                out += merge.push(Arrival("accel", number, readings(part)))
                done += len(part)
        found.append((flat(out + merge.finish()), counts(merge.state.streams[0])))
    assert found[0] == found[1]
    assert [row[2] for row in found[0][0] if isinstance(row[2], str)] == ["backwards", "clock", "ahead", "clock"]


def test_records_that_are_sent_once_more_are_no_clock_that_was_set():
    """A broker repeats a minute of messages at once, or packets overtake each other."""
    merge, out = Merge(("accel",)), []
    for time in range(0, 60_000, 100):
        if time % 500 == 0:
            out += merge.push(Tick(time * MS))
        out += merge.push(Arrival("accel", time // 100, readings([time])))
    for time in range(0, 60_000, 100):
        if time % 30_000 == 0:
            out += merge.push(Tick((60_000 + time // 100) * MS))
        out += merge.push(Arrival("accel", time // 100, readings([time])))
    out += merge.push(Arrival("accel", 600, readings([60_600])))
    assert [row[2] for row in flat(out) if isinstance(row[2], str)] == ["backwards"]
    assert merge.state.streams[0].newest_ns == 60_600 * MS


def test_a_pause_in_which_a_clock_was_set_is_as_long_as_the_others_went_on():
    """A logger starts anew after 20 s, with its clock an hour back."""
    items = sent({"accel": 100, "camera": 200}, accel_ms=-3_600_000, from_ms=20_000, to_ms=40_000)
    items = [
        item
        for item in items
        if not (isinstance(item, Arrival) and item.stream == "accel" and 1000 * 10 <= item.sequence * 100 < 20_000)
    ]
    merge, out = Merge(("accel", "camera"), lateness_s=0.5), []
    for item in items:
        out += merge.push(item)
    rows = flat(out + merge.finish())
    reported = [(stream, what) for stream, _, what in rows if isinstance(what, str)]
    # What it did not send is lost by its numbers; at its return one record lies where the camera is already.
    assert reported == [("accel", what) for what in ("silent", "lost", "backwards", "clock", "late", "returned")]
    given = np.array([value for stream, _, value in rows if stream == "accel" and not isinstance(value, str)])
    at = np.array([t for stream, t, value in rows if stream == "accel" and not isinstance(value, str)])
    # True times of what came after, from its values: the camera tells them to its interval and its delay.
    true = np.where(given < 0, given + 3_600_000, given)
    assert np.abs(at - true).max() <= 300
    assert true.max() == 39_900


def test_a_stream_that_is_only_early_has_no_clock_that_was_set():
    """The accelerometer's network takes 12 s: the camera is ahead of it for ever."""
    merge, out = Merge(("accel", "camera")), []
    items = [(float(time), Tick(time * MS)) for time in range(0, 60_000, 500)]
    items += [(time + 12_000.1, Arrival("accel", time // 100, readings([time]))) for time in range(0, 48_000, 100)]
    items += [(time + 50.2, Arrival("camera", time // 200, frame(time))) for time in range(0, 60_000, 200)]
    for _, item in sorted(items, key=lambda pair: pair[0]):
        out += merge.push(item)
    reported = [row[::2] for row in flat(out + merge.finish()) if isinstance(row[2], str)]
    assert ("camera", "clock") not in reported
    assert reported.count(("camera", "ahead")) == 1
    camera = merge.state.streams[1]
    assert camera.used + camera.late + camera.disordered == 300


def test_silence_is_reported_by_what_came():
    merge = Merge(("accel", "camera"), silent_s=5.0)
    pushed(merge, Tick(0), Arrival("accel", 0, readings([1000])), Arrival("camera", 0, frame(1000)))
    out = []
    for second in range(1, 8):
        # Stamps that go on nowhere.
        stamp = 900 if second % 2 else 800
        out += merge.push(Arrival("accel", second, readings([stamp]))) + merge.push(Tick(second * 1000 * MS))
    out += merge.finish()
    texts = {
        one.stream: one.record.text for one in out if isinstance(one.record, Event) and one.record.kind == "silent"
    }
    assert "no record with a usable time stamp arrived for" in texts["accel"]
    assert "nothing arrived for" in texts["camera"]


@pytest.mark.parametrize(
    "wrong",
    [
        lambda: Merge(()),
        lambda: Merge(("a", "a")),
        lambda: Merge(("a",), lateness_s=-1.0),
        lambda: Merge(("a",)).push(Arrival("b", 0, readings([0]))),
        lambda: Merge(("a",)).restore(Merge(("b",)).state),
    ],
)
def test_wrong_use_is_refused(wrong):
    with pytest.raises(UsageError):
        wrong()
