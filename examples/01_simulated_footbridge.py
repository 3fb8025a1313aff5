"""From a recording to displacement: simulate a footbridge, calibrate, estimate, compare with the truth.

The accelerometer sits on the bridge with a camera that looks at something fixed. Nothing about the target is known
beforehand, and the two clocks differ by 137 ms.
"""

import json
import tempfile
from pathlib import Path

import midspan
from midspan.simulate.scenarios.write import write

with tempfile.TemporaryDirectory() as folder:
    place = write("footbridge", Path(folder) / "footbridge", seed=1)
    known = json.loads((place / "known.json").read_text(encoding="utf-8"))["camera"]

    recording = midspan.open_recording(place)
    calibration = midspan.calibrate(recording)
    result = midspan.estimate(recording, calibration=calibration, method="smoother")
    result.save(place / "result.csv")
    figures = midspan.compare(result, place / "truth.csv")

    camera = calibration.to_dict()["camera"]
    print(f"scale factor  {camera['scale_mm_per_px']:.4f} ± {camera['scale_std_mm_per_px']:.4f} mm/px")
    print(f"       true   {known['scale_mm_per_px']:.4f} mm/px")
    print(f"clock offset  {1e3 * camera['time_offset_s']:.2f} ± {1e3 * camera['time_offset_std_s']:.2f} ms")
    print(f"       true   {1e3 * known['time_offset_s']:.2f} ms")
    print(result.to_pandas().head())
    print(f"rms error     {figures.rmse_mm:.4f} mm of {figures.reference_peak_to_peak_mm:.2f} mm peak to peak")
    print(f"inside ±1.96 standard deviations: {100 * (figures.coverage_95 or 0):.1f} %")
