"""The calibration of a recording as one record, and its JSON file."""

import json
import math
import os
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from midspan._version import __version__
from midspan.calibration.noise import NoiseCalibration
from midspan.calibration.scale import ScaleCalibration
from midspan.engine.monitor import CameraScale
from midspan.errors import DataError, UsageError
from midspan.records import Region, ScaleFactor, TimeOffset

CALIBRATION_FILE = "calibration.json"


@dataclass(frozen=True, slots=True)
class CameraCalibration:
    """Scale factor, clock offset, region, axis and noise of the camera.

    variance_factor: the learnt variance over the tracker's own.
    """

    scale: ScaleFactor
    offset: TimeOffset
    region: Region
    direction: str
    tracker: str
    noise_std_px: float
    variance_factor: float

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

    noise_density: of the acceleration, (m/s²)²/Hz; noise_std_m_s2: the same per sample; bias_m_s2: its mean in the
    window. diagnostics: what the estimates rest on, for the report; not stored in the file.
    """

    noise_density: float
    noise_std_m_s2: float
    bias_m_s2: float
    camera: CameraCalibration | None = None
    displacement: DisplacementCalibration | None = None
    warnings: tuple[str, ...] = ()
    created: str = field(default_factory=lambda: datetime.now(UTC).isoformat(timespec="seconds"))
    version: str = __version__
    diagnostics: "ScaleCalibration | NoiseCalibration | None" = field(default=None, compare=False, repr=False)

    def to_dict(self) -> dict[str, Any]:
        """The contents of `calibration.json`: mm, px, s and m/s²."""
        tree: dict[str, Any] = {
            "version": self.version,
            "created": self.created,
            "warnings": list(self.warnings),
            "accelerometer": {
                "noise_std_m_s2": self.noise_std_m_s2,
                "noise_density_m2_s4_hz": self.noise_density,
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
        partial = path.with_name(f".{path.name}.partial")
        try:
            partial.write_text(json.dumps(self.to_dict(), indent=2) + "\n", encoding="utf-8")
            os.replace(partial, path)
        except OSError as error:
            partial.unlink(missing_ok=True)
            raise UsageError(f"{path}: cannot be written ({error.strerror}). Choose another place with -o.") from None
        return path


def _camera_dict(camera: CameraCalibration) -> dict[str, Any]:
    region = camera.region
    return {
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
    """Read a `calibration.json` (or the folder that holds it); DataError where it is missing or damaged."""
    path = Path(path)
    path = path / CALIBRATION_FILE if path.is_dir() else path
    try:
        tree = json.loads(path.read_text(encoding="utf-8"))
        return calibration_from_dict(tree)
    except OSError as error:
        raise DataError(f"{path}: cannot be read ({error.strerror}). `midspan calibrate` writes one.") from None
    except (json.JSONDecodeError, KeyError, TypeError, ValueError, UnicodeDecodeError) as error:
        raise DataError(
            f"{path}: is not a calibration of midspan ({type(error).__name__}: {error}). Run `midspan calibrate` again."
        ) from None


def calibration_from_dict(tree: dict[str, Any]) -> Calibration:
    """The calibration that `Calibration.to_dict` describes; keys that only inform may be missing."""
    accelerometer = tree["accelerometer"]
    std = float(accelerometer["noise_std_m_s2"])
    camera, displacement = tree.get("camera"), tree.get("displacement")
    return Calibration(
        noise_density=float(accelerometer.get("noise_density_m2_s4_hz", std * std / 100.0)),
        noise_std_m_s2=std,
        bias_m_s2=float(accelerometer.get("bias_m_s2", 0.0)),
        camera=_camera_of(camera) if camera else None,
        displacement=_displacement_of(displacement) if displacement else None,
        warnings=tuple(tree.get("warnings", ())),
        created=str(tree.get("created", "")),
        version=str(tree.get("version", "")),
    )


def _camera_of(tree: dict[str, Any]) -> CameraCalibration:
    x, y, width, height = (int(number) for number in tree["roi"])
    scale = float(tree["scale_mm_per_px"]) / 1e3
    if not math.isfinite(scale) or scale == 0.0:
        raise ValueError("camera.scale_mm_per_px must be a finite number other than 0")
    return CameraCalibration(
        scale=ScaleFactor(scale, (float(tree.get("scale_std_mm_per_px", 0.0)) / 1e3) ** 2),
        offset=_offset_of(tree),
        region=Region(x, y, width, height),
        direction=str(tree.get("direction", "y")),
        tracker=str(tree.get("tracker", "template")),
        noise_std_px=float(tree.get("noise_std_px", 0.02)),
        variance_factor=float(tree.get("variance_factor", 1.0)),
    )


def _displacement_of(tree: dict[str, Any]) -> DisplacementCalibration:
    return DisplacementCalibration(float(tree["noise_std_mm"]) / 1e3, _offset_of(tree))


def _offset_of(tree: dict[str, Any]) -> TimeOffset:
    std = tree.get("time_offset_std_s")
    return TimeOffset(float(tree.get("time_offset_s", 0.0)), math.inf if std is None else float(std) ** 2)
