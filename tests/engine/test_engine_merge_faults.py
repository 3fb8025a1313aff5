"""Networks at their worst through the merge: every record is given out once, in time order, or is reported and
counted."""

import numpy as np
import pytest

from midspan.engine.merge import MAX_AHEAD, Merge
from midspan.records import Arrival, Event, Frame, Readings, Tick
from repeats import slow

RATES_HZ = {"accel": 100.0, "level": 30.0, "camera": 25.0}
COUNT = {"accel": 10, "level": 3, "camera": 1}
LENGTH_S, LATENESS_S, SILENT_S = 20.0, 0.5, 2.0
PIXELS = np.zeros((2, 2), dtype=np.uint8)
DISORDER = {"doubled", "backwards", "stamp", "ahead"}


def spoilt_stamps(rng, name):
    """Stamps (n,) in ns of a stream whose clock may step either way, for good or for one reading."""
    time_s = np.arange(0.0, LENGTH_S, 1.0 / RATES_HZ[name])
    if rng.random() < 0.5:
        time_s[time_s > rng.uniform(2.0, LENGTH_S)] += rng.choice([-3.0, -0.2, 0.2, 3.0, 100.0])
    for k in rng.integers(0, len(time_s), rng.integers(0, 4)):
        time_s[k] += rng.choice([-1.0, -0.05, 0.05, 1.0])
    return np.rint(time_s * 1e9).astype(np.int64)


def sent(rng, name):
    """(time at which it comes, arrival) of a stream, and how many of its arrivals were lost before a later one."""
    stamps, count = spoilt_stamps(rng, name), COUNT[name]
    delay_s = rng.choice([0.02, 0.3, 0.6]) + rng.exponential(0.03, len(stamps) // count + 1)
    # One stream in three is silent for a while.
    silent_s = rng.uniform(0.0, LENGTH_S) if rng.random() < 1.0 / 3.0 else np.inf
    items, kept, came_s = [], [], 0.0
    for number, first in enumerate(range(0, len(stamps), count)):
        block = stamps[first : first + count]
        true_s = (first + len(block) - 1) / RATES_HZ[name]
        if silent_s < true_s < silent_s + 2.0 * SILENT_S or rng.random() < 0.02:
            continue
        # A connection keeps the order of what it carries.
        came_s = max(came_s, true_s + delay_s[number])
        record = Readings(block, np.arange(first, first + len(block))[:, None] * 1.0)
        record = Frame(int(block[0]), PIXELS) if name == "camera" else record
        kept.append(number)
        items += [(came_s, Arrival(name, number, record))] * (2 if rng.random() < 0.02 else 1)
    return items, int(np.sum(np.diff(kept) - 1))


def stamps_of(record):
    return record.time_ns if isinstance(record, Readings) else np.array([record.time_ns])


def in_order(out):
    """Each stream increases, and nothing comes after what belongs behind it."""
    newest = dict.fromkeys(RATES_HZ, -(10**18))
    for arrival in out:
        if isinstance(arrival.record, Event):
            continue
        stamps = stamps_of(arrival.record)
        assert np.all(np.diff(np.concatenate(([newest[arrival.stream]], stamps))) > 0)
        newest[arrival.stream] = int(stamps[-1])
        # Readings of the first stream come last of all up to their time; a frame after readings of the same stamp.
        if arrival.stream != "accel":
            assert stamps[0] >= newest["accel"]
        if arrival.stream != "camera":
            assert stamps[0] > newest["camera"]


@pytest.mark.parametrize("seed", [*range(30), *slow(*range(30, 60))])
def test_every_record_is_given_out_once_in_order_or_is_reported(seed):
    rng = np.random.default_rng(seed)
    streams = {name: sent(rng, name) for name in RATES_HZ}
    items = [item for own, _ in streams.values() for item in own]
    items += [(second, Tick(round(second * 1e9))) for second in np.arange(0.0, LENGTH_S + 2.0, 0.25)]
    merge, out = Merge(tuple(RATES_HZ), LATENESS_S, SILENT_S), []
    # What may wait: until the first stream is out, as far as stamps may be ahead of it, and one arrival more.
    span_s = (1 + MAX_AHEAD) * SILENT_S + LATENESS_S + 1.0
    for number, (_, record) in enumerate(sorted(items, key=lambda item: item[0])):
        out += merge.push(record)
        if number % 50 == 0:
            state = merge.state
            merge = Merge(tuple(RATES_HZ), LATENESS_S, SILENT_S)
            merge.restore(state)
            for name, held in zip(RATES_HZ, state.held, strict=True):
                waiting = sum(len(stamps_of(one.record)) for one in held)
                assert waiting < span_s * RATES_HZ[name] + COUNT[name] + 20
    out += merge.finish()
    in_order(out)
    for health in merge.state.streams:
        own, lost = streams[health.name]
        given = [one.record for one in out if one.stream == health.name]
        reported = {record.kind for record in given if isinstance(record, Event)}
        used = sum(len(stamps_of(record)) for record in given if not isinstance(record, Event))
        assert used == health.used
        assert used + health.late + health.disordered == sum(len(stamps_of(one.record)) for _, one in own)
        assert health.lost == lost
        assert (health.late > 0) == ("late" in reported)
        assert (health.disordered > 0) == bool(reported & DISORDER)
        assert (lost > 0) == ("lost" in reported)


def test_a_first_stream_that_is_back_with_what_it_had_kept_puts_no_others_ahead():
    """Its sender stood still for half a minute and sends all at once: that is late, the others are right."""
    merge, out, number = Merge(["accel", "level"], LATENESS_S, SILENT_S), [], {"accel": 0, "level": 0}

    def block(name, tenth):
        number[name] += 1
        stamps = (np.arange(10) + 10 * tenth) * 10**7
        return Arrival(name, number[name], Readings(stamps, np.zeros((10, 1))))

    for tenth in range(420):
        out += merge.push(Tick(tenth * 10**8))
        out += merge.push(block("level", tenth))
        if not 100 <= tenth < 400:
            # What was kept comes within a second.
            kept = range(30 * (tenth - 400) + 100, 30 * (tenth - 399) + 100) if 400 <= tenth < 410 else ()
            for other in [*kept, tenth]:
                out += merge.push(block("accel", other))
    events = [one.record.kind for one in out if isinstance(one.record, Event)]
    assert events.count("late") == 1
    assert "ahead" not in events
    given = np.concatenate([stamps_of(one.record) for one in out if one.stream == "level" and not is_event(one)])
    np.testing.assert_array_equal(np.diff(given), 10**7)


def is_event(arrival):
    return isinstance(arrival.record, Event)
