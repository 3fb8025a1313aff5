"""A store that is away: what comes waits, the reason is said, and all of it is kept once, in order, when it is back."""

import secrets
import socket
import subprocess
import threading
import time
from contextlib import suppress

import numpy as np
import pytest

from midspan.records import NANOSECONDS, Event
from midspan.service import keeping
from midspan.service.keeping import Keeper
from midspan.store import database
from midspan.store.chunk import Chunk
from midspan.store.database import StoreFault
from midspan.store.store import Batch, open_store

BEGIN_NS = 1_790_000_000 * NANOSECONDS


@pytest.fixture
def store_name():
    """The name of a database that there is not yet."""
    return f"store_{secrets.token_hex(6)}"


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


def test_rows_are_kept_while_old_days_are_removed(postgres, monkeypatch):
    keeper, removing, done = Keeper(postgres.database("sweep"), points=["p"]), threading.Event(), threading.Event()

    def delete(*_):
        removing.set()
        done.wait(30.0)

    monkeypatch.setattr(database.PostgresDatabase, "delete", delete)
    keeper.put(batch(0))
    keeper.write()
    sweep = threading.Thread(target=keeper.forget_before, args=(BEGIN_NS,))
    sweep.start()
    assert removing.wait(30.0)
    keeper.put(batch(1))
    writing = threading.Thread(target=keeper.write)
    writing.start()
    writing.join(20.0)
    is_kept = not writing.is_alive() and keeper.waiting == 0
    done.set()
    sweep.join()
    writing.join()
    keeper.close()
    assert is_kept


class Line:
    """A line to a server on loopback; while it `hangs` it takes what comes and passes nothing on."""

    def __init__(self, port):
        self.to_port, self.hangs = port, False
        self._sockets = [server := socket.create_server(("127.0.0.1", 0))]
        self.port = server.getsockname()[1]
        threading.Thread(target=self._accept, daemon=True).start()

    def _accept(self):
        with suppress(OSError):
            while True:
                client, _ = self._sockets[0].accept()
                self._sockets.append(client)
                other = socket.create_connection(("127.0.0.1", self.to_port))
                self._sockets.append(other)
                for ends in ((client, other), (other, client)):
                    threading.Thread(target=self._pass, args=ends, daemon=True).start()

    def _pass(self, source, target):
        with suppress(OSError):
            while data := source.recv(65536):
                if not self.hangs:
                    target.sendall(data)
            target.shutdown(socket.SHUT_WR)

    def close(self):
        for one in self._sockets:
            with suppress(OSError):
                # Ends the wait of a thread, too.
                one.shutdown(socket.SHUT_RDWR)
            one.close()


@pytest.fixture
def line(postgres):
    made = Line(int(postgres.address.rpartition(":")[2]))
    yield made
    made.close()


def through(line, where):
    return where.replace(f":{line.to_port}/", f":{line.port}/")


def test_a_database_that_hangs_stops_the_writer_for_seconds_and_loses_nothing(postgres, line, monkeypatch):
    monkeypatch.setattr(pytest.importorskip("midspan.store.session"), "SILENT_S", 1.0)
    monkeypatch.setattr(database, "WAIT_S", 2.0)
    where = postgres.database("hangs")
    keeper = Keeper(through(line, where), ["p"])
    keeper.put(batch(0))
    keeper.write()
    assert keeper.reason == ""
    line.hangs = True
    for second in range(1, 4):
        keeper.put(batch(second))
        begun_s = time.monotonic()
        # First the session is silent, then a new one cannot be opened.
        keeper.write()
        assert time.monotonic() - begun_s < 10.0
        assert keeper.reason == "store_unavailable"
    assert keeper.waiting == 3
    line.hangs = False
    # The server may still have the old session, with the lock of the point.
    until_s = time.monotonic() + 60.0
    while keeper.waiting:
        assert time.monotonic() < until_s, keeper.text
        keeper.write()
        time.sleep(0.1)
    keeper.close()
    stamps, events = kept(where)
    np.testing.assert_array_equal(stamps, BEGIN_NS + np.arange(400) * (NANOSECONDS // 100))
    assert events == 4


def test_a_server_that_never_answers_is_away(monkeypatch):
    pytest.importorskip("psycopg")
    monkeypatch.setattr(database, "WAIT_S", 2.0)
    with socket.create_server(("127.0.0.1", 0)) as silent:
        keeper = Keeper(f"postgresql://midspan@127.0.0.1:{silent.getsockname()[1]}/store", ["p"])
        keeper.put(batch(0))
        begun_s = time.monotonic()
        keeper.write()
        assert time.monotonic() - begun_s < 10.0
    assert (keeper.reason, keeper.waiting) == ("store_unavailable", 1)


@pytest.mark.parametrize(
    ("sql", "code"),
    [
        ("DO $$ BEGIN RAISE EXCEPTION 'full' USING ERRCODE = 'disk_full'; END $$", "store_full"),
        ("DO $$ BEGIN RAISE EXCEPTION 'bug' USING ERRCODE = 'internal_error'; END $$", "store_unavailable"),
        ("SET statement_timeout = 50; SELECT pg_sleep(10)", "store_unavailable"),
        ("SELECT pg_terminate_backend(pg_backend_pid())", "store_unavailable"),
    ],
)
def test_what_is_wrong_with_a_server_is_a_store_that_is_away(postgres, store_name, sql, code):
    opened = database.PostgresDatabase(postgres.database(store_name))
    with pytest.raises(StoreFault) as fault:
        opened.execute(sql)
    assert fault.value.code == code
    opened._connection = opened._opened()
    opened._connection.close()
    assert opened.execute("SELECT 1") == [(1,)]
    opened.close()


def test_old_rows_are_deleted_in_steps(postgres, store_name, monkeypatch):
    monkeypatch.setattr(database, "DELETED_AT_ONCE", 3)
    opened = database.PostgresDatabase(postgres.database(store_name))
    opened.execute("CREATE TABLE number AS SELECT generate_series(1, 20) AS value")
    opened.delete("number", "value <= ?", (11,))
    assert opened.execute("SELECT value FROM number ORDER BY value") == [(value,) for value in range(12, 21)]
    opened.close()


def test_what_waits_is_bounded_and_the_oldest_is_lost(monkeypatch, tmp_path):
    monkeypatch.setattr(keeping, "MAX_WAITING", 10)
    (tmp_path / "store").write_text("a file where the store's folder should be")
    keeper = Keeper(str(tmp_path / "store"))
    for second in range(15):
        keeper.put(batch(second))
    keeper.write()
    assert (keeper.waiting, keeper.dropped, keeper.reason) == (10, 5, "store_unavailable")
