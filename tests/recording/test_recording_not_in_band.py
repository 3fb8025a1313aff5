"""What no band can contain stands in one list with sizes of this recording, and is no warning."""

import json
import re

import numpy as np
import pytest

import midspan
from lively_recordings import Lively, write
from midspan.cli.main import run
from midspan.recording.not_in_band import DELAY, SENSITIVITY, SLOW_ERROR
from recording_edits import set_keys


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return write(tmp_path_factory.mktemp("not_in_band") / "displacement", Lively(duration_s=25.0), "displacement", "")


def size_mm(lines, cause):
    (line,) = (line for line in lines if cause in line)
    return float(re.search(r"([\d.e+-]+) mm", line)[1])


def test_a_slow_error_that_would_not_show_is_no_warning_and_has_its_size(folder, tmp_path, capsys):
    assert run(["estimate", str(folder), "-o", str(tmp_path / "r.csv"), "--verbose"]) == 0
    printed = capsys.readouterr()
    assert "slow error" not in printed.err
    assert printed.out.count("not in the band") == 1
    assert "slow error" in printed.out
    said = json.loads((tmp_path / "r.json").read_text())
    # An accelerometer's noise hides some millimetres in 10 s, and not the motion's own size.
    assert 0.1 < size_mm(said["not_in_band"], SLOW_ERROR) < 50.0
    kept = tmp_path / "calibration.json"
    kept.write_text(json.dumps(said["calibration"]))
    assert list(midspan.estimate(folder, calibration=kept).not_in_band) == said["not_in_band"]


def test_declared_as_white_nothing_is_said_of_it(folder):
    set_keys(folder, "displacement", noise_time_s=0.0)
    assert not any(SLOW_ERROR in line for line in midspan.estimate(folder).not_in_band)
    set_keys(folder, "displacement", noise_time_s=None)


def test_tolerance_and_delay_are_sized_by_displacement_and_velocity(folder):
    set_keys(folder, "displacement", estimate_scale=True, estimate_offset=True)
    result = midspan.estimate(folder)
    set_keys(folder, "displacement", estimate_scale=None, estimate_offset=None)
    # Two digits are printed.
    assert size_mm(result.not_in_band, SENSITIVITY) == pytest.approx(0.01 * np.std(result.displacement_mm), rel=0.06)
    speed = np.sqrt(np.mean(result.velocity_mm_s**2))
    assert size_mm(result.not_in_band, DELAY) == pytest.approx(1e-3 * speed, rel=0.06)
