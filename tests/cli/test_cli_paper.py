"""`--paper`: all as one paper has it, or a refusal; what `replay` leaves where it is refused."""

import json

import numpy as np
import pytest

from lively_recordings import Lively, write
from midspan.cli.main import run
from midspan.simulate.radar.signal import Reflector
from radar_recordings import PLATE, Case
from radar_recordings import write as write_radar
from recording_edits import set_keys

LIVELY = Lively(duration_s=16.0, band_hz=(1.0, 3.0), rms_m=2e-3)


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    place = tmp_path_factory.mktemp("paper")
    wall = Case((Reflector(3.4, 900.0, ratio=1 / 1.27), PLATE), seed=1, rms_m=1e-3)
    return {
        "camera": write(place / "camera", LIVELY, "camera"),
        "displacement": write(place / "displacement", LIVELY, "displacement"),
        "radar": write_radar(place / "radar", wall),
    }


def test_a_papers_calibration_and_method_are_one_option(folders, tmp_path, capsys):
    file, result = tmp_path / "c.json", tmp_path / "r.csv"
    assert run(["calibrate", str(folders["radar"]), "--literal", "-o", str(file), "--quiet"]) == 0
    assert json.loads(file.read_text())["radar"]["literal"] is True
    asked = ["estimate", str(folders["radar"]), "-c", str(file), "-o", str(result), "--quiet", "--json"]
    assert run([*asked, "--paper", "002"]) == 0
    assert json.loads(result.with_suffix(".json").read_text())["settings"]["fusion"]["literal"] is True
    first = np.genfromtxt(result, delimiter=",", names=True, dtype=None, encoding=None)
    assert run([*asked, "--method", "fir", "--literal"]) == 0
    again = np.genfromtxt(result, delimiter=",", names=True, dtype=None, encoding=None)
    assert np.array_equal(first["displacement_mm"], again["displacement_mm"])


@pytest.mark.parametrize(
    ("kind", "options", "words"),
    [
        ("camera", ["--paper", "000", "--method", "kalman"], "remove --method"),
        ("camera", ["--paper", "002"], "has no [radar], which this paper needs"),
        ("displacement", ["--paper", "001"], "has no [camera] or [infrared]"),
        ("displacement", ["--method", "kalman", "--literal"], "literal = true needs the method of a paper"),
    ],
)
def test_what_does_not_fit_is_refused_and_leaves_no_store(folders, tmp_path, capsys, kind, options, words):
    store = tmp_path / "store"
    assert run(["replay", str(folders[kind]), "-o", str(store), *options]) == 2
    assert words in capsys.readouterr().err
    assert not store.exists()


def test_a_calibration_without_the_sensor_is_refused_by_replay_as_by_estimate(folders, tmp_path, capsys):
    file, store = tmp_path / "c.json", tmp_path / "store"
    assert run(["calibrate", str(folders["radar"]), "-o", str(file), "--quiet"]) == 0
    for command, target in (("estimate", tmp_path / "r.csv"), ("replay", store)):
        assert run([command, str(folders["displacement"]), "-c", str(file), "-o", str(target)]) == 2
        assert "The calibration has no displacement part" in capsys.readouterr().err
        assert not target.exists()


@pytest.mark.parametrize(
    ("method", "key", "value"), [("two-stage-fir", "transition_hz", [0.5, 200.0]), ("fir", "cut_off_hz", 80.0)]
)
def test_a_filter_beyond_half_the_rate_is_refused_by_its_key(folders, tmp_path, capsys, method, key, value):
    folder = write(tmp_path / "own", LIVELY, "displacement")
    set_keys(folder, "fusion", **{key: value})
    assert run(["replay", str(folder), "-o", str(tmp_path / "store"), "--method", method]) == 2
    assert f"fusion.{key} must be below half the accelerometer's rate (50 Hz)" in capsys.readouterr().err
    assert not (tmp_path / "store").exists()
