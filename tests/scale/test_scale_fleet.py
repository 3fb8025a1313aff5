"""The watch over the shards of a fleet: what ends or hangs starts again, after growing pauses, and all end with it."""

import json
import os
import signal
import socket
import subprocess
import sys
import textwrap
import threading
import time
from contextlib import suppress
from dataclasses import replace
from functools import partial
from pathlib import Path

import pytest
from benchmarks.live.servers import command

from midspan.cli.access import announce_admin
from midspan.cli.console import Console
from midspan.errors import UsageError
from midspan.scale import fleet_processes, fleet_status, pulse
from midspan.scale.fleet import Fleet, ShardState, driver_lock, fleet_file, read_fleet, watch
from midspan.scale.fleet_processes import ShardProcess
from midspan.scale.fleet_status import address_of, asked, at_once
from midspan.scale.pulse import Pauses, Pulse
from midspan.service.notify import notify

# Another process starts within this time on a busy machine, s.
PATIENCE_S = 60.0


def python(text):
    return [sys.executable, "-c", textwrap.dedent(text)]


def looked(shard, wanted):
    """Its state once it is as wanted."""
    until_s = time.monotonic() + PATIENCE_S
    while not wanted(state := shard.look()):
        assert time.monotonic() < until_s, state
        time.sleep(0.02)
    return state


def test_a_shard_that_ends_is_started_again_and_says_why(monkeypatch):
    monkeypatch.setattr(pulse, "FIRST_PAUSE_S", 0.05)
    shard = ShardProcess(3, python("raise SystemExit(7)"))
    state = looked(shard, lambda one: one.restarts == 2)
    assert state.shard == 3
    assert "exit code 7" in state.text
    shard.end(0.0)


def test_a_shard_that_is_killed_or_silent_is_started_again(monkeypatch):
    monkeypatch.setattr(pulse, "FIRST_PAUSE_S", 0.05)
    shard = ShardProcess(1, python("import time; time.sleep(1000)"))
    first = looked(shard, lambda one: one.pid is not None).pid
    os.kill(first, signal.SIGKILL)
    second = looked(shard, lambda one: one.pid not in (None, first))
    assert "SIGKILL" in second.text
    monkeypatch.setattr(fleet_processes, "SILENT_S", 0.3)
    third = looked(shard, lambda one: one.restarts == 2)
    assert "no sign of life" in third.text
    with pytest.raises(ProcessLookupError):
        os.kill(second.pid, 0)
    shard.terminate()
    shard.end(time.monotonic() + 10.0)


def test_pauses_grow_up_to_a_minute_and_begin_anew_after_a_good_while(monkeypatch):
    now_s = [0.0]
    monkeypatch.setattr(pulse.time, "monotonic", lambda: now_s[0])
    pauses = Pauses()
    assert [pauses.ended() for _ in range(8)] == [1, 2, 4, 8, 16, 32, 60, 60]
    pauses.begun()
    now_s[0] += 61.0
    assert pauses.ended() == 1


def test_a_pulse_is_what_a_service_says_to_systemd(monkeypatch):
    heard = Pulse()
    time.sleep(0.2)
    assert heard.silent_s() >= 0.2
    monkeypatch.setenv("NOTIFY_SOCKET", heard.address)
    notify("WATCHDOG=1")
    assert heard.silent_s() < 0.2
    heard.close()
    notify("WATCHDOG=1")


def is_alive(pid):
    """Whether a process is there, and not only waited for."""
    try:
        return " Z " not in Path(f"/proc/{pid}/stat").read_text()
    except (FileNotFoundError, ProcessLookupError):
        return False


def test_a_shard_ends_with_the_process_that_started_it(tmp_path):
    script = """
        import sys, time
        from midspan.scale.fleet_processes import ShardProcess
        shard = ShardProcess(1, [sys.executable, "-c", "import time; time.sleep(1000)"])
        print(shard.look().pid, flush=True)
        time.sleep(1000)
    """
    with subprocess.Popen(python(script), stdout=subprocess.PIPE, text=True) as driver:
        pid = int(driver.stdout.readline())
        driver.kill()
    until_s = time.monotonic() + PATIENCE_S
    while is_alive(pid):
        assert time.monotonic() < until_s
        time.sleep(0.05)


class Some:
    """Shards that stand as they are asked to."""

    def __init__(self, *states):
        self.states, self.stopped = list(states), False

    def look(self):
        return self.states.pop(0) if len(self.states) > 1 else self.states[0]

    def stop(self):
        self.stopped = True


def test_the_driver_says_and_writes_how_its_shards_stand(tmp_path):
    file, lines, kept = tmp_path / "SITE.toml", [], []
    shards = Some([ShardState(1)], [ShardState(1, 5)], [ShardState(1, None, 0, "", "it ended.")], [ShardState(1, 6, 1)])
    looks = iter(range(6))

    def stopped(_wait_s):
        kept.append(read_fleet(file))
        return next(looks) == 4

    last = watch(shards, Fleet("process", 1, 0.0, ()), file, say=lines.append, stopped=stopped)
    assert lines == ["shard 1: runs as process 5.", "shard 1: it ended.", "shard 1: runs as process 6."]
    assert [one.shards[0].pid for one in kept] == [None, 5, None, 6, 6]
    assert last.shards == (ShardState(1, 6, 1),)
    assert shards.stopped
    assert not fleet_file(file).exists()
    fleet_file(file).write_text('{"runner": "process"}')
    assert read_fleet(file) is None


def test_a_shard_that_does_not_answer_is_not_ready():
    ready, text = asked("127.0.0.1:1", tls=False)
    assert not ready
    assert "no answer" in text


@pytest.fixture
def server():
    """A function that starts a server which answers each request with some bytes, None: with nothing; its address."""
    servers = []

    def start(answer):
        listening = socket.create_server(("127.0.0.1", 0))
        servers.append(listening)

        def run():
            with suppress(OSError):
                while True:
                    connection, _ = listening.accept()
                    if answer is None:
                        servers.append(connection)
                        continue
                    with connection:
                        connection.recv(10_000)
                        connection.sendall(answer)

        threading.Thread(target=run, daemon=True).start()
        return f"127.0.0.1:{listening.getsockname()[1]}"

    yield start
    for one in servers:
        one.close()


@pytest.mark.parametrize(
    "answer",
    [
        b"no HTTP at all\r\n\r\n",
        b"",
        b"HTTP/1.1 200 OK\r\nContent-Length: 9\r\n\r\n{}",
        b"HTTP/1.1 503 Busy\r\nContent-Length: 9\r\n\r\n{}",
    ],
)
def test_what_answers_something_else_is_no_traceback(server, answer):
    ready, text = asked(server(answer), tls=False)
    assert not ready
    assert text.startswith("no answer (")
    assert len(text) > len("no answer ()")


def test_shards_are_asked_at_once(server, monkeypatch):
    monkeypatch.setattr(fleet_status, "ANSWER_S", 1.0)
    body = b'{"ready": true}'
    well = server(b"HTTP/1.1 200 OK\r\nContent-Length: %d\r\n\r\n%b" % (len(body), body))
    addresses = [*(server(None) for _ in range(7)), well]
    begun_s = time.monotonic()
    answers = at_once([partial(asked, address, tls=False) for address in addresses])
    # One time-out for all of them, and some time of a busy machine.
    assert time.monotonic() - begun_s < 4.0
    assert [one.ready for one in answers] == [False] * 7 + [True]
    assert all("no answer" in one.text for one in answers[:7])


def test_a_shard_of_another_machine_is_asked_there():
    there = ShardState(1, 5, 0, "node-7", "", "10.0.0.7")
    here = replace(there, host=socket.gethostname())
    for state in (None, ShardState(1, 5), here):
        assert address_of("127.0.0.1:8080", state) == "127.0.0.1:8080"
        assert address_of("0.0.0.0:8443", state) == "127.0.0.1:8443"
        assert address_of("[::]:8443", state) == "[::1]:8443"
    assert address_of("0.0.0.0:8443", there) == "10.0.0.7:8443"
    assert address_of("0.0.0.0:8443", replace(there, address="fd00::7")) == "[fd00::7]:8443"
    assert address_of("bridge.example.org:8443", there) == "bridge.example.org:8443"
    # Nobody else can ask it.
    assert address_of("127.0.0.1:8080", there) is None


def test_a_site_that_is_not_there_is_wrong_use(tmp_path):
    for line in (["fleet", "nowhere.toml"], ["fleet", "nowhere.toml", "--status"], ["run", "nowhere.toml"]):
        done = subprocess.run(command(*line), cwd=tmp_path, capture_output=True, text=True, check=False)
        assert done.returncode == 2, line
        assert "nowhere.toml: cannot be read" in done.stderr


def test_a_password_says_which_shard_it_is_for(tmp_path, capfd):
    announce_admin(str(tmp_path / "one"), Console(quiet=False, as_json=True), "2/3")
    assert json.loads(capfd.readouterr().err)["shard"] == "2/3"
    announce_admin(str(tmp_path / "two"), Console(quiet=False, as_json=False), "2/3")
    assert capfd.readouterr().out.startswith("shard 2/3: admin: password: ")
    announce_admin(str(tmp_path / "three"), Console(quiet=False, as_json=False))
    assert capfd.readouterr().out.startswith("admin: password: ")


def test_a_site_has_one_driver_at_a_time(tmp_path):
    first = driver_lock(tmp_path / "SITE.toml")
    with pytest.raises(UsageError, match="another `midspan fleet`"):
        driver_lock(tmp_path / "SITE.toml")
    first.close()
    driver_lock(tmp_path / "SITE.toml").close()


def test_a_shard_that_cannot_be_started_is_tried_again(monkeypatch):
    monkeypatch.setattr(pulse, "FIRST_PAUSE_S", 0.05)
    shard = ShardProcess(1, ["no-such-program"])
    state = looked(shard, lambda one: one.restarts == 2)
    assert "could not be started" in state.text
    assert state.pid is None
    shard.end(0.0)
