"""A live site as a process, on a real broker: it calibrates itself, runs, is killed, and goes on without a lost row."""

import asyncio
import itertools
import json
import signal
import socket
import subprocess
import threading
import time
import urllib.error
import urllib.request

import numpy as np
import pytest
from benchmarks.live.servers import command, free_port

import midspan.service.run
from midspan.errors import UntrustedError
from midspan.records import NANOSECONDS
from midspan.service.point import Job
from midspan.service.run import Service
from midspan.service.stored_recording import stored_table
from midspan.settings.site import load_site
from midspan.sources.live.blocks import ACCELERATION, DISPLACEMENT, RESULT, Block, pack, parse
from midspan.sources.live.camera import StampKind, frames
from midspan.sources.live.instants import SourceFault
from midspan.store.store import Batch, open_store

# The structure's motion: (mm, Hz, rad).
MOTION = ((3.0, 1.3, 0.0), (2.0, 0.6, 1.0), (1.0, 2.9, 0.0))
NOISE_MM, NOISE_M_S2 = 0.1, 2e-3
# This many seconds of records come in a second, which is no matter to the engine; LATER_S: records after the restart.
FASTER, BLOCK_S, LATER_S = 4.0, 0.2, 20.0
SITE = """
name = "site"
[store]
path = "store"
[mqtt]
port = {broker}
[service]
listen = "127.0.0.1:{web}"
[[point]]
name = "p"
calibration_s = 15
[point.accelerometer]
source = "mqtt:b/acceleration"
unit = "m/s^2"
[point.displacement]
source = "mqtt:b/displacement"
unit = "mm"
"""


def moved_mm(time_s):
    return sum(a * np.sin(2 * np.pi * f * time_s + p) for a, f, p in MOTION)


def accelerated_m_s2(time_s):
    return -1e-3 * sum(a * (2 * np.pi * f) ** 2 * np.sin(2 * np.pi * f * time_s + p) for a, f, p in MOTION)


def send(port, begin_ns, ending, sent):
    """Publish records as sensors would, but sooner, until the end is asked for; `sent` gets the number of blocks."""
    import paho.mqtt.client as mqtt

    rng, begun_s = np.random.default_rng(0), time.monotonic()
    client = mqtt.Client(mqtt.CallbackAPIVersion.VERSION2, client_id="sensors")
    client.max_queued_messages_set(0)
    client.connect("127.0.0.1", port)
    client.loop_start()
    for number in itertools.count():
        if ending.is_set():
            break
        fast, slow = (BLOCK_S * number + step * np.arange(round(BLOCK_S / step)) for step in (0.01, 0.1))
        t0_ns = begin_ns + round(BLOCK_S * number * NANOSECONDS)
        acceleration = accelerated_m_s2(fast) + rng.normal(0, NOISE_M_S2, len(fast))
        displacement = moved_mm(slow) + rng.normal(0, NOISE_MM, len(slow))
        client.publish("b/acceleration", pack(Block(ACCELERATION, number, t0_ns, 10**7, acceleration)), qos=1)
        client.publish("b/displacement", pack(Block(DISPLACEMENT, number, t0_ns, 10**8, displacement)), qos=1)
        time.sleep(max(begun_s + BLOCK_S * (number + 1) / FASTER - time.monotonic(), 0.0))
    sent.append(number)
    time.sleep(1.0)
    client.disconnect()
    client.loop_stop()


def listened(port):
    """All that a site publishes, by its topic."""
    import paho.mqtt.client as mqtt

    seen = {}
    client = mqtt.Client(mqtt.CallbackAPIVersion.VERSION2, client_id="listener")
    client.on_message = lambda _client, _data, message: seen.setdefault(message.topic, []).append(message.payload)
    client.connect("127.0.0.1", port)
    client.subscribe("midspan/#", qos=1)
    client.loop_start()
    return client, seen


def ready(port):
    """Status and document of /readyz; None while nothing answers."""
    try:
        with urllib.request.urlopen(f"http://127.0.0.1:{port}/readyz", timeout=30) as answer:
            return answer.status, json.loads(answer.read())
    except urllib.error.HTTPError as error:
        return error.code, json.loads(error.read())
    except OSError:
        return None


def until(condition, seconds=300.0):
    """Wait for a condition; its value."""
    until_s = time.monotonic() + seconds
    while time.monotonic() < until_s:
        if value := condition():
            return value
        time.sleep(0.1)
    raise TimeoutError


def service_of(folder, count):
    """A service of this many points whose sources do not exist."""
    point = '[[point]]\nname = "p{}"\n[point.accelerometer]\nsource = "{}"\n[point.displacement]\nsource = "{}"\n'
    points = "".join(point.format(k, "serial:/dev/none", "serial:/dev/nothing") for k in range(count))
    (folder / "SITE.toml").write_text('name = "site"\n[store]\npath = "store"\n' + points)
    return Service(load_site(folder / "SITE.toml"), lambda _line: None)


def test_a_site_runs_is_killed_and_loses_nothing(broker, tmp_path):
    web = free_port()
    (tmp_path / "SITE.toml").write_text(SITE.format(broker=broker, web=web))
    listener, seen = listened(broker)
    start = lambda: subprocess.Popen(command("run", tmp_path / "SITE.toml"), cwd=tmp_path)  # noqa: E731
    process = start()
    status, first = until(lambda: ready(web))
    assert status == 503
    assert {one["reason"] for one in first["sources"] if one["point"]} == {"starting"}
    begin_ns = (time.time_ns() // NANOSECONDS - 3000) * NANOSECONDS
    ending, sent = threading.Event(), []
    sender = threading.Thread(target=send, args=(broker, begin_ns, ending, sent))
    sender.start()
    until(lambda: "midspan/v1/site/p/displacement" in seen)
    # After a checkpoint, and in the middle of a second.
    until(lambda: kept(tmp_path))
    time.sleep(0.6)
    process.kill()
    process.wait(timeout=60)
    process = start()
    until(lambda: (ready(web) or (0,))[0] == 200)
    time.sleep(LATER_S / FASTER)
    ending.set()
    sender.join(timeout=120)
    length_s = BLOCK_S * sent[0]
    until(lambda: newest_s(tmp_path, begin_ns) > length_s - 0.5)
    process.send_signal(signal.SIGTERM)
    assert process.wait(timeout=120) == 0
    listener.disconnect()
    listener.loop_stop()
    table = check_rows(tmp_path, begin_ns, length_s)
    check_messages(seen, table)


def kept(folder):
    """The newest checkpoint; None before there is one."""
    store = open_store(folder / "store", read_only=True)
    try:
        return store.checkpoint("p")
    finally:
        store.close()


def newest_s(folder, begin_ns):
    """The newest row's place in the records, s."""
    store = open_store(folder / "store", read_only=True)
    newest_ns = store.newest_ns("p", "rows") or 0
    store.close()
    return (newest_ns - begin_ns) / NANOSECONDS


def check_rows(folder, begin_ns, length_s):
    """Raw records and rows are there once each, and the band holds."""
    store = open_store(folder / "store", read_only=True)
    raw = np.concatenate([one.time_ns for one in store.chunks("p", "accelerometer", 0, 2**62)])
    np.testing.assert_array_equal(raw, begin_ns + 10**7 * np.arange(round(100 * length_s)))
    table = stored_table(store, "p", None, None)
    assert set(np.diff(table.time_ns)) == {10**7}
    assert table.time_ns[-1] >= begin_ns + round((length_s - 0.5) * NANOSECONDS)
    assert len(table.time_ns) > 100 * 15
    error = table.columns["displacement_mm"] - moved_mm((table.time_ns - begin_ns) / NANOSECONDS)
    assert np.mean(np.abs(error) < 1.96 * table.columns["displacement_std_mm"]) > 0.85
    assert np.abs(error / table.columns["displacement_std_mm"]).max() < 6.0
    kinds = {event.kind for event in store.events("p", 0, 2**62)}
    assert "calibrated" in kinds
    assert "lost_records" not in kinds
    assert [one.state for one in store.calibrations("p")] == ["in force"]
    store.close()
    return table


def check_messages(seen, table):
    """What was published is as documented, and in the units of the rows that are kept."""
    root = "midspan/v1/site"
    assert seen[f"{root}/available"][0] == b"online"
    assert seen[f"{root}/available"][-1] == b"offline"
    blocks = [parse(payload, RESULT) for payload in seen[f"{root}/p/displacement"]]
    last = blocks[-1]
    kept = np.searchsorted(table.time_ns, last.time_ns)
    np.testing.assert_array_equal(table.time_ns[kept], last.time_ns)
    for name, sent in (("displacement_mm", last.values), ("displacement_std_mm", last.std)):
        np.testing.assert_allclose(sent, np.asarray(table.columns[name])[kept], rtol=1e-6, atol=1e-6)
    state = json.loads(seen[f"{root}/p/state"][-1])
    assert state["calibration"] == 1
    assert {one["source"] for one in state["sources"]} == {"accelerometer", "displacement"}
    assert json.loads(seen[f"{root}/p/summary"][-1])["unit"] == "mm"


def test_frames_of_a_network_camera_have_the_senders_stamps(rtsp, monkeypatch):
    # On a busy machine the sender's own reports disagree by milliseconds for longer than a camera's would.
    monkeypatch.setattr("midspan.sources.live.camera.REPORT_S", 300.0)
    rng = np.random.default_rng(0)
    film = rng.integers(60, 200, (20, 48, 64), dtype=np.uint8)
    address, found = rtsp(film, 20).address, []
    for stamped in frames(address):
        found.append(stamped)
        if len(found) == 40:
            break
    # Those before the sender said what its clock shows are left out.
    assert {one.kind for one in found} == {StampKind.SENDER}
    stamps = np.array([one.frame.time_ns for one in found])
    assert found[0].frame.pixels.shape == (48, 64)
    # The sender's frames come every 50 ms; its own timer is late by milliseconds where the machine is busy.
    assert np.median(np.diff(stamps)) / 1e6 == pytest.approx(50.0, abs=5.0)
    assert abs(time.time_ns() - stamps[-1]) < 5 * NANOSECONDS
    assert np.mean(np.abs(np.diff(film.astype(float), axis=0))) > 20
    apart = [np.mean(np.abs(one.frame.pixels.astype(float) - film[k])) for one in found[-3:] for k in range(20)]
    assert min(apart) < 12.0


def test_a_camera_that_is_not_there_says_why(rtsp):
    address = rtsp(np.zeros((2, 48, 64), dtype=np.uint8), 10).address
    for wrong, code in (
        (address.replace("/cam", "/none"), "not_found"),
        (f"rtsp://127.0.0.1:{free_port()}/x", "refused"),
    ):
        with pytest.raises(SourceFault) as fault:
            next(frames(wrong))
        assert fault.value.code == code


def test_a_camera_that_accepts_and_is_silent_is_given_up():
    with socket.create_server(("127.0.0.1", 0)) as server:
        begun_s = time.monotonic()
        with pytest.raises(SourceFault) as fault:
            next(frames(f"rtsp://127.0.0.1:{server.getsockname()[1]}/cam"))
        assert fault.value.code == "no_answer"
        # Three seconds to open it and three to read; a busy machine takes its time.
        assert time.monotonic() - begun_s < 60.0


def test_what_fails_unexpectedly_ends_the_service(tmp_path):
    """A service that keeps nothing any more, or publishes nothing, must not live on as if it did."""
    (tmp_path / "SITE.toml").write_text(
        f'name = "site"\n[store]\npath = "store"\n[service]\nlisten = "127.0.0.1:{free_port()}"\n[[point]]\n'
        'name = "p"\n[point.accelerometer]\nsource = "serial:/dev/none"\n'
        '[point.displacement]\nsource = "serial:/dev/nothing"\n'
    )
    service = Service(load_site(tmp_path / "SITE.toml"), lambda _line: None)
    service._keeper.write = lambda: 1 // 0
    with pytest.raises(ZeroDivisionError):
        asyncio.run(asyncio.wait_for(service.run(), 120.0))


def test_one_calibration_at_a_time(tmp_path, monkeypatch):
    """Points that begin together would otherwise calibrate together, and leave the engine no processor."""
    counts = []

    async def calibrated(_folder):
        counts.append(1)
        await asyncio.sleep(0.01)
        counts.append(-1)
        raise UntrustedError("Too little motion.")

    monkeypatch.setattr(midspan.service.run, "calibrated_folder", calibrated)
    service = service_of(tmp_path, 4)

    async def all_at_once():
        job = Job("calibrate", tmp_path)
        await asyncio.gather(*(service._work(one, job) for one in service._points))

    asyncio.run(all_at_once())
    assert max(itertools.accumulate(counts)) == 1
    assert len(counts) == 8


def test_points_go_on_side_by_side(tmp_path, monkeypatch):
    """Each reads its checkpoint and what was kept since: one after the other a site of many would take minutes."""
    meeting = threading.Barrier(3, timeout=60.0)
    monkeypatch.setattr(Service, "_begin_from", lambda _self, _one, _store: meeting.wait())
    service = service_of(tmp_path, 3)
    asyncio.run(asyncio.wait_for(service.run(0.2), 120.0))
    assert service.begun


def test_a_damaged_checkpoint_lets_its_point_open_anew(tmp_path):
    lines = []
    service = service_of(tmp_path, 1)
    service._say = lines.append
    (name,) = (one.name for one in service._points)
    store = open_store(service.site.store)
    store.write(Batch(checkpoints={name: (1, [b"a", b"b"])}))
    store.checkpoints.execute("DELETE FROM part")
    store.close()
    asyncio.run(asyncio.wait_for(service.run(0.2), 120.0))
    assert service.begun
    assert [line for line in lines if "checkpoint" in line and "is damaged; the point restarts" in line]


def test_every_command_is_answered_at_once(tmp_path):
    (tmp_path / "SITE.toml").write_text(
        'name = "site"\n[store]\npath = "store"\n[mqtt]\n[[point]]\nname = "p"\n'
        '[point.accelerometer]\nsource = "mqtt:a"\n[point.displacement]\nsource = "mqtt:d"\n'
    )
    service = Service(load_site(tmp_path / "SITE.toml"), lambda _line: None)
    answers, acknowledged = [], []

    class Recorder:
        def publish(self, topic, payload):
            answers.append((topic, json.loads(payload)["kind"], json.loads(payload)["text"]))

    service._broker = Recorder()

    async def commanded(place, payload=b""):
        service._loop = asyncio.get_running_loop()
        service._taken(f"midspan/v1/site/{place}", payload, lambda: acknowledged.append(place))
        await asyncio.gather(*service._jobs)
        return answers.pop()

    asked = {
        "p/cmd/calibrate": ("p/event", "p: records 60 s for a new calibration."),
        "p/cmd/accept": ("p/event", "p: no calibration 7 is offered."),
        "p/cmd/nonsense": ("p/event", "p: cmd/nonsense is not a command. Commands: calibrate, accept."),
        "q/cmd/calibrate": ("q/event", "q: is not a point of this site. Points: p."),
    }
    for place, (topic, text) in asked.items():
        assert asyncio.run(commanded(place, b"7")) == (topic, "command", text)
    assert acknowledged == list(asked)
    assert answers == []
