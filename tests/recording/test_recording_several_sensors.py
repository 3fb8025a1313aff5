"""Several sensors of one kind: each is opened by itself, shown by inspect and check-config, never left out silently."""

import json

import numpy as np
import pytest

import midspan
from midspan.cli.main import run
from midspan.recording.inspect import inspect_recording
from midspan.recording.tracking.track import TrackRequest, track
from midspan.records import Region

SETTINGS = """
[accelerometer]
file = "accel.csv"
unit = "m/s^2"

[[camera]]
name = "left"
file = "left.npz"

[[camera]]
name = "right"
file = "right.npz"
every = 2

[[radar]]
name = "near"
file = "near.npy"
rate_hz = 20.0
carrier_hz = 60e9

[[radar]]
name = "far"
file = "far.npy"
rate_hz = 10.0
carrier_hz = 60e9

[[displacement]]
name = "gnss"
file = "gnss.csv"
unit = "m"

[[displacement]]
name = "level"
file = "level.csv"
unit = "mm"
"""


@pytest.fixture
def folder(tmp_path):
    time_s = np.arange(0.0, 10.0, 0.05)
    for name in ("accel", "gnss", "level"):
        table = np.column_stack((time_s, np.sin(time_s)))
        np.savetxt(tmp_path / f"{name}.csv", table, delimiter=",", header=f"time_s,{name}", comments="")
    rng = np.random.default_rng(0)
    for name, width in (("left", 40), ("right", 50)):
        frames = rng.integers(0, 255, (12, 30, width), dtype=np.uint8)
        np.savez(tmp_path / f"{name}.npz", frames=frames, time_s=np.arange(12) / 10.0)
    for name, bins in (("near", 3), ("far", 5)):
        np.save(tmp_path / f"{name}.npy", rng.normal(size=(100, bins)) + 1j * rng.normal(size=(100, bins)))
    (tmp_path / "recording.toml").write_text(SETTINGS)
    return tmp_path


def test_each_sensor_is_opened_by_itself(folder):
    recording = midspan.open_recording(folder)
    found = {sensor.name: sensor for sensor in recording.sensors}
    assert list(found) == ["left", "right", "near", "far", "gnss", "level"]
    left, right = (recording.frames_of(found[name]) for name in ("left", "right"))
    assert (left.info.width, right.info.width) == (40, 50)
    assert (len(left.times_ns()), len(right.times_ns())) == (12, 6)
    near, far = (recording.radar_of(found[name]).times_ns() for name in ("near", "far"))
    assert (near[1] - near[0], far[1] - far[0]) == (50_000_000, 100_000_000)
    gnss, level = (recording.series_of(found[name]) for name in ("gnss", "level"))
    # Metres and millimetres of the same numbers.
    np.testing.assert_allclose(gnss.value, 1e3 * level.value, rtol=1e-12)
    assert {path.name for path in recording.own_files} >= {"left.npz", "right.npz", "near.npy", "far.npy", "level.csv"}


def test_a_missing_file_is_named_with_its_section(folder):
    (folder / "right.npz").unlink()
    recording = midspan.open_recording(folder)
    with pytest.raises(midspan.DataError, match=r"camera\[2\]\.file = 'right\.npz': no such file"):
        recording.frames_of(recording.sensors[1])


def test_inspect_shows_every_sensor_under_its_name(folder):
    tree = inspect_recording(midspan.open_recording(folder))
    assert [tree[name]["file"] for name in ("left", "right", "near", "far", "gnss", "level")] == [
        "left.npz", "right.npz", "near.npy", "far.npy", "gnss.csv", "level.csv",
    ]  # fmt: skip
    assert tree["level"]["largest"] == pytest.approx(1e-3, rel=1e-2)


@pytest.mark.parametrize("work", [midspan.calibrate, midspan.estimate, track])
def test_what_takes_one_sensor_of_a_kind_names_the_sections(folder, work):
    given = folder if work is track else midspan.open_recording(folder)
    with pytest.raises(midspan.UsageError, match=r"\[\[camera\]\] must be one section here; received 2: left, right"):
        work(given)


def test_track_asks_only_for_one_camera(folder):
    text = (folder / "recording.toml").read_text()
    start, end = text.index('[[camera]]\nname = "right"'), text.index("[[radar]]")
    (folder / "recording.toml").write_text(text[:start] + text[end:])
    assert len(track(folder, TrackRequest(region=Region(5, 5, 20, 20), tracker="template")).track.time_ns) == 12


def test_a_calibration_of_several_sensors_is_not_taken_for_one(folder):
    text = (folder / "recording.toml").read_text()
    tree = {"accelerometer": {"noise_std_m_s2": 0.01}}
    tree["displacement"] = [{"name": name, "noise_std_mm": 1.0, "time_offset_s": 0.0} for name in ("gnss", "level")]
    (folder / "calibration.json").write_text(json.dumps(tree))
    alone = text[: text.index("[[camera]]")] + text[text.index("[[displacement]]") : text.rindex("[[displacement]]")]
    (folder / "recording.toml").write_text(alone)
    with pytest.raises(midspan.UsageError, match="one sensor of each kind here; received gnss, level"):
        midspan.estimate(folder, folder / "calibration.json")


def test_check_config_shows_every_section_and_what_is_missing(folder, capsys):
    (folder / "far.npy").unlink()
    assert run(["check-config", str(folder)]) == 0
    said = capsys.readouterr()
    assert "camera[2].every" in said.out
    assert "displacement[1].unit" in said.out
    assert "far.file = 'far.npy': no such file yet" in said.err
    assert run(["check-config", str(folder), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)["settings"]
    assert [camera["name"] for camera in told["camera"]] == ["left", "right"]
    assert told["infrared"] is None
