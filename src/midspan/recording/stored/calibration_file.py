"""Reading `calibration.json` back; `recording/stored/calibration.py` writes it."""

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

from midspan.checks import ValueRange, shown
from midspan.errors import DataError, UsageError
from midspan.recording.stored.calibration import CALIBRATION_FILE, Calibration
from midspan.recording.stored.camera import CameraCalibration, TargetCalibration
from midspan.recording.stored.displacement import DisplacementCalibration
from midspan.recording.stored.json_values import BIAS_M_S2, NOISE, NOISE_M_S2, RATIO
from midspan.recording.stored.json_values import WrongValueError as _WrongValueError
from midspan.recording.stored.json_values import factor as _factor
from midspan.recording.stored.json_values import number as _number
from midspan.recording.stored.json_values import offset_of as _offset_of
from midspan.recording.stored.json_values import section_of as _section
from midspan.recording.stored.json_values import std as _std
from midspan.recording.stored.json_values import std_or_unknown as _std_or_unknown
from midspan.recording.stored.radar_file import radar_of
from midspan.records import Region, ScaleFactor, Source
from midspan.settings.fields import MAX_PX
from midspan.trees import TreeError, read_json
from midspan.vision.lens import Lens

TEMPERATURE_C = ValueRange(-273.15, 1e5, "°C")
# What the camera and its only target have in common.
OWN_KEYS = ("roi", "scale_mm_per_px", "scale_std_mm_per_px", "noise_std_px", "variance_factor")


def load_calibration(path: str | Path) -> Calibration:
    """Read a `calibration.json` (or the folder that holds it).

    Raises DataError naming file and key where it is missing, damaged or holds a value that cannot be.
    """
    path = Path(path)
    path = path / CALIBRATION_FILE if path.is_dir() else path
    try:
        tree = read_json(path)
    except OSError as error:
        raise DataError(f"{path}: cannot be read ({error.strerror}). `midspan calibrate` writes one.") from None
    except TreeError as error:
        raise DataError(f"{path}: {error}. Run `midspan calibrate` again.") from None
    try:
        return calibration_from_dict(tree)
    except _WrongValueError as error:
        raise DataError(f"{path}: {error}. Run `midspan calibrate` again.") from None


def calibration_from_dict(tree: dict[str, Any]) -> Calibration:
    """The calibration that `Calibration.to_dict` describes; keys that only inform may be missing."""
    accelerometer = _section(tree, "accelerometer")
    if accelerometer is None:
        raise _WrongValueError("accelerometer is missing")
    camera, displacement, thermal = (_section(tree, name) for name in ("camera", "displacement", "infrared"))
    first = camera or thermal
    radar = _section(tree, "radar")
    warnings = tree.get("warnings", [])
    found = Calibration(
        noise_std_m_s2=_number(accelerometer, "accelerometer.noise_std_m_s2", limits=NOISE_M_S2),
        bias_m_s2=_number(accelerometer, "accelerometer.bias_m_s2", 0.0, BIAS_M_S2),
        bias_std_m_s2=_std_or_unknown(accelerometer, "accelerometer.bias_std_m_s2"),
        camera=_camera_of(camera) if camera else None,
        infrared=_infrared_of(thermal) if thermal else None,
        radar=radar_of(radar) if radar else None,
        displacement=_displacement_of(displacement) if displacement else None,
        warnings=tuple(str(line) for line in warnings) if isinstance(warnings, list) else (),
        left_out=_left_out_of(first) if first else "",
        created=str(tree.get("created", "")),
        version=str(tree.get("version", "")),
    )
    return found if first is None or first.get("direction") != "xy" else _both_axes(found, first)


def _both_axes(found: Calibration, tree: dict[str, Any]) -> Calibration:
    """The calibration with the part of the second image axis."""
    main = found.first_camera
    assert main is not None
    second = "x" if main.direction == "y" else "y"
    axes = _section(tree, "axes") or {}
    own, other = _section(axes, main.direction), _section(axes, second)
    if own is None or other is None:
        raise _WrongValueError('camera.axes must hold x and y with camera.direction = "xy"')
    scale, targets = _scale_of(other, f"camera.axes.{second}"), _targets_of(other)
    # The best target along this axis may be another one than along the main axis: the one with the axis's own scale.
    regions = [target.region for target in targets if target.used and target.scale == scale]
    camera = replace(
        main,
        scale=scale,
        region=(*regions, main.region)[0],
        direction=second,
        noise_std_px=_number(other, f"camera.axes.{second}.noise_std_px", limits=NOISE),
        variance_factor=_number(other, f"camera.axes.{second}.variance_factor", limits=RATIO),
        phase_scale_m_per_rad=_phase_of(other),
        targets=targets,
        fused=other.get("fused") is not False,
        relative_scale_std=_relative_of(other),
    )
    across = Calibration(
        noise_std_m_s2=_number(other, f"camera.axes.{second}.accelerometer_noise_std_m_s2", limits=NOISE_M_S2),
        bias_m_s2=_number(other, f"camera.axes.{second}.accelerometer_bias_m_s2", 0.0, BIAS_M_S2),
        bias_std_m_s2=_std_or_unknown(other, f"camera.axes.{second}.accelerometer_bias_std_m_s2"),
        camera=camera if found.camera is not None else None,
        infrared=camera if found.camera is None else None,
        created=found.created,
        version=found.version,
    )
    return replace(found, across=across)


def _camera_of(tree: dict[str, Any]) -> CameraCalibration:
    direction = tree.get("direction", "y")
    if direction not in ("x", "y", "xy"):
        raise _WrongValueError(f'camera.direction must be "x", "y" or "xy"; received {shown(direction)}')
    if direction == "xy" and (direction := tree.get("axis")) not in ("x", "y"):
        raise _WrongValueError(f'camera.axis must be "x" or "y"; received {shown(direction)}')
    return CameraCalibration(
        scale=_scale_of(tree, "camera"),
        offset=_offset_of(tree, "camera"),
        region=_region_of(tree),
        direction=direction,
        tracker=str(tree.get("tracker", "template")),
        noise_std_px=_number(tree, "camera.noise_std_px", 0.02, NOISE),
        variance_factor=_number(tree, "camera.variance_factor", 1.0, RATIO),
        phase_scale_m_per_rad=_phase_of(tree),
        targets=_targets_of(tree),
        relative_scale_std=_relative_of(tree),
        lens=_lens_of(tree),
    )


def _infrared_of(tree: dict[str, Any]) -> CameraCalibration:
    """The part of a thermal camera; its messages name its own keys."""
    try:
        camera = _camera_of(tree)
        given = tree.get("temperature_range_c")
        if given is not None and not (isinstance(given, list) and len(given) == 2):
            raise _WrongValueError(f"camera.temperature_range_c must be two numbers, °C; received {shown(given)}")
        low, high = (
            _number({"c": value}, "camera.temperature_range_c.c", limits=TEMPERATURE_C) for value in given or (0.0, 1.0)
        )
        if low >= high:
            raise _WrongValueError(f"camera.temperature_range_c must rise; received {shown(given)}")
    except _WrongValueError as error:
        raise _WrongValueError(str(error).replace("camera.", "infrared.")) from None
    return replace(camera, source=Source.INFRARED, temperature_range_c=None if given is None else (low, high))


def _left_out_of(tree: dict[str, Any]) -> str:
    axis = tree.get("left_out", "")
    if axis not in ("", "x", "y"):
        raise _WrongValueError(f'camera.left_out must be "x" or "y"; received {shown(axis)}')
    return str(axis)


def _lens_of(tree: dict[str, Any]) -> Lens | None:
    section = _section(tree, "lens")
    if section is None:
        return None
    try:
        return Lens.from_dict(section)
    except (KeyError, TypeError, ValueError, OverflowError, UsageError) as error:
        raise _WrongValueError(f"camera.lens is no lens: {error}") from None


def _scale_of(tree: dict[str, Any], section: str) -> ScaleFactor:
    scale = _factor(tree, f"{section}.scale_mm_per_px") / 1e3
    return ScaleFactor(scale, (_std(tree, f"{section}.scale_std_mm_per_px", 0.0) / 1e3) ** 2)


def _phase_of(tree: dict[str, Any]) -> float | None:
    key = "phase_scale_mm_per_rad"
    return _factor(tree, f"camera.{key}") / 1e3 if key in tree else None


def _relative_of(tree: dict[str, Any]) -> float | None:
    key = "relative_scale_std"
    return _std(tree, f"camera.{key}") if key in tree else None


def _targets_of(tree: dict[str, Any]) -> tuple[TargetCalibration, ...]:
    listed = tree.get("targets", [])
    if not isinstance(listed, list) or not all(isinstance(target, dict) for target in listed):
        raise _WrongValueError(f"camera.targets must be a list of objects; received {shown(listed)}")
    if sum(target.get("used") is not False for target in listed) == 1:
        # The camera's own keys are those of the only target in use, and count where somebody has changed them.
        own = {key: tree[key] for key in OWN_KEYS if key in tree}
        listed = [target if target.get("used") is False else {**target, **own} for target in listed]
    return tuple(_target_of(target, number) for number, target in enumerate(listed, start=1))


def _number_or_nan(tree: dict[str, Any], key: str, used: bool, limits: ValueRange) -> float:
    """A number within the limits; a target that is not used may have none."""
    if not used and tree.get(key.rpartition(".")[2]) is None:
        return math.nan
    return _number(tree, key, limits=limits)


def _target_of(tree: dict[str, Any], number: int) -> TargetCalibration:
    place, used = f"camera.targets[{number}]", tree.get("used") is not False
    return TargetCalibration(
        region=_region_of(tree),
        name=str(tree.get("name", number)),
        scale=_scale_of(tree, place) if used or tree.get("scale_mm_per_px") is not None else None,
        noise_std_px=_number_or_nan(tree, f"{place}.noise_std_px", used, NOISE),
        variance_factor=_number_or_nan(tree, f"{place}.variance_factor", used, RATIO),
        used=used,
        reason=str(tree.get("reason", "")),
    )


def _region_of(tree: dict[str, Any]) -> Region:
    roi = tree.get("roi")
    if not (
        isinstance(roi, list)
        and len(roi) == 4
        and all(type(n) is int and 0 <= n <= MAX_PX for n in roi)
        and min(roi[2:]) > 0
    ):
        rule = f"four whole numbers x, y, width, height from 0 to {MAX_PX} px"
        raise _WrongValueError(f"camera.roi must be {rule}; received {shown(roi)}")
    return Region(*roi)


def _displacement_of(tree: dict[str, Any]) -> DisplacementCalibration:
    std = _number(tree, "displacement.noise_std_mm", limits=NOISE)
    scale = _factor(tree, "displacement.scale", 1.0)
    scale_std = _std(tree, "displacement.scale_std", 0.0)
    return DisplacementCalibration(std / 1e3, _offset_of(tree, "displacement"), scale, scale_std)
