"""A point of a store is written by one process at a time, and is free as soon as that one has ended."""

import signal
import socket
import subprocess
import sys
import time

import pytest
from benchmarks.live.servers import free_port

from midspan.cli.main import run
from midspan.errors import UsageError
from midspan.store.database import Division, StoreFault
from midspan.store.store import open_store

HOLD = """
import sys, time
from midspan.store.store import open_store
store = open_store(sys.argv[1], points=["p"])
print("held", flush=True)
time.sleep(600)
"""


def test_a_point_is_written_by_one_at_a_time(store_at):
    first = open_store(store_at, points=["p", "q"])
    with pytest.raises(UsageError, match="another process writes the point 'q'"):
        open_store(store_at, points=["r", "q"])
    # What was refused holds nothing; others' points and readers are free.
    second = open_store(store_at, points=["r"])
    open_store(store_at, read_only=True).close()
    first.close()
    third = open_store(store_at, points=["p", "q"])
    for store in (second, third):
        store.close()


def test_a_process_that_is_killed_lets_its_points_go(store_at):
    process = subprocess.Popen([sys.executable, "-c", HOLD, store_at], stdout=subprocess.PIPE, text=True)
    try:
        assert process.stdout.readline() == "held\n"
        with pytest.raises(UsageError, match="another process"):
            open_store(store_at, points=["p"])
    finally:
        process.send_signal(signal.SIGKILL)
        process.wait(timeout=30)
        process.stdout.close()
    freed(store_at).close()


def place(where, division):
    """The store of a division's first part."""
    return where if "://" in where or not division else f"{where}/shard-1"


@pytest.mark.parametrize(
    ("running", "second", "text"),
    [
        (2, 3, "runs as 2 shards, and as 3 shards"),
        (2, 0, "runs as 2 shards, and without shards"),
        (0, 1, "runs without shards, and as 1 shard "),
    ],
)
def test_a_site_runs_in_one_division_at_a_time(store_at, running, second, text):
    site, other = Division("bridge", running), Division("bridge", second)
    first = open_store(place(store_at, running), points=["north 0"], division=site)
    with pytest.raises(UsageError, match=text):
        open_store(place(store_at, second), points=["north 1"], division=other)
    # The shards of one division run together, and each end leaves the others.
    further = open_store(place(store_at, running), points=["north 2"], division=site)
    first.close()
    with pytest.raises(UsageError, match=text):
        open_store(place(store_at, second), points=["north 1"], division=other)
    further.close()
    open_store(place(store_at, second), points=["north 1"], division=other).close()


def test_a_point_may_be_called_shards(tmp_path):
    store = open_store(tmp_path / "store", points=["shards"], division=Division("bridge", 0))
    with pytest.raises(UsageError, match="as 2 shards"):
        open_store(tmp_path / "store" / "shard-1", points=["q"], division=Division("bridge", 2))
    store.close()


def test_a_division_whose_process_is_killed_is_free(store_at):
    with_division = HOLD.replace('points=["p"]', 'points=["p"], division=Division("bridge", 0)').replace(
        "import open_store", "import Division, open_store"
    )
    process = subprocess.Popen([sys.executable, "-c", with_division, store_at], stdout=subprocess.PIPE, text=True)
    try:
        assert process.stdout.readline() == "held\n"
        with pytest.raises(UsageError, match="without shards, and as 2 shards"):
            open_store(place(store_at, 2), points=["q"], division=Division("bridge", 2))
    finally:
        process.send_signal(signal.SIGKILL)
        process.wait(timeout=30)
        process.stdout.close()
    freed(store_at).close()
    open_store(place(store_at, 2), points=["q"], division=Division("bridge", 2)).close()


def freed(where, times=100):
    """The store with its point; a server takes some milliseconds to see that a client has gone."""
    for _ in range(times):
        try:
            return open_store(where, points=["p"])
        except UsageError:
            time.sleep(0.1)
    raise TimeoutError


def test_a_lost_connection_takes_its_points_again(postgres):
    psycopg = pytest.importorskip("psycopg")
    where = postgres.database("lost_connection")
    store = open_store(where, points=["p"], division=Division("bridge", 2))
    with psycopg.connect(where, autocommit=True) as other:
        other.execute("SELECT pg_terminate_backend(pid) FROM pg_locks WHERE locktype = 'advisory'")
    with pytest.raises(StoreFault):
        store.points  # noqa: B018
    assert store.points == []
    with pytest.raises(UsageError, match="another process"):
        open_store(where, points=["p"])
    with pytest.raises(UsageError, match="runs as 2 shards"):
        open_store(where, points=["q"], division=Division("bridge", 3))
    # Another site's in the same database is its own.
    open_store(where, points=["q"], division=Division("tower", 3)).close()
    store.close()


def files(folder):
    return {file: (file.stat().st_size, file.stat().st_mtime_ns) for file in folder.rglob("*")}


SITE = """
name = "river bridge"
[store]
path = "store"
[mqtt]
port = {broker}
[service]
listen = "127.0.0.1:{web}"
[[point]]
name = "p"
[point.accelerometer]
source = "mqtt:a"
[point.displacement]
source = "mqtt:d"
"""


def test_a_second_run_or_replay_is_refused_before_it_writes(footbridge, tmp_path, capsys):
    pytest.importorskip("paho.mqtt.client")
    (tmp_path / "SITE.toml").write_text(SITE.format(broker=free_port(), web=free_port()))
    store = open_store(tmp_path / "store", points=["p"])
    before = files(tmp_path)
    assert run(["run", str(tmp_path / "SITE.toml"), "--for", "5"]) == 2
    reported = capsys.readouterr().err
    assert f"{tmp_path / 'store'}: another process writes the point 'p'" in reported
    assert run(["replay", str(footbridge), "-o", str(tmp_path / "store"), "--point", "p"]) == 2
    assert "another process writes the point 'p'" in capsys.readouterr().err
    assert files(tmp_path) == before
    store.close()


def test_another_division_is_refused_at_its_start(store_at, tmp_path, capsys, monkeypatch):
    pytest.importorskip("paho.mqtt.client")
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    text = SITE.format(broker=free_port(), web=free_port())
    if "://" in store_at:
        text = text.replace('path = "store"', f'url = "{store_at}"')
    (tmp_path / "SITE.toml").write_text(text)
    store = open_store(place(store_at, 3), points=["q"], division=Division("river bridge", 3))
    assert run(["run", str(tmp_path / "SITE.toml"), "--for", "5", "--no-serve"]) == 2
    assert "the site 'river bridge' runs as 3 shards, and without shards" in capsys.readouterr().err
    assert run(["run", str(tmp_path / "SITE.toml"), "--for", "5", "--shard", "1/1"]) == 2
    assert "the site 'river bridge' runs as 3 shards, and as 1 shard " in capsys.readouterr().err
    store.close()


def test_an_address_in_use_is_refused_before_the_store_is_made(tmp_path, capsys):
    pytest.importorskip("paho.mqtt.client")
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        (tmp_path / "SITE.toml").write_text(SITE.format(broker=free_port(), web=port))
        assert run(["run", str(tmp_path / "SITE.toml"), "--for", "5"]) == 2
    reported = capsys.readouterr().err
    assert f"SITE.toml: service.listen: cannot listen on 127.0.0.1:{port} (Address already in use)" in reported
    assert "set another address or port" in reported
    assert not (tmp_path / "store").exists()


def test_a_site_runs_and_lets_its_points_go(tmp_path):
    pytest.importorskip("paho.mqtt.client")
    (tmp_path / "SITE.toml").write_text(SITE.format(broker=free_port(), web=free_port()))
    assert run(["run", str(tmp_path / "SITE.toml"), "--for", "0.5", "--quiet"]) == 0
    open_store(tmp_path / "store", points=["p"]).close()
