"""A store that is away: what comes waits, the reason is said, and all of it is kept once, in order, when it is back."""

import subprocess
import threading
import time
from contextlib import suppress

import numpy as np
import pytest

from midspan.records import NANOSECONDS, Event
from midspan.service import keeping
from midspan.service.keeping import Keeper
from midspan.store.chunk import Chunk
from midspan.store.store import Batch, open_store

BEGIN_NS = 1_790_000_000 * NANOSECONDS


def batch(second, count=100):
    """A second of rows that no compression makes small."""
    time_ns = BEGIN_NS + second * NANOSECONDS + np.arange(count) * (NANOSECONDS // count)
    columns = {"displacement_m": np.random.default_rng(second).standard_normal(count)}
    return Batch([Chunk("p", "rows", time_ns, columns, 1, "displacement_m")], [("p", Event(int(time_ns[0]), "x", ""))])


def kept(where):
    """The stamps of all rows, and how many events there are."""
    store = open_store(where, read_only=True)
    stamps = [one.time_ns for one in store.chunks("p", "rows", 0, 2**62)]
    events = len(store.events("p", 0, 2**62))
    store.close()
    return np.concatenate(stamps), events


@pytest.fixture
def small_disk(tmp_path):
    """A file system of its own, as large as a few chunks."""
    place = tmp_path / "disk"
    place.mkdir()
    mounted = subprocess.run(["mount", "-t", "tmpfs", "-o", "size=4m", "tmpfs", place], capture_output=True)
    if mounted.returncode:
        pytest.skip("file systems cannot be mounted here")
    yield place
    subprocess.run(["umount", "-l", place], check=True)


def test_the_end_waits_for_the_thread_that_writes(tmp_path):
    # Without the wait SQLite's connection is closed in the middle of a statement, which ends the process.
    for number in range(12):
        where = str(tmp_path / str(number))
        keeper = Keeper(where)
        keeper.store()
        for second in range(40):
            keeper.put(batch(second))
        writing = threading.Thread(target=keeper.write)
        writing.start()
        time.sleep(0.005 * number)
        keeper.close()
        writing.join()
        stamps, events = kept(where)
        assert (len(stamps), events) == (4000, 40)


def test_a_full_disk_is_said_and_nothing_is_lost_once_there_is_room(small_disk):
    keeper, ballast = Keeper(str(small_disk / "store")), small_disk / "ballast"
    keeper.put(batch(0))
    keeper.write()
    assert keeper.reason == ""
    with suppress(OSError), ballast.open("wb", buffering=0) as file:
        while True:
            file.write(b"\0" * 4096)
    for second in range(1, 40):
        keeper.put(batch(second))
        keeper.write()
    assert keeper.reason in ("store_full", "store_unavailable")
    assert keeper.waiting > 30
    ballast.unlink()
    keeper.write()
    assert (keeper.reason, keeper.waiting, keeper.dropped) == ("", 0, 0)
    keeper.close()
    stamps, events = kept(small_disk / "store")
    np.testing.assert_array_equal(stamps, BEGIN_NS + np.arange(4000) * (NANOSECONDS // 100))
    assert events == 40


def test_a_database_that_is_gone_for_a_while_loses_nothing(postgres):
    where = postgres.database("gone")
    keeper = Keeper(where)
    keeper.put(batch(0))
    keeper.write()
    postgres.stop()
    for second in range(1, 5):
        keeper.put(batch(second))
        keeper.write()
    assert keeper.reason == "store_unavailable"
    # The address, which may hold a password, is not said.
    assert postgres.address not in keeper.text
    assert keeper.waiting == 4
    postgres.start()
    keeper.write()
    assert (keeper.reason, keeper.waiting) == ("", 0)
    keeper.close()
    stamps, events = kept(where)
    np.testing.assert_array_equal(stamps, BEGIN_NS + np.arange(500) * (NANOSECONDS // 100))
    assert events == 5


def test_what_waits_is_bounded_and_the_oldest_is_lost(monkeypatch, tmp_path):
    monkeypatch.setattr(keeping, "MAX_WAITING", 10)
    (tmp_path / "store").write_text("a file where the store's folder should be")
    keeper = Keeper(str(tmp_path / "store"))
    for second in range(15):
        keeper.put(batch(second))
    keeper.write()
    assert (keeper.waiting, keeper.dropped, keeper.reason) == (10, 5, "store_unavailable")
