"""Bad input: for each case the exit code, the words that the message must hold, and no output under any name."""

import json
import shutil
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest

from midspan.cli.main import run
from recording_edits import acceleration, append, frames, replace_text, set_keys, write_acceleration, write_stack

Change = Callable[[Path], None]


def nothing(folder):
    pass


@dataclass(frozen=True)
class Bad:
    """change: what is wrong in the folder of the recording; arguments: after `estimate FOLDER`; words: in the message.

    code: one exit code, or several where the public face leaves it open.
    """

    change: Change
    code: int | tuple[int, ...]
    words: tuple[str, ...]
    arguments: tuple[str, ...] = field(default=())


def keys(section, **values):
    return lambda folder: set_keys(folder, section, **values)


def text(addition):
    return lambda folder: append(folder, addition)


def values(change):
    """A change of the acceleration: a function of time and value that gives both."""

    def changed(folder):
        write_acceleration(folder, *change(*acceleration(folder)))

    return changed


def stack(change):
    """A change of the frames, written as a stack."""
    return lambda folder: write_stack(folder, change(frames(folder)))


def write(name, content):
    return lambda folder: (folder / name).write_bytes(content) and None


def cut(folder):
    """A video that ends in the middle, as after a full disk."""
    whole = (folder / "camera.mkv").read_bytes()
    (folder / "camera.mkv").write_bytes(whole[: len(whole) // 2])


def folder_without_images(folder):
    (folder / "pictures").mkdir()
    set_keys(folder, "camera", file="pictures")


def short_times(folder):
    (folder / "t.csv").write_text("time_s\n0.0\n0.1\n", encoding="utf-8")
    set_keys(folder, "camera", times="t.csv")


def falling_times(folder):
    stamps = "\n".join(f"{t:.3f}" for t in np.arange(248)[::-1] / 10.0)
    (folder / "t.csv").write_text(f"time_s\n{stamps}\n", encoding="utf-8")
    set_keys(folder, "camera", times="t.csv")


# The calibration of the good recording, as `midspan calibrate` writes it, made once for all cases.
GOOD: list[str] = []


def good_calibration(folder):
    """Its text; folder: a copy of the good recording."""
    if not GOOD:
        assert run(["calibrate", str(folder), "-o", str(folder / "cal.json"), "--quiet"]) == 0
        GOOD.append((folder / "cal.json").read_text(encoding="utf-8"))
    return GOOD[0]


def calibration(**camera):
    """A damaged calibration file: the good one with some values of its camera changed."""

    def changed(folder):
        tree = json.loads(good_calibration(folder))
        tree["camera"] = {key: value for key, value in {**tree["camera"], **camera}.items() if value is not ...}
        (folder / "cal.json").write_text(json.dumps(tree), encoding="utf-8")

    return changed


def where(selected, value):
    """The acceleration with `value` where `selected` says so of the time."""
    return values(lambda t, a: (t, np.where(selected(t), value, a)))


WITH_CAL = ("-c", "cal.json")
CASES = {
    # files that are missing, empty or something else
    "no recording.toml": Bad(lambda f: (f / "recording.toml").unlink(), 3, ("recording.toml", "not found")),
    "acceleration missing": Bad(keys("accelerometer", file="acel.csv"), 3, ("recording.toml", "acel.csv")),
    "video missing": Bad(keys("camera", file="cam.mkv"), 3, ("recording.toml", "camera.file", "cam.mkv")),
    "times missing": Bad(keys("camera", times="t.csv"), 3, ("camera.times", "t.csv")),
    "acceleration empty": Bad(write("accel.csv", b""), 3, ("accel.csv", "empty")),
    "acceleration only a header": Bad(write("accel.csv", b"time_s,accel\n"), 3, ("accel.csv",)),
    "acceleration of one row": Bad(write("accel.csv", b"time_s,accel\n0.0,1.0\n"), 3, ("accel.csv", "accel")),
    "acceleration no table": Bad(write("accel.csv", bytes(range(256)) * 40), 3, ("accel.csv",)),
    "video empty": Bad(write("camera.mkv", b""), 3, ("camera.mkv",)),
    "video no video": Bad(write("camera.mkv", b"hello " * 1000), 3, ("camera.mkv",)),
    "video truncated": Bad(cut, 3, ("camera.mkv", "truncated")),
    "no images": Bad(folder_without_images, 3, ("pictures", "no images")),
    "glob without images": Bad(keys("camera", file="*.png"), 3, ("*.png", "no images")),
    # settings
    "no TOML": Bad(write("recording.toml", b"[accelerometer\n"), 2, ("recording.toml", "TOML")),
    "unknown key": Bad(keys("camera", rio=[0, 0, 9, 9]), 2, ("recording.toml", "camera.rio", "'roi'")),
    "unknown section": Bad(text("[fuson]\nmethod = 'kalman'"), 2, ("recording.toml", "fuson", "'fusion'")),
    "text for a number": Bad(keys("camera", rate_hz="ten"), 2, ("camera.rate_hz", "'ten'")),
    "no camera": Bad(lambda f: replace_text(f, "[camera]", "[reference2]"), 2, ("recording.toml",)),
    "unit of nothing": Bad(keys("accelerometer", unit="furlong"), 2, ("accel.csv", "unit", "'furlong'", "m/s^2")),
    "unit of a length": Bad(keys("accelerometer", unit="mm"), 2, ("accel.csv", "unit", "'mm'")),
    "volts without sensitivity": Bad(keys("accelerometer", unit="V"), 2, ("sensitivity", "V per m/s^2")),
    "sensitivity without volts": Bad(keys("accelerometer", sensitivity=0.5), 2, ("sensitivity", "0.5")),
    "column missing": Bad(keys("accelerometer", value="acel"), 2, ("accel.csv", "'acel'", "'accel'")),
    "time missing": Bad(keys("accelerometer", time="tiem"), 2, ("accel.csv", "'tiem'", "'time_s'")),
    "tracker unknown": Bad(keys("camera", tracker="nonsense"), 2, ("camera.tracker", "'nonsense'", "template")),
    "method unknown": Bad(keys("fusion", method="smother"), 2, ("fusion.method", "'smother'", "'smoother'")),
    "method unknown, typed": Bad(nothing, 2, ("method", "'nonsense'", "smoother"), ("--method", "nonsense")),
    "tracker unknown, typed": Bad(nothing, 2, ("tracker", "'nonsense'", "template"), ("--tracker", "nonsense")),
    "region outside the image": Bad(keys("camera", roi=[60, 60, 57, 57]), 2, ("roi", "96x96", "x=60")),
    "region too small": Bad(keys("camera", roi=[10, 10, 3, 3]), 2, ("roi", "12 px")),
    "region of three numbers": Bad(keys("camera", roi=[1, 2, 3]), 2, ("camera.roi",)),
    "window before everything": Bad(
        keys("calibration", window_s=[-20.0, -10.0]), 2, ("recording.toml", "calibration.window_s", "-20")
    ),
    "band above the rate": Bad(keys("calibration", band_hz=[60.0, 80.0]), 2, ("calibration.band_hz", "60", "100 Hz")),
    # signals
    "all missing": Bad(where(lambda t: t >= 0, np.nan), (2, 3), ("accel.csv",)),
    "a third missing": Bad(where(lambda t: (t > 8) & (t < 17), np.nan), 3, ("accel.csv", "missing", "20 %")),
    "clipped": Bad(values(lambda t, a: (t, np.clip(a, -0.2, 0.2))), 3, ("accel.csv", "clipped", "5 %")),
    "frozen": Bad(where(lambda t: t >= 0, 0.5), 3, ("accel.csv", "frozen", "100")),
    "time backwards": Bad(values(lambda t, a: (t[::-1], a)), 3, ("accel.csv", "time", "increase")),
    "time starts again": Bad(values(lambda t, a: (t % 15.0, a)), 3, ("accel.csv", "row 1501")),
    "time holds gaps": Bad(write("accel.csv", b"time_s,accel\n0.0,1\n,2\n0.2,3\n0.3,3\n"), 3, ("accel.csv", "time")),
    "no overlap": Bad(values(lambda t, a: (t + 1000.0, a)), 3, ("overlap", "1000.000 s", "start_s")),
    "too short": Bad(values(lambda t, a: (t[:50], a[:50])), 3, ("overlap", "1 s")),
    "fewer times than frames": Bad(short_times, 3, ("t.csv", "2 rows", "248 frames")),
    "times of frames backwards": Bad(falling_times, 3, ("t.csv", "increase")),
    # pictures
    "one frame": Bad(stack(lambda s: s[:1]), 3, ("camera", "1")),
    "black": Bad(stack(lambda s: 0 * s), 3, ("texture", "roi")),
    "the same picture": Bad(stack(lambda s: np.repeat(s[:1], len(s), axis=0)), (3, 4), ("camera",)),
    "stack of one image": Bad(stack(lambda s: s[0]), 3, ("camera.npy", "(96, 96)")),
    # results that could not be trusted
    "the other axis": Bad(keys("camera", direction="x"), 4, ("recording.toml", "motion", "camera.direction")),
    "a window of two seconds": Bad(keys("calibration", window_s=[5.0, 7.0]), 4, ("20", "window_s")),
    # where to write
    "suffix unknown": Bad(nothing, 2, ("out.xyz", ".csv", ".parquet"), ("-o", "out.xyz")),
    "no suffix": Bad(nothing, 2, ("suffix", ".csv"), ("-o", "out")),
    "folder missing": Bad(nothing, 2, ("nowhere", "folder"), ("-o", "nowhere/out.csv")),
    "report with another suffix": Bad(nothing, 2, ("--report", ".html"), ("--report", "report.txt")),
    "report into nowhere": Bad(nothing, 2, ("--report", "nowhere"), ("--report", "nowhere/report.html")),
    "reference of the report missing": Bad(
        keys("reference", file="no.csv"), 3, ("reference.file", "no.csv"), ("--report", "report.html")
    ),
    "output over the acceleration": Bad(nothing, 2, ("accel.csv",), ("-o", "accel.csv")),
    # calibrations
    "calibration missing": Bad(nothing, 3, ("cal.json",), WITH_CAL),
    "calibration empty": Bad(write("cal.json", b" "), 3, ("cal.json", "midspan calibrate"), WITH_CAL),
    "calibration a list": Bad(write("cal.json", b"[]"), 3, ("cal.json", "midspan calibrate"), WITH_CAL),
    "calibration without a scale": Bad(calibration(scale_mm_per_px=...), 3, ("cal.json", "scale_mm_per_px"), WITH_CAL),
    "calibration of scale zero": Bad(calibration(scale_mm_per_px=0.0), 3, ("cal.json", "scale_mm_per_px"), WITH_CAL),
    "calibration of scale NaN": Bad(
        calibration(scale_mm_per_px=float("nan")), 3, ("cal.json", "scale_mm_per_px"), WITH_CAL
    ),
    "calibration of offset NaN": Bad(
        calibration(time_offset_s=float("nan")), 3, ("cal.json", "time_offset_s"), WITH_CAL
    ),
    "calibration without an offset": Bad(calibration(time_offset_s=...), 3, ("cal.json", "time_offset_s"), WITH_CAL),
    "calibration of an endless offset": Bad(calibration(time_offset_s=1e9), (3, 4), ("offset",), WITH_CAL),
    "calibration of the wrong offset": Bad(calibration(time_offset_s=-0.3), 4, ("Calibrate",), WITH_CAL),
    "calibration of a negative variance": Bad(
        calibration(variance_factor=-1.0), 3, ("cal.json", "variance_factor"), WITH_CAL
    ),
    "calibration of the other axis": Bad(calibration(direction="x"), 2, ("direction", "'x'"), WITH_CAL),
    "calibration of a larger image": Bad(calibration(roi=[500, 500, 50, 50]), (2, 3), ("roi", "96x96"), WITH_CAL),
}


@pytest.fixture(scope="module")
def source(footbridge, tmp_path_factory):
    """The recording without what only the simulation knows."""
    folder = tmp_path_factory.mktemp("bad") / "recording"
    shutil.copytree(footbridge, folder)
    (folder / "known.json").unlink()
    return folder


def contents(folder):
    return {str(path.relative_to(folder)): path.stat().st_mtime_ns for path in folder.rglob("*")}


@pytest.mark.parametrize("name", list(CASES))
def test_bad_input_is_one_message_and_leaves_nothing(name, source, tmp_path, monkeypatch, capsys):
    case = CASES[name]
    folder = tmp_path / "recording"
    shutil.copytree(source, folder)
    case.change(folder)
    monkeypatch.chdir(folder)
    before = contents(tmp_path)
    capsys.readouterr()
    code = run(["estimate", str(folder), *case.arguments, "--json"])
    said = capsys.readouterr()
    assert code in (case.code if isinstance(case.code, tuple) else (case.code,)), said.err
    assert json.loads(said.out) == {"error": json.loads(said.out)["error"], "exit_code": code}
    message = json.loads(said.out)["error"]
    assert message in said.err
    for word in case.words:
        assert word in message
    assert "Traceback" not in said.err
    assert "internal error" not in message
    assert contents(tmp_path) == before


@pytest.mark.parametrize("name", ["acceleration missing", "video empty", "the other axis", "frozen", "unknown key"])
def test_calibrate_leaves_nothing_either(name, source, tmp_path, capsys):
    case = CASES[name]
    folder = tmp_path / "recording"
    shutil.copytree(source, folder)
    case.change(folder)
    before = contents(tmp_path)
    assert run(["calibrate", str(folder)]) == case.code
    assert contents(tmp_path) == before
    assert len(capsys.readouterr().err.strip().splitlines()) <= 2


TRACKS = {
    "missing video": (["nowhere.mp4"], 3, "nowhere.mp4"),
    "a table": (["accel.csv"], 2, "accel.csv"),
    "region of letters": (["camera.mkv", "--roi", "a,b,c,d"], 2, "--roi"),
    "region outside": (["camera.mkv", "--roi", "80,80,57,57"], 2, "96x96"),
    "region below zero": (["camera.mkv", "--roi", "-1,0,40,40"], 2, "--roi"),
    "every none": (["camera.mkv", "--every", "0"], 2, "--every"),
    "unknown tracker": (["camera.mkv", "--tracker", "tmplate"], 2, "'template'"),
    "no rate": (["camera.mkv", "--rate-hz", "-1"], 2, "--rate-hz"),
    "too few frames": ([".", "--every", "500"], 3, "frames"),
}


@pytest.mark.parametrize("name", list(TRACKS))
def test_track_refuses_and_leaves_nothing(name, source, monkeypatch, tmp_path, capsys):
    arguments, code, word = TRACKS[name]
    monkeypatch.chdir(source)
    before = contents(source)
    assert run(["track", *arguments, "-o", str(tmp_path / "t.csv")]) == code
    assert word in capsys.readouterr().err
    assert contents(source) == before
    assert contents(tmp_path) == {}


OVER_OWN_FILES = {
    "result over acceleration": ["estimate", ".", "-o", "accel.csv"],
    "result over reference": ["estimate", ".", "-o", "truth.csv"],
    "result's JSON over the calibration": ["estimate", ".", "-o", "calibration.csv"],
    "calibration over the settings": ["calibrate", ".", "-o", "recording.toml"],
    "calibration over the video": ["calibrate", ".", "-o", "camera.mkv"],
    "track over acceleration": ["track", ".", "-o", "accel.csv"],
}


@pytest.mark.parametrize("name", list(OVER_OWN_FILES))
def test_no_command_writes_over_the_recordings_own_files(name, footbridge_copy, monkeypatch, capsys):
    (footbridge_copy / "calibration.json").write_text(good_calibration(footbridge_copy), encoding="utf-8")
    (footbridge_copy / "cal.json").unlink(missing_ok=True)
    monkeypatch.chdir(footbridge_copy)
    before = contents(footbridge_copy)
    assert run(OVER_OWN_FILES[name]) == 2
    assert capsys.readouterr().err
    assert contents(footbridge_copy) == before


def test_simulate_does_not_take_a_folder_that_holds_something_else(tmp_path, capsys):
    (tmp_path / "mine.txt").write_text("mine", encoding="utf-8")
    assert run(["simulate", "gnss", "-o", str(tmp_path)]) == 2
    assert "mine.txt" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["mine.txt"]


def test_simulate_names_the_nearest_scenario(tmp_path, capsys):
    assert run(["simulate", "footbrige", "-o", str(tmp_path / "new")]) == 2
    assert "'footbridge'" in capsys.readouterr().err
    assert not (tmp_path / "new").exists()


@pytest.mark.parametrize(
    ("arguments", "code", "word"),
    [
        (["nowhere.csv", "truth.csv"], 3, "nowhere.csv"),
        (["truth.csv", "nowhere.csv"], 3, "nowhere.csv"),
        (["truth.csv", "truth.csv", "--unit", "nonsense"], 2, "'nonsense'"),
        (["truth.csv", "truth.csv", "--unit", "s"], 2, "'s'"),
        (["truth.csv", "camera.mkv"], 2, "camera.mkv"),
    ],
)
def test_compare_refuses_what_is_no_displacement(arguments, code, word, source, monkeypatch, capsys):
    monkeypatch.chdir(source)
    assert run(["compare", *arguments]) == code
    assert word in capsys.readouterr().err


def test_compare_refuses_spans_that_do_not_meet(source, tmp_path, capsys):
    late = tmp_path / "late.csv"
    late.write_text("time_s,displacement_mm\n" + "".join(f"{900 + k},{k}\n" for k in range(9)), encoding="utf-8")
    assert run(["compare", str(source / "truth.csv"), str(late)]) == 3
    assert "no instants in common" in capsys.readouterr().err
