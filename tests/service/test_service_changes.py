"""Other settings while a site runs: what they leave as it is goes on, the rest begins, ends or is connected anew."""

import asyncio
import json
import threading
import time
from contextlib import asynccontextmanager

import numpy as np
import pytest

from midspan.errors import DataError, UsageError
from midspan.records import NANOSECONDS
from midspan.service.calibrations import number_in_force, settings_json
from midspan.service.changes import Changes
from midspan.service.run import Service
from midspan.service.running import running
from midspan.settings.site import load_site
from midspan.sources.live.blocks import ACCELERATION, Block, pack
from midspan.store.store import open_store

HEAD = 'name = "site"\n[store]\npath = "store"\n'
POINT = """[[point]]
name = "{name}"
{more}
[point.accelerometer]
source = "{scheme}{name}/acc"
[point.displacement]
source = "{scheme}{name}/dis"
unit = "mm"
"""
ALARM = '[[point.alarm]]\nname = "off"\non = "silent"\ndelay_s = 30.0\n'


def point(name, more="", scheme="mqtt:"):
    return POINT.format(name=name, more=more, scheme=scheme)


def serial(name, more=""):
    return point(name, more, "serial:/dev/none/")


def site_of(folder, text):
    (folder / "SITE.toml").write_text(HEAD + text)
    return load_site(folder / "SITE.toml")


@asynccontextmanager
async def started(site):
    """A service that runs, and the task that it runs in."""
    service = Service(site, lambda _line: None)
    task = asyncio.ensure_future(service.run())
    try:
        await until(lambda: service.begun or task.done())
        yield service, task
    finally:
        service.stop()
        await asyncio.gather(task, return_exceptions=True)


async def until(condition, seconds=30.0):
    end_s = time.monotonic() + seconds
    while not (value := condition()):
        assert time.monotonic() < end_s
        await asyncio.sleep(0.02)
    return value


def test_changes_are_those_of_what_measures(tmp_path):
    both = site_of(tmp_path, serial("a") + serial("b"))
    assert Changes.between(None, both) == Changes(added=("a", "b"))
    assert Changes.between(both, both) == Changes()
    for text, changes in (
        (serial("b") + serial("a"), Changes()),
        (serial("a") + ALARM + serial("b"), Changes()),
        (serial("a", 'method = "lag"') + serial("b"), Changes(changed=("a",))),
        (serial("a") + serial("b").replace("mm", "m"), Changes(changed=("b",))),
        (serial("c") + serial("b"), Changes(added=("c",), removed=("a",))),
    ):
        assert Changes.between(both, site_of(tmp_path, text)) == changes
    # Captured recordings in another folder are other ones.
    moved = load_site(write(tmp_path, HEAD + 'captures = "elsewhere"\n' + serial("a")))
    assert Changes.between(site_of(tmp_path, serial("a")), moved) == Changes(changed=("a",))
    assert Changes(("c",), ("a", "b"), ()).text == "c: begins. a, b: begins anew. The other points go on."
    assert Changes().text == "All points go on."


def write(folder, text):
    (folder / "SITE.toml").write_text(text)
    return folder / "SITE.toml"


def test_what_cannot_be_run_changes_nothing(tmp_path):
    one = site_of(tmp_path, serial("a"))
    taken = open_store(str(tmp_path / "store"), points=["b"])

    async def work():
        async with started(one) as (service, _):
            before = list(service._points)
            with pytest.raises(UsageError, match="another process writes the point 'b'"):
                await service.take(site_of(tmp_path, serial("a") + serial("b")))
            with pytest.raises(DataError, match=r"none\.json"):
                await service.take(site_of(tmp_path, serial("a", 'calibration = "none.json"')))
            assert service._points == before
            assert service.site is one
            assert not service.is_changing
            taken.close()
            await service.take(site_of(tmp_path, serial("a") + serial("b")))
            await until(lambda: not service.is_changing)
            assert service._points[0] is before[0]
            assert [running.name for running in service._points] == ["a", "b"]

    asyncio.run(work())


def test_what_fails_on_the_way_ends_the_run(tmp_path, monkeypatch):
    """Whoever runs the service falls back to what ran before."""
    one = site_of(tmp_path, serial("a"))

    async def work():
        async with started(one) as (service, task):

            def broken(_one, _store):
                raise DataError("the point cannot begin")

            monkeypatch.setattr(service, "_begin_from", broken)
            await service.take(site_of(tmp_path, serial("a") + serial("b")))
            await until(task.done)
            with pytest.raises(DataError, match="cannot begin"):
                task.result()

    asyncio.run(work())


def test_a_point_that_cannot_begin_is_missed(tmp_path, monkeypatch):
    """While the store is away, for example: that it gives no rows, and that its sensors are silent, is an alarm."""
    one = site_of(tmp_path, serial("a") + ALARM.replace("30.0", "0.2"))
    end = threading.Event()

    async def work():
        async with started(one) as (service, _):
            monkeypatch.setattr(service, "_begin_from", lambda _one, _store: end.wait(30.0))
            await service.take(site_of(tmp_path, serial("a", 'method = "lag"') + ALARM.replace("30.0", "0.2")))
            await until(lambda: service._points[0].beginning)
            await until(service._alarms._watch.trees, 5.0)
            assert service._points[0].beginning
            end.set()

    asyncio.run(work())


def test_a_calibration_of_other_sensors_is_not_in_force(tmp_path):
    live = running(site_of(tmp_path, serial("a")).points[0], tmp_path, tmp_path).live
    with_camera = serial("a") + '[point.camera]\nsource = "usb:0"\ndirection = "y"\n'
    other = running(site_of(tmp_path, with_camera).points[0], tmp_path, tmp_path).live
    store = open_store(str(tmp_path / "store"))
    store.add_calibration("a", 1, "{}", settings_json(live.settings, {}), accept=True)
    assert (number_in_force(live, store, tmp_path), number_in_force(other, store, tmp_path)) == (1, 0)
    store.close()


def test_topics_and_broker_follow_the_settings(tmp_path, broker):
    import paho.mqtt.client as mqtt

    came, client = {}, mqtt.Client(mqtt.CallbackAPIVersion.VERSION2, client_id="other")
    client.on_message = lambda _client, _data, message: came.setdefault(message.topic, []).append(message.payload)
    client.connect("127.0.0.1", broker)
    client.subscribe("+/v1/#", qos=1)
    client.loop_start()
    broker_of = f"[mqtt]\nport = {broker}\n"
    numbers = iter(range(1000))

    def send(name):
        number = next(numbers)
        t0_ns = time.time_ns() - NANOSECONDS + 200_000_000 * number
        client.publish(f"{name}/acc", pack(Block(ACCELERATION, number, t0_ns - 60 * NANOSECONDS, 10**7, np.zeros(20))))

    async def counted(service, name):
        """The records of a point, once one more has come."""
        stream = next(one for one in service._points if one.name == name).streams["accelerometer"]
        before = stream.records
        send(name)
        await until(lambda: stream.records > before)
        return stream.records

    async def work():
        async with started(site_of(tmp_path, broker_of + point("a") + point("b"))) as (service, _):
            await until(lambda: service._broker.connected)
            assert [await counted(service, "a") for _ in range(3)] == [1, 2, 3]
            first = service._broker
            await service.take(site_of(tmp_path, broker_of + point("a") + point("c", 'method = "lag"')))
            # What comes while a point is begun is its own afterwards.
            send("c")
            await until(lambda: not service.is_changing)
            assert service._broker is first
            assert await counted(service, "a") == 4
            assert await counted(service, "c") >= 1
            before = [one.streams["accelerometer"].records for one in service._points]
            send("b")
            await asyncio.sleep(0.3)
            assert [one.streams["accelerometer"].records for one in service._points] == before
            # Another prefix is another connection.
            other = f'{broker_of}prefix = "other"\n' + point("a") + point("c", 'method = "lag"')
            await service.take(site_of(tmp_path, other))
            await until(lambda: not service.is_changing and service._broker.connected)
            assert await counted(service, "a") == 5
            await until(lambda: came.get("other/v1/site/available") == [b"online"])
            assert came["midspan/v1/site/available"] == [b"online", b"offline"]
            state = await until(lambda: came.get("other/v1/site/a/state"))
            assert json.loads(state[-1])["sources"][0]["records"] == 5
            # Without one it is left.
            await service.take(site_of(tmp_path, serial("a")))
            await until(lambda: not service.is_changing)
            assert service._broker is None

    try:
        asyncio.run(work())
    finally:
        client.disconnect()
        client.loop_stop()
