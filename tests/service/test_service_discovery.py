"""Home Assistant finds each point by what a site retains on the broker, and reads its figures by what it says there."""

import json
import re
import time

import numpy as np
import pytest

from midspan.records import NANOSECONDS
from midspan.service.discovery import announcements
from midspan.service.mqtt import Broker, summary
from midspan.settings.site import MqttSettings
from midspan.store.chunk import Chunk

SETTINGS = MqttSettings(discovery="homeassistant", prefix="bridges")


def test_what_is_announced_names_topics_and_fields_that_there_are():
    found = {topic: json.loads(text) for topic, text in announcements(SETTINGS, "river bridge", ["a", "b-1"]).items()}
    assert len(found) == 6
    time_ns = 1_790_000_000 * NANOSECONDS + np.arange(3) * 10**7
    rows = Chunk("a", "rows", time_ns, {"displacement_m": np.full(3, 1e-3), "std_m": np.full(3, 1e-5)}, 1)
    published = {"summary": json.loads(summary(rows, "tracking")), "state": {"status": "tracking"}}
    for topic, config in found.items():
        # Node and object are letters, digits, - and _ alone, as Home Assistant wants them.
        assert re.fullmatch(r"homeassistant/sensor/[\w-]+/[\w-]+/config", topic)
        root, point, kind = config["state_topic"].rsplit("/", 2)
        assert root == "bridges/v1/river bridge"
        assert point in ("a", "b-1")
        (field,) = re.fullmatch(r"\{\{ value_json\.(\w+) \}\}", config["value_template"]).groups()
        assert field in published[kind]
        assert config["availability_topic"] == f"{root}/available"
    assert len({config["unique_id"] for config in found.values()}) == 6
    assert announcements(MqttSettings(), "s", ["a"]) == {}


def test_sites_whose_names_differ_by_a_sign_are_two_devices():
    nodes = {next(iter(announcements(SETTINGS, name, ["a"]))) for name in ("a b", "a.b", "a-b")}
    assert len(nodes) == 3


def test_it_is_retained_for_whoever_connects_later(broker):
    mqtt = pytest.importorskip("paho.mqtt.client")
    settings, came = SETTINGS.model_copy(update={"port": broker}), {}
    announced = announcements(settings, "s", ["a"])
    site = Broker(settings, "s", {}, lambda *_: None, announced=announced)
    site.start()
    end_s = time.monotonic() + 20.0
    while not site.connected and time.monotonic() < end_s:
        time.sleep(0.02)
    time.sleep(0.3)
    later = mqtt.Client(mqtt.CallbackAPIVersion.VERSION2, client_id="home")
    later.on_message = lambda _client, _data, message: came.update({message.topic: message.payload.decode()})
    later.connect("127.0.0.1", broker)
    later.subscribe("homeassistant/#", qos=1)
    later.loop_start()
    try:
        while came != announced and time.monotonic() < end_s:
            time.sleep(0.02)
        assert came == announced
    finally:
        later.disconnect()
        later.loop_stop()
        site.stop()


class Client:
    """Of paho's client what a change uses."""

    def __init__(self):
        self.retained = {}

    def publish(self, topic, payload, *, qos, retain):
        assert (qos, retain) == (1, True)
        self.retained[topic] = payload

    def subscribe(self, *_):
        pass

    reconnect_delay_set = subscribe


class Accepted:
    is_failure = False


@pytest.mark.parametrize("is_away", [False, True])
def test_of_a_removed_point_nothing_is_retained_any_more(is_away):
    both, first = (announcements(SETTINGS, "s", names) for names in (["a", "b"], ["a"]))
    site = Broker(SETTINGS, "s", {}, lambda *_: None, announced=both)
    site._client = client = Client()
    site.connected = not is_away
    site.change({}, first, ["b"])
    if is_away:
        assert client.retained == {}
        site._met(client, None, None, Accepted(), None)
    cleared = {topic for topic, payload in client.retained.items() if payload == ""}
    assert cleared == {*(both.keys() - first.keys()), "bridges/v1/s/b/state"}
    # One that comes again is announced again.
    site.change({}, both)
    assert {topic: client.retained[topic] for topic in both.keys() - first.keys()} == {
        topic: payload for topic, payload in both.items() if topic not in first
    }
