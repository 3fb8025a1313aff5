"""A camera and a thermal camera from noon to noon, on a simulated recording: what the rows rest on, and the error.

24 hours of sun are squeezed into 4.4 minutes here. At night the camera sees nothing but passing headlights, and the
thermal camera carries on; at dusk and at dawn the sunlit surfaces lose their contrast of temperature, and turn it
around.
"""

import tempfile
from pathlib import Path

import numpy as np

import midspan
from midspan.simulate.scenarios.write import write

with tempfile.TemporaryDirectory() as folder:
    site = write("day-and-night", Path(folder) / "bridge", seed=1)
    # Every other frame, two a second, is enough here; all of them take twice as long and have nine tenths of the error.
    recording = midspan.open_recording(site, camera={"every": 2}, infrared={"every": 2})
    calibration = midspan.calibrate(recording)
    for camera in (calibration.camera, calibration.infrared):
        print(
            f"{camera.source.word:8s}  {1e3 * camera.scale.value_m_per_px:8.4f} mm/px, "
            f"clock offset {1e3 * camera.offset.value_s:6.1f} ms"
        )

    result = midspan.estimate(recording, calibration=calibration)
    truth = np.genfromtxt(site / "truth.csv", delimiter=",", names=True)
    error = result.displacement_mm - np.interp(result.time_s, truth["time_s"], truth["displacement_mm"])
    rows = result.to_pandas().assign(error=error, hour=lambda found: (24.0 * found.index / 264.0) // 3 * 3)
    print()
    print("hours after noon   rows by camera   by infrared   error rms (mm)   claimed (mm)")
    for hour, part in rows.groupby("hour"):
        shares = part["source"].value_counts(normalize=True)
        print(
            f"{hour:9.0f} to {hour + 3:2.0f}   {100 * shares['camera']:12.0f} %   {100 * shares['infrared']:9.0f} %"
            f"   {np.sqrt((part['error'] ** 2).mean()):14.3f}   {part['displacement_std_mm'].median():12.3f}"
        )

    rms, inside = np.sqrt(np.mean(error**2)), np.mean(np.abs(error) < 1.96 * result.displacement_std_mm)
    print(f"{'all':>15s}{'':31s}   {rms:14.3f}   {100 * inside:.1f} % inside 1.96 standard deviations")

    print()
    for event in result.events:
        if event.kind in ("dark", "lost", "seen"):
            print(f"{event.time_ns / 1e9:6.1f} s  {event.text}")
