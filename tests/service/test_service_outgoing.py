"""What goes to a broker that is slow, that comes back empty, or that was away for long."""

import asyncio
import contextlib
import json
import socket
import threading
import time
from types import SimpleNamespace

import numpy as np
import pytest
from benchmarks.live.servers import Mosquitto

from midspan.service import packets, retention
from midspan.service.group import Group
from midspan.service.groups import Groups
from midspan.service.mqtt import Broker
from midspan.settings.group import GroupPlan, GroupSettings
from midspan.settings.site import MqttSettings

POINTS, BEGIN_NS = 30, 1_790_000_000 * 10**9


def until(condition, seconds=30.0):
    end_s = time.monotonic() + seconds
    while not (found := condition()) and time.monotonic() < end_s:
        time.sleep(0.02)
    return found


class SlowBroker:
    """Accepts one connection and reads nothing of it until `read_on`; then the results that come."""

    def __init__(self):
        self.results, self._reading = [], threading.Event()
        self._server = socket.create_server(("127.0.0.1", 0))
        self.port = self._server.getsockname()[1]
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def read_on(self):
        self._reading.set()

    def close(self):
        self._reading.set()
        self._server.close()
        self._thread.join(10.0)

    def _run(self):
        connection, _ = self._server.accept()
        with connection, connection.makefile("rb") as stream:
            self._packet(stream)
            # CONNACK of MQTT 5 without properties.
            connection.sendall(b"\x20\x03\x00\x00\x00")
            self._reading.wait()
            with contextlib.suppress(OSError, IndexError):
                while True:
                    self._packet(stream)

    def _packet(self, stream):
        kind, length, shift = stream.read(1)[0], 0, 0
        while True:
            digit = stream.read(1)[0]
            length, shift = length + ((digit & 127) << shift), shift + 7
            if digit < 128:
                break
        body = stream.read(length)
        if kind == packets.PUBLISH:
            size = int.from_bytes(body[:2], "big")
            self.results.append((body[2 : 2 + size].decode(), body[3 + size :]))


@pytest.fixture
def slow_broker():
    server = SlowBroker()
    yield server
    server.close()


def test_of_results_that_a_slow_broker_leaves_the_oldest_are_dropped_and_counted(slow_broker, monkeypatch):
    monkeypatch.setattr(packets, "MAX_WAITING_BYTES", 2_000_000)
    sender = Broker(MqttSettings(port=slow_broker.port), "site", {}, lambda *_: None)
    sender.start()
    try:
        assert until(lambda: sender.connected)
        count, size = 6000, 5000
        for first in range(0, count, 100):
            numbers = range(first, first + 100)
            sender.publish_results((f"p-{k}/displacement", k.to_bytes(4, "big") * (size // 4)) for k in numbers)
        client = sender._client
        waiting = sum(len(one["packet"]) for one in list(client._out_packet))
        # One part more than the bounds, and what else a client says.
        assert waiting < packets.MAX_HANDED_BYTES + 100_000
        assert sender._outgoing._waiting_bytes <= packets.MAX_WAITING_BYTES
        dropped = sender.dropped_results(100.0)
        assert 0 < dropped < count
        assert sender.dropped_results(200.0) == 0
        slow_broker.read_on()
        assert until(lambda: len(slow_broker.results) == count - dropped)
        numbers = [int.from_bytes(payload[:4], "big") for _, payload in slow_broker.results]
        # In order, the newest among them, each whole.
        assert numbers == sorted(numbers)
        assert numbers[-300:] == list(range(count - 300, count))
        assert [topic for topic, _ in slow_broker.results] == [f"midspan/v1/site/p-{k}/displacement" for k in numbers]
        assert {len(payload) for _, payload in slow_broker.results} == {size}
    finally:
        sender.stop()


def test_what_was_dropped_is_said_once_a_minute():
    sender = Broker(MqttSettings(), "site", {}, lambda *_: None)
    assert sender.dropped_results(0.0) == 0
    sender._outgoing.dropped = 5
    assert sender.dropped_results(1.0) == 5
    sender._outgoing.dropped = 7
    assert sender.dropped_results(60.9) == 0
    assert sender.dropped_results(61.0) == 2


def test_results_go_on_after_a_connection_that_was_lost(mosquitto):
    """What the client had of the lost connection does not count as on its way any more."""
    sender = Broker(MqttSettings(port=mosquitto.port), "site", {}, lambda *_: None)
    sender.start()
    try:
        for _ in range(2):
            assert until(lambda: sender.connected)
            for number in range(200):
                sender.publish_results([(f"p-{number}/displacement", bytes(20_000))])
            mosquitto.stop()
            assert until(lambda: not sender.connected)
            mosquitto.start()
        assert until(lambda: sender.connected)
        assert until(lambda: sender._outgoing._handed_bytes == 0)
        with watching(mosquitto.port, "midspan/v1/site/+/displacement") as came:
            sender.publish_results([("p-1/displacement", b"new")])
            assert until(lambda: came)
    finally:
        sender.stop()


@contextlib.contextmanager
def watching(port, topic):
    """What comes of a topic, and what is retained there."""
    import paho.mqtt.client as mqtt

    came, subscribed = {}, threading.Event()
    client = mqtt.Client(mqtt.CallbackAPIVersion.VERSION2)
    client.on_message = lambda _client, _data, message: came.update({message.topic: message.payload})
    client.on_subscribe = lambda *_: subscribed.set()
    client.connect("127.0.0.1", port)
    client.subscribe(topic, 1)
    client.loop_start()
    subscribed.wait(10.0)
    try:
        yield came
    finally:
        client.disconnect()
        client.loop_stop()


def group():
    topics = {"accelerometer": "mqtt:north/{i}/acc", "displacement": "mqtt:north/{i}/gnss"}
    noise = {"accelerometer_noise_std": 0.005, "displacement_noise_std": 1.5}
    return Group.begun(GroupPlan(GroupSettings(name="north", points=POINTS, **topics, **noise), range(POINTS)))


def test_a_broker_that_comes_back_empty_has_the_states_of_all_points(mosquitto):
    groups, sender = (
        Groups(lambda _: None, print),
        Broker(MqttSettings(port=mosquitto.port), "site", {}, lambda *_: None),
    )
    groups._groups = {"north": group()}
    groups._sequences = {"north": np.zeros(POINTS, np.uint32)}
    sender.start()
    try:
        for second in range(2):
            assert until(lambda: sender.connected)
            groups.second(BEGIN_NS + second * 10**9, sender)
            with watching(mosquitto.port, "midspan/v1/site/+/state") as came:
                assert until(lambda: len(came) == POINTS), len(came)
            assert json.loads(came["midspan/v1/site/north-3/state"])["reason"] == "starting"
            mosquitto.stop()
            assert until(lambda: not sender.connected)
            # Nothing is marked as published that a broker which is away cannot have.
            groups.second(BEGIN_NS + second * 10**9 + 1, sender)
            mosquitto.start()
    finally:
        sender.stop()


def test_states_for_which_the_client_has_no_room_follow(broker, monkeypatch):
    sender = Broker(MqttSettings(port=broker), "site", {}, lambda *_: None)
    groups = Groups(lambda _: None, print)
    groups._groups, groups._sequences = {"north": group()}, {"north": np.zeros(POINTS, np.uint32)}
    sender.start()
    try:
        assert until(lambda: sender.connected)
        monkeypatch.setattr("midspan.service.mqtt.MAX_QUEUED", 4)
        with watching(broker, "midspan/v1/site/+/state") as came:
            for second in range(POINTS):
                groups.second(BEGIN_NS + second * 10**9, sender)
                time.sleep(0.05)
            assert until(lambda: len(came) == POINTS)
    finally:
        sender.stop()


def test_a_site_is_online_however_much_waits_for_the_broker(tmp_path, monkeypatch):
    pytest.importorskip("paho.mqtt.client")
    if Mosquitto.program() is None:
        pytest.skip("mosquitto is not installed")
    monkeypatch.setattr("midspan.service.mqtt.MAX_QUEUED", 20)
    server = Mosquitto(tmp_path)
    sender = Broker(MqttSettings(port=server.port), "site", {}, lambda *_: None)
    sender.start()
    try:
        for number in range(30):
            sender.publish("p/event", f"{number}")
            # A state that is old when the broker is back takes no place.
            assert not sender.publish("p/state", "{}", retain=True)
        server.start()
        with watching(server.port, "midspan/v1/site/available") as came:
            assert until(lambda: came.get("midspan/v1/site/available") == b"online"), came
    finally:
        sender.stop()
        server.stop()


def test_one_sweep_follows_another_whatever_fails_in_one(monkeypatch):
    under_way, most, sweeps, said, forgotten = [], [], [], [], []

    def archive_days(_site, _say):
        under_way.append(1)
        most.append(len(under_way))
        time.sleep(0.05)
        under_way.pop()
        sweeps.append(1)
        if len(sweeps) < 3:
            raise RuntimeError("no such table")

    class Kept:
        def forget_before(self, time_ns):
            forgotten.append(time_ns)

    site = SimpleNamespace(settings=SimpleNamespace(store=SimpleNamespace(keep_days=2.0)))
    monkeypatch.setattr(retention, "archive_days", archive_days)
    monkeypatch.setattr(retention, "SWEEP_S", 0.001)

    async def some():
        task = asyncio.create_task(retention.sweeping(lambda: site, Kept(), said.append))
        while len(sweeps) < 5:
            await asyncio.sleep(0.01)
            assert not task.done()
        task.cancel()

    asyncio.run(some())
    assert set(most) == {1}
    assert said == ["archive: RuntimeError: no such table; midspan retries in an hour."] * 2
    # Of a failed archive nothing is removed.
    assert 2 <= len(forgotten) <= 3
    assert forgotten[0] == pytest.approx((time.time() - 2 * 86_400.0) * 1e9, abs=60e9)
