"""A recording that begins at rest is calibrated in its liveliest minute."""

import re
from dataclasses import dataclass

import numpy as np
import pytest

import midspan
from lively_recordings import SCALE_MM_PER_PX, Lively, write
from recording_edits import set_keys
from repeats import slow


@dataclass(frozen=True)
class Late(Lively):
    """At rest for 70 s, then in motion, which grows within ten seconds."""

    def motion(self, at_s, derivative=0):
        """Broad-band motion times an envelope; the acceleration by differences, right to 3e-5 m/s²."""
        if derivative == 2:
            step_s = 1e-3
            here, before, after = (self.motion(np.asarray(at_s) + k * step_s) for k in (0, -1, 1))
            return (before - 2.0 * here + after) / step_s**2
        ahead = np.clip((np.asarray(at_s, dtype=float) - 70.0) / 10.0, 0.0, 1.0)
        return super().motion(at_s) * np.sin(0.5 * np.pi * ahead) ** 4


@pytest.mark.parametrize("sensor", ["displacement", *slow("camera")])
def test_a_recording_that_begins_at_rest_is_calibrated_later(sensor, tmp_path):
    case = Late(duration_s=140.0, rms_m=3e-3, noise_m=0.05e-3)
    folder = write(tmp_path / "site", case, sensor)
    found = midspan.calibrate(folder)
    if sensor == "camera":
        (said,) = [line for line in found.warnings if "liveliest" in line]
        first_s, last_s = map(float, re.search(r"liveliest minute, ([\d.]+) to ([\d.]+) s", said).groups())
        assert 70.0 <= first_s < last_s <= 140.0
        assert abs(found.camera.scale.value_m_per_px * 1e3 - SCALE_MM_PER_PX) < 4e3 * np.sqrt(
            found.camera.scale.variance
        )
        assert np.sqrt(found.camera.scale.variance) * 1e3 < 0.01 * abs(SCALE_MM_PER_PX)
    result = midspan.estimate(folder)
    error = result.displacement_mm - case.from_zero_mm(result.time_s)
    assert np.mean(np.abs(error) < 1.96 * result.displacement_std_mm) > 0.9


def test_a_window_that_is_given_is_kept(tmp_path):
    folder = write(tmp_path / "site", Late(duration_s=140.0, rms_m=3e-3), "camera")
    set_keys(folder, "calibration", window_s=[0.0, 60.0])
    with pytest.raises(midspan.UntrustedError, match="Too little motion"):
        midspan.calibrate(folder)
