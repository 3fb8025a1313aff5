"""What is published: blocks whose stamps are those of the rows, whatever is missing between them."""

import time

import numpy as np
import pytest

from midspan.records import NANOSECONDS
from midspan.service.mqtt import Broker, even_parts, result_payload
from midspan.settings.site import MqttSettings
from midspan.sources.live.blocks import RESULT, parse
from midspan.store.chunk import Chunk

BEGIN_NS = 1_790_000_000 * NANOSECONDS


@pytest.mark.parametrize("missing", [[], [5], [0], list(range(10, 30)), [3, 4, 50], [98]])
def test_blocks_end_where_stamps_do_not_go_on_evenly(missing):
    rng = np.random.default_rng(0)
    number = np.delete(np.arange(100), missing)
    # The accelerometer's stamps shiver by a tenth of a step.
    time_ns = BEGIN_NS + 10**7 * number + rng.integers(-(10**6), 10**6, len(number))
    value = rng.normal(0.0, 1e-3, len(number))
    columns = {"displacement_m": value, "std_m": np.full(len(number), 2e-5)}
    rows = Chunk("p", "rows", time_ns, columns, 1)
    blocks = [parse(result_payload(part, k), RESULT) for k, part in enumerate(even_parts(rows))]
    np.testing.assert_allclose(np.concatenate([one.values for one in blocks]), 1e3 * value, rtol=1e-6)
    np.testing.assert_allclose(np.concatenate([one.std for one in blocks]), 0.02, rtol=1e-6)
    assert np.abs(np.concatenate([one.time_ns for one in blocks]) - time_ns).max() < 5 * 10**6


def test_a_single_row_is_a_block():
    rows = Chunk("p", "rows", np.array([BEGIN_NS]), {"displacement_m": np.zeros(1), "std_m": np.ones(1)}, 1)
    (part,) = even_parts(rows)
    assert parse(result_payload(part, 0), RESULT).time_ns.tolist() == [BEGIN_NS]


def test_what_waits_to_be_kept_does_not_hold_back_what_comes(broker):
    import paho.mqtt.client as mqtt

    came, count = [], 500
    held = Broker(MqttSettings(port=broker), "site", {"acc/+": 1}, lambda topic, payload, _kept: came.append(payload))
    sender = mqtt.Client(mqtt.CallbackAPIVersion.VERSION2, client_id="sender")
    sender.max_queued_messages_set(0)
    held.start()
    sender.connect("127.0.0.1", broker)
    sender.loop_start()
    try:
        until_s = time.monotonic() + 30.0
        while not held.connected and time.monotonic() < until_s:
            time.sleep(0.05)
        time.sleep(0.5)
        for number in range(count):
            sender.publish("acc/1", str(number), qos=1)
        while len(came) < count and time.monotonic() < until_s:
            time.sleep(0.05)
    finally:
        held.stop()
        sender.disconnect()
        sender.loop_stop()
    # None of them was acknowledged yet.
    assert [int(one) for one in came] == list(range(count))
