"""midspan: displacement of structures in millimetres, from an accelerometer and a camera, with an honest error band.

    recording = midspan.open_recording("footbridge/")
    calibration = midspan.calibrate(recording)
    result = midspan.estimate(recording, calibration=calibration, method="smoother")
    result.save("result.parquet")

Names are looked up when first used, so that importing midspan is quick.
"""

from midspan._version import __version__
from midspan.caches import prepare as _prepare_caches

TYPE_CHECKING = False  # typing alone takes longer to import than the rest of this file
if TYPE_CHECKING:
    from typing import Any

_prepare_caches()

_PLACES = {
    "Acceleration": "records",
    "Calibration": "settings.stored.calibration",
    "DataError": "errors",
    "Displacement": "records",
    "Estimate": "records",
    "Frame": "records",
    "KalmanFilter": "fusion.streams",
    "KalmanSettings": "fusion.streams",
    "MidspanError": "errors",
    "Pair": "calibration.fit",
    "Prediction": "records",
    "Rates": "fusion.model",
    "Recording": "recording.streams.recording",
    "Region": "records",
    "Result": "recording.result",
    "UntrustedError": "errors",
    "UsageError": "errors",
    "batch": "scale.batch",
    "calibrate": "recording.calibrate",
    "calibrate_noise": "calibration.noise",
    "calibrate_scale": "calibration.scale",
    "choose_region": "vision.roi",
    "compare": "evaluate.result_file",
    "estimate": "recording.estimate",
    "load_calibration": "settings.stored.calibration",
    "open_recording": "recording.streams.recording",
    "open_tracker": "vision.tracker",
    "smooth": "fusion.streams",
    "track": "recording.tracking.track",
    "write_report": "report.report",
}

__all__ = ["__version__", *sorted(_PLACES)]


def __getattr__(name: str) -> "Any":
    if name not in _PLACES:
        raise AttributeError(f"module 'midspan' has no attribute {name!r}")
    import importlib

    value = getattr(importlib.import_module(f"midspan.{_PLACES[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return __all__
