"""The newest minutes of a store: a log that a kill leaves whole, that a power cut shortens, and that becomes blocks."""

import os
import signal
import subprocess
import sys
from contextlib import suppress

import numpy as np
import pytest

from midspan.errors import UsageError
from midspan.records import NANOSECONDS
from midspan.store import pieces
from midspan.store import store as module
from midspan.store.chunk import Chunk, body_of, join
from midspan.store.days import BLOCK_S, DAY_NS
from midspan.store.pieces import PIECE, SYNC_S, Followed, layout_bytes, record_of
from midspan.store.store import Batch, open_store

BEGIN_NS, RATE_HZ = 20_700 * DAY_NS, 100


def second(number, point="p"):
    """A second of noise, in float32 as sensors give it."""
    rng = np.random.default_rng(number)
    time_ns = BEGIN_NS + number * NANOSECONDS + np.arange(RATE_HZ) * (NANOSECONDS // RATE_HZ)
    columns = {"displacement_m": rng.normal(0, 1e-3, RATE_HZ).astype(np.float32), "status": np.zeros(RATE_HZ, "u1")}
    return Chunk(point, "rows", time_ns, columns, 1, "displacement_m")


def kept(where, point="p"):
    store = open_store(where, read_only=True)
    try:
        found = list(store.chunks(point, "rows", 0, 2**62))
    finally:
        store.close()
    return join(found) if found else None


def equals_seconds(found, count):
    true = join([second(k) for k in range(count)])
    np.testing.assert_array_equal(found.time_ns, true.time_ns)
    np.testing.assert_array_equal(found.columns["displacement_m"], true.columns["displacement_m"])


WRITE = """
import sys
sys.path.insert(0, sys.argv[2])
from test_store_log import second
from midspan.store import store as module
from midspan.store.store import Batch, open_store
module.BLOCK_S = 20.0
store = open_store(sys.argv[1], points=["p"])
number = int(sys.argv[3])
while True:
    store.write(Batch([second(number)], checkpoints={"p": (number, [b"%d" % number])} if number % 10 == 0 else {}))
    number += 1
    print(number, flush=True)
"""


def test_a_killed_process_loses_nothing_however_often(tmp_path):
    """At any place, also while blocks are made: every second that was acknowledged is there once."""
    acknowledged = 0
    for stop in (30, 45):
        words = [sys.executable, "-c", WRITE, str(tmp_path), os.path.dirname(__file__), str(acknowledged)]
        process = subprocess.Popen(words, stdout=subprocess.PIPE, text=True)
        for line in process.stdout:
            acknowledged = int(line)
            if acknowledged >= stop:
                process.send_signal(signal.SIGKILL)
                break
        # What it wrote before the signal came was acknowledged as well.
        acknowledged = max([acknowledged, *(int(line) for line in process.stdout)])
        process.wait(timeout=30)
        process.stdout.close()
        found = kept(tmp_path)
        # The last second may have been written without a word of it.
        count = len(found.time_ns) // RATE_HZ
        assert count - acknowledged in (0, 1)
        equals_seconds(found, count)
        acknowledged = count
    store = open_store(tmp_path, points=["p"])
    store.write(Batch([second(acknowledged)]))
    # Checkpoints of each tenth second, the last of which may not have been written any more.
    assert 0 <= acknowledged - 1 - int(store.checkpoint("p")[1]) < 20
    store.close()
    equals_seconds(kept(tmp_path), acknowledged + 1)
    assert list((tmp_path / "log").iterdir()) == []


def test_a_power_cut_takes_the_last_seconds_of_the_log_alone(tmp_path, monkeypatch):
    """Of the log the disk has what was synchronised, and perhaps a part of what came after."""
    synced = []

    def sync(descriptor):
        synced.append(os.fstat(descriptor).st_size)

    monkeypatch.setattr(pieces.os, "fsync", sync)
    store = open_store(tmp_path, points=["p"])
    for number in range(35):
        store.write(Batch([second(number)]))
    (log,) = (tmp_path / "log").iterdir()
    whole = log.read_bytes()
    for cut in (synced[-1], synced[-1] + 500, len(whole) - 1):
        log.write_bytes(whole[:cut] + bytes(len(whole) - cut))
        found = kept(tmp_path)
        equals_seconds(found, len(found.time_ns) // RATE_HZ)
        assert len(found.time_ns) / RATE_HZ >= 35 - SYNC_S
    # A checkpoint is never newer on the disk than what it rests on.
    log.write_bytes(whole)
    store.write(Batch([second(35)], checkpoints={"p": (0, [b"x"])}))
    assert synced[-1] == log.stat().st_size
    store.close()


def test_blocks_are_made_as_time_goes_on_and_readers_see_all_of_it(tmp_path, monkeypatch):
    monkeypatch.setattr(module, "BLOCK_S", 20.0)
    store = open_store(tmp_path, points=["p"])
    seen = []
    for number in range(50):
        store.write(Batch([second(number)]))
        if number % 10 == 9:
            equals_seconds(kept(tmp_path), number + 1)
        seen.append(sum(file.stat().st_size for file in (tmp_path / "log").iterdir()))
    assert max(seen) < 1.1 * seen[19]
    store.close()


def test_another_process_takes_over_what_an_ended_one_left(tmp_path):
    """And never what belongs to one that still writes."""
    first = open_store(tmp_path, points=["q"])
    first.write(Batch([second(0, "q")]))
    left = open_store(tmp_path, points=["p"])
    left.write(Batch([second(0)]))
    # As after a kill: the log stays, without its lock.
    os.close(left._pieces._file)
    left._locks.close()
    with pytest.raises(UsageError):
        open_store(tmp_path, points=["q"])
    second_writer = open_store(tmp_path, points=["r"])
    second_writer.write(Batch([second(0, "r")]))
    assert len(list((tmp_path / "log").iterdir())) == 2
    for one in (first, second_writer):
        one.close()
    for point in "pqr":
        assert len(kept(tmp_path, point).time_ns) == RATE_HZ
    left._pieces._file = left._pieces._path = None
    left._begun.clear()
    left.close()


def test_a_log_that_cannot_grow_keeps_what_it_has(tmp_path, monkeypatch):
    store, write = open_store(tmp_path, points=["p"]), os.write
    store.write(Batch([second(0)]))

    def full(descriptor, data):
        if len(data) > 100:
            return write(descriptor, data[:100])
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(pieces.os, "write", full)
    for _ in range(2):
        with suppress(Exception):
            store.write(Batch([second(1)]))
            raise AssertionError
    monkeypatch.undo()
    store.write(Batch([second(1)]))
    equals_seconds(kept(tmp_path), 2)
    store.close()


def test_a_day_of_rows_takes_what_they_tell(tmp_path):
    """Kept as steps: of noise of 1000 steps 11 bits and little more; without a log afterwards."""
    rng = np.random.default_rng(0)
    count = 100 * round(BLOCK_S)
    time_ns = BEGIN_NS + np.arange(count) * (NANOSECONDS // 100)
    values = 2.0**-33 * rng.integers(-512, 512, count).astype(np.float64)
    store = open_store(tmp_path)
    store.write(Batch([Chunk("p", "rows", time_ns, {"displacement_m": values}, 1, "displacement_m")]))
    store.close()
    (day,) = (tmp_path / "days").iterdir()
    # 10 bits of noise are 40 kB; the rest are seconds of 14 bytes (4.5 kB) and empty pages.
    assert day.stat().st_size < 1.5 * count * 10 / 8 + 16_384


def test_a_log_is_followed_as_it_grows_and_begins_anew(tmp_path):
    """Who looks again and again sees what one sees who looks once; no record is read twice."""
    path, taken = tmp_path / "a.log", []
    following = Followed(path)

    def record(number, point="p"):
        chunk, new = second(number, point), number % 7 == 0 or point != "p"
        layout, body = layout_bytes(chunk), body_of(chunk)
        return record_of(PIECE.pack(0, len(layout) if new else 0, len(body)) + (layout if new else b"") + body)

    def seen():
        found = {place: [one.t0_ns for one in own] for place, own in following.look().items()}
        assert found == {place: [one.t0_ns for one in own] for place, own in Followed(path).look().items()}
        return found

    assert seen() == {}
    data = b""
    for number in range(5):
        data += record(number)
        # With half of the next one.
        path.write_bytes(data + record(number + 1)[:100])
        taken.append(BEGIN_NS + number * NANOSECONDS)
        assert seen() == {("p", "rows"): taken}
    # Begun anew, and already longer than it was.
    again = b"".join(record(number) for number in range(7, 14))
    path.write_bytes(again)
    assert seen() == {("p", "rows"): [BEGIN_NS + number * NANOSECONDS for number in range(7, 14)]}
    before = following.look()["p", "rows"][0]
    path.write_bytes(again + record(14)[:50])
    assert following.look()["p", "rows"][0] is before
    path.write_bytes(record(0, "q"))
    assert list(seen()) == [("q", "rows")]
    path.unlink()
    assert seen() == {}
