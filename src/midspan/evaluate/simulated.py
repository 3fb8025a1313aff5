"""What a simulated recording allows: the least error for the noise that was put into it."""

import json
from typing import Any

import numpy as np

from midspan.errors import UsageError
from midspan.evaluate.bound import zeroed_bound
from midspan.recording.result import Result
from midspan.records import Acceleration, Displacement, Source
from midspan.simulate.scenarios.table import pixel_bound

KNOWN_FILE = "known.json"


def least_error_mm(result: Result) -> float:
    """The least rms error (mm) of a camera's result from a simulated recording, its zero at the first frame included.

    From the Cramér-Rao bound of the region, the accelerometer's known noise and the true stamps. Raises UsageError
    where the recording is not simulated or has no camera.
    """
    recording, camera = result.recording, result.calibration.first_camera
    file = None if recording is None else recording.folder / KNOWN_FILE
    track = result.track
    if recording is None or file is None or not file.is_file() or camera is None or track is None:
        raise UsageError("The least error is only known for a simulated recording with a camera (with its known.json).")
    known: dict[str, Any] = json.loads(file.read_text(encoding="utf-8"))
    bounds = pixel_bound(known["scenario"], camera.region, seed=known["seed"])
    std_m = bounds["xy".index(camera.direction)] * abs(known["camera"]["scale_mm_per_px"]) / 1e3
    camera_ns = track.time_ns + round(1e9 * known["camera"]["time_offset_s"])
    prepared = recording.prepared
    density = known["accelerometer"]["noise_std_m_s2"] ** 2 / prepared.rate_hz
    n, m = len(prepared.time_ns), len(camera_ns)
    acceleration = Acceleration(prepared.time_ns, np.zeros(n), np.full(n, density))
    source = np.full(m, Source.CAMERA, dtype=np.uint8)
    return 1e3 * zeroed_bound(acceleration, Displacement(camera_ns, np.zeros(m), np.full(m, std_m**2), source))
