"""The order of time of several streams: whatever the interleaving and the cutting; late, doubled and silent ones."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from midspan.engine.merge import Merge
from midspan.errors import UsageError
from midspan.records import Arrival, ClockOffset, Event, Frame, Readings, StreamState, Tick

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
        return flat(out + merge.finish()), merge.health

    first, health = run(turns, whole=True)
    assert [row[1] for row in first] == sorted(row[1] for row in first)
    in_turn = [name for name, records in streams.items() for _ in records]
    for order in (turns, in_turn):
        again, the_same = run(order, whole=False)
        assert again == first
        assert the_same == health
    # Nothing is lost but what is out of order, and that is counted.
    for stream in health:
        given_out = [row for row in first if row[0] == stream.stream and not isinstance(row[2], str)]
        stamps = [t for r in streams[stream.stream] for t in np.atleast_1d(r.time_ns)]
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
    assert merge.health[1].state == StreamState.BEHIND
    assert pushed(merge, Arrival("camera", 2, frame(400)), Arrival("camera", 3, frame(433))) == []
    assert merge.health[1].late == 2
    # What is not late is used, between the readings where it belongs.
    out = pushed(merge, Arrival("camera", 4, frame(505)))
    assert out == [("camera", 490, "late"), ("accel", 500, 500.0), ("camera", 505, None)]
    assert merge.health[1].state == StreamState.LIVE


def test_a_block_that_is_late_in_part_loses_that_part_only():
    merge = Merge(("accel", "level"), lateness_s=0.1)
    pushed(merge, Arrival("accel", 0, readings(range(0, 300, 10))))
    out = pushed(merge, Arrival("level", 0, readings([150, 180, 195, 205])))
    assert [row for row in out if row[0] == "level"] == [
        ("level", 190, "late"),
        ("level", 195, 195.0),
        ("level", 205, 205.0),
    ]
    assert (merge.health[1].late, merge.health[1].used) == (2, 2)


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
    assert merge.health[0].state == StreamState.OUT
    assert "5" in merge.health[0].reason
    out = pushed(merge, Arrival("accel", 1, readings([50, 70, 80])), Arrival("camera", 4, frame(90)))
    assert out == [("accel", 60, "late"), ("accel", 60, "returned"), ("accel", 70, 70.0), ("accel", 80, 80.0)]
    assert merge.health[0].state == StreamState.LIVE


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
    assert (merge.health[0].disordered, merge.health[0].lost) == (3, 2)


def test_stamps_that_are_no_times_and_streams_far_ahead_harm_nobody():
    merge = Merge(("accel", "camera"), silent_s=1.0)
    far = Readings(np.array([0, 2**63 - 1, -(2**63), 10 * MS], dtype=np.int64), np.zeros((4, 2)))
    out = pushed(
        merge, Arrival("accel", 0, far), Arrival("camera", 0, frame(3_600_000)), Arrival("camera", 1, frame(10))
    )
    assert [row[2] for row in out] == ["ahead", 0.0, "stamp", 0.0, None]
    assert merge.health[1].newest_ns == 10 * MS


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
