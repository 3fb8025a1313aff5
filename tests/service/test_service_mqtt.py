"""What is published: blocks whose stamps are those of the rows, whatever is missing between them."""

import json
import re
import shutil
import subprocess
import time
from pathlib import Path

import numpy as np
import pytest

import midspan
from midspan.engine import stream
from midspan.errors import UsageError
from midspan.fusion.blocks import EVENT_KINDS
from midspan.records import NANOSECONDS
from midspan.service.mqtt import Broker, even_parts, result_payload, summary
from midspan.settings.site import MqttSettings
from midspan.sources.live.blocks import ACCELERATION, DISPLACEMENT, RESULT, parse
from midspan.store.chunk import Chunk

EVENT = re.compile(r'\bEvent\(\s*[^"()]*(?:\([^"]*\))?[^"()]*,\s*"([\w -]+)"|_(?:tell|event)\((?:\w+, )?"([\w -]+)"')
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


def strict(text):
    """JSON without the constants that it does not have."""

    def refuse(name):
        raise ValueError(name)

    return json.loads(text, parse_constant=refuse)


def test_a_summary_of_rows_that_are_not_finite_is_json():
    columns = {"displacement_m": np.array([1e-3, 2e-3]), "std_m": np.array([np.inf, np.nan])}
    found = strict(summary(Chunk("p", "rows", np.array([BEGIN_NS, BEGIN_NS + 10**7]), columns, 1), "coasting"))
    assert (found["std_mm"], found["rows"], found["unit"]) == (None, 2, "mm")
    assert found["mean_mm"] == pytest.approx(1.5)


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
        until_s = time.monotonic() + 120.0
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


def documented(begin, end):
    """A part of live.md."""
    text = (Path(__file__).parents[2] / "docs" / "live.md").read_text(encoding="utf-8")
    return text.split(begin, 1)[1].split(end, 1)[0]


def test_the_documented_publisher_is_understood():
    names = {}
    exec(documented("```python\n", "```"), names)
    values = np.linspace(-1.0, 1.0, 20)
    found = parse(names["block"](7, BEGIN_NS, 10**7, values), ACCELERATION)
    assert (found.sequence, found.t0_ns, found.dt_ns) == (7, BEGIN_NS, 10**7)
    np.testing.assert_array_equal(found.values, values.astype(np.float32))
    assert parse(names["block"](2**32 + 1, BEGIN_NS, 10**8, values, kind=2), DISPLACEMENT).sequence == 1
    # As the shell writes it: date fills the stamp in.
    line = documented("  -m '", "'\n").replace("'$(date -u +%FT%T.%3NZ)'", "2026-11-22T10:00:00.123Z")
    found = parse(line.encode(), ACCELERATION)
    assert found.values.tolist() == [0.012, 0.013, 0.011]
    assert found.t0_ns % NANOSECONDS == 123_000_000


def test_the_documented_publisher_publishes(broker):
    names, came = {}, []
    exec(documented("```python\n", "```"), names)
    held = Broker(MqttSettings(port=broker), "site", {"acc": 1}, lambda _topic, payload, _kept: came.append(payload))
    held.start()

    blocks = iter(range(3))

    def read(count):
        # Ends with StopIteration once all of them came.
        number = next(blocks, None)
        if number is None:
            until(lambda: len(came) == 3)
            raise StopIteration
        return BEGIN_NS + number * 200_000_000, np.zeros(count)

    try:
        assert until(lambda: held.connected)
        time.sleep(0.5)
        with pytest.raises(StopIteration):
            names["publish"](read, "acc", port=broker)
    finally:
        held.stop()
    assert [parse(one, ACCELERATION).sequence for one in came] == [0, 1, 2]


def test_every_kind_of_event_is_in_the_documentation():
    text = documented("## Faults\n", "\n## ")
    given = {*filter(None, stream.KINDS), stream.CLOCK_SET, *EVENT_KINDS, "lost frames", "blocked", "hidden"}
    for room in ("service", "engine", "vision", "thermal"):
        for file in (Path(midspan.__file__).parent / room).rglob("*.py"):
            for found in EVENT.findall(file.read_text(encoding="utf-8")):
                given |= set(filter(None, found))
    assert {"returned", "gap", "lost_records", "shutter", "command"} <= given
    assert [kind for kind in sorted(given) if f"`{kind}`" not in text] == []


def until(condition, seconds=30.0):
    end_s = time.monotonic() + seconds
    while not condition() and time.monotonic() < end_s:
        time.sleep(0.02)
    return condition()


def test_a_wrong_password_is_no_broker_that_is_gone(mosquitto, tmp_path):
    mosquitto.stop()
    mosquitto.require("midspan", "right")
    mosquitto.start()
    refused = Broker(MqttSettings(port=mosquitto.port, user="midspan", password="wrong"), "a", {}, lambda *_: None)
    nobody = Broker(MqttSettings(port=mosquitto.port), "b", {}, lambda *_: None)
    known = Broker(MqttSettings(port=mosquitto.port, user="midspan", password="right"), "c", {}, lambda *_: None)
    for one in (refused, nobody, known):
        one.start()
    try:
        assert until(lambda: known.connected)
        for one in (refused, nobody):
            assert until(lambda one=one: one.reason == "unauthorized")
        # Neither the end of that connection nor the next attempt changes why.
        seen = set()
        until(lambda: seen.update((refused.reason, nobody.reason)), 3.0)
        assert seen == {"unauthorized"}
    finally:
        for one in (refused, nobody, known):
            one.stop()


@pytest.fixture
def certificate(tmp_path):
    """A function that makes NAME.pem and NAME.key for 127.0.0.1, which prove themselves."""
    openssl = shutil.which("openssl")
    if openssl is None:
        pytest.skip("openssl is not installed")

    def make(name):
        words = [openssl, "req", "-x509", "-newkey", "rsa:2048", "-nodes", "-days", "2", "-subj", f"/CN={name}"]
        files = ["-out", tmp_path / f"{name}.pem", "-keyout", tmp_path / f"{name}.key"]
        subprocess.run([*words, "-addext", "subjectAltName=IP:127.0.0.1", *files], check=True, capture_output=True)
        return tmp_path / f"{name}.pem", tmp_path / f"{name}.key"

    return make


# Paho leaves the socket of a handshake that failed to the garbage collector.
@pytest.mark.filterwarnings("ignore:unclosed:ResourceWarning", "ignore::pytest.PytestUnraisableExceptionWarning")
def test_over_tls_both_sides_prove_who_they_are(mosquitto, certificate, tmp_path):
    own, key = certificate("broker")
    certificate("other")
    mosquitto.stop()
    mosquitto.use_tls(own, own, key, ask=True)
    mosquitto.start()
    known, stranger, plain, unproved = (
        Broker(MqttSettings(port=mosquitto.port, **tls), name, {}, lambda *_: None, tmp_path)
        for name, tls in {
            "a": {"ca": "broker.pem", "cert": "broker.pem", "key": "broker.key"},
            "b": {"ca": "other.pem", "cert": "broker.pem", "key": "broker.key"},
            "c": {},
            "d": {"ca": "broker.pem"},
        }.items()
    )
    for one in (known, stranger, plain, unproved):
        one.start()
    try:
        assert until(lambda: known.connected)
        # Whose certificate is not proved by ca is not talked to.
        assert until(lambda: stranger.reason == "untrusted")
        time.sleep(1.0)
        assert not any(one.connected for one in (stranger, plain, unproved))
    finally:
        for one in (known, stranger, plain, unproved):
            one.stop()


def test_certificates_that_are_none_or_not_there_are_said(tmp_path):
    (tmp_path / "ca.pem").write_text("no certificate")
    with pytest.raises(UsageError, match="mqtt: ca, cert and key must be matching certificates"):
        Broker(MqttSettings(ca="ca.pem"), "a", {}, lambda *_: None, tmp_path)
    for wrong in ({"cert": "a.pem", "ca": "ca.pem"}, {"cert": "a.pem", "key": "a.key"}):
        with pytest.raises(ValueError, match="must have"):
            MqttSettings(**wrong)


def test_it_connects_again_within_two_seconds_of_the_brokers_return(mosquitto):
    broker = Broker(MqttSettings(port=mosquitto.port), "site", {}, lambda *_: None)
    broker.start()
    try:
        assert until(lambda: broker.connected)
        mosquitto.stop()
        assert until(lambda: broker.reason == "broker_gone")
        # Delays that double would come to an attempt 7 s after the end, 3 s from now.
        time.sleep(4.0)
        mosquitto.start()
        assert until(lambda: broker.connected, 2.0)
    finally:
        broker.stop()
