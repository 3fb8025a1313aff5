"""What settings say of a calibration: what gravity and optics contradict, and what a camera's tilt makes."""

import math

from midspan.calibration.sensors.camera import CameraCalibration
from midspan.notices import Notice
from midspan.settings.camera import CameraSettings
from midspan.settings.recording import RecordingSettings
from midspan.settings.stored.calibration import Calibration
from midspan.signals.acceleration import GRAVITY_M_S2
from midspan.sources.accelerometer.units import GRAVITY_READS, likely_units, measures, si_factor

# Bias over gravity of an axis that is level to 17 degrees, or upright to 26: that of a motion up, down or sideways.
LEVEL, UPRIGHT = 0.3, (0.9, 1.1)
# Zero offsets and an axis level to 2 degrees stay below this share of gravity.
OFFSET = 0.03
# A reading this near to 1 m/s² at rest is taken for 1 g in a wrong unit: zero offset and inclination of an upright axis
# change it by 2 % at most; an axis that is level to 5.7 ± 0.12 degrees shows the same by chance.
SWAPPED_WITHIN = 0.02
# A paced distance and a nominal focal length are good to a tenth each, rms: three times both together.
OPTICS_WITHIN = 1.4


def implausible(settings: RecordingSettings, calibration: Calibration, unit: str = "") -> tuple[Notice, ...]:
    """Warnings on what a wrong unit, sensitivity or optics would explain; unit: of the acceleration as it was read."""
    found = []
    if settings.accelerometer is not None and (text := _against_gravity(calibration, unit)):
        found.append(Notice("unit-doubtful", f"accelerometer: the reading at rest is {text}"))
    for one in settings.sensors:
        if isinstance(one.settings, CameraSettings):
            own = [c for name, _, c in calibration.sensors if name == one.name and isinstance(c, CameraCalibration)]
            found += [line for camera in own for line in _against_optics(one.name, one.settings, camera)]
    return tuple(found)


def _against_gravity(calibration: Calibration, unit: str) -> str:
    """What the reading at rest has against its unit; empty where it is that of an axis upright or level."""
    bias, usual = calibration.bias_m_s2, calibration.usual
    share = abs(bias) / GRAVITY_M_S2
    if UPRIGHT[0] < share < UPRIGHT[1]:
        return ""
    declared = unit if measures(unit, "acceleration") else "m/s^2"
    reading = bias / si_factor(declared, "acceleration", None)
    off = [one for one in likely_units(reading) if one != declared]
    # An offset of the zero, where the motion is larger; or an inclination.
    by_chance = (usual is not None and usual.peak_m_s2 > abs(bias)) or (
        OFFSET < share < LEVEL and off and abs(abs(reading) / GRAVITY_READS[off[0]] - 1.0) > SWAPPED_WITHIN
    )
    if off and (share > LEVEL or not by_chance):
        factor = si_factor(off[0], "acceleration", None) / si_factor(declared, "acceleration", None)
        wrong = f"{factor:.3g} times too small" if factor > 1.0 else f"{1.0 / factor:.3g} times too large"
        return (
            f"{reading:+.4g} {declared}; 1 g in {' or '.join(off)} reads the same. Check accelerometer.unit and "
            f"sensitivity: all displacements may be {wrong}."
        )
    if share <= LEVEL:
        return ""
    return (
        f"{bias / GRAVITY_M_S2:.3g} g; a horizontal axis reads 0 g, a vertical one ±1 g. Check accelerometer.unit, "
        "sensitivity (their error scales all displacements) and inclination."
    )


def expected_m_per_px(camera: CameraSettings, calibration: CameraCalibration) -> float | None:
    """Size of a pixel at the target's distance, m; None where the settings do not say."""
    focal_px = None
    if camera.focal_length_mm is not None and camera.pixel_pitch_um is not None:
        focal_px = 1e3 * camera.focal_length_mm / camera.pixel_pitch_um
    elif calibration.lens is not None:
        focal_px = calibration.lens.focal_px(calibration.direction)
    return None if camera.distance_m is None or focal_px is None else camera.distance_m / focal_px


def _against_optics(name: str, camera: CameraSettings, calibration: CameraCalibration) -> list[Notice]:
    """A sentence where the scale factor is not what the optics make it."""
    expected = expected_m_per_px(camera, calibration)
    found = abs(calibration.scale.value_m_per_px)
    if expected is None or 1.0 / OPTICS_WITHIN < found / expected < OPTICS_WITHIN:
        return []
    text = (
        f"{name}: scale factor {1e3 * expected:.3g} mm/px from distance and focal length, but {1e3 * found:.3g} "
        f"mm/px from the accelerometer, {found / expected:.3g} times as much. Check accelerometer.unit, sensitivity; "
        "distance_m, focal_length_mm and pixel_pitch_um of the camera; and whether the video was resized or zoomed."
    )
    return [Notice("scale-implausible", text)]


def target_distance_m(camera: CameraSettings, calibration: CameraCalibration) -> float | None:
    """Distance of the farthest target, m; None where the settings do not say.

    A turn by an angle moves the image by that times the focal length (px), which times the scale factor (m/px) is the
    distance.
    """
    lens = calibration.lens
    if camera.distance_m is not None or lens is None:
        return camera.distance_m
    focal_px = lens.focal_px(calibration.direction)
    return focal_px * max(abs(one.scale_m_per_px) for one in calibration.mappings())


def tilt_std_m(camera: CameraSettings, calibration: CameraCalibration) -> float:
    """What a camera's tilt makes of the displacement along an axis, m: its standard deviation times the distance.

    0 where the targets show it.
    """
    if calibration.tilt_std_px > 0.0:
        return 0.0
    return math.radians(1e-3 * camera.tilt_std_mdeg) * (target_distance_m(camera, calibration) or 0.0)
