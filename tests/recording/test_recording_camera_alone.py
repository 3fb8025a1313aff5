"""A recording of a camera alone: it can be looked at and tracked, with several targets too, and nothing else."""

import json
import tomllib
from pathlib import Path

import numpy as np
import pytest
import tomli_w

from midspan.cli.main import run

TARGETS = [{"roi": [8, 8, 32, 32], "name": "left"}, {"roi": [48, 48, 32, 32], "name": "right"}]


@pytest.fixture
def alone(footbridge_copy: Path) -> Path:
    """The footbridge without its accelerometer."""
    rewrite(footbridge_copy)
    return footbridge_copy


def rewrite(folder: Path, **camera: object) -> None:
    """Keep [camera] alone, with these keys; None takes one away."""
    tree = tomllib.loads((folder / "recording.toml").read_text(encoding="utf-8"))
    kept = {key: value for key, value in {**tree["camera"], **camera}.items() if value is not None}
    (folder / "recording.toml").write_text(tomli_w.dumps({"camera": kept}), encoding="utf-8")


def test_several_targets_are_tracked_without_an_accelerometer(alone: Path) -> None:
    rewrite(alone, roi=None, target=TARGETS)
    assert run(["track", str(alone), "-o", str(alone / "track.csv"), "-q"]) == 0
    table = np.genfromtxt(alone / "track.csv", delimiter=",", names=True, usecols=range(5), encoding="utf-8")
    header = (alone / "track.csv").read_text(encoding="utf-8").splitlines()[0].split(",")
    assert header[:6] == ["time_s", "x_px", "y_px", "std_x_px", "std_y_px", "status"]
    assert header[6:] == [f"{name}_right" for name in header[1:6]]
    # One rigid picture moves: both targets move by the same pixels, up to the noise of each.
    both = np.genfromtxt(alone / "track.csv", delimiter=",", usecols=(2, 7), skip_header=1)
    assert np.ptp(both[:, 0]) > 0.2
    assert np.std(both[:, 0] - both[:, 1]) < 0.1
    assert len(table) > 100


def test_a_camera_alone_gives_the_same_track_as_the_camera_of_a_whole_recording(
    footbridge: Path, alone: Path, tmp_path: Path
) -> None:
    assert run(["track", str(footbridge), "-o", str(tmp_path / "whole.csv"), "-q"]) == 0
    assert run(["track", str(alone), "-o", str(tmp_path / "alone.csv"), "-q"]) == 0
    assert (tmp_path / "alone.csv").read_text() == (tmp_path / "whole.csv").read_text()


@pytest.mark.parametrize("direction", ["x", "y", "xy"])
def test_a_camera_alone_can_be_checked_and_inspected(
    alone: Path, capsys: pytest.CaptureFixture[str], direction: str
) -> None:
    rewrite(alone, direction=direction)
    assert run(["check-config", str(alone)]) == 0
    capsys.readouterr()
    assert run(["inspect", str(alone), "--json"]) == 0
    tree = json.loads(capsys.readouterr().out)
    assert "camera" in tree
    assert "accelerometer" not in tree


@pytest.mark.parametrize("command", [["estimate", "-o", "o.csv"], ["calibrate", "-o", "c.json"]])
def test_estimation_and_calibration_demand_an_accelerometer(
    alone: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], command: list[str]
) -> None:
    assert run([command[0], str(alone), "-o", str(tmp_path / command[2])]) == 2
    said = capsys.readouterr().err
    assert "recording.toml: has no [accelerometer], which calibration and estimation need" in said
    assert "midspan track" in said


@pytest.mark.parametrize("section", ['[displacement]\nfile = "a.csv"\n', '[radar]\nfile = "a.bin"\n', 'name = "x"\n'])
def test_a_recording_of_anything_else_must_have_an_accelerometer(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], section: str
) -> None:
    (tmp_path / "recording.toml").write_text(section)
    assert run(["check-config", str(tmp_path)]) == 2
    assert "has no [accelerometer]" in capsys.readouterr().err
