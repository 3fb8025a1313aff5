"""The calibration of a recording as one record, and its JSON file."""

import json
import math
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from midspan._version import __version__
from midspan.calibration.noise import NoiseCalibration
from midspan.calibration.scale import ScaleCalibration
from midspan.engine.monitor import CameraScale
from midspan.errors import DataError
from midspan.records import Region, ScaleFactor, TimeOffset
from midspan.sinks.replace import replacing

CALIBRATION_FILE = "calibration.json"


@dataclass(frozen=True, slots=True)
class CameraCalibration:
    """Scale factor, clock offset, region, axis and noise of the camera.

    variance_factor: the learnt variance over the tracker's own. phase_scale_m_per_rad: displacement per radian of the
    active pixels' mean phase, with the trackers that use it.
    """

    scale: ScaleFactor
    offset: TimeOffset
    region: Region
    direction: str
    tracker: str
    noise_std_px: float
    variance_factor: float
    phase_scale_m_per_rad: float | None = None

    def mapping(self) -> CameraScale:
        """What turns this camera's pixels into metres."""
        return CameraScale(
            scale_m_per_px=self.scale.value_m_per_px,
            direction=self.direction,
            time_offset_ns=round(1e9 * self.offset.value_s),
            variance_factor=self.variance_factor,
        )


@dataclass(frozen=True, slots=True)
class DisplacementCalibration:
    """Noise per measurement (m) and clock offset of a displacement sensor."""

    noise_std_m: float
    offset: TimeOffset


@dataclass(frozen=True, slots=True)
class Calibration:
    """Everything `calibrate` learns about a recording's sensors.

    noise_std_m_s2: white noise of the acceleration per sample; bias_m_s2: its mean in the window. diagnostics: what the
    estimates rest on, for the report; not stored in the file.
    """

    noise_std_m_s2: float
    bias_m_s2: float
    camera: CameraCalibration | None = None
    displacement: DisplacementCalibration | None = None
    warnings: tuple[str, ...] = ()
    created: str = field(default_factory=lambda: datetime.now(UTC).isoformat(timespec="seconds"))
    version: str = __version__
    diagnostics: "ScaleCalibration | NoiseCalibration | None" = field(default=None, compare=False, repr=False)

    def noise_density(self, rate_hz: float) -> float:
        """Two-sided density of the acceleration's noise, (m/s²)²/Hz, at the accelerometer's rate."""
        return self.noise_std_m_s2**2 / rate_hz

    def to_dict(self) -> dict[str, Any]:
        """The contents of `calibration.json`: mm, px, s and m/s²."""
        tree: dict[str, Any] = {
            "version": self.version,
            "created": self.created,
            "warnings": list(self.warnings),
            "accelerometer": {
                "noise_std_m_s2": self.noise_std_m_s2,
                "bias_m_s2": self.bias_m_s2,
            },
        }
        if self.camera:
            tree["camera"] = _camera_dict(self.camera)
        if self.displacement:
            offset = self.displacement.offset
            tree["displacement"] = {
                "noise_std_mm": 1e3 * self.displacement.noise_std_m,
                "time_offset_s": offset.value_s,
                "time_offset_std_s": _finite_or_none(math.sqrt(offset.variance)),
            }
        return tree

    def save(self, path: str | Path) -> Path:
        """Write `calibration.json`; a folder gets a file of that name."""
        path = Path(path)
        path = path / CALIBRATION_FILE if path.is_dir() else path
        with replacing(path) as (partial,):
            partial.write_text(json.dumps(self.to_dict(), indent=2) + "\n", encoding="utf-8")
        return path


def _camera_dict(camera: CameraCalibration) -> dict[str, Any]:
    region = camera.region
    phase = camera.phase_scale_m_per_rad
    return {
        **({} if phase is None else {"phase_scale_mm_per_rad": 1e3 * phase}),
        "scale_mm_per_px": 1e3 * camera.scale.value_m_per_px,
        "scale_std_mm_per_px": 1e3 * math.sqrt(camera.scale.variance),
        "time_offset_s": camera.offset.value_s,
        "time_offset_std_s": _finite_or_none(math.sqrt(camera.offset.variance)),
        "roi": [region.x, region.y, region.width, region.height],
        "direction": camera.direction,
        "tracker": camera.tracker,
        "noise_std_px": camera.noise_std_px,
        "variance_factor": camera.variance_factor,
    }


def _finite_or_none(value: float) -> float | None:
    return value if math.isfinite(value) else None


def load_calibration(path: str | Path) -> Calibration:
    """Read a `calibration.json` (or the folder that holds it).

    Raises DataError naming file and key where it is missing, damaged or holds a value that cannot be.
    """
    path = Path(path)
    path = path / CALIBRATION_FILE if path.is_dir() else path
    try:
        tree = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise DataError(f"{path}: cannot be read ({error.strerror}). `midspan calibrate` writes one.") from None
    except (json.JSONDecodeError, UnicodeDecodeError) as error:
        raise DataError(f"{path}: is not JSON ({error}). Run `midspan calibrate` again.") from None
    try:
        return calibration_from_dict(tree)
    except _WrongValueError as error:
        raise DataError(f"{path}: {error}. Run `midspan calibrate` again.") from None


class _WrongValueError(ValueError):
    """A key of a calibration that is missing or holds what it cannot."""


def calibration_from_dict(tree: dict[str, Any]) -> Calibration:
    """The calibration that `Calibration.to_dict` describes; keys that only inform may be missing."""
    accelerometer = _section(tree, "accelerometer")
    if accelerometer is None:
        raise _WrongValueError("accelerometer is missing")
    camera, displacement = _section(tree, "camera"), _section(tree, "displacement")
    warnings = tree.get("warnings", [])
    return Calibration(
        noise_std_m_s2=_number(accelerometer, "accelerometer.noise_std_m_s2", positive=True),
        bias_m_s2=_number(accelerometer, "accelerometer.bias_m_s2", default=0.0),
        camera=_camera_of(camera) if camera else None,
        displacement=_displacement_of(displacement) if displacement else None,
        warnings=tuple(str(line) for line in warnings) if isinstance(warnings, list) else (),
        created=str(tree.get("created", "")),
        version=str(tree.get("version", "")),
    )


def _section(tree: Any, name: str) -> dict[str, Any] | None:
    section = tree.get(name) if isinstance(tree, dict) else None
    if section is not None and not isinstance(section, dict):
        raise _WrongValueError(f"{name} must be an object with keys; received {section!r}")
    return section


def _number(section: dict[str, Any], key: str, default: float | None = None, positive: bool = False) -> float:
    value = section.get(key.rpartition(".")[2], default)
    if value is None:
        raise _WrongValueError(f"{key} is missing")
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise _WrongValueError(f"{key} must be a finite number; received {value!r}")
    if positive and value <= 0:
        raise _WrongValueError(f"{key} must be above 0; received {value!r}")
    return float(value)


def _std(section: dict[str, Any], key: str, default: float | None = None) -> float:
    value = _number(section, key, default)
    if value < 0:
        raise _WrongValueError(f"{key} must be 0 or more; received {value!r}")
    return value


def _camera_of(tree: dict[str, Any]) -> CameraCalibration:
    scale = _number(tree, "camera.scale_mm_per_px") / 1e3
    if scale == 0.0:
        raise _WrongValueError("camera.scale_mm_per_px must not be 0")
    direction = tree.get("direction", "y")
    if direction not in ("x", "y"):
        raise _WrongValueError(f'camera.direction must be "x" or "y"; received {direction!r}')
    return CameraCalibration(
        scale=ScaleFactor(scale, (_std(tree, "camera.scale_std_mm_per_px", 0.0) / 1e3) ** 2),
        offset=_offset_of(tree, "camera"),
        region=_region_of(tree),
        direction=direction,
        tracker=str(tree.get("tracker", "template")),
        noise_std_px=_number(tree, "camera.noise_std_px", 0.02, positive=True),
        variance_factor=_number(tree, "camera.variance_factor", 1.0, positive=True),
        phase_scale_m_per_rad=(
            _number(tree, "camera.phase_scale_mm_per_rad") / 1e3 if "phase_scale_mm_per_rad" in tree else None
        ),
    )


def _region_of(tree: dict[str, Any]) -> Region:
    roi = tree.get("roi")
    if not (
        isinstance(roi, list) and len(roi) == 4 and all(type(n) is int and n >= 0 for n in roi) and min(roi[2:]) > 0
    ):
        raise _WrongValueError(f"camera.roi must be four whole numbers x, y, width, height in px; received {roi!r}")
    return Region(*roi)


def _displacement_of(tree: dict[str, Any]) -> DisplacementCalibration:
    std = _number(tree, "displacement.noise_std_mm", positive=True)
    return DisplacementCalibration(std / 1e3, _offset_of(tree, "displacement"))


def _offset_of(tree: dict[str, Any], section: str) -> TimeOffset:
    unknown = tree.get("time_offset_std_s", 0.0) is None
    std = math.inf if unknown else _std(tree, f"{section}.time_offset_std_s", 0.0)
    return TimeOffset(_number(tree, f"{section}.time_offset_s"), std**2)
