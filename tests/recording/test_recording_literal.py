"""Warnings of a method run exactly as printed."""

import json
import shutil

import numpy as np
import pytest

import midspan
from midspan.cli.main import run
from recording_edits import acceleration, frames, set_keys, write_acceleration, write_displacement, write_stack


@pytest.fixture
def footbridge_copy(footbridge, tmp_path):
    folder = tmp_path / "footbridge"
    shutil.copytree(footbridge, folder)
    return folder


def test_a_run_away_of_the_printed_filter_is_reported_also_where_a_frame_was_lost(footbridge_copy):
    # 0.1 m/s² more than at the calibration: what is taken off does not hold it, and the printed filter has no bias.
    calibration = midspan.calibrate(midspan.open_recording(footbridge_copy))
    time, value = acceleration(footbridge_copy)
    write_acceleration(footbridge_copy, time, value + 0.1)
    stack = frames(footbridge_copy)
    stack[60] = 0
    write_stack(footbridge_copy, stack)
    set_keys(footbridge_copy, "fusion", method="adaptive-kalman", literal=True)
    found = midspan.estimate(midspan.open_recording(footbridge_copy), calibration=calibration)
    lost = ~np.isfinite(found.track.along(calibration.direction)[0])
    assert lost[60]
    assert any("it runs away" in text for text in found.warnings)


@pytest.mark.parametrize(
    ("rate_hz", "method", "keys", "delay_s"),
    [
        # The radar paper: an order of 101 at 100 Hz, 0.5 s; the spline looks 0.015 s ahead.
        (100.0, "fir", {"half_window": 50, "spline_frames": 0}, 0.5 + 0.015),
        # The existing technique of the two-stage paper: 1.5 periods of 1 Hz to each side.
        (10.0, "fir", {"cut_off_hz": 1.0}, 1.5 + 0.55),
        # The two-stage paper: 2.5 s at 3 frames a second.
        (3.0, "two-stage-fir", {"taps": 201, "anti_alias_taps": 201, "spline_frames": 0}, 2.0 + 0.5),
        (3.0, "two-stage-fir", {"transition_hz": [0.4, 1.0], "taps": 151, "anti_alias_taps": 251}, 2.0 + 5.5 / 3),
    ],
)
def test_the_keys_of_the_fir_methods_reach_them_by_the_command(tmp_path, capsys, rate_hz, method, keys, delay_s):
    rng = np.random.default_rng(2)
    time, met = np.arange(0.0, 40.0, 0.01), np.arange(0.0, 40.0, 1.0 / rate_hz)
    size, omega = np.array([8.0, 3.0]), 2.0 * np.pi * np.array([0.1, 2.2])
    value = 1e-3 * (-np.sin(np.outer(time, omega)) @ (size * omega**2)) + rng.normal(0.0, 1e-3, len(time))
    seen = np.sin(np.outer(met, omega)) @ size + rng.normal(0.0, 0.05, len(met))
    write_displacement(tmp_path, (time, value), (met, seen))
    set_keys(tmp_path, "fusion", **keys)
    assert run(["estimate", str(tmp_path), "--method", method, "--literal", "--json"]) == 0
    reported = json.loads(capsys.readouterr().out)["figures"]
    # Two samples more, with an anti-aliasing filter three, and part of one.
    assert reported["delay_s"] == pytest.approx(delay_s + 0.03, abs=0.011)
    stored = json.loads((tmp_path / "result.json").read_text())
    assert stored["delay_s"] == reported["delay_s"]
    assert stored["settings"]["fusion"]["literal"]
    result = np.genfromtxt(tmp_path / "result.csv", delimiter=",", names=True, dtype=None, encoding=None)
    error = result["displacement_mm"] - np.sin(np.outer(result["time_s"], omega)) @ size
    # The existing technique keeps what 2.2 Hz aliases to at 3 a second; none of these cases does.
    assert np.std(error[1000:-1000]) < 0.3
