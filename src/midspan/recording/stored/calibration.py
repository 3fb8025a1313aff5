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
from midspan.recording.stored.radar import RadarCalibration
from midspan.records import Region, ScaleFactor, Source, TimeOffset
from midspan.sinks.replace import replacing
from midspan.vision.lens import Lens

CALIBRATION_FILE = "calibration.json"


@dataclass(frozen=True, slots=True)
class TargetCalibration:
    """What was learnt of one of several targets; scale None where it was refused.

    used: whether the result rests on it; reason: why not. variance_factor: the learnt variance over the tracker's own.
    """

    region: Region
    name: str
    scale: ScaleFactor | None
    noise_std_px: float = math.nan
    variance_factor: float = math.nan
    used: bool = True
    reason: str = ""


@dataclass(frozen=True, slots=True)
class CameraCalibration:
    """Scale factor, clock offset, region, axis and noise of the camera; with several targets those of the best one.

    variance_factor: the learnt variance over the tracker's own. phase_scale_m_per_rad: displacement per radian of the
    active pixels' mean phase, with the trackers that use it. targets: all of them. fused: whether this axis has an
    accelerometer; without one the scale factor is the other axis's. relative_scale_std: of all targets together.
    lens: what the pixels were corrected by; the scale factor holds for that lens only. source: which camera it is.
    temperature_range_c: of a thermal camera what its tracker saw, °C.
    """

    scale: ScaleFactor
    offset: TimeOffset
    region: Region
    direction: str
    tracker: str
    noise_std_px: float
    variance_factor: float
    phase_scale_m_per_rad: float | None = None
    targets: tuple[TargetCalibration, ...] = ()
    fused: bool = True
    relative_scale_std: float | None = None
    lens: Lens | None = None
    source: Source = Source.CAMERA
    temperature_range_c: tuple[float, float] | None = None

    @property
    def used(self) -> tuple[TargetCalibration, ...]:
        """The targets that the result rests on."""
        found = tuple(target for target in self.targets if target.used)
        return found or (TargetCalibration(self.region, "1", self.scale, self.noise_std_px, self.variance_factor),)

    @property
    def relative_std(self) -> float:
        """Relative standard deviation of the scale factor of all targets together."""
        if self.relative_scale_std is not None:
            return self.relative_scale_std
        return math.sqrt(self.scale.variance) / abs(self.scale.value_m_per_px)

    def mappings(self) -> tuple[CameraScale, ...]:
        """What turns the pixels of each used target into metres."""
        return tuple(self._mapping(target) for target in self.used)

    def mapping(self) -> CameraScale:
        """What turns the best target's pixels into metres."""
        return self._mapping(TargetCalibration(self.region, "", self.scale, self.noise_std_px, self.variance_factor))

    def _mapping(self, target: TargetCalibration) -> CameraScale:
        assert target.scale is not None
        value = target.scale.value_m_per_px
        return CameraScale(
            scale_m_per_px=value,
            direction=self.direction,
            time_offset_ns=round(1e9 * self.offset.value_s),
            variance_factor=target.variance_factor,
            relative_std=math.sqrt(target.scale.variance) / abs(value),
            source=self.source,
        )


@dataclass(frozen=True, slots=True)
class DisplacementCalibration:
    """Noise per measurement (m) and clock offset of a displacement sensor, and its scale where that was learnt.

    scale: displacement in one unit read, which is 1 for a sensor of known unit; scale_std: its standard deviation, 0
    where it was not learnt.
    """

    noise_std_m: float
    offset: TimeOffset
    scale: float = 1.0
    scale_std: float = 0.0

    @property
    def relative_std(self) -> float:
        """Relative standard deviation of the scale."""
        return self.scale_std / abs(self.scale)


@dataclass(frozen=True, slots=True)
class Calibration:
    """Everything `calibrate` learns about a recording's sensors.

    noise_std_m_s2: white noise of the acceleration per sample; bias_m_s2: its mean in the window. across: the same
    along the second image axis, with camera.direction = "xy"; where that has no accelerometer, the noise is the
    motion's own acceleration. left_out: the second axis "x" or "y" where nothing could be learnt of it, else empty.
    diagnostics: what the estimates rest on, for the report; not stored in the file.
    """

    noise_std_m_s2: float
    bias_m_s2: float
    camera: CameraCalibration | None = None
    infrared: CameraCalibration | None = None
    radar: RadarCalibration | None = None
    displacement: DisplacementCalibration | None = None
    warnings: tuple[str, ...] = ()
    across: "Calibration | None" = None
    left_out: str = ""
    created: str = field(default_factory=lambda: datetime.now(UTC).isoformat(timespec="seconds"))
    version: str = __version__
    diagnostics: "ScaleCalibration | NoiseCalibration | None" = field(default=None, compare=False, repr=False)

    @property
    def first_camera(self) -> CameraCalibration | None:
        """The camera whose zero counts and whose axes the columns belong to, of light or infrared."""
        return self.camera or self.infrared

    def of(self, sensor: str) -> CameraCalibration | None:
        """The part of the section "camera" or "infrared"."""
        return self.infrared if sensor == "infrared" else self.camera

    @property
    def direction(self) -> str:
        """The camera's direction, "x", "y" or "xy"; empty without one."""
        if self.first_camera is None:
            return ""
        return self.first_camera.direction if self.across is None and not self.left_out else "xy"

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
        first = self.first_camera
        if first:
            own = _camera_dict(first) | ({"left_out": self.left_out} if self.left_out else {})
            if self.across is not None and self.across.first_camera is not None:
                sides = ((part.first_camera, part) for part in (self, self.across))
                both = {camera.direction: _axis_dict(part) for camera, part in sides if camera is not None}
                own |= {"direction": "xy", "axis": first.direction, "axes": both}
            tree["infrared" if self.camera is None else "camera"] = own
        if self.camera and self.infrared:
            tree["infrared"] = _camera_dict(self.infrared)
        if self.radar:
            tree["radar"] = self.radar.to_dict()
        if self.displacement:
            offset = self.displacement.offset
            tree["displacement"] = {
                "noise_std_mm": 1e3 * self.displacement.noise_std_m,
                "time_offset_s": offset.value_s,
                "time_offset_std_s": _finite_or_none(math.sqrt(offset.variance)),
            }
            if self.displacement.scale_std > 0.0:
                learnt = {"scale": self.displacement.scale, "scale_std": self.displacement.scale_std}
                tree["displacement"] |= learnt
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
    return {
        **_scale_dict(camera),
        "time_offset_s": camera.offset.value_s,
        "time_offset_std_s": _finite_or_none(math.sqrt(camera.offset.variance)),
        "roi": [region.x, region.y, region.width, region.height],
        "direction": camera.direction,
        "tracker": camera.tracker,
        "noise_std_px": camera.noise_std_px,
        "variance_factor": camera.variance_factor,
        "targets": [_target_dict(target) for target in camera.targets],
        **({} if camera.lens is None else {"lens": camera.lens.to_dict()}),
        **({} if camera.temperature_range_c is None else {"temperature_range_c": list(camera.temperature_range_c)}),
    }


def _scale_dict(camera: CameraCalibration) -> dict[str, Any]:
    phase, relative = camera.phase_scale_m_per_rad, camera.relative_scale_std
    return {
        **({} if phase is None else {"phase_scale_mm_per_rad": 1e3 * phase}),
        "scale_mm_per_px": 1e3 * camera.scale.value_m_per_px,
        "scale_std_mm_per_px": 1e3 * math.sqrt(camera.scale.variance),
        **({} if relative is None else {"relative_scale_std": relative}),
    }


def _target_dict(target: TargetCalibration) -> dict[str, Any]:
    region, scale = target.region, target.scale
    return {
        "name": target.name,
        "roi": [region.x, region.y, region.width, region.height],
        "scale_mm_per_px": None if scale is None else 1e3 * scale.value_m_per_px,
        "scale_std_mm_per_px": None if scale is None else 1e3 * math.sqrt(scale.variance),
        "noise_std_px": _finite_or_none(target.noise_std_px),
        "variance_factor": _finite_or_none(target.variance_factor),
        "used": target.used,
        "reason": target.reason,
    }


def _axis_dict(part: Calibration) -> dict[str, Any]:
    """What belongs to one image axis where both are measured."""
    camera = part.first_camera
    assert camera is not None
    return {
        "fused": camera.fused,
        **_scale_dict(camera),
        "noise_std_px": camera.noise_std_px,
        "variance_factor": camera.variance_factor,
        "accelerometer_noise_std_m_s2": part.noise_std_m_s2,
        "accelerometer_bias_m_s2": part.bias_m_s2,
        "targets": [_target_dict(target) for target in camera.targets],
    }


def _finite_or_none(value: float) -> float | None:
    return value if math.isfinite(value) else None
