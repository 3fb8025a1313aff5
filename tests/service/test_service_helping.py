"""Live points with a sensor that helps others: it is calibrated and used like that of a file, and nothing waits for it
that can do without.
"""

import json
import re
import shutil
from dataclasses import replace

import numpy as np
import pytest

import midspan
from lively_recordings import FOCAL_PX, Lively, add_gyroscope, add_velocity, write
from midspan.cli.main import run
from midspan.engine.point import PointStatus
from midspan.errors import DataError, UsageError
from midspan.records import NANOSECONDS, Arrival
from midspan.service.checking import checked
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
from recording_edits import set_keys

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


def error_of(batch, case=CASE):
    """Root mean square error without the mean (mm) and the share inside the band, after the first seconds."""
    time_ns, value, std = (column[500:] for column in rows_of(batch))
    off = value - case.motion((time_ns - BEGIN_NS) / NANOSECONDS)
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
    lacks = "p: velocity is not used with calibration 1 and method kalman."
    assert ("calibration_warning", lacks) in {(event.kind, event.text) for _, event in kept.events}
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


SIDEWAYS = """
name = "site"
[store]
path = "store"
[mqtt]
[[point]]
name = "p"
calibration_s = 30
[point.accelerometer]
source = "replay:bridge"
[point.camera]
source = "replay:bridge"
direction = "{direction}"
roi = [18, 18, 48, 48]
[point.gyroscope]
{source}
"""


def turned(nodding, folder):
    """The same on its side: down becomes right, and a rotation about x one about y, the other way round."""
    shutil.copytree(nodding, folder)
    np.save(folder / "camera.npy", np.load(folder / "camera.npy").transpose(0, 2, 1))
    head, *rows = (folder / "gyroscope.csv").read_text().splitlines()
    rows = [f"{time},{-float(value):.9f}" for time, value in (row.split(",") for row in rows)]
    (folder / "gyroscope.csv").write_text("\n".join([head, *rows]) + "\n")
    set_keys(folder, "camera", direction="x")
    set_keys(folder, "gyroscope", value_x=None, value_y="value")


def test_a_gyroscope_takes_the_tilt_off_an_image_that_moves_sideways(nodding, tmp_path):
    turned(nodding, tmp_path / "bridge")
    (tmp_path / "SITE.toml").write_text(SIDEWAYS.format(direction="x", source='source = "replay:bridge"'))
    (plan,) = load_site(tmp_path / "SITE.toml").points
    (one,) = checked(load_site(tmp_path / "SITE.toml"), ["p"])
    address = f"replay:{tmp_path / 'bridge'}@{BEGIN_NS}#"
    found = [Arrival("accelerometer", 0, record) for _, record in readings(f"{address}accelerometer:x")]
    found += [Arrival("gyroscope", 0, record) for _, record in readings(f"{address}gyroscope:x")]
    frames = midspan.open_recording(tmp_path / "bridge").frames.frames()
    found += [Arrival("camera", 0, replace(frame, time_ns=frame.time_ns + BEGIN_NS)) for frame in frames]
    calibration, batch = lived(one.live, sorted(found, key=lambda one: (one.newest_ns, one.stream)))
    known = calibration.helped_by("gyroscope")
    assert known.focal_px == pytest.approx(FOCAL_PX, abs=3.0 * known.focal_std_px)
    captured = midspan.open_recording(next(tmp_path.glob("store/captures/p/calibration-*"))).settings.gyroscope
    assert (captured.value_x, captured.value_y, captured.unit) == (None, "value", "rad/s")
    error, inside = error_of(batch, NODDING)
    # The tilt alone would be 1.6 mm rms; a gyroscope leaves its slow part, 0.34 mm of the file too.
    assert error < 0.5
    assert inside > 0.85
    assert plan.axis == "x"


@pytest.mark.parametrize(
    ("direction", "source", "said"),
    [
        (
            "y",
            'source = "mqtt:g"',
            r"gyroscope\.source_x: is missing: a rotation about the image's x axis moves",
        ),
        ("x", 'source_x = "mqtt:g"', r"gyroscope\.source_y: is missing"),
        ("xy", 'source_x = "mqtt:g"', r"gyroscope\.source_y: is missing"),
        ("y", 'source_x = "rtsp://g"', r"gyroscope\.source: must be one of mqtt:"),
        ("y", 'source_x = "mqtt:g"\nunit = "mm"', "measure rotation rate"),
        ("y", 'source_x = "mqtt:g"\nnoise_dens = 1', r"noise_dens: is not a known key\. Did you mean 'noise_density'"),
        ("y", 'source_x = "mqtt:g"\nvalue_x = "gx"', r"gyroscope\.value_x: is for files only"),
        ("y", 'source_x = "mqtt:g"\n[point.velocity]\nunit = "mm/s"', r"velocity\.source: is missing"),
        ("xy", 'source_x = "mqtt:g"\nsource_y = "mqtt:h"\n[point.velocity]\nsource = "mqtt:v"', "the only sensor"),
        ("x", 'source = "replay:bridge"', r"has no gyroscope\.value_y"),
    ],
)
def test_what_a_section_may_not_say(direction, source, said, nodding, tmp_path, capsys):
    shutil.copytree(nodding, tmp_path / "bridge")
    text = SIDEWAYS.format(direction=direction, source=source)
    if direction == "xy":
        both = 'source_x = "mqtt:ax"\nsource_y = "mqtt:ay"'
        text = text.replace('[point.accelerometer]\nsource = "replay:bridge"', f"[point.accelerometer]\n{both}")
    (tmp_path / "SITE.toml").write_text(text)
    code = run(["check-config", str(tmp_path / "SITE.toml")])
    if "replay" not in source:
        assert code == 2
        assert re.search(said, capsys.readouterr().err)
        return
    with pytest.raises(DataError, match=said):
        checked(load_site(tmp_path / "SITE.toml"), ["p"])


def test_both_axes_of_a_camera_have_their_own_rotation(tmp_path):
    text = SIDEWAYS.format(direction="xy", source='source_x = "mqtt:gx"\nsource_y = "mqtt:gy"\nsource_z = "mqtt:gz"')
    both = 'source_x = "mqtt:ax"\nsource_y = "mqtt:ay"'
    (tmp_path / "SITE.toml").write_text(text.replace('source = "replay:bridge"', both, 1).replace("roi", "# roi"))
    points = load_site(tmp_path / "SITE.toml").points
    assert [(plan.axis, plan.sources["gyroscope"]) for plan in points] == [("y", "mqtt:gx"), ("x", "mqtt:gy")]


def test_gravity_along_the_view_is_for_recordings(tmp_path):
    text = SIDEWAYS.format(direction="y", source='source_x = "mqtt:gx"')
    named = 'source_y = "mqtt:ay"\nsource_z = "mqtt:az"'
    (tmp_path / "SITE.toml").write_text(text.replace('source = "replay:bridge"', named, 1))
    with pytest.raises(UsageError, match=r"accelerometer\.source_z: is for recordings only"):
        load_site(tmp_path / "SITE.toml")


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
