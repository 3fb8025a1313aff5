"""A site of a group that runs: its rows outlive a kill, each point has its own, and the interface shows them."""

import json
import struct
import subprocess
import time
import urllib.error
import urllib.request
from contextlib import closing

import numpy as np
import pytest
from benchmarks.live.servers import command, free_port
from benchmarks.shard import SITE
from benchmarks.shard_sensors import HEAD, Motion, Publisher, blocks
from websockets.sync.client import connect

from midspan.engine.bank import Bank, BankBlocks, BankSensor, BankSettings
from midspan.records import NANOSECONDS
from midspan.service.mqtt import Broker
from midspan.service.packets import acknowledgements, parts, publication
from midspan.service.reasons import NOT_CALIBRATED
from midspan.settings.site import MqttSettings
from midspan.sources.live.blocks import RESULT, parse
from midspan.store.chunk import join
from midspan.store.store import open_store

POINTS = 12


def until(condition, seconds=60.0):
    end_s = time.monotonic() + seconds
    while not (found := condition()) and time.monotonic() < end_s:
        time.sleep(0.05)
    return found


class GroupSite:
    """`midspan run` of a group, and its senders: seconds that are over are sent as fast as they are asked for."""

    def __init__(self, folder, broker, *, shared):
        self.shared, self.store, self.web = shared, folder / "store", free_port()
        text = SITE.format(port=broker, listen=self.web, points=POINTS, each="" if shared else "{i}/")
        (folder / "SITE.toml").write_text(text)
        self.folder, self.sender = folder, Publisher(broker)
        self.motion, self.first = Motion(POINTS), int(time.time()) - 60
        self.values = [blocks(self.motion, self.first + k, np.random.default_rng(k)) for k in range(60)]

    def start(self):
        line = command("run", self.folder / "SITE.toml", "-q")
        with (self.folder / "log.txt").open("ab") as log:
            self.process = subprocess.Popen(line, stdout=log, stderr=log)

    def send(self, second):
        """Publish a second of all points."""
        messages = []
        for sensor, values in enumerate(self.values[second]):
            count, name = values.shape[1], ("acc", "gnss")[sensor]
            stamp = (self.first + second) * NANOSECONDS
            head = HEAD.pack(1, 1 + sensor + 3 * self.shared, 0, second, stamp, 10**9 // count, count)
            if self.shared:
                messages.append((f"north/{name}", head + struct.pack("<I", POINTS) + values.tobytes()))
            else:
                messages += [(f"north/{i}/{name}", head + values[i].tobytes()) for i in range(POINTS)]
        self.sender.publish(messages)

    def newest_ns(self):
        """The newest row of the last point that the store has."""
        try:
            with closing(open_store(self.store, read_only=True)) as store:
                return store.newest_ns(f"north-{POINTS - 1}", "rows") or 0
        except Exception:  # it may not be there yet
            return 0

    def reaches(self, second):
        return until(lambda: self.newest_ns() > (self.first + second) * NANOSECONDS)

    def bank_rows(self, seconds):
        """By point the rows of a bank that is given the same blocks: stamps, displacements, deviations."""
        bank = Bank(POINTS, BankSettings(acceleration_std_m_s2=0.005, displacement_std_m=1.5e-3))
        number, found = np.arange(POINTS, dtype=np.uint32), [[] for _ in range(POINTS)]
        for second in range(seconds):
            for sensor, values in zip(BankSensor, self.values[second], strict=True):
                count = values.shape[1]
                si = values.reshape(-1)
                si = si if sensor is BankSensor.ACCELERATION else 1e-3 * si.astype(np.float64)
                stamps, steps = np.full(POINTS, (self.first + second) * NANOSECONDS), np.full(POINTS, 10**9 // count)
                bank.push(BankBlocks(sensor, number, stamps, steps, np.full(POINTS, count, dtype=np.uint32), si))
            rows = bank.rows((self.first + second) * NANOSECONDS + 990_000_000)
            ends = np.cumsum(rows.count, dtype=np.int64)
            for j, end in enumerate(ends.tolist()):
                at = slice(end - int(rows.count[j]), end)
                time_ns = rows.t0_ns[j] + rows.dt_ns[j] * np.arange(rows.count[j])
                found[rows.point[j]].append((time_ns, rows.displacement_m[at], rows.std_m[at]))
        return [tuple(np.concatenate(one) for one in zip(*parts, strict=True)) for parts in found]


def is_online(broker):
    import paho.mqtt.subscribe as subscribe

    found = subscribe.simple("midspan/v1/fleet/available", port=broker)
    return found.payload == b"online"


@pytest.fixture
def site(tmp_path, broker, request):
    running = GroupSite(tmp_path, broker, shared=getattr(request, "param", False))
    running.start()
    # The broker keeps what comes for a session that it knows.
    assert until(lambda: is_online(broker))
    yield running
    running.sender.close()
    if running.process.poll() is None:
        running.process.terminate()
        assert running.process.wait(60) == 0, (tmp_path / "log.txt").read_text()


@pytest.mark.parametrize("site", [False, True], indirect=True)
def test_rows_outlive_a_kill_bit_for_bit(site):
    for second in range(8):
        site.send(second)
    assert site.reaches(4)
    for second in range(8, 10):
        site.send(second)
    # In the middle of what comes.
    site.process.kill()
    site.process.wait()
    for second in range(10, 13):
        site.send(second)
    site.start()
    for second in range(13, 16):
        site.send(second)
    assert site.reaches(14)
    site.process.terminate()
    assert site.process.wait(60) == 0
    wanted = site.bank_rows(16)
    with closing(open_store(site.store, read_only=True)) as store:
        for point in range(POINTS):
            kept = join(list(store.chunks(f"north-{point}", "rows", 0, 2**62)))
            time_ns, displacement_m, std_m = wanted[point]
            assert np.all(np.diff(kept.time_ns) == 10**7)
            np.testing.assert_array_equal(kept.time_ns, time_ns)
            np.testing.assert_array_equal(kept.columns["displacement_m"], displacement_m)
            np.testing.assert_array_equal(kept.columns["std_m"], std_m)


def test_each_point_publishes_its_own_displacement(site, broker):
    import paho.mqtt.client as mqtt

    came = {}
    client = mqtt.Client(mqtt.CallbackAPIVersion.VERSION2, client_id="watcher")
    client.on_message = lambda _client, _data, message: came.setdefault(message.topic, []).append(message.payload)
    client.connect("127.0.0.1", broker)
    client.subscribe(
        [("midspan/v1/fleet/+/displacement", 0), ("midspan/v1/fleet/+/state", 0), ("midspan/v1/fleet/+/event", 0)]
    )
    client.loop_start()
    try:
        client.publish("midspan/v1/fleet/north-3/cmd/calibrate", b"", qos=1)
        for second in range(14):
            site.send(second)
            time.sleep(0.2)
        topics = [f"midspan/v1/fleet/north-{i}/displacement" for i in range(POINTS)]
        end_ns = (site.first + 13) * NANOSECONDS

        def is_whole(topic):
            return any(parse(one, RESULT).time_ns[-1] > end_ns for one in came.get(topic, ()))

        assert until(lambda: all(map(is_whole, topics)))
        states = until(lambda: len([one for one in came if one.endswith("/state")]) == POINTS)
        assert states
    finally:
        client.disconnect()
        client.loop_stop()
    wanted = site.bank_rows(14)
    for point, topic in enumerate(topics):
        found = [parse(one, RESULT) for one in came[topic]]
        assert [one.sequence for one in found] == list(range(len(found)))
        time_ns, displacement_m, std_m = wanted[point]
        np.testing.assert_array_equal(np.concatenate([one.time_ns for one in found]), time_ns)
        # As float32 of millimetres.
        np.testing.assert_allclose(np.concatenate([one.values for one in found]), 1e3 * displacement_m, rtol=1e-6)
        np.testing.assert_allclose(np.concatenate([one.std for one in found]), 1e3 * std_m, rtol=1e-6)
    events = [json.loads(one) for one in came["midspan/v1/fleet/north-3/event"]]
    assert [(one["kind"], one["text"]) for one in events] == [("command", f"north-3: {NOT_CALIBRATED}")]
    newest = json.loads(came["midspan/v1/fleet/north-3/state"][-1])
    assert newest["point"] == "north-3"
    assert newest["status"] in ("tracking", "coasting")


def asked(site, path, token=None, method="GET"):
    """Status and body of an answer."""
    request = urllib.request.Request(f"http://127.0.0.1:{site.web}{path}", method=method)
    if token:
        request.add_header("Authorization", f"Bearer {token}")
    try:
        with urllib.request.urlopen(request, timeout=20) as answer:
            return answer.status, answer.read().decode()
    except urllib.error.HTTPError as error:
        return error.code, error.read().decode()
    except OSError:
        return 0, ""


def test_the_interface_shows_points_of_a_group(site):
    assert until(lambda: asked(site, "/healthz")[0] == 200)
    line = command("access", site.store, "add-token", "test", "--scope", "operate", "--json")
    token = json.loads(subprocess.run(line, check=True, capture_output=True).stdout)["token"]
    sent = iter(range(60))
    url = f"ws://127.0.0.1:{site.web}/api/v1/live?points=north-3"
    with connect(url, additional_headers={"Authorization": f"Bearer {token}"}) as socket:
        rows = []

        def taken():
            site.send(next(sent))
            try:
                message = json.loads(socket.recv(timeout=0.5))
            except TimeoutError:
                return False
            rows.extend([message] if "sequence" in message else [])
            return len(rows) > 2

        assert until(taken, 30.0)
    assert {one["point"] for one in rows} == {"north-3"}
    status, body = asked(site, "/api/v1/points", token)
    points = {one["name"]: one for one in json.loads(body)}
    assert (status, list(points)) == (200, [f"north-{i}" for i in range(POINTS)])
    truth = 1e3 * site.motion.displacement_m(np.zeros(1))[:, 0]
    assert all(abs(one["displacement_mm"]) < 30.0 for one in points.values()), truth
    first = json.loads(asked(site, "/api/v1/points?of_groups=2&also=north-7", token)[1])
    assert len(first) == 3
    assert first[-1]["name"] == "north-7"
    assert json.loads(asked(site, "/api/v1/points/north-3", token)[1])["name"] == "north-3"
    assert asked(site, "/api/v1/points/north-12", token)[0] == 404
    status, body = asked(site, "/api/v1/points/north-3/calibrate", token, "POST")
    assert (status, json.loads(body)["detail"]) == (409, f"north-3: {NOT_CALIBRATED}")
    series = json.loads(asked(site, "/api/v1/points/north-3/series", token)[1])
    assert len(series["time"]) > 100
    assert 'midspan_group_points{group="north"' in asked(site, "/metrics")[1]
    # Of all that is silent some points are named.
    assert until(lambda: "silent" in asked(site, "/readyz")[1])
    status, body = asked(site, "/readyz")
    assert status == 503
    ready = json.loads(body)
    assert ready["groups"][0]["reasons"] == {"silent": POINTS}
    assert [one["point"] for one in ready["points"]] == [f"north-{i}" for i in range(POINTS)]
    assert [(one["source"], one["reason"]) for one in ready["sources"]] == [("north", "silent")]


def test_packets_of_many_messages_reach_the_broker(broker):
    """As the packets of the client's own functions, one after another."""
    import paho.mqtt.client as mqtt

    came = []
    client = mqtt.Client(mqtt.CallbackAPIVersion.VERSION2, client_id="reader")
    client.on_message = lambda _client, _data, message: came.append((message.topic, message.payload))
    client.connect("127.0.0.1", broker)
    client.subscribe("midspan/v1/site/#", 0)
    client.loop_start()
    sender = Broker(MqttSettings(port=broker), "site", {}, lambda *_: None)
    sender.start()
    # Lengths of one, two and three bytes.
    messages = [(f"p-{k}/displacement", bytes([k % 256]) * (k * k)) for k in range(0, 300, 7)]
    try:
        assert until(lambda: sender.connected)
        assert until(lambda: came)
        sender.publish_results(messages)
        wanted = [(f"midspan/v1/site/{topic}", payload) for topic, payload in messages]
        assert until(lambda: [one for one in came if "/p-" in one[0]] == wanted)
    finally:
        sender.stop()
        client.disconnect()
        client.loop_stop()


def test_packets_are_those_of_the_standard():
    assert publication("a/b", b"xy") == b"\x30\x08\x00\x03a/b\x00xy"
    assert publication("t", b"z" * 124)[:3] == b"\x30\x80\x01"
    assert acknowledgements([1, 515]) == b"\x40\x02\x00\x01\x40\x02\x02\x03"
    found = list(parts([b"x" * 40_000] * 5))
    assert b"".join(one.packets for one in found) == b"x" * 200_000
    assert [len(one.packets) for one in found] == [80_000, 80_000, 40_000]
    assert [one.messages for one in found] == [2, 2, 1]


def test_a_broker_that_comes_back_without_memory_has_all_states(site, mosquitto):
    import paho.mqtt.client as mqtt

    for second in range(5):
        site.send(second)
    assert site.reaches(2)
    mosquitto.stop()
    mosquitto.start()
    assert until(lambda: is_online(mosquitto.port))
    came = {}
    client = mqtt.Client(mqtt.CallbackAPIVersion.VERSION2, client_id="newcomer")
    client.on_message = lambda _client, _data, message: came.setdefault(message.topic, message.payload)
    client.connect("127.0.0.1", mosquitto.port)
    client.subscribe("midspan/v1/fleet/+/state", 1)
    client.loop_start()
    try:
        assert until(lambda: len(came) == POINTS), came
    finally:
        client.disconnect()
        client.loop_stop()
    names = {json.loads(payload)["point"] for payload in came.values()}
    assert names == {f"north-{number}" for number in range(POINTS)}
