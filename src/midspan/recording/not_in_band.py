"""What no band can contain, in sentences: nothing in a recording shows it, and the settings say nothing of it.

Such a sentence stands below clean results as well, and is no warning. Where this recording tells how much a given
amount of it would be, the sentence says so: gain errs with the displacement, a late clock with the velocity.
"""

import math

import numpy as np

from midspan.calibration.sensors.camera import CameraCalibration
from midspan.calibration.sensors.displacement import DisplacementCalibration
from midspan.calibration.slow_error import DRIFT_S
from midspan.notices import rounded
from midspan.records import Estimate
from midspan.settings.camera import CameraSettings
from midspan.settings.plausible import target_distance_m
from midspan.settings.recording import RecordingSettings
from midspan.settings.stored.calibration import Calibration

SENSITIVITY = "accelerometer sensitivity"
DELAY = "delay of the accelerometer's logger"
TILT = "tilt not observed"
OWN_MOTION = "slow motion of one target alone"
SLOW_ERROR = "a slow error"
# Of each sensor of a slow angle: its name, what drifts, and what else errs.
ANGLES = {
    "inclinometer": ("inclinometer", "a drift of its zero (warm-up)", ", and its delay"),
    "gravity": ("accelerometer along the view", "a drift of its bias (warm-up)", ""),
}
# Farther from where it was, m, a structure is not, as the estimator takes it: a step as large has no limit that counts.
NEAR_M = 1.0


def not_in_band(settings: RecordingSettings, calibration: Calibration, rows: Estimate) -> tuple[str, ...]:
    """What the standard deviations of a result do not contain, one sentence for each cause."""
    return (
        *_sensitivity(settings, calibration, rows),
        *_logger_delay(settings, calibration, rows),
        *_tilt(settings, calibration),
        *_targets(settings, calibration),
        *_angles(calibration),
        *_slow_errors(calibration),
    )


def _sensitivity(settings: RecordingSettings, calibration: Calibration, rows: Estimate) -> list[str]:
    own = settings.accelerometer
    if own is None or own.scale_std > 0.0 or calibration.accelerometer_scale_std > 0.0:
        return []
    if own.estimate_scale and any(not one.estimate_scale for one in settings.displacements):
        # A sensor in metres tells the gain.
        return []
    size = f"an error of 1 % is {_mm(0.01 * float(np.std(rows.displacement_m)))} rms"
    return [f"{SENSITIVITY}: {size} (accelerometer.scale_std includes it)"]


def _logger_delay(settings: RecordingSettings, calibration: Calibration, rows: Estimate) -> list[str]:
    # The clock offset of all sensors but those of a displacement is estimated; of these where the motion shows one.
    known = [one for one in settings.displacements if not one.estimate_offset]
    shown = any(one.offset.value_s != 0.0 for _, _, one in calibration.sensors if _is_displacement(one))
    if not shown and len(known) == len(settings.sensors):
        return []
    size = _mm(1e-3 * float(np.sqrt(np.mean(np.square(rows.velocity_m_s)))))
    return [f"{DELAY} (anti-alias filter), indistinguishable from a clock offset: 1 ms is {size} rms"]


def _tilt(settings: RecordingSettings, calibration: Calibration) -> list[str]:
    found = dict[str, list[str]]()
    own = {name: one for name, _, one in calibration.sensors if isinstance(one, CameraCalibration)}
    for sensor in settings.sensors:
        camera = sensor.settings
        if not isinstance(camera, CameraSettings) or camera.tilt_std_mdeg > 0.0:
            continue
        if sensor.name in own and (own[sensor.name].tilt_std_px > 0.0 or own[sensor.name].holds_tilt):
            continue
        distance_m = target_distance_m(camera, own[sensor.name]) if sensor.name in own else camera.distance_m
        turned = _mm(math.radians(1e-3) * (distance_m or 1.0))
        size = f"{turned} at {distance_m:.3g} m" if distance_m else f"{turned} per metre of distance"
        found.setdefault(size, []).append(sensor.name)
    return [
        f"{', '.join(names)}: {TILT}; 1 mdeg is {size} (tilt_std_mdeg includes it)" for size, names in found.items()
    ]


def _targets(settings: RecordingSettings, calibration: Calibration) -> list[str]:
    # Two targets cannot tell a slow motion of one from a tilt; a third or another sensor of the tilt contradicts.
    found = list[str]()
    if settings.gyroscope is not None or settings.inclinometer is not None:
        return found
    for name, _, one in calibration.sensors:
        if not isinstance(one, CameraCalibration) or one.tilt_std_px == 0.0 or len(one.used) != 2:
            continue
        per_m = [1.0 / mapping.scale_m_per_px for mapping in one.mappings()]
        size = _mm(0.1 / abs(per_m[0] - per_m[1]))
        names = " or ".join(target.name for target in one.used)
        found.append(
            f"{name}: {OWN_MOTION} ({names}; settlement, warming, a loose mount), indistinguishable from a tilt: "
            f"0.1 px is {size} (a third target shows it)"
        )
    return found


def _angles(calibration: Calibration) -> list[str]:
    """What an inclinometer or gravity may be off by; a tilt moves the displacement by as much as the image shows."""
    found = []
    for one in calibration.auxiliary:
        if one.kind not in ANGLES:
            continue
        name, drift, more = ANGLES[one.kind]
        declared = "" if one.verified else "sign and scale, which the motion does not verify, "
        included = math.degrees(math.sqrt(60.0 * one.zero_walk)) * 1e3
        found.append(f"{name}: {declared}{drift} beyond {rounded(included)} mdeg in a minute{more}")
    return found


def _slow_errors(calibration: Calibration) -> list[str]:
    found = []
    for name, _, one in calibration.sensors:
        if not isinstance(one, DisplacementCalibration) or one.unseen_drift_m == 0.0:
            continue
        size = f"of up to {_mm(one.unseen_drift_m)}" if math.isfinite(one.unseen_drift_m) else "of any size"
        step = f"below {_mm(one.unseen_step_m)}" if math.isfinite(one.unseen_step_m) else "of any size"
        if one.unseen_gap_m > 0.0:
            in_gap = f"below {_mm(one.unseen_gap_m)}" if one.unseen_gap_m < NEAR_M else "of any size"
            step += f" ({in_gap} in its longest gap)"
        found.append(
            f"{name}: {SLOW_ERROR} (GNSS multipath, refraction at a total station) {size} in {DRIFT_S:g} s, or a zero "
            f"step {step}, cannot be detected (displacement.noise_time_s includes the slow error; 0: none)"
        )
    return found


def _is_displacement(sensor: object) -> bool:
    return isinstance(sensor, DisplacementCalibration)


def _mm(metres: float) -> str:
    return f"{rounded(1e3 * metres)} mm"
