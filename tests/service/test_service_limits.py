"""What comes over the network is bounded before it is read: connections, requests, messages."""

import asyncio
import json
import resource
import socket
import time

import pytest

from midspan.service import web as connection
from midspan.service.mqtt import Broker
from midspan.service.web import application, server
from midspan.settings.site import MqttSettings
from midspan.sources.live.blocks import ACCELERATION, MAX_BYTES, parse
from midspan.sources.live.instants import SourceFault

HALF = b"GET /readyz HTTP/1.1\r\nHost: x\r\n"


async def answered(port):
    """The status line of a whole request."""
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    writer.write(b"GET /healthz HTTP/1.1\r\nHost: x\r\nConnection: close\r\n\r\n")
    line = await asyncio.wait_for(reader.read(), 30.0)
    writer.close()
    return line.split(b"\r\n", 1)[0]


async def served(check):
    """Run a check against the web application, which is ready and has no figures."""
    with socket.create_server(("127.0.0.1", 0)) as listener:
        web = server(application(lambda: {"ready": True, "sources": []}, lambda: ""))
        task = asyncio.create_task(web.serve(sockets=[listener]))
        try:
            return await check(listener.getsockname()[1])
        finally:
            web.should_exit = True
            await asyncio.wait_for(task, 30.0)


def test_half_requests_are_ended_and_whole_ones_answered(monkeypatch):
    monkeypatch.setattr(connection, "REQUEST_S", 1.0)

    async def check(port):
        begun_s = time.monotonic()
        halves = [await asyncio.open_connection("127.0.0.1", port) for _ in range(50)]
        for _, writer in halves:
            writer.write(HALF)
        assert await answered(port) == b"HTTP/1.1 200 OK"
        # Each is ended by the server; the test's own limit is what a busy machine may take.
        for reader, _ in halves:
            assert await asyncio.wait_for(reader.read(), 30.0) == b""
        assert time.monotonic() - begun_s >= 1.0
        for _, writer in halves:
            writer.close()

    asyncio.run(served(check))


def test_a_request_whose_body_does_not_come_is_ended(monkeypatch):
    monkeypatch.setattr(connection, "REQUEST_S", 1.0)

    async def check(port):
        reader, writer = await asyncio.open_connection("127.0.0.1", port)
        writer.write(b"POST /healthz HTTP/1.1\r\nHost: x\r\nContent-Length: 1000\r\n\r\nhalf")
        # It may be answered before, but is not held.
        assert b"200 OK" not in await asyncio.wait_for(reader.read(), 30.0)
        writer.close()

    asyncio.run(served(check))


def test_a_connection_that_asks_again_is_given_the_time_anew(monkeypatch):
    monkeypatch.setattr(connection, "REQUEST_S", 2.0)

    async def check(port):
        reader, writer = await asyncio.open_connection("127.0.0.1", port)
        for _ in range(4):
            writer.write(b"GET /healthz HTTP/1.1\r\nHost: x\r\n\r\n")
            assert b"200 OK" in await asyncio.wait_for(reader.readuntil(b"ok\n"), 30.0)
            await asyncio.sleep(0.8)
        writer.write(HALF)
        assert await asyncio.wait_for(reader.read(), 30.0) == b""
        writer.close()

    asyncio.run(served(check))


def test_many_half_requests_leave_the_service_its_descriptors():
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)

    async def check(port):
        used = len(asyncio.all_tasks())
        halves = []
        for _ in range(400):
            reader, writer = await asyncio.open_connection("127.0.0.1", port)
            writer.write(HALF)
            halves.append((reader, writer))
        # Those above the limit are ended at once: this end of them may be closed too.
        await asyncio.sleep(0.5)
        ended = sum(reader.at_eof() or reader.exception() is not None for reader, _ in halves)
        for _, writer in halves:
            writer.close()
        await asyncio.sleep(0.2)
        assert ended >= 400 - connection.MAX_CONNECTIONS
        assert len(asyncio.all_tasks()) <= used + 1
        assert await answered(port) == b"HTTP/1.1 200 OK"

    # Both ends of each connection are in this process.
    resource.setrlimit(resource.RLIMIT_NOFILE, (min(max(soft, 1024), hard), hard))
    try:
        asyncio.run(served(check))
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))


@pytest.mark.parametrize("begin", [b'{"sequence": 7, "values": [', b"\x01\x01\x00\x00"])
def test_a_payload_that_is_too_long_is_not_parsed(begin):
    payload = begin + b"1," * 10_000_000
    begun_s = time.process_time()
    with pytest.raises(SourceFault, match=f"{len(payload)} bytes; at most {MAX_BYTES} are taken") as fault:
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
        time.sleep(3.0)
        changes, before = 0, (first.connected, second.connected)
        for _ in range(80):
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
