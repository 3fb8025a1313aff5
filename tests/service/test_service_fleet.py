"""A site as shards: rows of all points, each once, whatever is killed on the way."""

import json
import os
import signal
import subprocess
import sys
import threading
import time
from contextlib import closing, suppress

import numpy as np
import pytest
from benchmarks.live.servers import command, free_port
from benchmarks.shard_sensors import HEAD, RATE_HZ, SLOW_HZ, Motion, blocks

from midspan.records import NANOSECONDS
from midspan.scale.fleet import fleet_file, read_fleet
from midspan.store.store import is_store, open_store

EACH, ALL = 7, 5
SECONDS, KILL_AT = 24, 8
# A second of blocks is sent in this time, s.
STEP_S = 0.4
# Processes start slowly on a busy machine.
PATIENCE_S = 150.0

SITE = """
name = "bridge"
[store]
{store}
[mqtt]
host = "127.0.0.1"
port = {broker}
[service]
listen = "127.0.0.1:{port}"
[[group]]
name = "each"
points = {each}
accelerometer = "mqtt:each/{{i}}/acc"
displacement = "mqtt:each/{{i}}/gnss"
accelerometer_noise_std = 0.005
displacement_noise_std = 1.5
[[group]]
name = "all"
points = {all}
accelerometer = "mqtt:all/acc"
displacement = "mqtt:all/gnss"
accelerometer_noise_std = 0.005
displacement_noise_std = 1.5
"""


def free_ports(count):
    """The first of some ports in a row that nothing listens on."""
    for _ in range(50):
        first = free_port()
        with suppress(OSError):
            import socket

            servers = [socket.create_server(("127.0.0.1", first + k)) for k in range(count)]
            for one in servers:
                one.close()
            return first
    raise OSError("no free ports")


class Listener:
    """What is retained below the site's topic."""

    def __init__(self, port):
        import paho.mqtt.client as mqtt

        self.seen = {}
        self.client = mqtt.Client(mqtt.CallbackAPIVersion.VERSION2, client_id="test")
        self.client.on_message = self._came
        self.client.connect("127.0.0.1", port)
        self.client.subscribe([("midspan/v1/bridge/available", 1), ("midspan/v1/bridge/+/available", 1)])
        self.client.loop_start()

    def _came(self, _client, _data, message):
        self.seen.setdefault(message.topic.removeprefix("midspan/v1/bridge/"), []).append(message.payload.decode())

    def wait(self, topic, text):
        until_s = time.monotonic() + PATIENCE_S
        while ["", *self.seen.get(topic, ())][-1] != text:
            assert time.monotonic() < until_s, (topic, text, self.seen)
            time.sleep(0.05)

    def stop(self):
        self.client.disconnect()
        self.client.loop_stop()


def send(listener, first, seconds):
    """Publish a second of blocks of all points after the other."""
    motion = Motion(EACH + ALL)
    for second in range(first, first + seconds):
        rng = np.random.default_rng(second)
        for sensor, (rate_hz, values) in enumerate(zip((RATE_HZ, SLOW_HZ), blocks(motion, second, rng), strict=True)):
            name = ("acc", "gnss")[sensor]
            stamps = (second - first, second * NANOSECONDS, NANOSECONDS // rate_hz, rate_hz)
            for point in range(EACH):
                head = HEAD.pack(1, 1 + sensor, 0, *stamps)
                listener.client.publish(f"each/{point}/{name}", head + values[point].tobytes(), qos=1)
            head = HEAD.pack(1, 4 + sensor, 0, *stamps) + int(ALL).to_bytes(4, "little")
            listener.client.publish(f"all/{name}", head + values[EACH:].tobytes(), qos=1)
        time.sleep(STEP_S)


def stamps(stores, point):
    """The stamps of a point's rows in stores of which one has it."""
    found = []
    for where in stores:
        if is_store(where):
            with closing(open_store(where, read_only=True)) as store:
                found += [one.time_ns for one in store.chunks(point, "rows", 0, 2**62)]
    return np.concatenate(found) if found else np.empty(0, np.int64)


def assert_whole(stores, first, seconds):
    """All points have all rows of the seconds once; waits for them."""
    names = [f"each-{k}" for k in range(EACH)] + [f"all-{k}" for k in range(ALL)]
    # The first rows come once the filter knows the velocity; the last ones wait for a measurement after them.
    step_ns, begin_ns = NANOSECONDS // RATE_HZ, (first + 2) * NANOSECONDS
    end_ns = (first + seconds - 1) * NANOSECONDS
    until_s = time.monotonic() + PATIENCE_S
    for name in names:
        while (found := stamps(stores, name)).max(initial=0) < end_ns:
            assert time.monotonic() < until_s, (name, len(found))
            time.sleep(0.5)
        assert found[0] <= begin_ns
        np.testing.assert_array_equal(np.diff(found), step_ns, err_msg=name)


def site_file(tmp_path, broker, store='path = "store"'):
    file = tmp_path / "SITE.toml"
    text = SITE.format(store=store, broker=broker, port=free_ports(3), each=EACH, all=ALL)
    file.write_text(text)
    return file


@pytest.fixture
def fleet(tmp_path):
    """A function that starts a fleet; it is ended at the end."""
    started = []

    def start(file, *arguments, **environment):
        log = (tmp_path / f"fleet-{len(started)}.log").open("wb")
        program = command("fleet", file, *arguments)
        process = subprocess.Popen(program, stderr=log, stdout=subprocess.PIPE, env={**os.environ, **environment})
        log.close()
        started.append(process)
        return process

    yield start
    for process in started:
        with process:
            if process.poll() is None:
                process.terminate()
                try:
                    process.wait(60)
                except subprocess.TimeoutExpired:
                    process.kill()
        process.stdout.close()


def pids(file):
    """The processes of the shards, once all run."""
    until_s = time.monotonic() + PATIENCE_S
    while (found := read_fleet(file)) is None or any(one.pid is None for one in found.shards) or not found.shards:
        assert time.monotonic() < until_s, found
        time.sleep(0.1)
    return {one.shard: one.pid for one in found.shards}


def status(file):
    """Exit code and reports of `midspan fleet --status`."""
    done = subprocess.run(command("fleet", file, "--status", "--json"), capture_output=True, text=True, check=False)
    return done.returncode, json.loads(done.stdout)["shards"]


def test_a_fleet_loses_no_row_where_a_shard_and_its_driver_are_killed(tmp_path, broker, fleet):
    file, listener = site_file(tmp_path, broker), Listener(broker)
    first = int(time.time()) - 3600
    stores = [tmp_path / "store" / f"shard-{k}" for k in (1, 2, 3)]
    try:
        process = fleet(file, "--shards", "3")
        listener.wait("available", "online")
        sending = threading.Thread(target=send, args=(listener, first, SECONDS))
        sending.start()
        time.sleep(KILL_AT * STEP_S)
        killed = pids(file)[2]
        os.kill(killed, signal.SIGKILL)
        listener.wait("available", "offline")
        assert listener.seen["shard-2/available"][-1] == "offline"
        listener.wait("available", "online")
        assert pids(file)[2] != killed
        assert [one.restarts for one in read_fleet(file).shards] == [0, 1, 0]
        sending.join()
        assert_whole(stores, first, SECONDS)
        # The driver: its shards end with it, and those of the next one go on.
        process.kill()
        process.wait()
        listener.wait("available", "offline")
        process = fleet(file, "--shards", "3", "--json")
        send(listener, first + SECONDS, 4)
        listener.wait("available", "online")
        assert_whole(stores, first, SECONDS + 4)
        # On a busy machine a shard that begins needs longer than it has for an answer.
        for _ in range(10):
            code, reports = status(file)
            if all("no answer" not in report["text"] for report in reports):
                break
        assert [report["shard"] for report in reports] == [1, 2, 3]
        assert code in (0, 3)
        assert all("no answer" not in report["text"] for report in reports)
        process.send_signal(signal.SIGTERM)
        assert process.wait(60) == 0
        assert json.loads(process.stdout.read())["count"] == 3
        listener.wait("available", "offline")
        assert not fleet_file(file).exists()
        code, reports = status(file)
        assert code == 3
        assert all("no answer" in one["text"] for one in reports)
        # Each store has its own points alone.
        with closing(open_store(stores[1], read_only=True)) as store:
            assert store.points == ["all-0", "all-3", "each-1", "each-4"]
    finally:
        listener.stop()


def test_shards_keep_their_rows_in_one_database(tmp_path, broker, fleet, postgres):
    where = postgres.database("fleet_of_three")
    file, listener = site_file(tmp_path, broker, store=f'url = "{where}"\ncaptures = "captures"'), Listener(broker)
    first = int(time.time()) - 3600
    try:
        fleet(file, "--shards", "3", XDG_STATE_HOME=str(tmp_path / "state"))
        listener.wait("available", "online")
        send(listener, first, 6)
        os.kill(pids(file)[3], signal.SIGKILL)
        send(listener, first + 6, 6)
        assert_whole([where], first, 12)
    finally:
        listener.stop()


def test_another_number_of_shards_is_refused_while_some_run_and_doubles_nothing_after_them(
    tmp_path, broker, fleet, postgres
):
    where, state = postgres.database("fleet_of_two"), {"XDG_STATE_HOME": str(tmp_path / "state")}
    file, listener = site_file(tmp_path, broker, store=f'url = "{where}"\ncaptures = "captures"'), Listener(broker)
    first = int(time.time()) - 3600
    try:
        process = fleet(file, "--shards", "3", **state)
        listener.wait("available", "online")
        send(listener, first, 6)
        assert_whole([where], first, 6)
        second = subprocess.run(
            command("run", file, "--shard", "2/2", "--for", "5", "--no-serve"),
            capture_output=True, text=True, check=False, env={**os.environ, **state},
        )  # fmt: skip
        assert second.returncode == 2
        assert "the site 'bridge' runs as 3 shards, and as 2 shards the same points would be" in second.stderr
        process.send_signal(signal.SIGSTOP)
        for pid in pids(file).values():
            os.kill(pid, signal.SIGKILL)
        process.kill()
        listener.wait("available", "offline")
        fleet(file, "--shards", "2", **state)
        listener.wait("available", "online")
        # The last seconds come again.
        send(listener, first + 3, 8)
        with closing(open_store(where, read_only=True)) as store:
            names = store.points
        assert len(names) == EACH + ALL
        until_s = time.monotonic() + PATIENCE_S
        for name in names:
            while (found := stamps([where], name)).max() < (first + 10) * NANOSECONDS:
                assert time.monotonic() < until_s, (name, len(found))
                time.sleep(0.5)
            assert (np.diff(found) >= NANOSECONDS // RATE_HZ).all()
    finally:
        listener.stop()


def test_a_fleet_of_more_shards_than_points_is_refused(tmp_path, fleet):
    process = fleet(site_file(tmp_path, 1883), "--shards", "13")
    assert process.wait(60) == 2


def test_actors_lose_no_row_where_one_is_killed(tmp_path, broker, fleet):
    pytest.importorskip("ray")
    file, listener = site_file(tmp_path, broker), Listener(broker)
    first = int(time.time()) - 3600
    try:
        process = fleet(file, "--shards", "2", "--runner", "ray")
        listener.wait("available", "online")
        sending = threading.Thread(target=send, args=(listener, first, SECONDS))
        sending.start()
        time.sleep(KILL_AT * STEP_S)
        killed = pids(file)[2]
        os.kill(killed, signal.SIGKILL)
        listener.wait("available", "offline")
        listener.wait("available", "online")
        sending.join()
        assert_whole([tmp_path / "store" / f"shard-{k}" for k in (1, 2)], first, SECONDS)
        assert pids(file)[2] != killed
        assert read_fleet(file).shards[1].restarts == 1
        process.send_signal(signal.SIGINT)
        assert process.wait(90) == 0
        listener.wait("available", "offline")
    finally:
        listener.stop()


@pytest.fixture
def cluster():
    """The address of a cluster that does not end with a fleet's driver."""
    ray = pytest.importorskip("ray")
    ray.init(num_cpus=2, include_dashboard=False, log_to_driver=False, configure_logging=False)
    yield ray.get_runtime_context().gcs_address
    ray.shutdown()


def test_actors_outlive_their_driver_and_the_next_one_finds_them(tmp_path, broker, fleet, cluster):
    file, listener = site_file(tmp_path, broker), Listener(broker)
    first = int(time.time()) - 3600
    try:
        process = fleet(file, "--shards", "2", "--runner", "ray", RAY_ADDRESS=cluster)
        listener.wait("available", "online")
        before = pids(file)
        process.kill()
        process.wait()
        fleet_file(file).unlink()
        send(listener, first, 4)
        process = fleet(file, "--shards", "2", "--runner", "ray", RAY_ADDRESS=cluster)
        assert pids(file) == before
        send(listener, first + 4, 4)
        assert_whole([tmp_path / "store" / f"shard-{k}" for k in (1, 2)], first, 8)
        assert listener.seen["available"][-1] == "online"
        process.send_signal(signal.SIGTERM)
        assert process.wait(90) == 0
        listener.wait("available", "offline")
    finally:
        listener.stop()


def test_ray_is_imported_nowhere_else():
    script = (
        "import sys, midspan.cli.fleet, midspan.scale.fleet, midspan.scale.fleet_processes, midspan.scale.fleet_ray, "
        "midspan.service.part; print('ray' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"
