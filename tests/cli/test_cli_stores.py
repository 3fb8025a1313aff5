"""Commands on stores and SITE.toml: names that become files, what is checked beforehand, messages about a store."""

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import midspan
from lively_recordings import Lively, write
from midspan.cli.main import run
from midspan.records import NANOSECONDS
from midspan.service.stored_recording import ADVICE
from midspan.store.chunk import Chunk
from midspan.store.store import Batch, open_store


@pytest.mark.parametrize("name", ["a/b", "a b", "../../esc", "", "x" * 65])
def test_replay_takes_the_names_that_a_site_takes(footbridge, tmp_path, capsys, name):
    assert run(["replay", str(footbridge), "-o", str(tmp_path / "store"), "--point", name]) == 2
    assert "--point must be 1 to 64 letters, digits, - and _" in capsys.readouterr().err
    assert not (tmp_path / "store").exists()


def test_a_store_takes_no_recordings_place(footbridge_copy, tmp_path, capsys):
    before = sorted(footbridge_copy.rglob("*"))
    assert run(["replay", str(footbridge_copy), "-o", str(footbridge_copy)]) == 2
    assert "is a recording's folder. Choose another folder" in capsys.readouterr().err
    assert sorted(footbridge_copy.rglob("*")) == before
    (tmp_path / "file").write_text("kept")
    assert run(["replay", str(footbridge_copy), "-o", str(tmp_path / "file")]) == 2
    assert (tmp_path / "file").read_text() == "kept"


def rows(point):
    """A second of rows."""
    time_ns = 10**18 + np.arange(100) * (NANOSECONDS // 100)
    columns = {name: np.zeros(100) for name in ("displacement_m", "std_m", "velocity_m_s", "zero_std_m")}
    columns |= {name: np.zeros(100, np.uint8) for name in ("source", "status")}
    return Chunk(point, "rows", time_ns, columns, 1, "displacement_m")


def test_an_export_stays_in_the_working_folder_whatever_the_point_is_called(tmp_path, monkeypatch):
    store = open_store(tmp_path / "store")
    store.write(Batch([rows("../outside")]))
    store.close()
    (tmp_path / "work").mkdir()
    monkeypatch.chdir(tmp_path / "work")
    assert run(["export", str(tmp_path / "store"), "--quiet"]) == 0
    assert sorted(file.name for file in tmp_path.iterdir()) == ["store", "work"]
    assert (tmp_path / "work" / "---outside.csv").is_file()


SITE = """
name = "river bridge"
[store]
path = "store"
[mqtt]
[[point]]
name = "p"
calibration = "p.json"
[point.accelerometer]
source = "mqtt:a"
[point.displacement]
source = "mqtt:d"
unit = "mm"
[[point]]
name = "q"
[point.accelerometer]
source = "replay:bridge"
[point.camera]
source = "replay:bridge"
"""


def checked(folder, capsys, text=SITE):
    (folder / "SITE.toml").write_text(text)
    code = run(["check-config", str(folder / "SITE.toml"), "--json"])
    return code, json.loads(capsys.readouterr().out)


def test_what_a_site_names_and_is_not_there_is_said(tmp_path, capsys):
    code, found = checked(tmp_path, capsys)
    assert code == 0
    assert [line.partition("SITE.toml: ")[2] for line in found["warnings"]] == [
        "point 'p': calibration = 'p.json': no such file yet.",
        "point 'p': accelerometer.unit: is missing; m/s^2 is assumed.",
        "point 'q': accelerometer.source = 'replay:bridge': no such recording yet.",
        "point 'q': camera.source = 'replay:bridge': no such recording yet.",
    ]
    (tmp_path / "p.json").write_text("no calibration")
    code, found = checked(tmp_path, capsys)
    assert code == 3
    assert "SITE.toml: point 'p': calibration: " in found["error"]
    (tmp_path / "p.json").unlink()
    (tmp_path / "bridge").mkdir()
    (tmp_path / "bridge" / "recording.toml").write_text("")
    text = SITE.replace('"mqtt:a"', '"mqtt:a"\nunit = "g"').replace('calibration = "p.json"\n', "")
    code, found = checked(tmp_path, capsys, text)
    assert (code, found["warnings"]) == (0, [])


def test_a_unit_of_something_else_and_a_site_without_points_are_refused(tmp_path, capsys):
    code, found = checked(tmp_path, capsys, SITE.replace('"mm"', '"g"'))
    assert code == 2
    assert "point 'p': displacement: " in found["error"]
    code, found = checked(tmp_path, capsys, SITE[: SITE.index("[[point]]")])
    assert code == 2
    assert "point: is missing. Add one [[point]]" in found["error"]


def test_a_folder_with_a_site_is_that_site_and_a_store_in_the_place_of_a_file_is_refused(tmp_path, capsys):
    text = SITE.replace('path = "store"', 'path = "SITE.toml"')
    code, found = checked(tmp_path, capsys, text)
    assert (code, "store.path = 'SITE.toml': must be a writable folder" in found["error"]) == (2, True)
    for command in ("check-config", "run"):
        assert run([command, str(tmp_path), "--json"]) == 2
        assert "store.path = 'SITE.toml': must be a writable folder" in json.loads(capsys.readouterr().out)["error"]


def test_an_empty_file_is_neither_a_recording_nor_a_site(tmp_path, capsys):
    (tmp_path / "new.toml").write_text("")
    assert run(["check-config", str(tmp_path / "new.toml"), "--json"]) == 2
    assert "is empty. A recording has [accelerometer]" in json.loads(capsys.readouterr().out)["error"]


def test_a_replay_by_a_method_for_files_leaves_no_store(gnss, tmp_path, capsys):
    assert run(["replay", str(gnss), "-o", str(tmp_path / "new"), "--method", "smoother"]) == 2
    assert "kalman" in capsys.readouterr().err
    assert not (tmp_path / "new").exists()


@pytest.fixture(scope="module")
def stored(gnss, tmp_path_factory):
    """A store with one point."""
    folder = tmp_path_factory.mktemp("stored") / "store"
    calibration = midspan.calibrate(midspan.open_recording(gnss)).save(folder.parent)
    assert run(["replay", str(gnss), "-o", str(folder), "--point", "p", "-c", str(calibration), "--quiet"]) == 0
    return folder


def test_an_error_names_store_and_point_and_says_what_to_do_with_a_store(stored, tmp_path, capsys):
    output = str(tmp_path / "x.csv")
    store = open_store(stored)
    again = next(store.chunks("p", "accelerometer", 0, 2**62))
    # Its stamps stand twice with other values, as two writers at once would leave them; equal rows would be dropped.
    again = replace(again, columns={"value": again.columns["value"] + 1e-3})
    store._days.of(0).insert(again)
    store.close()
    assert run(["estimate", str(stored), "-o", output]) == 3
    reported = capsys.readouterr().err
    assert f"{stored}: point 'p', accelerometer: time must increase" in reported
    assert "Choose a span without them (--from, --to)." in reported
    assert "midspan-" not in reported
    assert run(["estimate", str(stored), "-o", output, "--tracker", "template", "--from", "5"]) == 2
    reported = capsys.readouterr().err
    assert f"{stored}: point 'p' has no [camera]" in reported
    assert "midspan-" not in reported


def test_the_advice_that_is_replaced_is_what_messages_say():
    folder = Path(midspan.__file__).parent
    sources = [file.read_text() for file in folder.rglob("*.py") if file.name != "stored_recording.py"]
    # Texts of several lines as one.
    joined = re.sub(r'"\s*\n\s*f?"', "", "\n".join(sources))
    assert [advice for advice in ADVICE if advice not in joined] == []


def test_check_config_shows_the_keys_of_sensors_and_recordings_that_are_too_short(tmp_path, capsys):
    write(tmp_path / "short", Lively(duration_s=8.0), "displacement")
    (tmp_path / "SITE.toml").write_text(
        'name = "s"\n[store]\npath = "store"\n[[point]]\nname = "p"\ncalibration_s = 10\n'
        '[point.accelerometer]\nsource = "replay:short"\n'
        '[point.displacement]\nsource = "replay:short"\nreceiver = "gnss"\nestimate_offset = false\n'
    )
    assert run(["check-config", str(tmp_path / "SITE.toml"), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    own = {"accelerometer": {}, "displacement": {"receiver": "gnss", "estimate_offset": False}}
    assert found["settings"]["point"][0]["sensors"] == own
    (warning,) = found["warnings"]
    assert "replays 7.99 s; calibration_s = 10, the calibration itself and 5 s to open come before rows" in warning
