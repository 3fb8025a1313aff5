"""Several points on one source: it is opened once, and each point gets the records that it would get alone."""

import asyncio
import json
import os
import time
from dataclasses import dataclass, field
from multiprocessing import Pipe

import numpy as np
import pytest

from midspan.errors import UsageError
from midspan.records import NANOSECONDS, Arrival, Frame, RangeFrame, Region
from midspan.service import intake
from midspan.service.camera_process import CameraProcess, _Sender
from midspan.service.cutting import part_of, whole_frame
from midspan.service.intake import Intake
from midspan.service.running import running
from midspan.settings.site import PointPlan, load_site
from midspan.sources.live.camera import Stamped, StampKind
from radar_recordings import PLATE, Case, write

HEAD = 'name = "site"\n[store]\npath = "store"\n[mqtt]\n'
POINT = """
[[point]]
name = "{name}"
[point.accelerometer]
source = "{accelerometer}"
[point.{kind}]
source = "{source}"
{more}
"""
REGIONS = {"a": Region(2, 4, 12, 10), "b": Region(16, 8, 20, 16), "c": Region(16, 8, 20, 16)}
FRAMES, SHAPE = 100, (32, 40)


@dataclass
class Taker:
    """Stands for a point's engine: keeps what it is given."""

    plan: PointPlan
    arrivals: list[Arrival] = field(default_factory=list)
    opened: None = None

    @property
    def name(self):
        return self.plan.name

    def push(self, arrival):
        self.arrivals.append(arrival)

    def of(self, stream):
        return [one.record for one in self.arrivals if one.stream == stream]


def points_of(folder, names, **source):
    """The points of a site that all have the same sources."""
    (folder / "SITE.toml").write_text(HEAD + "".join(POINT.format(name=name, **source) for name in names))
    found = []
    for plan in load_site(folder / "SITE.toml").points:
        found.append(running(plan, folder / plan.name, folder))
        found[-1].live = Taker(plan)
    return found


def intake_of(points, folder):
    return Intake(points, folder, lambda _one: None, lambda _one, _kind, _text: None)


async def taken_in(one, points, done, seconds=30.0):
    """Let an intake work until a condition holds."""
    one.start_cameras(points)
    for point in points:
        for name, feed in point.cameras.items():
            assert name == "camera"
            feed.cut(REGIONS[point.name])
    one.begin(points)
    opened, until_s = dict(one._sources), time.monotonic() + seconds
    while not done() and time.monotonic() < until_s:
        await asyncio.sleep(0.02)
    await one.end(points)
    assert not one._sources
    return opened


@pytest.fixture
def film(tmp_path):
    """A recording of ten seconds whose every frame is another one."""
    folder, rng = tmp_path / "recording", np.random.default_rng(0)
    folder.mkdir()
    time_s = np.arange(0.0, 10.0, 0.01)
    np.savez(folder / "accel.npz", time_s=time_s, accel=rng.normal(0.0, 1.0, len(time_s)))
    frames = rng.integers(0, 255, (FRAMES, *SHAPE), dtype=np.uint8)
    np.save(folder / "camera.npy", frames)
    np.savez(folder / "times.npz", time_s=0.1 * np.arange(FRAMES))
    (folder / "recording.toml").write_text(
        '[accelerometer]\nfile = "accel.npz"\nunit = "m/s^2"\n[camera]\nfile = "camera.npy"\ntimes = "times.npz"\n'
    )
    return frames


def test_points_on_one_camera_get_what_each_would_get_alone(film, tmp_path, monkeypatch):
    monkeypatch.setattr(intake, "REPLAY_AFTER_S", 2.0)
    source = {"kind": "camera", "accelerometer": "replay:recording", "source": "replay:recording", "more": ""}
    points = points_of(tmp_path, "abc", **source)
    first, second, third = points
    third.streams["camera"].paused = "taken down"
    one, cut = intake_of(points, tmp_path), []

    def done():
        # In the middle one point is calibrated anew, for which it needs whole frames, and another one leaves.
        if not cut and len(first.live.of("camera")) >= 5:
            cut.append(first.cameras["camera"].cut(None))
            third.cameras["camera"].leave()
        # A frame that is on its way is cut as before.
        enough = all(len(point.live.of("camera")) > 5 for point in (first, second))
        return enough and is_whole(first.live.of("camera")[-1])

    opened = asyncio.run(taken_in(one, points, done))
    (at,) = (at for at, source in opened.items() if isinstance(source.reader, CameraProcess))
    begin_ns = int(at.rpartition("@")[2].partition("#")[0])
    stamps = [np.concatenate([part.time_ns for part in point.live.of("accelerometer")]) for point in points]
    for own in stamps:
        np.testing.assert_array_equal(own, begin_ns + 10**7 * np.arange(len(stamps[0])))
    # Each frame is in its place with what the point needs of it, bit for bit; a busy machine may miss some.
    for point in (first, second):
        assert len(point.live.of("camera")) > 5
        for frame in point.live.of("camera"):
            whole = film[round((frame.time_ns - begin_ns) / 1e8)]
            expected = whole_frame(*part_of(whole, REGIONS[point.name]), SHAPE)
            if point is second or not is_whole(frame):
                np.testing.assert_array_equal(frame.pixels, expected)
            else:
                np.testing.assert_array_equal(frame.pixels, whole)
    assert not is_whole(first.live.of("camera")[0])
    assert is_whole(first.live.of("camera")[-1])
    # A pause is of one point alone.
    assert not third.live.of("camera")


def is_whole(frame):
    """Whether its corner was transmitted: around a part is its mean level."""
    return len(np.unique(frame.pixels[:2])) > 1


def test_a_point_that_leaves_lets_the_others_go_on(tmp_path):
    points = points_of(tmp_path, "ab", kind="displacement", accelerometer="mqtt:x", source="mqtt:y", more="")
    one = intake_of(points, tmp_path)
    payload = json.dumps({"sequence": 0, "t0": 1_790_000_000 * NANOSECONDS, "dt_s": 0.1, "values": [1.0]}).encode()
    asyncio.run(one.end(points[:1]))
    one.payload("x", payload)
    assert [len(point.live.of("accelerometer")) for point in points] == [0, 1]
    # One that joins later gets what comes from then on.
    one.join(points[:1])
    one.payload("x", payload.replace(b"0,", b"1,", 1))
    assert [len(point.live.of("accelerometer")) for point in points] == [1, 2]
    asyncio.run(one.end(points))
    assert not one.topics


def test_a_part_that_two_points_need_leaves_the_process_once():
    here, there = Pipe()
    sender = _Sender(there, {0: REGIONS["b"], 1: REGIONS["c"], 2: None})
    pixels = np.random.default_rng(0).integers(0, 255, SHAPE, dtype=np.uint8)
    sender.give(Stamped(Frame(1, pixels, 0), StampKind.SENDER))
    assert here.poll(10.0)
    item = here.recv()
    assert sorted(item) == [0, 1, 2]
    assert item[0].part is item[1].part
    np.testing.assert_array_equal(item[0].part, pixels[8:24, 16:36])
    np.testing.assert_array_equal(item[2].part, pixels)
    here.close()


def test_two_points_on_a_serial_line_get_every_block(tmp_path):
    pytest.importorskip("serial")
    master, slave = os.openpty()
    device = os.ttyname(slave)
    points = points_of(tmp_path, "ab", accelerometer=f"serial:{device}", kind="displacement", source="mqtt:x", more="")
    one, sent = intake_of(points, tmp_path), 0
    begin_ns = time.time_ns() - 100 * NANOSECONDS

    def done():
        nonlocal sent
        # The first line may be cut off.
        if sent < 30:
            block = {"sequence": sent, "t0": begin_ns + sent * NANOSECONDS, "dt_s": 0.1, "values": [float(sent)] * 10}
            os.write(master, json.dumps(block).encode() + b"\n")
            sent += 1
        return all(len(point.live.of("accelerometer")) >= 25 and sent == 30 for point in points)

    opened = asyncio.run(taken_in(one, points, done, 10.0))
    os.close(master)
    os.close(slave)
    assert len([source for source in opened.values() if source.reader is not None]) == 1
    first, second = ([r.value[0, 0] for r in point.live.of("accelerometer")] for point in points)
    assert first == second
    assert len(first) >= 25
    assert set(np.diff(first)) == {1.0}


def test_two_points_on_a_radar_share_its_port(tmp_path, monkeypatch):
    opened = []

    def profiles(address, _layout, _ended):
        opened.append(address)
        while True:
            time.sleep(0.01)
            yield RangeFrame(time.time_ns(), np.zeros((2, 8), dtype=np.complex64), np.ones(2, dtype=np.bool_))

    monkeypatch.setattr(intake, "profiles", profiles)
    write(tmp_path, Case((PLATE,), frames=2))
    source = {"kind": "radar", "accelerometer": "mqtt:x", "source": "udp:4098", "more": 'config = "radar.cfg"'}
    points = points_of(tmp_path, "ab", **source)
    one = intake_of(points, tmp_path)
    asyncio.run(taken_in(one, points, lambda: len(points[1].live.arrivals) >= 5))
    assert opened == [":4098"]
    first, second = ([r.time_ns for r in point.live.of("radar")] for point in points)
    assert first == second


@pytest.mark.parametrize(
    ("ours", "theirs", "words"),
    [
        ("serial:/dev/x@9600", "serial:/dev/x", "serial:/dev/x is opened once and needs the same settings"),
        ("serial:/dev/x", "serial:/dev/x@115200", ""),
    ],
)
def test_a_line_is_opened_in_one_way(tmp_path, ours, theirs, words):
    more = {"kind": "displacement", "source": "mqtt:x", "more": ""}
    text = POINT.format(name="a", accelerometer=ours, **more) + POINT.format(name="b", accelerometer=theirs, **more)
    (tmp_path / "SITE.toml").write_text(HEAD + text)
    if not words:
        assert len(load_site(tmp_path).points) == 2
        return
    with pytest.raises(UsageError, match=f"point 'b': accelerometer.source: {words}"):
        load_site(tmp_path)


def test_a_line_brings_one_kind_of_values(tmp_path):
    point = POINT.format(name="a", accelerometer="serial:/dev/x", kind="displacement", source="serial:/dev/x", more="")
    (tmp_path / "SITE.toml").write_text(HEAD + point)
    with pytest.raises(UsageError, match=r"received displacement at 115200 baud here and acceleration at 115200 baud"):
        load_site(tmp_path)
