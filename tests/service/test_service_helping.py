"""Live points with a sensor that helps others: it is calibrated and used like that of a file, and nothing waits for it
that can do without.
"""

import json
import shutil
from dataclasses import replace

import numpy as np
import pytest

import midspan
from lively_recordings import Lively, add_gyroscope, add_velocity, write
from midspan.cli.main import run
from midspan.engine.point import PointStatus
from midspan.records import NANOSECONDS, Arrival
from midspan.service.intake import Intake
from midspan.service.opening import checkpoint, opened, resumed
from midspan.service.point import Phase
from midspan.service.replay import replay
from midspan.service.replayed import readings
from midspan.service.running import running
from midspan.service.stored_recording import stored_table
from midspan.settings.site import load_site
from midspan.sources.live.blocks import VELOCITY, Block, pack
from midspan.store.store import open_store

CASE = Lively(rate_hz=1.0, duration_s=60.0, band_hz=(1.0, 3.0), rms_m=2e-3, noise_m=1e-3)
NODDING = replace(CASE, rate_hz=10.0, duration_s=40.0, nods=(1.5, 0.9))
BEGIN_NS = 1_790_000_000 * NANOSECONDS
SITE = """
name = "site"
[store]
path = "store"
[mqtt]
[[point]]
name = "p"
calibration_s = 30
[point.accelerometer]
source = "replay:bridge"
[point.displacement]
source = "replay:bridge"
estimate_offset = false
noise_time_s = 0
[point.velocity]
source = "{velocity}"
noise_std = 0.1
unit = "mm/s"
"""


@pytest.fixture(scope="module")
def bridge(tmp_path_factory):
    """A slow displacement with a vibrometer."""
    folder = write(tmp_path_factory.mktemp("v") / "bridge", CASE, "displacement", "estimate_offset = false")
    return add_velocity(folder, CASE)


@pytest.fixture(scope="module")
def nodding(tmp_path_factory):
    """A camera that tilts, with a gyroscope in its box."""
    return add_gyroscope(write(tmp_path_factory.mktemp("g") / "nodding", NODDING, "camera"), NODDING)


def point_of(folder, bridge, velocity="replay:bridge"):
    """A point of a site whose vibrometer has this source."""
    shutil.copytree(bridge, folder / "bridge", dirs_exist_ok=True)
    (folder / "SITE.toml").write_text(SITE.format(velocity=velocity))
    (plan,) = load_site(folder / "SITE.toml").points
    return running(plan, folder / "captures", folder)


def records(folder, *names):
    """The records of a recording's channels in the order of their stamps."""
    address = f"replay:{folder}@{BEGIN_NS}#"
    found = [Arrival(name, 0, one) for name in names for _, one in readings(f"{address}{name}")]
    return sorted(found, key=lambda one: (one.newest_ns, one.stream))


def lived(point, arrivals):
    """Push everything, doing the point's jobs at once; returns the calibration and what is to be kept."""
    calibration = None
    for arrival in arrivals:
        point.push(arrival)
        if point.job is not None and point.job.kind == "calibrate":
            calibration = midspan.calibrate(point.job.folder)
            point.calibrated(1)
        elif point.job is not None:
            point.is_opened(opened(point.job.folder, "p", calibration, 1))
    assert (point.phase, point.status) == (Phase.RUNNING, PointStatus.TRACKING)
    return calibration, point.batch()


def rows_of(batch):
    chunks = [one for one in batch.chunks if one.stream == "rows"]
    return tuple(
        np.concatenate([get(one) for one in chunks])
        for get in (lambda c: c.time_ns, lambda c: c.columns["displacement_m"], lambda c: c.columns["std_m"])
    )


def error_of(batch):
    """Root mean square error without the mean (mm) and the share inside the band, after the first seconds."""
    time_ns, value, std = (column[500:] for column in rows_of(batch))
    off = value - CASE.motion((time_ns - BEGIN_NS) / NANOSECONDS)
    off -= off.mean()
    return 1e3 * float(np.sqrt(np.mean(off**2))), float(np.mean(np.abs(off) < 1.96 * std))


ALL = ("accelerometer", "displacement", "velocity")


def test_a_point_calibrates_itself_with_a_vibrometer_and_is_sharper(bridge, tmp_path):
    point = point_of(tmp_path / "with", bridge).live
    calibration, batch = lived(point, records(bridge, *ALL))
    assert [one.kind for one in calibration.auxiliary] == ["velocity"]
    # As the section says, in SI units.
    assert calibration.helped_by("velocity").noise_std == pytest.approx(1e-4)
    assert "velocity" in {one.stream for one in batch.chunks}
    error, inside = error_of(batch)
    alone = point_of(tmp_path / "without", bridge).live
    without, kept = lived(alone, records(bridge, *ALL[:2]))
    assert not without.auxiliary
    assert "velocity" in " ".join(without.warnings)
    before, _ = error_of(kept)
    assert error < 0.8 * before
    assert inside > 0.9


def test_a_calibrated_point_goes_on_without_a_vibrometer_that_is_silent_frozen_or_comes_late(bridge, tmp_path):
    point = point_of(tmp_path, bridge).live
    arrivals = records(bridge, *ALL)
    calibration, _ = lived(point, arrivals)
    late = point_of(tmp_path, bridge).live
    late.number, late.folder = 1, tmp_path / "again"
    came, events = [], []
    for one in arrivals:
        at_s = (one.newest_ns - BEGIN_NS) / NANOSECONDS
        if one.stream == "velocity":
            if at_s < 12.0 or 30.0 < at_s < 32.0:
                continue
            if 40.0 < at_s < 45.0:
                one = Arrival(one.stream, 0, replace(one.record, value=np.full_like(one.record.value, 1e-3)))
        late.push(one)
        if late.job is not None:
            late.is_opened(opened(late.job.folder, "p", calibration, 1))
            assert "velocity" in late.opened.point.sensors
        batch = late.batch()
        events += [event for _, event in batch.events]
        came += [chunk for chunk in batch.chunks if chunk.stream == "rows"]
    assert {event.kind for event in events if "velocity" in event.text} == {"frozen", "released"}
    status = np.concatenate([one.columns["status"] for one in came])
    assert np.all(status == 0)


def test_a_checkpoint_holds_its_state(bridge, tmp_path):
    point = point_of(tmp_path, bridge).live
    arrivals = records(bridge, *ALL)
    calibration, _ = lived(point, arrivals[:-200])
    kept, folder = b"".join(checkpoint(point.opened, point.settled_in)), point.settled_in
    store = open_store(tmp_path / "store")
    again = opened(folder, "p", calibration, 1, push=False)
    resumed(again, kept, store)
    assert again.point.sensors["velocity"].state == point.opened.point.sensors["velocity"].state
    store.close()
    for arrival in arrivals[-200:]:
        point.push(arrival)
        again.counts[arrival.stream] += 1
        again.journal.given(again.point.push(replace(arrival, sequence=again.counts[arrival.stream])))
    old, new = rows_of(point.batch()), rows_of(again.journal.batch())
    assert len(new[0]) > 500
    for whole, rest in zip(old, new, strict=True):
        np.testing.assert_array_equal(whole[-len(rest) :], rest)


def test_blocks_of_a_vibrometer_come_by_the_broker_in_their_unit(bridge, tmp_path):
    one, events = point_of(tmp_path, bridge, "mqtt:b/v"), []
    intake = Intake([one], tmp_path, lambda _: None, lambda _one, kind, text: events.append((kind, text)))
    t0_ns = BEGIN_NS
    intake.payload("b/v", pack(Block(VELOCITY, 0, t0_ns, 20_000_000, np.array([1.0, 2.0]))))
    text = {"sequence": 1, "t0": t0_ns + 40_000_000, "dt_s": 0.02, "values": [3.0]}
    intake.payload("b/v", json.dumps(text).encode())
    intake.payload("b/v", pack(Block(2, 2, t0_ns + 60_000_000, 20_000_000, np.zeros(1))))
    stream = one.streams["velocity"]
    assert (stream.records, stream.faults) == (2, 1)
    assert events == [("payload", "velocity: a block must be as documented; received kind 2 where 6 is expected")]
    raw = np.concatenate([c.columns["value"] for c in one.live.batch().chunks if c.stream == "velocity"])
    np.testing.assert_allclose(raw, [1e-3, 2e-3, 3e-3], rtol=1e-6)
    named = [source["source"] for source in one.standing(0.0)["sources"]]
    assert named == ["accelerometer", "displacement", "velocity"]


@pytest.mark.parametrize(("which", "kind"), [("bridge", "velocity"), ("nodding", "gyroscope")])
def test_a_replay_gives_the_rows_of_the_file_and_keeps_what_gives_them_again(which, kind, tmp_path, request):
    recording = midspan.open_recording(request.getfixturevalue(which))
    calibration = midspan.calibrate(recording)
    assert [one.kind for one in calibration.auxiliary] == [kind]
    result = midspan.estimate(recording, calibration, method="kalman")
    store = open_store(tmp_path / "store")
    replay(recording, store, name="p", calibration=calibration)
    table = stored_table(store, "p", None, None)
    store.close()
    np.testing.assert_array_equal(table.time_ns, result.estimate.time_ns)
    np.testing.assert_array_equal(table.columns["status"], result.estimate.status)
    np.testing.assert_allclose(table.columns["displacement_mm"], result.displacement_mm, rtol=1e-12, atol=1e-7)
    output = tmp_path / "again.csv"
    assert run(["estimate", str(tmp_path / "store"), "--method", "kalman", "-o", str(output), "--quiet"]) == 0
    again = np.genfromtxt(output, delimiter=",", names=True, usecols=(0, 1))
    np.testing.assert_allclose(again["displacement_mm"], result.displacement_mm, rtol=0, atol=1e-6)
