"""A result of an hour at 200 Hz with measurements at 30 Hz: a mode, with noise as a recording has it."""

import numpy as np
from scipy.ndimage import gaussian_filter1d

from midspan.calibration.sensors.displacement import DisplacementCalibration
from midspan.engine.sensor_series import SensorSeries
from midspan.recording.result import Result
from midspan.records import Estimate, Innovation, Source, TimeOffset
from midspan.settings.load import validate
from midspan.settings.stored.calibration import Calibration

RATE_HZ, CAMERA_HZ, LENGTH_S = 200, 30, 3600
MODE_HZ = 2.1
NOISE_M_S2, CAMERA_NOISE_M = 2.5e-3, 5e-5


def hour_result(folder):
    """The result; its accelerometer's file is written to `folder`."""
    rng = np.random.default_rng(5)
    time_ns = np.arange(RATE_HZ * LENGTH_S, dtype=np.int64) * (10**9 // RATE_HZ)
    t, turn = time_ns / 1e9, 2 * np.pi * MODE_HZ
    size = 4e-3 * (1.2 + np.sin(2 * np.pi * t / 333.0))
    truth = size * np.sin(turn * t)
    acceleration = -(turn**2) * truth + NOISE_M_S2 * rng.standard_normal(len(t))
    np.savez(folder / "accel.npz", time_s=t, accel=acceleration)
    # A smoother's error varies slowly, over about a frame.
    error = gaussian_filter1d(rng.standard_normal(len(t)), RATE_HZ / CAMERA_HZ)
    value = truth + 1e-5 * error / error.std()
    phase = (np.arange(len(t)) * CAMERA_HZ / RATE_HZ) % 1.0
    variance = 1e-10 * (1.0 + 0.1 * phase * (1.0 - phase))
    source, status = np.full(len(t), Source.DISPLACEMENT, np.uint8), np.zeros(len(t), np.uint8)
    rows = Estimate(time_ns, value, variance, np.gradient(value, t), source, status)
    seen_ns = np.arange(CAMERA_HZ * LENGTH_S, dtype=np.int64) * 10**9 // CAMERA_HZ
    noise = CAMERA_NOISE_M * rng.standard_normal(len(seen_ns))
    seen = np.interp(seen_ns / 1e9, t, truth) + noise
    innovation = Innovation(seen_ns, noise, np.full(len(noise), CAMERA_NOISE_M**2), np.zeros(len(noise), dtype=np.int8))
    own = {"file": "accel.npz", "time": "time_s", "value": "accel", "unit": "m/s^2"}
    settings = validate({"accelerometer": own, "displacement": {"file": "d.csv"}}, "test")
    sensor = SensorSeries("displacement", Source.DISPLACEMENT, seen_ns, seen, np.full(len(seen), CAMERA_NOISE_M))
    known = DisplacementCalibration(CAMERA_NOISE_M, TimeOffset(0.0, np.inf))
    calibration = Calibration(NOISE_M_S2, 0.0, displacement=known)
    return Result(
        rows, calibration, settings, "smoother", innovation, (), (),
        measured=(sensor,), file=folder / "recording.toml", name="an hour",
    )  # fmt: skip
