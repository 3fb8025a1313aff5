"""Several targets of one camera, and motion along both axes of the image, on two simulated recordings.

Each target has its own distance and so its own scale factor; the one that swings on its own is found out.
"""

import tempfile
from pathlib import Path

import numpy as np

import midspan
from midspan.simulate.scenarios.write import write

with tempfile.TemporaryDirectory() as folder:
    site = write("several-targets", Path(folder) / "targets", seed=1)
    result = midspan.estimate(midspan.open_recording(site))
    print("target      mm/px              noise (mm)   used")
    for target in result.calibration.camera.targets:
        value, std = 1e3 * target.scale.value_m_per_px, 1e3 * target.scale.variance**0.5
        noise = abs(value) * target.noise_std_px
        print(f"{target.name:10s}  {value:.4f} ± {std:.4f}   {noise:10.4f}   {target.used}")

    site = write("two-axes", Path(folder) / "axes", seed=1)
    result = midspan.estimate(midspan.open_recording(site))
    truth = np.genfromtxt(site / "truth.csv", delimiter=",", names=True)
    print()
    for axis, value, column in (
        (result.axis, result.displacement_mm, "displacement_mm"),
        (result.across.axis, result.across.displacement_mm, f"displacement_{result.across.axis}_mm"),
    ):
        error = value - np.interp(result.time_s, truth["time_s"], truth[column])
        print(f"along {axis}: {np.std(value):.3f} mm rms, error {np.std(error):.4f} mm rms about its mean")
