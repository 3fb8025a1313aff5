"""A radar together with the accelerometer, on a simulated recording: targets, limit speed, and the result against the
truth.

A tall building sways by 40 mm at 0.3 Hz. Its radar looks at the facade opposite, and the range to it changes faster
than the phase can be unwrapped from frame to frame; with the accelerometer it can.
"""

import tempfile
from pathlib import Path

import numpy as np

import midspan
from midspan.simulate.scenarios.write import write

with tempfile.TemporaryDirectory() as folder:
    site = write("radar-tall-building", Path(folder) / "building", seed=1)
    recording = midspan.open_recording(site)
    calibration = midspan.calibrate(recording)
    print("range (m)   conversion factor      coherence   used")
    for item in calibration.radar.targets:
        target = item.target
        factor = f"{target.conversion_factor:8.5f} ± {target.conversion_factor_std:.5f}" if target.coherence else ""
        print(f"{target.range_m:9.2f}   {factor:18s}   {target.coherence:9.4f}   {item.reason or 'yes'}")
    print(f"clock offset: {1e3 * calibration.radar.offset.value_s:.2f} ms")

    result = midspan.estimate(recording, calibration=calibration)
    truth = np.genfromtxt(site / "truth.csv", delimiter=",", names=True)
    trace, (alone,) = result.radar, result.measured
    speed, limit = 1e3 * trace.speed_m_s, 1e3 * trace.limit_speed_m_s
    print()
    print(f"range to the best target: up to {speed:.0f} mm/s; plain unwrapping fails from {limit:.0f} mm/s on")
    for what, value, time_s in (
        ("radar alone", 1e3 * alone.value_m, alone.time_ns / 1e9),
        ("radar and accelerometer", result.displacement_mm, result.time_s),
    ):
        error = value - np.interp(time_s, truth["time_s"], truth["displacement_mm"])
        print(f"{what}: {np.nanstd(value):.2f} mm rms, error {np.nanstd(error):.4f} mm rms about its mean")
