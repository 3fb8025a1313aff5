"""Several sensors of one kind: each is opened on its own, shown by inspect and check-config, never left out
silently."""

import json

import numpy as np
import pytest

import midspan
from midspan.cli.main import run
from midspan.recording.inspect import inspect_recording
from midspan.recording.tracking.track import track
from midspan.records import Region
from midspan.settings.stored.calibration import calibration_from_dict

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
    found = {view.sensor: view for view in recording.views}
    assert list(found) == ["left", "right", "near", "far", "gnss", "level"]
    left, right = (found[name].frames for name in ("left", "right"))
    assert (left.info.width, right.info.width) == (40, 50)
    assert (len(left.times_ns()), len(right.times_ns())) == (12, 6)
    near, far = (found[name].radar.times_ns() for name in ("near", "far"))
    assert (near[1] - near[0], far[1] - far[0]) == (50_000_000, 100_000_000)
    gnss, level = (found[name].displacement for name in ("gnss", "level"))
    # Metres and millimetres of the same numbers.
    np.testing.assert_allclose(gnss.value, 1e3 * level.value, rtol=1e-12)
    assert {path.name for path in recording.own_files} >= {"left.npz", "right.npz", "near.npy", "far.npy", "level.csv"}


def test_a_missing_file_is_named_with_its_section(folder):
    (folder / "right.npz").unlink()
    recording = midspan.open_recording(folder)
    with pytest.raises(midspan.DataError, match=r"camera\[2\]\.file = 'right\.npz': no such file"):
        recording.views[1].frames.times_ns()


def test_inspect_shows_every_sensor_under_its_name(folder):
    tree = inspect_recording(midspan.open_recording(folder))
    assert [tree[name]["file"] for name in ("left", "right", "near", "far", "gnss", "level")] == [
        "left.npz", "right.npz", "near.npy", "far.npy", "gnss.csv", "level.csv",
    ]  # fmt: skip
    assert tree["level"]["largest"] == pytest.approx(1e-3, rel=1e-2)


def test_the_printed_forms_take_one_sensor_of_a_kind_and_name_the_sections(folder):
    with pytest.raises(midspan.UsageError, match=r"\[\[camera\]\] must be one section with fusion.literal; received 2"):
        midspan.open_recording(folder, fusion={"method": "adaptive-kalman", "literal": True})


def test_track_follows_the_first_camera_and_tells_of_the_other(folder):
    found = track(folder, roi=Region(5, 5, 20, 20), tracker="template")
    assert len(found.track.time_ns) == 12
    assert "Only [left] was tracked; for [right] give its file as SOURCE." in found.warnings


def test_a_sensor_takes_its_own_part_of_a_calibration_of_several(folder):
    recording = midspan.open_recording(folder)
    tree = {"accelerometer": {"noise_std_m_s2": 0.01}}
    tree["displacement"] = [
        {"name": name, "noise_std_mm": n, "time_offset_s": 0.0} for n, name in ((1, "level"), (2, "gnss"))
    ]
    calibration = calibration_from_dict(tree)
    known = {view.sensor: calibration.of_sensor(view.own, view.companions) for view in recording.views}
    assert (known["gnss"].noise_std_m, known["level"].noise_std_m) == (2e-3, 1e-3)
    assert known["left"] is known["near"] is None
    # One without a name belongs to the only sensor of its kind, and to none of several.
    tree["displacement"] = tree["displacement"][0] | {"name": None}
    unnamed = calibration_from_dict(tree)
    assert [unnamed.of_sensor(view.own, view.companions) for view in recording.views] == [None] * 6
    text = (folder / "recording.toml").read_text()
    alone = text[: text.index("[[camera]]")] + text[text.index("[[displacement]]") : text.rindex("[[displacement]]")]
    (folder / "recording.toml").write_text(alone)
    (gnss,) = midspan.open_recording(folder).views
    assert unnamed.of_sensor(gnss.own, gnss.companions) is unnamed.displacement


def test_check_config_shows_every_section_and_what_is_missing(folder, capsys):
    (folder / "far.npy").unlink()
    assert run(["check-config", str(folder)]) == 0
    said = capsys.readouterr()
    assert "camera[2].every" in said.out
    assert "displacement[1].unit" in said.out
    assert "far.file = 'far.npy': no such file yet" in said.err
    assert run(["check-config", str(folder), "--json"]) == 0
    reported = json.loads(capsys.readouterr().out)["settings"]
    assert [camera["name"] for camera in reported["camera"]] == ["left", "right"]
    assert reported["infrared"] is None
