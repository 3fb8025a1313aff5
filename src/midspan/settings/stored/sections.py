"""The sections of `calibration.json` (mm, px, s) and the records that they stand for (SI): each way by sensor."""

import math
from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from midspan.calibration.sensors.camera import CameraCalibration, TargetCalibration
from midspan.calibration.sensors.displacement import DisplacementCalibration
from midspan.calibration.sensors.radar import RadarCalibration, RadarTarget
from midspan.engine.axis import AxisFigures
from midspan.radar.following import Background
from midspan.radar.target import Target
from midspan.records import Region, ScaleFactor, Source, TimeOffset
from midspan.settings.calibration import (
    Stored,
    StoredAxis,
    StoredCamera,
    StoredDisplacement,
    StoredRadar,
    StoredRadarTarget,
    StoredScale,
    StoredTarget,
    StoredUsual,
)

MM = 1e3
# What the camera and its only target have in common.
OWN_KEYS = ("roi", "scale_mm_per_px", "scale_std_mm_per_px", "noise_std_px", "variance_factor")
# What a radar's target has under the same name and in the same unit in the file.
SAME = (
    "place_bin", "range_m", "snr_db", "amplitude", "conversion_factor", "conversion_factor_std", "time_offset_s",
    "time_offset_std_s", "coherence", "clutter", "disagreement_rad", "reach_bins", "modulation_rad", "phase_noise_rad2",
    "own_hz",
)  # fmt: skip
# The keys of the accelerometer's section and the fields that they are; a second axis has them with a prefix.
ACCELERATION = {
    "noise_std_m_s2": "noise_std_m_s2", "motion_noise_s": "motion_noise_s", "bias_m_s2": "bias_m_s2",
    "bias_std_m_s2": "bias_std_m_s2", "bias_drift_m_s3": "bias_drift_m_s3", "scale_std": "accelerometer_scale_std",
    "misfit": "misfit", "slope_rad_m": "slope",
}  # fmt: skip
USUAL = {key: "variance" if key == "variance_m2_s4" else key for key in StoredUsual.model_fields}


def finite_or_none(value: float) -> float | None:
    """The value as it is written: None for one that is not finite."""
    return float(value) if math.isfinite(value) else None


def camera_tree(camera: CameraCalibration) -> dict[str, Any]:
    """The section of a camera along its main axis."""
    own = {"roi": _roi(camera.region), "direction": camera.direction, "tracker": camera.tracker}
    more = {
        "exposure_s": camera.exposure_s or None,
        "literal": camera.literal or None,
        "lens": None if camera.lens is None else camera.lens.to_dict(),
        "temperature_range_c": None if camera.temperature_range_c is None else list(camera.temperature_range_c),
    }
    return _sensor_tree(camera) | scale_tree(camera) | own | _known(more)


def scale_tree(camera: CameraCalibration) -> dict[str, Any]:
    """What of it belongs to one image axis."""
    phase = camera.phase_scale_m_per_rad
    more = {
        "phase_scale_mm_per_rad": None if phase is None else MM * phase,
        "apart_std_mm": MM * camera.apart_std_m or None,
        "relative_scale_std": camera.relative_scale_std,
    }
    noise = {"noise_std_px": camera.noise_std_px, "variance_factor": camera.variance_factor}
    return (
        _factor_tree(camera.scale) | noise | _known(more) | {"targets": [_target_tree(one) for one in camera.targets]}
    )


def radar_tree(radar: RadarCalibration) -> dict[str, Any]:
    """The section of a radar; complex numbers as [real, imaginary]."""
    best = radar.best
    return _sensor_tree(radar) | {
        "conversion_factor": best.conversion_factor,
        "conversion_factor_std": best.conversion_factor_std,
        "relative_std": radar.relative_std,
        "target_range_m": finite_or_none(best.range_m),
        "noise_std_mm": MM * best.noise_m,
        "variance_factor": radar.variance_factor,
        "carrier_hz": radar.carrier_hz,
        "channels": radar.channels,
        "literal": radar.literal,
        "targets": [_radar_target_tree(item) for item in radar.targets],
    }


def displacement_tree(sensor: DisplacementCalibration) -> dict[str, Any]:
    """The section of a displacement sensor; what is 0 is not written."""
    ends = {"low_m": finite_or_none(sensor.low_m), "high_m": finite_or_none(sensor.high_m)}
    groups: tuple[tuple[float, dict[str, float]], ...] = (
        (sensor.exposure_s, {"exposure_s": sensor.exposure_s}),
        (sensor.apart_std_m, {"apart_std_mm": MM * sensor.apart_std_m}),
        (sensor.clock_rate, {"clock_rate": sensor.clock_rate, "clock_reference_s": sensor.clock_reference_s}),
        (sensor.slow_std_m, {"slow_std_mm": MM * sensor.slow_std_m, "slow_time_s": sensor.slow_time_s}),
        (sensor.scale_std, {"scale": sensor.scale, "scale_std": sensor.scale_std}),
    )
    more = {key: value for written, keys in groups if written for key, value in keys.items()}
    own = {"noise_std_mm": MM * sensor.noise_std_m} | _known({"resolution_m": sensor.resolution_m, **ends})
    return _sensor_tree(sensor) | own | more


def acceleration_tree(part: Any, prefix: str = "") -> dict[str, Any]:
    """Noise, bias and what is usual of the acceleration along one axis, of a `Calibration`."""
    usual = part.usual
    own = {} if usual is None else {f"{prefix}usual": {key: _of(usual, name) for key, name in USUAL.items()}}
    return own | {f"{prefix}{key}": _of(part, name) for key, name in ACCELERATION.items()}


def acceleration_of(part: Stored, prefix: str = "") -> dict[str, Any]:
    """The fields of a `Calibration` that `acceleration_tree` writes."""
    usual: StoredUsual | None = getattr(part, f"{prefix}usual")
    figures = None if usual is None else AxisFigures(**{name: getattr(usual, key) for key, name in USUAL.items()})
    own = {name: getattr(part, f"{prefix}{key}") for key, name in ACCELERATION.items()}
    return {**own, "usual": figures}


def _of(record: Any, name: str) -> float | None:
    return finite_or_none(getattr(record, name))


def camera_of(part: StoredCamera, source: Source) -> CameraCalibration:
    """The camera along its main axis."""
    direction = part.axis if part.direction == "xy" and part.axis is not None else part.direction
    own = _same(CameraCalibration, part) | _along(part)
    return CameraCalibration(**own | {"region": Region(*part.roi), "direction": direction, "source": source})


def camera_across(main: CameraCalibration, part: StoredAxis) -> CameraCalibration:
    """The same camera along its second axis."""
    found = replace(main, **_along(part), direction="x" if main.direction == "y" else "y", fused=part.fused)
    # The best target along this axis may be another one than along the main axis: the one with the axis's own scale.
    regions = [target.region for target in found.targets if target.used and target.scale == found.scale]
    return replace(found, region=(*regions, main.region)[0])


def radar_of(part: StoredRadar) -> RadarCalibration:
    """The radar; the section's own conversion factor is that of the best target."""
    best, *others = sorted((_radar_target(one, part) for one in part.targets), key=lambda item: not item.used)
    factor, std = part.conversion_factor, part.conversion_factor_std
    told = replace(best, target=replace(best.target, conversion_factor=factor, conversion_factor_std=std))
    spread = best.target.relative_std if part.relative_std is None else part.relative_std
    return RadarCalibration(**_same(RadarCalibration, part) | {"targets": (told, *others), "relative_std": spread})


def displacement_of(part: StoredDisplacement) -> DisplacementCalibration:
    """The displacement sensor."""
    metres = {f"{name}_m": getattr(part, f"{name}_mm") / MM for name in ("noise_std", "slow_std", "apart_std")}
    return DisplacementCalibration(**metres, **_same(DisplacementCalibration, part))


def _same(record: type, part: Stored) -> dict[str, Any]:
    """What a record has under the same name and in the same unit in the file."""
    return {item.name: getattr(part, item.name) for item in fields(record) if hasattr(part, item.name)}


def _known(tree: dict[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in tree.items() if value is not None}


def _sensor_tree(sensor: CameraCalibration | RadarCalibration | DisplacementCalibration) -> dict[str, Any]:
    offset = sensor.offset
    std = finite_or_none(math.sqrt(offset.variance))
    return _known({"name": sensor.name}) | {"time_offset_s": offset.value_s, "time_offset_std_s": std}


def _roi(region: Region) -> list[int]:
    return [region.x, region.y, region.width, region.height]


def _factor_tree(scale: ScaleFactor | None) -> dict[str, float | None]:
    value, std = (None, None) if scale is None else (MM * scale.value_m_per_px, MM * math.sqrt(scale.variance))
    return {"scale_mm_per_px": value, "scale_std_mm_per_px": std}


def _factor(part: StoredScale | StoredTarget) -> ScaleFactor | None:
    value, std = part.scale_mm_per_px, part.scale_std_mm_per_px or 0.0
    return None if value is None else ScaleFactor(value / MM, (std / MM) ** 2)


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
    records = tuple(
        TargetCalibration(
            **_same(TargetCalibration, one)
            | {"region": Region(*one.roi), "name": one.name or str(number), "scale": _factor(one)}
        )
        for number, one in enumerate(targets, start=1)
    )
    phase = part.phase_scale_mm_per_rad
    return {
        **{key: getattr(part, key) for key in ("noise_std_px", "variance_factor", "relative_scale_std")},
        "scale": _factor(part),
        "phase_scale_m_per_rad": None if phase is None else phase / MM,
        "targets": records,
        "apart_std_m": part.apart_std_mm / MM,
    }


def _radar_target_tree(item: RadarTarget) -> dict[str, Any]:
    target, still = item.target, item.target.background
    background = None if still is None else {"bins": still.bins.tolist(), "phasors": _pairs(still.phasors)}
    return {key: finite_or_none(getattr(target, key)) for key in SAME} | {
        "noise_std_mm": finite_or_none(MM * target.noise_m),
        "own_std_mm": MM * target.own_m,
        "leak": [target.leak.real, target.leak.imag],
        **_known({"background": background}),
        "weights": _pairs(target.weights),
        "used": item.used,
        "reason": item.reason,
    }


def _radar_target(part: StoredRadarTarget, radar: StoredRadar) -> RadarTarget:
    """One target; what is not known of it is another thing for one that is used than for one that is not."""
    std, offset_s, coherence = (0.0, radar.time_offset_s, 1.0) if part.used else (math.inf, math.nan, 0.0)
    unknown = {"conversion_factor_std": std, "time_offset_s": offset_s, "coherence": coherence}
    still = part.background
    more = {
        "noise_m": part.noise_std_mm / MM,
        "own_m": part.own_std_mm / MM,
        "leak": complex(*part.leak),
        "background": None if still is None else Background(np.array(still.bins), _complex(still.phasors)),
        "weights": _complex(part.weights),
    }
    return RadarTarget(
        Target(**unknown | _known({key: getattr(part, key) for key in SAME}) | more), part.used, part.reason
    )


def _pairs(values: np.ndarray[Any, np.dtype[np.complex128]]) -> list[list[float]]:
    return [[float(value.real), float(value.imag)] for value in values]


def _complex(pairs: tuple[tuple[float, float], ...]) -> np.ndarray[Any, np.dtype[np.complex128]]:
    return np.array([complex(*pair) for pair in pairs])


def camera_summary(camera: CameraCalibration) -> str:
    """Scale factor and clock offset."""
    value, std = 1e3 * camera.scale.value_m_per_px, 1e3 * math.sqrt(camera.scale.variance)
    return f"{value:.5g} ± {std:.2g} mm/px along {camera.direction}, {_offset(camera.offset)}"


def radar_summary(radar: RadarCalibration) -> str:
    """Conversion factor, range of the target and clock offset."""
    target = radar.targets[0].target
    value, std = target.conversion_factor, target.conversion_factor_std
    return f"conversion factor {value:.5g} ± {std:.2g}, target at {target.range_m:.4g} m, {_offset(radar.offset)}"


def displacement_summary(sensor: DisplacementCalibration) -> str:
    """Noise, scale where it was estimated, and clock offset."""
    scale = "" if sensor.scale == 1.0 else f", scale {sensor.scale:.5g} ± {sensor.scale_std:.2g}"
    return f"noise {1e3 * sensor.noise_std_m:.3g} mm{scale}, {_offset(sensor.offset)}"


def _offset(offset: TimeOffset) -> str:
    return f"clock offset {1e3 * offset.value_s:.2f} ± {1e3 * math.sqrt(offset.variance):.2f} ms"


@dataclass(frozen=True, slots=True)
class SectionKind:
    """The section of a kind of sensor: written, read, and shown in a line."""

    tree: Callable[[Any], dict[str, Any]]
    record: Callable[[Any], CameraCalibration | RadarCalibration | DisplacementCalibration]
    summary: Callable[[Any], str]


SECTIONS = {
    "camera": SectionKind(camera_tree, lambda part: camera_of(part, Source.CAMERA), camera_summary),
    "infrared": SectionKind(camera_tree, lambda part: camera_of(part, Source.INFRARED), camera_summary),
    "radar": SectionKind(radar_tree, radar_of, radar_summary),
    "displacement": SectionKind(displacement_tree, displacement_of, displacement_summary),
}
