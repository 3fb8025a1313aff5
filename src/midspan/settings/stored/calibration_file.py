"""Reading `calibration.json` back; `settings/stored/calibration.py` writes it."""

from dataclasses import replace
from pathlib import Path
from typing import Any

from midspan.calibration.direction import Direction
from midspan.checks import path_of
from midspan.errors import DataError
from midspan.notices import NOTICES, Notice
from midspan.records import Source
from midspan.settings.calibration import StoredCalibration, StoredCamera, validate_calibration
from midspan.settings.stored.calibration import CALIBRATION_FILE, Calibration, SensorCalibration, placed
from midspan.settings.stored.sections import camera_across, camera_of, displacement_of, radar_of, usual_of
from midspan.trees import TreeError, read_json


def load_calibration(path: str | Path) -> Calibration:
    """Read a `calibration.json` (or the folder that holds it).

    Raises DataError naming file and key where it is missing, damaged or holds a value that cannot be.
    """
    path = path_of("path", path)
    path = path / CALIBRATION_FILE if path.is_dir() else path
    try:
        tree = read_json(path)
    except OSError as error:
        raise DataError(f"{path}: cannot be read ({error.strerror}). `midspan calibrate` writes one.") from None
    except TreeError as error:
        raise DataError(f"{path}: {error}. Run `midspan calibrate` again.") from None
    return calibration_from_dict(tree, str(path))


def calibration_from_dict(tree: Any, where: str = CALIBRATION_FILE) -> Calibration:
    """The calibration that `Calibration.to_dict` describes; keys that only inform may be missing.

    where: names the tree in messages. Raises DataError for a value that cannot be.
    """
    stored = validate_calibration(tree, where)
    own, first = stored.accelerometer, (*stored.camera, *stored.infrared, None)[0]
    sensors: tuple[SensorCalibration, ...] = (
        *(camera_of(part, Source.CAMERA) for part in stored.camera),
        *(camera_of(part, Source.INFRARED) for part in stored.infrared),
        *(radar_of(part) for part in stored.radar),
        *(displacement_of(part) for part in stored.displacement),
    )
    found = Calibration(
        noise_std_m_s2=own.noise_std_m_s2,
        motion_noise_s=own.motion_noise_s,
        bias_m_s2=own.bias_m_s2,
        bias_std_m_s2=own.bias_std_m_s2,
        bias_drift_m_s3=own.bias_drift_m_s3,
        warnings=_notices(stored),
        left_out="" if first is None else first.left_out,
        created=stored.created,
        version=stored.version,
        **placed(sensors),
        accelerometer_scale=own.scale,
        accelerometer_scale_std=own.scale_std,
        misfit=own.misfit,
        slope=own.slope_rad_m,
        sensor_axis=Direction(own.direction, own.direction_std) if own.direction else None,
        usual=usual_of(own.usual),
    )
    return found if first is None or first.direction != "xy" else _with_second_axis(found, first)


def _notices(stored: StoredCalibration) -> tuple[Notice, ...]:
    """The warnings with their codes; earlier versions wrote none."""
    codes = {one.text: one.code for one in stored.notices if one.code in NOTICES}
    return tuple(Notice(codes.get(text, "uncoded"), text) for text in stored.warnings)


def _with_second_axis(found: Calibration, first: StoredCamera) -> Calibration:
    """The calibration with the part of the second image axis."""
    main = found.first_camera
    assert main is not None
    assert first.axes is not None
    part = first.axes.x if main.direction == "y" else first.axes.y
    camera = camera_across(main, part)
    across = Calibration(
        noise_std_m_s2=part.accelerometer_noise_std_m_s2,
        motion_noise_s=part.accelerometer_motion_noise_s,
        bias_m_s2=part.accelerometer_bias_m_s2,
        bias_std_m_s2=part.accelerometer_bias_std_m_s2,
        bias_drift_m_s3=part.accelerometer_bias_drift_m_s3,
        accelerometer_scale_std=part.accelerometer_scale_std,
        misfit=part.accelerometer_misfit,
        slope=part.accelerometer_slope_rad_m,
        usual=usual_of(part.accelerometer_usual),
        camera=camera if found.camera is not None else None,
        infrared=camera if found.camera is None else None,
        created=found.created,
        version=found.version,
    )
    return replace(found, across=across)
