"""What only settings tell of a result's band: a camera's tilt, and what was left out, in sentences."""

import math

from midspan.calibration.sensors.camera import CameraCalibration
from midspan.calibration.sensors.displacement import DisplacementCalibration
from midspan.settings.camera import CameraSettings
from midspan.settings.recording import RecordingSettings
from midspan.settings.stored.calibration import Calibration

SENSITIVITY = (
    "The accelerometer's own tolerance: all displacements are off by the same share as its sensitivity. "
    "accelerometer.scale_std puts it in."
)
TILT = (
    "tilt not observed. A camera's own tilt shows as 0.0175 mm for each millidegree and metre of distance. "
    "tilt_std_mdeg puts it in."
)
DELAY = (
    "The delay of the accelerometer's logger (of its anti-alias filter, some samples): it looks like a clock offset, "
    "and the displacement is late by it."
)


def not_in_band(settings: RecordingSettings, calibration: Calibration) -> tuple[str, ...]:
    """What the standard deviations of a result do not contain."""
    found = (SENSITIVITY,) if sensitivity_left_out(settings, calibration) else ()
    cameras = [(one.name, one.settings) for one in settings.sensors if isinstance(one.settings, CameraSettings)]
    tilting = ", ".join(name for name, camera in cameras if camera.tilt_std_mdeg == 0.0)
    # The clock offset of all sensors but those of a displacement is estimated; of these where the motion shows one.
    known = [one for one in settings.displacements if not one.estimate_offset]
    shown = any(
        isinstance(one, DisplacementCalibration) and one.offset.value_s != 0.0 for _, _, one in calibration.sensors
    )
    delay = (DELAY,) if shown or len(known) < len(settings.sensors) else ()
    return (*found, *delay, f"{tilting}: {TILT}") if tilting else (*found, *delay)


def tilt_std_m(camera: CameraSettings, calibration: CameraCalibration) -> float:
    """What a camera's tilt makes of the displacement along an axis, m: its standard deviation times the distance.

    A turn by an angle moves the image by that times the focal length (px), which times the scale factor (m/px) is the
    distance; of several targets the farthest counts.
    """
    distance_m, lens = camera.distance_m, calibration.lens
    if distance_m is None and lens is not None:
        focal_px = lens.matrix["xy".index(calibration.direction)]
        distance_m = focal_px * max(abs(one.scale_m_per_px) for one in calibration.mappings())
    return math.radians(1e-3 * camera.tilt_std_mdeg) * (distance_m or 0.0)


def sensitivity_left_out(settings: RecordingSettings, calibration: Calibration) -> bool:
    """Whether nothing tells how well the accelerometer's gain is known: neither the settings nor a sensor in metres."""
    own = settings.accelerometer
    if own is None or own.scale_std > 0.0 or calibration.accelerometer_scale_std > 0.0:
        return False
    in_metres = any(not one.estimate_scale for one in settings.displacements)
    return not (in_metres and own.estimate_scale)
