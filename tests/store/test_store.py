"""The store: nothing that was acknowledged is lost or doubled, and every view shows the same rows."""

import sqlite3
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from midspan.errors import DataError, UsageError
from midspan.records import NANOSECONDS, Event
from midspan.store.chunk import Chunk, join
from midspan.store.database import StoreFault
from midspan.store.days import DAY_NS
from midspan.store.store import Batch, open_store

# Ten seconds before midnight.
BEGIN_NS = 20_700 * DAY_NS - 10 * NANOSECONDS
RATE_HZ = 20


def rows(first, last, point="p"):
    """Rows of the seconds from `first` to `last`."""
    number = np.arange(round(first * RATE_HZ), round(last * RATE_HZ))
    value = np.sin(0.01 * number) + 0.2 * np.sin(1.7 * number)
    columns = {"displacement_m": value, "status": (number % 3).astype(np.uint8)}
    return Chunk(point, "rows", BEGIN_NS + number * (NANOSECONDS // RATE_HZ), columns, 1, "displacement_m")


def kept(store, point="p", first_ns=0, last_ns=2**62):
    found = list(store.chunks(point, "rows", first_ns, last_ns))
    return join(found) if found else None


def written(where, pieces):
    store = open_store(where)
    for piece in pieces:
        store.write(Batch([piece]))
    return store


@pytest.mark.parametrize("piece_s", [0.1, 1.0, 7.3, 100.0])
def test_rows_come_back_whole_across_midnight_however_they_were_cut(store_at, piece_s):
    edges = np.append(np.arange(0.0, 100.0, piece_s), 100.0)
    store = written(store_at, [rows(a, b) for a, b in pairwise(edges)])
    found, true = kept(store), rows(0, 100)
    np.testing.assert_array_equal(found.time_ns, true.time_ns)
    for name, values in true.columns.items():
        np.testing.assert_array_equal(found.columns[name], values)
    part = kept(store, first_ns=int(true.time_ns[150]), last_ns=int(true.time_ns[1500]))
    np.testing.assert_array_equal(part.time_ns, true.time_ns[150:1501])
    store.close()


def test_rows_that_are_pushed_again_are_not_doubled(store_at):
    store = written(store_at, [rows(0, 12), rows(5, 20)])
    store.close()
    store = written(store_at, [rows(3, 25)])
    np.testing.assert_array_equal(kept(store).time_ns, rows(0, 25).time_ns)
    store.close()


@pytest.mark.parametrize("count", [7, 50, 400])
def test_buckets_hold_the_least_and_the_largest_value(store_at, count):
    store, true = written(store_at, [rows(k, k + 5) for k in range(0, 1500, 5)]), rows(0, 1500)
    first_ns, last_ns = BEGIN_NS, BEGIN_NS + 1500 * NANOSECONDS
    found = store.buckets("p", "rows", first_ns, last_ns, count)
    values = true.columns["displacement_m"]
    # Seconds are kept in float32, and rows as they are.
    assert np.nanmin(found.low) == pytest.approx(values.min(), rel=1e-7)
    assert np.nanmax(found.high) == pytest.approx(values.max(), rel=1e-7)
    step_ns = (last_ns - first_ns) // count
    # Each extreme stands in its bucket.
    peak = (true.time_ns[np.argmax(values)] - first_ns) // step_ns
    assert found.high[peak] == pytest.approx(values.max(), rel=1e-7)
    store.close()


def test_gaps_are_gaps_in_buckets(store_at):
    store = written(store_at, [rows(0, 100), rows(300, 400)])
    found = store.buckets("p", "rows", BEGIN_NS, BEGIN_NS + 400 * NANOSECONDS, 40)
    assert np.isnan(found.low[11:30]).all()
    assert np.isfinite(found.low[:10]).all()
    store.close()


def test_points_streams_events_calibrations_and_checkpoints(store_at):
    store = open_store(store_at)
    event = Event(BEGIN_NS, "lost", "The target is lost.")
    store.write(
        Batch([rows(0, 1), rows(0, 1, "q")], [("p", event), ("p", event)], {"p": (BEGIN_NS, [b"\x00st", b"ate"])})
    )
    assert store.points == ["p", "q"]
    assert store.streams("p") == ["rows"]
    assert store.events("p", 0, 2**62) == [event]
    assert store.checkpoint("p") == (BEGIN_NS, b"\x00state")
    assert store.checkpoint("q") is None
    first = store.add_calibration("p", 1, "{}", "{}", accept=True)
    second = store.add_calibration("p", 2, '{"a": 1}', "{}", accept=False)
    assert store.calibration("p").number == first
    store.accept("p", second)
    assert [one.state for one in store.calibrations("p")] == ["retired", "in force"]
    assert store.calibration("p").body == '{"a": 1}'
    store.close()


def test_pieces_that_are_blocks_already_are_not_kept_twice(store_at, monkeypatch):
    """As where a process was killed, or lost its server, after it made blocks and before the log began anew."""
    store = open_store(store_at, points=["p"])
    for number in range(5):
        store.write(Batch([rows(number, number + 1)]))
    with monkeypatch.context() as patched:
        patched.setattr(type(store._pieces), "clear", lambda *_: (_ for _ in ()).throw(StoreFault("x", "gone")))
        with pytest.raises(StoreFault):
            store.flush()
        np.testing.assert_array_equal(kept(store).time_ns, rows(0, 5).time_ns)
    for number in range(5, 8):
        store.write(Batch([rows(number, number + 1)]))
    np.testing.assert_array_equal(kept(store).time_ns, rows(0, 8).time_ns)
    store.flush()
    np.testing.assert_array_equal(kept(store).time_ns, rows(0, 8).time_ns)
    assert store.count("p", "rows", 0, 2**62) == 8 * RATE_HZ
    store.close()


def test_calibrations_that_take_turns_leave_the_rows_in_order(store_at):
    store = open_store(store_at)
    for number in range(6):
        part = rows(number, number + 1)
        store.write(Batch([replace(part, calibration=number % 2)]))
    store.flush()
    found = list(store.chunks("p", "rows", 0, 2**62))
    assert [one.calibration for one in found] == [0, 1, 0, 1, 0, 1]
    np.testing.assert_array_equal(join(found).time_ns, rows(0, 6).time_ns)
    store.close()


def test_days_that_are_too_old_are_removed_whole(store_at):
    store = written(store_at, [rows(k, k + 1) for k in range(40)])
    store.forget_before(BEGIN_NS + 20 * NANOSECONDS)
    assert kept(store).time_ns[0] == BEGIN_NS + 10 * NANOSECONDS
    store.close()


def test_reading_needs_a_store_and_a_known_version(tmp_path):
    with pytest.raises(DataError, match="is not a store"):
        open_store(tmp_path, read_only=True)
    open_store(tmp_path).close()
    with sqlite3.connect(tmp_path / "site.sqlite") as file:
        file.execute("UPDATE meta SET value = '99'")
    with pytest.raises(UsageError, match="version 99"):
        open_store(tmp_path)
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "site.sqlite").write_bytes(b"no database" * 1000)
    with pytest.raises(DataError, match="is damaged"):
        open_store(tmp_path / "other")


def test_a_store_that_cannot_be_written_is_a_fault_with_a_code(tmp_path):
    store = written(tmp_path, [rows(0, 1)])
    reader = open_store(tmp_path, read_only=True)
    with pytest.raises(StoreFault) as fault:
        reader.write(Batch([rows(1, 2)]))
    assert fault.value.code == "store_unavailable"
    store.write(Batch([rows(1, 2)]))
    # A reader sees what was committed since it was opened.
    np.testing.assert_array_equal(kept(reader).time_ns, rows(0, 2).time_ns)
    reader.close()
    store.close()


def rows_with_figures(length_s, rate_hz, seed=0):
    """Rows of random values, some lost, with deviations; stamps that are not even."""
    rng = np.random.default_rng(seed)
    count = round(length_s * rate_hz)
    time_ns = BEGIN_NS + np.sort(rng.choice(round(length_s * 1e6), count, replace=False)) * 1000
    columns = {
        "displacement_m": rng.normal(0.0, 1e-3, count),
        "std_m": rng.uniform(1e-5, 1e-4, count).astype(np.float32),
        "status": rng.choice([0, 0, 0, 1, 2], count).astype(np.int8),
    }
    return Chunk("p", "rows", time_ns, columns, 1, "displacement_m")


@pytest.mark.parametrize("count", [7, 40, 120, 130, 1000])
def test_figures_of_buckets_are_those_of_their_rows(store_at, count):
    """Of whole seconds, and of less than one, exactly; others have each second's extremes in the right bucket."""
    rows = rows_with_figures(130.0, 50.0)
    gap = (rows.time_ns < BEGIN_NS + 40 * NANOSECONDS) | (rows.time_ns >= BEGIN_NS + 65 * NANOSECONDS)
    rows = rows.rows(gap)
    store = open_store(store_at)
    for part in rows.split(1.0):
        store.write(Batch(chunks=[part]))
    edges = BEGIN_NS + (130 * NANOSECONDS * np.arange(count + 1)) // count
    found = store.drawn("p", "rows", edges, "displacement_m")
    status, value = rows.columns["status"], rows.columns["displacement_m"]
    whole = 130 % count == 0 or count > 130
    for k in range(count):
        inside = (rows.time_ns >= edges[k]) & (rows.time_ns < edges[k + 1])
        good = inside & (status != 2)
        if not good.any():
            assert np.isnan([found.low[k], found.high[k]]).all()
            continue
        assert np.isnan(found.low[k]) or found.low[k] >= value[good].min() - 1e-9
        assert np.isnan(found.high[k]) or found.high[k] <= value[good].max() + 1e-9
        if whole:
            assert found.low[k] == pytest.approx(value[good].min(), rel=1e-6)
            assert found.high[k] == pytest.approx(value[good].max(), rel=1e-6)
            assert found.mean[k] == pytest.approx(value[good].mean(), abs=1e-9)
            assert found.std[k] == pytest.approx(rows.columns["std_m"][good].max(), rel=1e-6)
            assert found.status[k] == status[inside].max()
    # The peak is in its own bucket at every zoom.
    good = status != 2
    peak = int(np.searchsorted(edges, rows.time_ns[good][np.argmax(value[good])], side="right")) - 1
    assert np.nanargmax(found.high) == peak
    store.close()
