"""Warnings of a method run exactly as printed."""

import shutil

import numpy as np
import pytest

import midspan
from recording_edits import acceleration, frames, set_keys, write_acceleration, write_stack


@pytest.fixture
def footbridge_copy(footbridge, tmp_path):
    folder = tmp_path / "footbridge"
    shutil.copytree(footbridge, folder)
    return folder


def test_a_run_away_of_the_printed_filter_is_told_also_where_a_frame_was_lost(footbridge_copy):
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
