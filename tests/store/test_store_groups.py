"""Rows of the points of a group in a store: none lost or doubled, read as those of any other point."""

import os
import signal
import subprocess
import sys
import textwrap
from contextlib import contextmanager, suppress
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from midspan import _core
from midspan.errors import DataError
from midspan.records import NANOSECONDS, GroupRows, member_of
from midspan.service.keeping import Keeper
from midspan.service.stored_recording import stored_table
from midspan.store import group_state, pieces
from midspan.store.archive import archive
from midspan.store.chunk import Chunk
from midspan.store.database import Division, PostgresDatabase, SqliteDatabase, StoreFault
from midspan.store.days import BLOCK_S, DAY_NS
from midspan.store.group_rows import GroupChunk, in_slots, newer, packed, part_of_pack, unpacked
from midspan.store.store import Batch, open_store
from midspan.store.upkeep import backup, check, repair

BEGIN_NS, RATE_HZ = 20_700 * DAY_NS, 20
STEP_NS = NANOSECONDS // RATE_HZ


def motion(point, row):
    """Displacement of a row of a point, m, in steps as the filter rounds it."""
    return 2.0**-24 * np.rint(2.0**24 * 1e-3 * (1 + point) * np.sin(0.2 * row + point))


def rows_of(points, first, last, status=0):
    """Rows of points from a number to before another one, a run each."""
    row = np.arange(first, last)
    value = np.concatenate([motion(point, row) for point in points])
    count, k = last - first, len(points)
    return GroupRows(
        np.array(points, np.uint32),
        np.full(k, BEGIN_NS + first * STEP_NS),
        np.full(k, STEP_NS),
        np.full(k, count, np.uint32),
        np.full(k, status, np.uint8),
        value,
        np.full(k * count, 2.0**-13),
        2.0**-20 * np.rint(value * 2.0**22),
    )


def second(number, points=(0, 3, 17), checkpoint=True):
    """A second of a group with the state that it leads to."""
    state = (BEGIN_NS + (number + 1) * NANOSECONDS, f"state {number}".encode()) if checkpoint else None
    return GroupChunk("north", rows_of(points, number * RATE_HZ, (number + 1) * RATE_HZ), state)


def assert_rows(store, point, first, last, *, of=None):
    """A point has its rows from one to before another one, and each once."""
    name = f"north-{point}" if of is None else of
    chunks = list(store.chunks(name, "rows", BEGIN_NS, BEGIN_NS + DAY_NS))
    time_ns = np.concatenate([one.time_ns for one in chunks])
    np.testing.assert_array_equal(time_ns, BEGIN_NS + STEP_NS * np.arange(first, last))
    value = np.concatenate([one.columns["displacement_m"] for one in chunks])
    np.testing.assert_array_equal(value, motion(point, np.arange(first, last)))


def test_rows_of_a_group_are_those_of_its_points(store_at):
    store = open_store(store_at, points=["north"])
    for number in range(5):
        store.write(Batch(groups=[second(number)]))
    for _ in range(2):
        # From the log, and from the blocks.
        assert store.points == ["north-0", "north-17", "north-3"]
        assert store.has_point("north-17")
        assert not store.has_point("north-4")
        assert not store.has_point("north")
        assert store.streams("north-17") == ["rows"]
        assert store.days("north-17", "rows") == [20_700]
        assert store.newest_ns("north-3", "rows") == BEGIN_NS + 5 * NANOSECONDS - STEP_NS
        assert store.group_checkpoint("north") == (BEGIN_NS + 5 * NANOSECONDS, b"state 4")
        for point in (0, 3, 17):
            assert_rows(store, point, 0, 5 * RATE_HZ)
        assert list(store.chunks("north-4", "rows", BEGIN_NS, BEGIN_NS + DAY_NS)) == []
        store.close()
        store = open_store(store_at, read_only=True)
    store.close()


def test_a_point_of_a_group_has_table_buckets_and_spans_like_any_other(store_at):
    store = open_store(store_at, points=["north"])
    store.write(Batch(groups=[GroupChunk("north", rows_of([2, 5], 0, 400 * RATE_HZ))]))
    store.write(Batch(groups=[GroupChunk("north", rows_of([2, 5], 400 * RATE_HZ, 410 * RATE_HZ, status=1))]))
    table = stored_table(store, "north-5", BEGIN_NS + NANOSECONDS, BEGIN_NS + 3 * NANOSECONDS)
    row = np.arange(RATE_HZ, 3 * RATE_HZ + 1)
    np.testing.assert_array_equal(table.columns["displacement_mm"], 1e3 * motion(5, row))
    np.testing.assert_array_equal(table.columns["displacement_std_mm"], 1e3 * 2.0**-13)
    np.testing.assert_array_equal(table.columns["source"], 4)
    assert table.metadata["zero_std_mm"] == 0.0
    late = stored_table(store, "north-5", BEGIN_NS + 405 * NANOSECONDS, None)
    assert set(late.columns["source"]) == {0}
    assert set(late.columns["status"]) == {1}
    assert len(late.time_ns) == 5 * RATE_HZ
    values = motion(5, np.arange(410 * RATE_HZ)).reshape(-1, 41 * RATE_HZ)
    for count, parts in ((10, values), (1, values.reshape(1, -1))):
        found = store.buckets("north-5", "rows", BEGIN_NS, BEGIN_NS + 410 * NANOSECONDS, count)
        # Seconds have float32, relative 6e-8.
        np.testing.assert_allclose(found.low, parts.min(axis=1), rtol=1e-7)
        np.testing.assert_allclose(found.high, parts.max(axis=1), rtol=1e-7)
    edges = BEGIN_NS + NANOSECONDS * np.arange(0, 411, 5)
    drawn = store.drawn("north-5", "rows", edges, "displacement_m")
    np.testing.assert_allclose(drawn.mean, motion(5, np.arange(410 * RATE_HZ)).reshape(-1, 100).mean(axis=1), atol=1e-9)
    np.testing.assert_array_equal(drawn.rows, 100)
    np.testing.assert_array_equal(drawn.status, [0] * 80 + [1] * 2)
    assert [(one.calibration, one.first_ns) for one in store.spans("north-5", "rows")] == [(0, BEGIN_NS)]
    assert store.count("north-5", "rows", BEGIN_NS, BEGIN_NS + DAY_NS) == 410 * RATE_HZ
    store.close()


def test_the_seconds_of_a_group_are_those_that_other_points_have(tmp_path):
    """Made in the core from a pack, and by NumPy from the same rows."""
    from midspan.store import summary
    from midspan.store.group_rows import chunk_of_pack

    parts = [
        packed(rows_of([1], first, last, status)) for first, last, status in ((7, 90, 0), (95, 130, 1), (140, 170, 2))
    ]
    pack = _core.join_packs(parts, np.empty(0, np.int64))
    ((point, first_ns, last_ns, count, low, high, seconds, own),) = _core.pack_blocks(pack)
    chunk = chunk_of_pack(own, "north-1", "rows", "displacement_m")
    assert (point, count, first_ns, last_ns) == (1, 148, chunk.time_ns[0], chunk.time_ns[-1])
    assert chunk.limits == (low, high)
    found, expected = np.frombuffer(seconds, summary.ENTRY), summary.entries(chunk)
    for name in summary.ENTRY.names:
        # Sums in another order.
        np.testing.assert_allclose(found[name], expected[name], rtol=1e-6 if name == "mean" else 0, atol=0)


def test_a_second_that_comes_again_or_in_parts_is_kept_once(store_at):
    store = open_store(store_at, points=["north"])
    store.write(Batch(groups=[second(0), second(1)]))
    store.close()
    store = open_store(store_at, points=["north"])
    # After a start some come again, cut in other places; one of them goes on.
    store.write(Batch(groups=[second(1), GroupChunk("north", rows_of([0, 3], 30, 55))]))
    store.write(Batch(groups=[GroupChunk("north", rows_of([0, 3, 17], 35, 70))]))
    store.write(Batch(groups=[second(0)]))
    store.flush()
    store.write(Batch(groups=[GroupChunk("north", rows_of([0, 3, 17, 20], 60, 80))]))
    for point, first in ((0, 0), (3, 0), (17, 0), (20, 60)):
        assert_rows(store, point, first, 80)
    store.close()


def test_old_rows_of_one_point_are_kept_with_new_ones_of_the_others(store_at):
    """A point may come back with what it has measured meanwhile."""
    store = open_store(store_at, points=["north"])
    store.write(Batch(groups=[GroupChunk("north", rows_of([0], 0, 20))]))
    for begin in range(20, 700 * RATE_HZ, 70 * RATE_HZ):
        store.write(Batch(groups=[GroupChunk("north", rows_of([1], begin, begin + 70 * RATE_HZ))]))
    store.write(Batch(groups=[GroupChunk("north", rows_of([0], 20, 700 * RATE_HZ))]))
    store.close()
    store = open_store(store_at, points=["north"])
    store.write(Batch(groups=[GroupChunk("north", rows_of([0, 1], 690 * RATE_HZ, 710 * RATE_HZ))]))
    assert_rows(store, 0, 0, 710 * RATE_HZ)
    assert_rows(store, 1, 20, 710 * RATE_HZ)
    edges = BEGIN_NS + NANOSECONDS * np.arange(0, 711, 10)
    assert np.isfinite(store.drawn("north-0", "rows", edges, "displacement_m").low).all()
    store.close()


def test_blocks_end_with_their_day(store_at):
    store = open_store(store_at, points=["north"])
    rows = rows_of([4], -30 * RATE_HZ, 30 * RATE_HZ)
    store.write(Batch(groups=[GroupChunk("north", rows)]))
    store.flush()
    assert store.days("north-4", "rows") == [20_699, 20_700]
    store.forget_before(BEGIN_NS)
    assert store.days("north-4", "rows") == [20_700]
    assert_rows(store, 4, 0, 30 * RATE_HZ)
    store.close()


def test_parts_of_a_day_are_dropped_in_postgresql(postgres, store_name):
    import psycopg

    where = postgres.database(store_name)
    store = open_store(where, points=["north"])
    store.write(Batch(groups=[GroupChunk("north", rows_of([4], -5 * RATE_HZ, 5 * RATE_HZ))]))
    store.flush()
    sql = "SELECT relid::regclass::text FROM pg_partition_tree('group_block') WHERE isleaf ORDER BY 1"
    with psycopg.connect(where) as connection:
        assert [row[0] for row in connection.execute(sql)] == ["group_block_2026_09_03", "group_block_2026_09_04"]
    store.forget_before(BEGIN_NS)
    with psycopg.connect(where) as connection:
        assert [row[0] for row in connection.execute(sql)] == ["group_block_2026_09_04"]
    store.close()


def test_shards_write_one_database_at_once(postgres, store_name):
    where = postgres.database(store_name)
    parts = [open_store(where, points=[f"north {k} 2"]) for k in (0, 1)]
    for number in range(3):
        for k, store in enumerate(parts):
            rows = rows_of([k, k + 2], number * RATE_HZ, (number + 1) * RATE_HZ)
            state = (BEGIN_NS, f"state {k} {number}".encode())
            store.write(Batch(groups=[GroupChunk("north", rows, state, f"{k} 2")]))
    parts[0].flush()
    with open_store_closing(where) as read:
        assert read.points == [f"north-{point}" for point in range(4)]
        for point in range(4):
            assert_rows(read, point, 0, 3 * RATE_HZ)
        assert read.group_checkpoint("north 1 2") == (BEGIN_NS, b"state 1 2")
    for store in parts:
        store.close()


def part_of_second(part, number, points=6):
    """A second of the points of a shard."""
    first, step = (int(word) for word in part.split())
    rows = rows_of(range(first, points, step), number * RATE_HZ, (number + 1) * RATE_HZ)
    return Batch(groups=[GroupChunk("north", rows, None, part)])


def killed(store):
    """Its process has ended without a word."""
    if store._locks is None:
        store._site.close()
    else:
        os.close(store._pieces._file)
        store._locks.close()


def test_another_number_of_shards_takes_over_what_was_left_in_a_database(postgres, store_name):
    import psycopg

    where = postgres.database(store_name)
    for part in ("0 2", "1 2"):
        store = open_store(where, points=[f"north {part}"], division=Division("bridge", 2))
        for number in range(3):
            store.write(part_of_second(part, number))
        killed(store)
    parts = [f"{k} 3" for k in range(3)]
    stores = {part: open_store(where, points=[f"north {part}"], division=Division("bridge", 3)) for part in parts}
    # A second comes again, as nobody acknowledged it.
    for number in (2, 3):
        for part in parts:
            stores[part].write(part_of_second(part, number))
    with psycopg.connect(where) as connection:
        kept = connection.execute("SELECT part, COUNT(*) FROM group_piece GROUP BY part ORDER BY part").fetchall()
    assert kept == [(part, 1) for part in parts]
    for _ in range(2):
        with open_store_closing(where) as read:
            for point in range(6):
                assert_rows(read, point, 0, 4 * RATE_HZ)
        for store in stores.values():
            store.flush()
    for store in stores.values():
        store.close()


def test_another_number_of_shards_takes_over_what_was_left_in_folders(tmp_path):
    for part in ("0 3", "1 3", "2 3"):
        where = tmp_path / "store" / f"shard-{int(part[0]) + 1}"
        store = open_store(where, points=[f"north {part}"], division=Division("bridge", 3))
        store.write(part_of_second(part, 0))
        killed(store)
    for part in ("0 2", "1 2"):
        keeper = Keeper(str(tmp_path / "store" / f"shard-{int(part[0]) + 1}"), [f"north {part}"], Division("bridge", 2))
        # What is left of its own points does not come again; of others there is nothing.
        for number in (0, 1):
            keeper.put(part_of_second(part, number))
        keeper.write()
        keeper.close()
    assert not list((tmp_path / "store").glob("*/log/*.log"))
    for point, folder in enumerate((1, 2, 3, 1, 2, 3)):
        with open_store_closing(tmp_path / "store" / f"shard-{folder}") as read:
            first = 0 if (folder - 1) % 3 == point % 3 else RATE_HZ
            last = 2 * RATE_HZ if folder - 1 == point % 2 else RATE_HZ
            assert_rows(read, point, first, last)
    whole = Keeper(str(tmp_path / "store"), ["north"], Division("bridge", 0))
    whole.put(Batch(groups=[GroupChunk("north", rows_of(range(6), 40, 60))]))
    whole.close()


def open_store_closing(where):
    from contextlib import closing

    return closing(open_store(where, read_only=True))


WRITER = """
    import sys
    from tests.store.test_store_groups import second
    from midspan.store.store import Batch, open_store

    store = open_store(sys.argv[1], points=["north"])
    for number in range(10_000):
        store.write(Batch(groups=[second(number)]))
        print(number, flush=True)
"""


@pytest.mark.parametrize("after", [3, 40, 700])
def test_after_a_kill_rows_are_whole_and_the_state_is_not_newer(tmp_path, after):
    where = str(tmp_path / "store")
    program = [sys.executable, "-c", textwrap.dedent(WRITER), where]
    with subprocess.Popen(program, stdout=subprocess.PIPE, text=True) as process:
        for line in process.stdout:
            if int(line) >= after:
                os.kill(process.pid, signal.SIGKILL)
                break
    store = open_store(where, points=["north"])
    newest_ns = store.newest_ns("north-17", "rows")
    time_ns, state = store.group_checkpoint("north")
    number = int(state.split()[1])
    kept = (newest_ns - BEGIN_NS) // NANOSECONDS
    # What was acknowledged is there; one more may be, whose state is not.
    assert number >= after
    assert number <= kept <= number + 1
    assert time_ns == BEGIN_NS + (number + 1) * NANOSECONDS
    for again in range(number, number + 3):
        store.write(Batch(groups=[second(again)]))
    for point in (0, 3, 17):
        assert_rows(store, point, 0, (number + 3) * RATE_HZ)
    store.close()
    assert check(where).faults == ()


@pytest.mark.parametrize("seconds", [9, 11, 14, 25, 41])
def test_after_a_power_cut_the_state_is_not_newer_than_its_rows(tmp_path, monkeypatch, seconds):
    """Of the log that is left what was synchronised; all states came to the disk, as the kernel may write them."""
    where, real, synced = tmp_path / "store", os.fsync, [0]

    def fsync(file):
        synced.append(os.fstat(file).st_size) if file == store._pieces._file else None
        real(file)

    monkeypatch.setattr(os, "fsync", fsync)
    store = open_store(where, points=["north", "south"])
    for number in range(seconds):
        store.write(Batch(groups=[replace(second(number), name="south")]))
        store.write(Batch(groups=[second(number)]))
    killed(store)
    (log,) = (where / "log").glob("*.log")
    os.truncate(log, synced[-1])
    store = open_store(where, points=["north"])
    newest_ns, state = store.newest_ns("north-17", "rows"), store.group_checkpoint("north")
    kept = round((newest_ns - BEGIN_NS) / NANOSECONDS)
    assert seconds - kept <= pieces.SYNC_S
    assert state == (BEGIN_NS + kept * NANOSECONDS, b"state %d" % (kept - 1))
    assert store.group_checkpoint("south") is not None
    for number in range(kept, kept + 3):
        store.write(Batch(groups=[second(number)]))
        assert store.group_checkpoint("north")[1] == b"state %d" % number
    assert_rows(store, 17, 0, (kept + 3) * RATE_HZ)
    store.close()


def test_a_state_is_used_whose_rows_are_too_old_to_be_kept(tmp_path):
    where = tmp_path / "store"
    store = open_store(where, points=["north"])
    for number in range(12):
        store.write(Batch(groups=[second(number)]))
    store.close()
    store = open_store(where, points=["north"])
    store.forget_before(BEGIN_NS + 10 * 86_400 * NANOSECONDS)
    store.close()
    store = open_store(where, points=["north"])
    assert store.newest_ns("north-17", "rows") is None
    assert store.group_checkpoint("north") is not None
    store.close()


def test_a_state_of_an_earlier_version_is_used(tmp_path):
    import zlib

    store = open_store(tmp_path / "store", points=["north"])
    store.write(Batch(groups=[second(0), second(1, checkpoint=False)]))
    for turn in range(3):
        (tmp_path / "store" / "groups" / f"north.{turn}").unlink()
    head = group_state.FIRST_HEAD.pack(group_state.FIRST_MAGIC, 7, BEGIN_NS, 5, zlib.crc32(b"first"))
    (tmp_path / "store" / "groups" / "north.1").write_bytes(head + b"first")
    assert store.group_checkpoint("north") == (BEGIN_NS, b"first")
    store.close()
    store = open_store(tmp_path / "store", points=["north"])
    store.write(Batch(groups=[second(2)]))
    assert store.group_checkpoint("north")[1] == b"state 2"
    store.close()


def left_by_a_kill(where, batch):
    """A store whose writer ended without a word."""
    store = open_store(where, points=["north", "deck"])
    store.write(batch)
    os.close(store._pieces._file)
    store._locks.close()


def test_a_log_goes_on_where_its_points_are_those_of_the_next_process(tmp_path):
    where = tmp_path / "store"
    left_by_a_kill(where, Batch(groups=[second(0), second(1)]))
    (log,) = (where / "log").glob("*.log")
    with log.open("ab") as file:
        # Of a power cut.
        file.write(b"half a record")
    store = open_store(where, points=["north"])
    store.write(Batch(groups=[second(1), second(2)]))
    assert list((where / "log").glob("*.log")) == [log]
    assert not list((where / "days").glob("*"))
    assert_rows(store, 17, 0, 3 * RATE_HZ)
    store.flush()
    assert_rows(store, 17, 0, 3 * RATE_HZ)
    store.close()
    assert check(str(where)).faults == ()


def test_a_log_with_points_of_others_becomes_blocks_at_once(tmp_path):
    where = tmp_path / "store"
    left_by_a_kill(where, Batch(groups=[second(0)]))
    other = open_store(where, points=["deck"])
    other.write(Batch([Chunk("deck", "rows", BEGIN_NS + np.arange(3), {"displacement_m": np.zeros(3)})]))
    assert len(list((where / "days").glob("*.sqlite"))) == 1
    store = open_store(where, points=["north"])
    store.write(Batch(groups=[second(1)]))
    store.flush()
    other.close()
    assert_rows(store, 17, 0, 2 * RATE_HZ)
    store.close()


def test_a_kill_while_blocks_are_made_doubles_nothing(tmp_path, monkeypatch):
    where = str(tmp_path / "store")
    store = open_store(where, points=["north"])
    store.write(Batch(groups=[GroupChunk("north", rows_of([0, 3], 0, 400 * RATE_HZ))]))
    with monkeypatch.context() as patched:
        patched.setattr(type(store._pieces), "clear", lambda *_: (_ for _ in ()).throw(StoreFault("x", "gone")))
        with pytest.raises(StoreFault):
            store.flush()
    store._pieces.close()
    store._locks.close()
    # The log is there still, and the days have its blocks.
    store = open_store(where, points=["north"])
    for point in (0, 3):
        assert_rows(store, point, 0, 400 * RATE_HZ)
    store.write(Batch(groups=[GroupChunk("north", rows_of([0, 3], 390 * RATE_HZ, 401 * RATE_HZ))]))
    store.close()
    with open_store_closing(where) as read:
        for point in (0, 3):
            assert_rows(read, point, 0, 401 * RATE_HZ)


def histories(where):
    """All of the pyramid, and the days of the group."""
    store = open_store(where, read_only=True)
    rows = store._site.execute("SELECT point, stream, level, t0_ns, low, high FROM pyramid ORDER BY 1, 2, 3, 4")
    days = store._kept.days_of_group("north")
    store.close()
    return rows, days


def peaks(first, last):
    """Rows of which those of the first minute are the least and largest, and some in each further block as well."""
    rows = rows_of([0, 3], first, last)
    value = rows.displacement_m / (1 + np.tile(np.arange(first, last) // (60 * RATE_HZ), 2))
    return GroupChunk("north", replace(rows, displacement_m=value))


@pytest.mark.parametrize("of_ended", range(6))
def test_a_kill_between_transactions_costs_no_peak_of_a_history(store_at, tmp_path, monkeypatch, of_ended):
    places, ended = [tmp_path / "undisturbed", store_at], [0]
    for where in places:
        store = open_store(where, points=["north"])
        store.write(Batch(groups=[peaks(0, 400 * RATE_HZ), peaks(400 * RATE_HZ, 800 * RATE_HZ)]))
        if where == store_at:
            for kind in (SqliteDatabase, PostgresDatabase):
                monkeypatch.setattr(kind, "transaction", until(kind.transaction, ended, of_ended))
            with suppress(StoreFault):
                store.flush()
            monkeypatch.undo()
            killed(store)
        else:
            store.close()
    for where in places:
        store = open_store(where, points=["north"])
        store.write(Batch(groups=[peaks(800 * RATE_HZ, 801 * RATE_HZ)]))
        assert store.count("north-3", "rows", BEGIN_NS, BEGIN_NS + DAY_NS) == 801 * RATE_HZ
        store.close()
    assert histories(places[0]) == histories(places[1])


def until(transaction, ended, count):
    """Transactions of which none is begun after so many have ended."""

    @contextmanager
    def counted(database):
        if ended[0] == count:
            raise StoreFault("store_unavailable", "killed")
        with transaction(database):
            yield
        ended[0] += 1

    return counted


def test_a_full_disk_keeps_the_state_before(tmp_path, monkeypatch):
    import errno

    store = open_store(tmp_path / "store", points=["north"])
    store.write(Batch(groups=[second(0)]))
    real = os.write

    def full(file, data):
        if data[:4] == group_state.MAGIC:
            real(file, data[: len(data) // 2])
            raise OSError(errno.ENOSPC, "No space left on device")
        return real(file, data)

    with monkeypatch.context() as patched:
        patched.setattr(os, "write", full)
        with pytest.raises(StoreFault) as fault:
            store.write(Batch(groups=[second(1)]))
    assert fault.value.code == "store_full"
    assert store.group_checkpoint("north")[1] == b"state 0"
    store.write(Batch(groups=[second(1)]))
    assert store.group_checkpoint("north")[1] == b"state 1"
    assert_rows(store, 17, 0, 2 * RATE_HZ)
    store.close()


def test_damage_is_found_and_repaired(tmp_path):
    where = tmp_path / "store"
    store = open_store(where, points=["north"])
    store.write(Batch(groups=[second(0), second(1), second(2)]))
    for turn in (0, 1):
        file = where / "groups" / f"north.{turn}"
        data = bytearray(file.read_bytes())
        data[-1] ^= 1
        file.write_bytes(data)
    with pytest.raises(DataError, match="checkpoint of the group north is damaged"):
        store.group_checkpoint("north")
    store.close()
    assert [one.file for one in check(str(where)).faults] == ["groups/north.0"]
    assert any("north.0" in line for line in repair(str(where)))
    store = open_store(where, points=["north"])
    assert store.group_checkpoint("north") is None
    assert_rows(store, 3, 0, 3 * RATE_HZ)
    store.close()


@pytest.mark.parametrize("lost", ["", "DELETE FROM grouped"])
def test_repair_keeps_the_days_of_a_group(tmp_path, lost):
    """Without them a restart would look for the newest rows nowhere, and keep rows twice; lost: of a damaged file."""
    where = tmp_path / "store"
    store = open_store(where, points=["north"])
    point = Chunk("deck-1", "rows", BEGIN_NS + np.arange(3), {"displacement_m": np.zeros(3)}, 0, "displacement_m")
    store.write(Batch([point], groups=[GroupChunk("north", rows_of([0, 3], -5 * RATE_HZ, 5 * RATE_HZ))]))
    store.flush()
    before, days = histories(where)
    store._site.execute(lost or "SELECT 1")
    store.close()
    repair(str(where))
    assert histories(where) == (before, days)
    assert days == [20_699, 20_700]
    store = open_store(where, points=["north"])
    assert store.groups == ["north"]
    assert store.points == ["deck-1", "north-0", "north-3"]
    assert store.days("north-3", "rows") == days
    store.write(Batch(groups=[GroupChunk("north", rows_of([0, 3], 0, 6 * RATE_HZ))]))
    for number in (0, 3):
        assert_rows(store, number, 0, 6 * RATE_HZ)
    store.close()


def test_a_copy_and_an_archive_have_the_points_of_groups(tmp_path):
    where = tmp_path / "store"
    store = open_store(where, points=["north"])
    store.write(Batch(groups=[second(0), second(1)]))
    backup(str(where), tmp_path / "copy")
    with open_store_closing(tmp_path / "copy") as read:
        assert_rows(read, 17, 0, 2 * RATE_HZ)
        assert read.group_checkpoint("north")[1] == b"state 1"
    places = list(archive(store, tmp_path / "archive", BEGIN_NS + DAY_NS))
    assert [place.parent.name for place in places] == ["north-0", "north-17", "north-3"]
    frame = pd.read_parquet(places[1] / "rows.parquet")
    np.testing.assert_array_equal(frame["displacement_m"], motion(17, np.arange(2 * RATE_HZ)))
    store.close()


numbers = st.one_of(
    st.floats(allow_nan=True, allow_infinity=True, width=64),
    st.integers(-(2**20), 2**20).map(lambda whole: whole * 2.0**-30),
)


@st.composite
def groups(draw):
    """Rows of some points, two runs of each at most, with any numbers."""
    runs = []
    for point in draw(st.lists(st.integers(0, 500), min_size=1, max_size=5, unique=True)):
        at = draw(st.integers(-(2**60), 2**60))
        for _ in range(draw(st.integers(1, 2))):
            dt, count = draw(st.integers(1, 10**9)), draw(st.integers(1, 30))
            runs.append((point, at, dt, count, draw(st.integers(0, 2))))
            at += dt * count + draw(st.integers(0, 10**10))
    point, t0, dt, count, status = (np.array(one) for one in zip(*runs, strict=True))
    total = int(count.sum())
    columns = [np.array(draw(st.lists(numbers, min_size=total, max_size=total))) for _ in range(3)]
    return GroupRows(
        point.astype(np.uint32), t0.astype(np.int64), dt.astype(np.int64), count.astype(np.uint32),
        status.astype(np.uint8), *columns,
    )  # fmt: skip


def assert_same(found, expected):
    for name in GroupRows.__slots__:
        a, b = getattr(found, name), getattr(expected, name)
        np.testing.assert_array_equal(a.view(np.uint64) if a.dtype == np.float64 else a,
                                      b.view(np.uint64) if b.dtype == np.float64 else b)  # fmt: skip


def by_point(rows, point):
    """The rows of one point."""
    of_run = rows.point == point
    of_row = np.repeat(of_run, rows.count)
    runs = [getattr(rows, name)[of_run] for name in GroupRows.__slots__[:5]]
    return GroupRows(*runs, *(getattr(rows, name)[of_row] for name in GroupRows.__slots__[5:]))


@settings(max_examples=60)
@given(groups())
def test_every_bit_of_any_rows_comes_back(rows):
    pack = packed(rows)
    for point in set(rows.point.tolist()):
        assert_same(unpacked(part_of_pack(pack, point)[2]), by_point(rows, point))
        assert_same(by_point(unpacked(pack), point), by_point(rows, point))


@settings(max_examples=60)
@given(groups(), st.integers(10**8, 10**11), st.integers(-(2**60), 2**60))
def test_parts_joined_are_the_whole(rows, slot_ns, shift):
    """Cut at slots, packed and joined: the rows of each point, stamp by stamp."""
    rows = GroupRows(rows.point, rows.t0_ns % 10**11, *(getattr(rows, name) for name in GroupRows.__slots__[2:]))
    # The runs of a point follow each other still.
    rows = by_point(rows, int(rows.point[0]))
    if len(rows.t0_ns) > 1:
        rows.t0_ns[1] = rows.t0_ns[0] + rows.dt_ns[0] * int(rows.count[0]) + shift % 10**9
    parts = list(in_slots(rows, slot_ns))
    joined = unpacked(_core.join_packs([packed(part) for part in parts], np.empty(0, np.int64)))
    for name in ("displacement_m", "std_m", "velocity_m_s"):
        np.testing.assert_array_equal(getattr(joined, name), getattr(rows, name))
    np.testing.assert_array_equal(stamps(joined), stamps(rows))
    for part in parts:
        assert len(set((stamps(part) // slot_ns).tolist())) == 1


def stamps(rows):
    count = rows.count.astype(np.int64)
    place = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)
    return np.repeat(rows.t0_ns, count) + np.repeat(rows.dt_ns, count) * place


@settings(max_examples=60)
@given(groups(), st.integers(0, 40))
def test_newer_rows_are_those_after_the_newest(rows, cut):
    newest_ns = np.full(501, -(2**62), dtype=np.int64)
    stamp = stamps(rows)
    newest_ns[rows.point[0]] = np.sort(stamp[np.repeat(rows.point, rows.count) == rows.point[0]])[:cut][-1:].max(
        initial=-(2**62)
    )
    found = newer(rows, newest_ns)
    expected = stamp[stamp > newest_ns[np.repeat(rows.point, rows.count)]]
    np.testing.assert_array_equal(stamps(found), expected)


def test_realistic_rows_take_three_bytes_at_most():
    """A motion of a millimetre at 2 Hz sampled at 100 Hz, deviation 0.3 mm, noise of 5 mm/s² in the velocity."""
    rng = np.random.default_rng(1)
    time_s = np.arange(100) / 100
    count, points = 100, 50
    noise = np.cumsum(5e-3 / 100 * rng.standard_normal((points, count)), axis=1)
    phase = rng.uniform(0, 6, (points, 1))
    value = 1e-3 * np.sin(2 * np.pi * 2.0 * time_s + phase) + np.cumsum(noise, axis=1) / 100
    velocity = 1e-3 * 4 * np.pi * np.cos(2 * np.pi * 2.0 * time_s + phase) + noise
    step = 2.0**-20
    rows = GroupRows(
        np.arange(points, dtype=np.uint32), np.full(points, BEGIN_NS), np.full(points, 10**7),
        np.full(points, count, np.uint32), np.zeros(points, np.uint8), step * np.rint(value / step).ravel(),
        np.full(points * count, 2.0**-12 * 75 / 64), step * np.rint(velocity / step).ravel(),
    )  # fmt: skip
    assert len(packed(rows)) <= 3 * points * count


def test_slots_of_a_block_are_parts_of_a_day():
    assert DAY_NS % round(BLOCK_S * NANOSECONDS) == 0


def test_a_name_means_a_point_of_a_group_in_one_form_alone():
    assert member_of("north-0") == ("north", 0)
    assert member_of("pier-2-17") == ("pier-2", 17)
    for name in ("north", "north-", "north-017", "north-+1", "north-²", "-1", "north-1_0", "north-" + 30 * "9"):
        assert member_of(name) is None


def test_the_export_names_groups_of_many_points_by_their_range(tmp_path, capsys):
    from midspan.cli.main import run

    where = str(tmp_path / "store")
    store = open_store(where, points=["north"])
    point = Chunk("deck", "rows", BEGIN_NS + np.arange(3), {"displacement_m": np.zeros(3)}, 0, "displacement_m")
    store.write(Batch([point], groups=[GroupChunk("north", rows_of(range(3, 1000), 0, 2))]))
    store.close()
    for arguments, text in (([], "; the store has several points"), (["--point", "north-1000"], "; received")):
        assert run(["export", where, *arguments]) == 2
        reported = capsys.readouterr().err
        assert f"--point must be one of deck, north-3 to north-999 (997 points){text}" in reported
        assert len(reported) < 400


def test_the_page_and_the_export_read_a_point_of_a_group_as_any_other(tmp_path):
    import json

    from click.testing import CliRunner

    from midspan.cli.export import command
    from midspan.serve import reading

    where = str(tmp_path / "store")
    store = open_store(where, points=["north"])
    for number in range(4):
        store.write(Batch(groups=[second(number)]))
    for _ in range(2):
        newest = reading.newest(where, "north-3")
        assert newest["status"] == "tracking"
        assert newest["displacement_mm"] == pytest.approx(1e3 * motion(3, 4 * RATE_HZ - 1), rel=1e-12)
        span = BEGIN_NS + NANOSECONDS, BEGIN_NS + 3 * NANOSECONDS
        series = json.loads(reading.series_json(where, "north-3", *span))
        assert len(series["time"]) == 2 * RATE_HZ
        assert set(series["source"]) == {"displacement"}
        buckets = reading.buckets(where, "north-3", *span, 2)
        rows = 1e3 * motion(3, np.arange(RATE_HZ, 3 * RATE_HZ)).reshape(2, -1)
        np.testing.assert_allclose(buckets["displacement_mm_max"], rows.max(axis=1), rtol=1e-6)
        assert reading.calibrations(where, "north-3") == []
        assert len(reading.calibrated_rows(where, "north-3")) == 1
        # From the log, then from the blocks.
        store.close()
        store = open_store(where, points=["north"])
    store.close()
    file = tmp_path / "rows.csv"
    done = CliRunner().invoke(command, [where, "--point", "north-17", "-o", str(file)])
    assert done.exit_code == 0, done.output
    frame = pd.read_csv(file, comment="#")
    np.testing.assert_allclose(frame["displacement_mm"], 1e3 * motion(17, np.arange(4 * RATE_HZ)), atol=1e-8)
