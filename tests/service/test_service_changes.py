"""Other settings while a site runs: what they leave as it is goes on, the rest begins, ends or is connected anew."""

import asyncio
import json
import os
import threading
import time
from contextlib import asynccontextmanager, suppress
from types import SimpleNamespace

import numpy as np
import pytest

from midspan.calibration.sensors.camera import CameraCalibration
from midspan.errors import DataError, UsageError
from midspan.records import NANOSECONDS, Region, ScaleFactor, TimeOffset
from midspan.service import beginning
from midspan.service.calibrations import accepted, added, number_in_force, settings_json
from midspan.service.changes import Changes
from midspan.service.checking import checked
from midspan.service.run import Service
from midspan.service.running import running
from midspan.settings.site import load_site
from midspan.settings.stored.calibration import Calibration
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
    assert Changes(("c",), ("a", "b"), ()).text == "Point c starts. Points a, b restart. The other points continue."
    assert Changes().text == "All points continue."


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


def test_the_newer_of_the_file_and_of_what_was_accepted_is_in_force(tmp_path):
    """Also over a restart: nobody's choice is undone silently."""
    plan = site_of(tmp_path, serial("a", 'calibration = "own.json"')).points[0]
    live = running(plan, tmp_path, tmp_path).live
    store, file = open_store(str(tmp_path / "store")), tmp_path / "own.json"

    def written(bias_m_s2, at_s):
        Calibration(1e-3, bias_m_s2).save(file)
        os.utime(file, (at_s, at_s))
        return number_in_force(live, store, tmp_path)

    now_s = time.time()
    assert written(0.0, now_s - 60.0) == 1
    body = json.dumps(Calibration(1e-3, 0.1).to_dict())
    offered = added(live, store, body, accept=False)
    assert number_in_force(live, store, tmp_path) == 1
    assert accepted(live, store, str(offered)) == offered == number_in_force(live, store, tmp_path)
    # Touched by nobody since; then people put the first one back into the file.
    assert written(0.0, now_s - 30.0) == offered
    assert written(0.0, now_s + 60.0) == 3
    assert store.calibration("a").number == 3
    store.close()


def calibration(direction="y", bias_m_s2=0.0, left_out=""):
    scale, region = ScaleFactor(1e-3, 1e-12), Region(0, 0, 64, 64)
    camera = CameraCalibration(scale, TimeOffset(0.0, 1e-6), region, direction, "template", 0.01, 1.0)
    return Calibration(1e-3, bias_m_s2, camera=camera, left_out=left_out)


def filmed(name, direction="y", more=""):
    """A point with a camera."""
    return f"""[[point]]
name = "{name}"
{more}
[point.accelerometer]
source = "serial:/dev/none/acc"
[point.camera]
source = "usb:97"
direction = "{direction}"
"""


def live_of(folder, text):
    return running(site_of(folder, text).points[0], folder / "captures", folder).live


def test_what_a_site_names_is_read_before_anything_ends(tmp_path):
    """The calibrations of all points, along their axes, and the broker's certificates."""
    named = serial("a", 'calibration = "own.json"')
    (tmp_path / "own.json").write_text("{")
    with pytest.raises(DataError, match=r"own\.json"):
        checked(site_of(tmp_path, named + serial("b")), ["b"])
    calibration(left_out="x").save(tmp_path / "one.json")
    point_across = site_of(tmp_path, filmed("a", "x", 'calibration = "one.json"'))
    with pytest.raises(DataError, match=r"one\.json"):
        checked(point_across, ["a"])
    assert len(checked(site_of(tmp_path, filmed("a", "y", 'calibration = "one.json"')), ["a"])) == 1
    replayed = serial("a").replace("serial:/dev/none/a/acc", "replay:nowhere")
    with pytest.raises(DataError, match="nowhere"):
        checked(site_of(tmp_path, replayed), ["a"])
    beyond = filmed("a", more='calibration = "one.json"').replace("direction", "roi = [130, 0, 64, 64]\ndirection")
    with pytest.raises(UsageError, match=r"a': camera.roi: must lie inside the image \(160 x 120 px\)"):
        checked(site_of(tmp_path, beyond), ["a"], {"usb:97": (160, 120)})
    with pytest.raises(UsageError, match="mqtt: ca, cert and key"):
        checked(site_of(tmp_path, '[mqtt]\nca = "missing.pem"\n' + serial("a")), [])


def test_a_calibration_that_is_damaged_on_the_way_leaves_the_one_in_force(tmp_path, monkeypatch):
    calibration().save(tmp_path / "own.json")
    text = filmed("a", more='calibration = "own.json"').replace("usb:97", "rtsp://127.0.0.1:9/none")
    events = []

    async def work():
        async with started(site_of(tmp_path, text)) as (service, task):
            monkeypatch.setattr(service, "_event", lambda one, kind, text: events.append((one.name, kind, text)))
            first = service._points[0]
            assert first.live.number == 1
            # Another calibration that was accepted since stays in force, as long as the file is as it was.
            later = json.dumps(calibration(bias_m_s2=0.1).to_dict())
            first.live.number = await service._in_thread(lambda *of: added(*of, accept=True), first.live, later)
            await service.take(site_of(tmp_path, text + ALARM))
            await until(lambda: not service.is_changing)
            assert (first.live.number, events) == (2, [])
            site = site_of(tmp_path, text)
            monkeypatch.setattr(
                "midspan.service.run.checked", lambda *_: (tmp_path / "own.json").write_text("{") and []
            )
            await service.take(site)
            await until(lambda: not service.is_changing)
            assert not task.done()
            assert [(name, kind) for name, kind, _ in events] == [("a", "calibration_refused")]
            assert "Calibration 2 stays in force" in events[0][2]

    asyncio.run(work())


def test_an_offer_of_another_axis_is_not_accepted(tmp_path):
    along, across = live_of(tmp_path, filmed("a", "y")), live_of(tmp_path, filmed("a", "x"))
    store = open_store(str(tmp_path / "store"))
    added(along, store, json.dumps(calibration().to_dict()), accept=False)
    assert accepted(across, store, "") is None
    assert accepted(across, store, "1") is None
    assert accepted(along, store, "1") == 1
    store.close()


@pytest.mark.parametrize(("direction", "resumes"), [("y", ["resumed"]), ("x", [])])
def test_a_point_along_another_axis_opens_anew(tmp_path, monkeypatch, direction, resumes):
    store, calls = open_store(str(tmp_path / "store")), []
    added(live_of(tmp_path, filmed("a", "y")), store, json.dumps(calibration().to_dict()), accept=True)
    calibration(direction, bias_m_s2=0.1).save(tmp_path / "own.json")
    site = site_of(tmp_path, filmed("a", direction, 'calibration = "own.json"'))
    one = running(site.points[0], tmp_path / "captures", tmp_path)
    (tmp_path / "captures" / "opening-1").mkdir(parents=True)
    (tmp_path / "captures" / "opening-1" / "recording.toml").write_text("")
    found = SimpleNamespace(point=SimpleNamespace(sensors={"camera": None}))
    monkeypatch.setattr(beginning, "head_of", lambda _kept: {"folder": "opening-1", "calibration": 1})
    monkeypatch.setattr(beginning, "opened", lambda *_, **__: found)
    monkeypatch.setattr(beginning, "resumed", lambda *_: None)
    monkeypatch.setattr(type(one.live), "resumed", lambda *_: calls.append("resumed"))
    monkeypatch.setattr(store, "checkpoint", lambda _name: (1, b""))
    beginning.begin(one, store, tmp_path, lambda _line: None)
    assert (calls, one.live.number) == (resumes, 2)
    store.close()


def test_what_comes_while_a_point_ends_is_that_of_the_next_one(tmp_path):
    """A camera needs seconds to end; blocks that come meanwhile are acknowledged."""
    text, numbers = "[mqtt]\nport = 9\n" + point("a"), iter(range(100))

    def sent(service):
        number = next(numbers)
        t0_ns = time.time_ns() + (number - 100) * 10**8
        block = Block(ACCELERATION, number, t0_ns, 10**7, np.zeros(10))
        service._taken("a/acc", pack(block), lambda: None)

    async def work():
        async with started(site_of(tmp_path, text)) as (service, _):
            first, stop, slow = service._points[0], service._intake.stop, asyncio.Event()

            async def stopped(unused):
                with suppress(TimeoutError):
                    await asyncio.wait_for(slow.wait(), 5.0)
                await stop(unused)

            service._intake.stop = stopped
            sent(service)
            await service.take(site_of(tmp_path, "[mqtt]\nport = 9\n" + point("a", 'method = "lag"')))
            await until(lambda: first.ended)
            for _ in range(3):
                sent(service)
            slow.set()
            await until(lambda: not service.is_changing)
            assert service._points[0] is not first
            records = [one.streams["accelerometer"].records for one in (first, service._points[0])]
            assert records == [1, 3]

    asyncio.run(work())


def test_alarms_watch_a_point_that_is_being_begun(tmp_path):
    async def work():
        async with started(site_of(tmp_path, serial("a") + ALARM)) as (service, _):
            looked = []
            service._alarms.look = lambda _now_ns, points: looked.append([one.name for one in points])
            service._points[0].beginning = True
            await until(lambda: looked)
            assert looked[0] == ["a"]
            service._points[0].beginning = False

    asyncio.run(work())


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
