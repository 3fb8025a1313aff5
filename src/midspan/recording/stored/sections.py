"""The sections of `calibration.json` (mm, px, s), and what they stand for in SI: one function each way and sensor."""

import math
from dataclasses import replace
from typing import Any

import numpy as np

from midspan.radar.following import Background
from midspan.radar.target import Target
from midspan.recording.stored.camera import CameraCalibration, TargetCalibration
from midspan.recording.stored.displacement import DisplacementCalibration
from midspan.recording.stored.radar import RadarCalibration, RadarTarget
from midspan.records import Region, ScaleFactor, Source, TimeOffset
from midspan.settings.calibration import (
    StoredAxis,
    StoredCamera,
    StoredDisplacement,
    StoredRadar,
    StoredRadarTarget,
    StoredScale,
    StoredTarget,
)

MM = 1e3
# What the camera and its only target have in common.
OWN_KEYS = ("roi", "scale_mm_per_px", "scale_std_mm_per_px", "noise_std_px", "variance_factor")
# What null stands for in a radar's target that is used, and in one that is not.
UNKNOWN = {
    "range_m": (math.nan, math.nan),
    "snr_db": (math.inf, math.inf),
    "conversion_factor": (math.nan, math.nan),
    "conversion_factor_std": (0.0, math.inf),
    "time_offset_std_s": (math.inf, math.inf),
    "coherence": (1.0, 0.0),
    "clutter": (math.nan, math.nan),
    "disagreement_rad": (0.0, 0.0),
    "reach_bins": (0.0, 0.0),
    "modulation_rad": (math.nan, math.nan),
    "phase_noise_rad2": (0.0, 0.0),
}


def finite_or_none(value: float) -> float | None:
    """The value as it is written: None for one that is not finite."""
    return float(value) if math.isfinite(value) else None


def or_unknown(value: float | None, unknown: float) -> float:
    """The value as it was read, `unknown` for None."""
    return unknown if value is None else value


def camera_tree(camera: CameraCalibration) -> dict[str, Any]:
    """The section of a camera along its main axis."""
    lens, range_c = camera.lens, camera.temperature_range_c
    return {
        **_named(camera.name),
        **scale_tree(camera),
        **_offset_tree(camera.offset),
        "roi": _roi(camera.region),
        "direction": camera.direction,
        "tracker": camera.tracker,
        **({} if lens is None else {"lens": lens.to_dict()}),
        **({} if range_c is None else {"temperature_range_c": list(range_c)}),
    }


def scale_tree(camera: CameraCalibration) -> dict[str, Any]:
    """What of it belongs to one image axis."""
    phase, relative = camera.phase_scale_m_per_rad, camera.relative_scale_std
    return {
        **({} if phase is None else {"phase_scale_mm_per_rad": MM * phase}),
        **_factor_tree(camera.scale),
        **({} if relative is None else {"relative_scale_std": relative}),
        "noise_std_px": camera.noise_std_px,
        "variance_factor": camera.variance_factor,
        "targets": [_target_tree(target) for target in camera.targets],
    }


def camera_of(part: StoredCamera, source: Source) -> CameraCalibration:
    """The camera along its main axis."""
    return CameraCalibration(
        **_along(part),
        offset=_offset(part),
        region=Region(*part.roi),
        direction=part.axis if part.direction == "xy" and part.axis is not None else part.direction,
        tracker=part.tracker,
        lens=part.lens,
        source=source,
        temperature_range_c=part.temperature_range_c,
        name=part.name,
    )


def camera_across(main: CameraCalibration, part: StoredAxis) -> CameraCalibration:
    """The same camera along its second axis."""
    found = replace(main, **_along(part), direction="x" if main.direction == "y" else "y", fused=part.fused)
    # The best target along this axis may be another one than along the main axis: the one with the axis's own scale.
    regions = [target.region for target in found.targets if target.used and target.scale == found.scale]
    return replace(found, region=(*regions, main.region)[0])


def radar_tree(radar: RadarCalibration) -> dict[str, Any]:
    """The section of a radar; complex numbers as [real, imaginary]."""
    best = radar.best
    return {
        **_named(radar.name),
        "conversion_factor": best.conversion_factor,
        "conversion_factor_std": best.conversion_factor_std,
        "relative_std": radar.relative_std,
        "target_range_m": finite_or_none(best.range_m),
        **_offset_tree(radar.offset),
        "noise_std_mm": MM * best.noise_m,
        "variance_factor": radar.variance_factor,
        "carrier_hz": radar.carrier_hz,
        "channels": radar.channels,
        "literal": radar.literal,
        "targets": [_radar_target_tree(item) for item in radar.targets],
    }


def radar_of(part: StoredRadar) -> RadarCalibration:
    """The radar; the section's own conversion factor is that of the best target."""
    offset = _offset(part)
    targets = sorted((_radar_target(one, offset) for one in part.targets), key=lambda item: not item.used)
    listed, factor, std = targets[0].target, part.conversion_factor, part.conversion_factor_std
    targets[0] = replace(targets[0], target=replace(listed, conversion_factor=factor, conversion_factor_std=std))
    return RadarCalibration(
        targets=tuple(targets),
        offset=offset,
        variance_factor=part.variance_factor,
        relative_std=or_unknown(part.relative_std, listed.relative_std),
        carrier_hz=part.carrier_hz,
        channels=part.channels,
        literal=part.literal,
        name=part.name,
    )


def displacement_tree(sensor: DisplacementCalibration) -> dict[str, Any]:
    """The section of a displacement sensor."""
    scale = {"scale": sensor.scale, "scale_std": sensor.scale_std} if sensor.scale_std > 0.0 else {}
    return {
        **_named(sensor.name),
        "noise_std_mm": MM * sensor.noise_std_m,
        **_offset_tree(sensor.offset),
        **scale,
    }


def displacement_of(part: StoredDisplacement) -> DisplacementCalibration:
    """The displacement sensor."""
    return DisplacementCalibration(part.noise_std_mm / MM, _offset(part), part.scale, part.scale_std, part.name)


def _named(name: str | None) -> dict[str, str]:
    return {} if name is None else {"name": name}


def _offset_tree(offset: TimeOffset) -> dict[str, float | None]:
    return {"time_offset_s": offset.value_s, "time_offset_std_s": finite_or_none(math.sqrt(offset.variance))}


def _offset(part: StoredCamera | StoredRadar | StoredDisplacement) -> TimeOffset:
    return TimeOffset(part.time_offset_s, or_unknown(part.time_offset_std_s, math.inf) ** 2)


def _roi(region: Region) -> list[int]:
    return [region.x, region.y, region.width, region.height]


def _factor_tree(scale: ScaleFactor | None) -> dict[str, float | None]:
    value, std = (None, None) if scale is None else (MM * scale.value_m_per_px, MM * math.sqrt(scale.variance))
    return {"scale_mm_per_px": value, "scale_std_mm_per_px": std}


def _factor(scale_mm_per_px: float, std_mm_per_px: float | None) -> ScaleFactor:
    return ScaleFactor(scale_mm_per_px / MM, (or_unknown(std_mm_per_px, 0.0) / MM) ** 2)


def _target_tree(target: TargetCalibration) -> dict[str, Any]:
    return {
        "name": target.name,
        "roi": _roi(target.region),
        **_factor_tree(target.scale),
        "noise_std_px": finite_or_none(target.noise_std_px),
        "variance_factor": finite_or_none(target.variance_factor),
        "used": target.used,
        "reason": target.reason,
    }


def _along(part: StoredScale) -> dict[str, Any]:
    """What of a camera belongs to one image axis; its own keys count for its only target in use."""
    own = {key: getattr(part, key) for key in OWN_KEYS if key in part.model_fields_set}
    alone = sum(target.used for target in part.targets) == 1
    targets = [one.model_copy(update=own) if alone and one.used else one for one in part.targets]
    phase = part.phase_scale_mm_per_rad
    return {
        "scale": _factor(part.scale_mm_per_px, part.scale_std_mm_per_px),
        "noise_std_px": part.noise_std_px,
        "variance_factor": part.variance_factor,
        "phase_scale_m_per_rad": None if phase is None else phase / MM,
        "targets": tuple(_target(target, number) for number, target in enumerate(targets, start=1)),
        "relative_scale_std": part.relative_scale_std,
    }


def _target(part: StoredTarget, number: int) -> TargetCalibration:
    scale = part.scale_mm_per_px
    return TargetCalibration(
        region=Region(*part.roi),
        name=str(number) if part.name is None else part.name,
        scale=None if scale is None else _factor(scale, part.scale_std_mm_per_px),
        noise_std_px=or_unknown(part.noise_std_px, math.nan),
        variance_factor=or_unknown(part.variance_factor, math.nan),
        used=part.used,
        reason=part.reason,
    )


def _radar_target_tree(item: RadarTarget) -> dict[str, Any]:
    target, still = item.target, item.target.background
    known = {key: finite_or_none(getattr(target, key)) for key in (*UNKNOWN, "time_offset_s")}
    background = {} if still is None else {"bins": still.bins.tolist(), "phasors": _pairs(still.phasors)}
    return {
        "place_bin": target.place_bin,
        "amplitude": target.amplitude,
        **known,
        "noise_std_mm": finite_or_none(MM * target.noise_m),
        "leak": _pairs(np.array([target.leak]))[0],
        **({"background": background} if background else {}),
        "weights": _pairs(target.weights),
        "used": item.used,
        "reason": item.reason,
    }


def _radar_target(part: StoredRadarTarget, offset: TimeOffset) -> RadarTarget:
    known: dict[str, Any] = {
        key: or_unknown(getattr(part, key), unknown[not part.used]) for key, unknown in UNKNOWN.items()
    }
    still = part.background
    target = Target(
        place_bin=part.place_bin,
        amplitude=part.amplitude,
        **known,
        time_offset_s=or_unknown(part.time_offset_s, offset.value_s if part.used else math.nan),
        noise_m=or_unknown(part.noise_std_mm, math.inf) / MM,
        leak=complex(*part.leak),
        background=None if still is None else Background(np.array(still.bins), _complex(still.phasors)),
        weights=_complex(part.weights),
    )
    return RadarTarget(target, part.used, part.reason)


def _pairs(values: np.ndarray[Any, np.dtype[np.complex128]]) -> list[list[float]]:
    return [[float(value.real), float(value.imag)] for value in values]


def _complex(pairs: tuple[tuple[float, float], ...]) -> np.ndarray[Any, np.dtype[np.complex128]]:
    return np.array([complex(*pair) for pair in pairs])
