"""What comes over the network is bounded before it is read: messages."""

import json
import time

import pytest

from midspan.service.mqtt import Broker
from midspan.settings.site import MqttSettings
from midspan.sources.live.blocks import ACCELERATION, MAX_BYTES, parse
from midspan.sources.live.instants import SourceFault


@pytest.mark.parametrize("begin", [b'{"sequence": 7, "values": [', b"\x01\x01\x00\x00"])
def test_a_payload_that_is_too_long_is_not_parsed(begin):
    payload = begin + b"1," * 10_000_000
    begun_s = time.process_time()
    with pytest.raises(SourceFault, match=f"{len(payload)} bytes; at most {MAX_BYTES} are accepted") as fault:
        parse(payload, ACCELERATION)
    assert fault.value.code == "payload"
    # Parsing them takes seconds.
    assert time.process_time() - begun_s < 0.2


def test_a_message_that_is_too_long_does_not_reach_us(broker):
    import paho.mqtt.client as mqtt

    came = []
    held = Broker(MqttSettings(port=broker), "site", {"acc": 1}, lambda _topic, payload, _kept: came.append(payload))
    sender = mqtt.Client(mqtt.CallbackAPIVersion.VERSION2, client_id="sender")
    held.start()
    sender.connect("127.0.0.1", broker)
    sender.loop_start()
    try:
        assert until(lambda: held.connected)
        time.sleep(0.5)
        sender.publish("acc", bytes(20_000_000), qos=1)
        sender.publish("acc", json.dumps([1]), qos=1)
        assert until(lambda: came)
    finally:
        held.stop()
        sender.disconnect()
        sender.loop_stop()
    assert came == [b"[1]"]


def test_two_sites_of_one_name_do_not_end_each_other_once_a_second(broker):
    first, second = (Broker(MqttSettings(port=broker), "site", {}, lambda *_: None) for _ in range(2))
    first.start()
    try:
        assert until(lambda: first.connected)
        assert first.reason == ""
        second.start()
        # Each sees at its own return that the other one was there, and waits for half a minute then.
        assert until(lambda: "name_taken" in (first.reason, second.reason))
        assert until(lambda: (first.connected, second.connected) in ((True, False), (False, True)))
        time.sleep(1.5)
        changes, before = 0, (first.connected, second.connected)
        # Two that end each other do so some three times in this time.
        for _ in range(60):
            time.sleep(0.05)
            now = (first.connected, second.connected)
            changes, before = changes + (now != before), now
        assert changes == 0
    finally:
        first.stop()
        second.stop()


def test_a_site_that_starts_again_has_its_own_name(mosquitto):
    for _ in range(2):
        one = Broker(MqttSettings(port=mosquitto.port), "site", {}, lambda *_: None)
        one.start()
        try:
            assert until(lambda one=one: one.connected)
            mosquitto.stop()
            assert until(lambda one=one: one.reason == "broker_gone")
            mosquitto.start()
            assert until(lambda one=one: one.connected)
            time.sleep(0.5)
            assert one.reason == ""
        finally:
            one.stop()


def until(condition, seconds=30.0):
    end_s = time.monotonic() + seconds
    while not condition() and time.monotonic() < end_s:
        time.sleep(0.02)
    return condition()
