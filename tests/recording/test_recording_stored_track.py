"""A track in place of a camera's images: calibrated and fused as the camera itself."""

import numpy as np
import pytest

import midspan
from midspan.simulate.motion.motion import Sines

MM_PER_PX, NOISE_PX, OFFSET_S = -1.5, 0.02, 0.04


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    folder, rng = tmp_path_factory.mktemp("track"), np.random.default_rng(2)
    motion = Sines(np.array([2e-3, 1e-3]), np.array([0.8, 2.3]), phase_rad=np.array([0.3, 1.1]))
    fast, slow = np.arange(0.0, 60.0, 0.01), np.arange(0.2, 59.5, 0.1)
    accel = motion.acceleration(fast) + rng.normal(0.0, 2e-3, len(fast))
    y_px = 1e3 * motion.displacement(slow) / MM_PER_PX + rng.normal(0.0, NOISE_PX, len(slow))
    x_px = rng.normal(0.0, NOISE_PX, len(slow))
    for name, head, columns in (
        ("accel", "time_s,accel", (fast, accel)),
        ("track", "time_s,x_px,y_px", (slow - OFFSET_S, x_px, y_px)),
    ):
        np.savetxt(folder / f"{name}.csv", np.column_stack(columns), "%.9f", ",", header=head, comments="")
    (folder / "recording.toml").write_text(
        '[accelerometer]\nfile = "accel.csv"\nunit = "m/s^2"\n[camera]\nfile = "track.csv"\ndirection = "y"\n'
    )
    return folder, motion


def test_a_track_is_calibrated_and_fused(recording):
    folder, motion = recording
    calibration = midspan.calibrate(folder)
    camera = calibration.to_dict()["camera"]
    assert abs(camera["scale_mm_per_px"] - MM_PER_PX) < 4.0 * camera["scale_std_mm_per_px"] < 0.02
    assert abs(camera["time_offset_s"] - OFFSET_S) < 4.0 * camera["time_offset_std_s"] < 0.01
    result = midspan.estimate(folder, calibration=calibration)
    error = result.displacement_mm - 1e3 * motion.displacement(result.time_s)
    # The zero is the first frame's: one draw, common to all rows.
    error -= np.mean(error)
    assert np.mean(np.abs(error) < 1.96 * result.displacement_std_mm) > 0.9
    # 30 µm a frame ten times a second, smoothed by the acceleration.
    assert np.std(error) < 0.02
