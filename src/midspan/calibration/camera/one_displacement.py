"""The targets of a camera as displacements on the accelerometer's clock."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from midspan.calibration.camera.view import SeenTarget
from midspan.calibration.sensors.camera import CameraCalibration
from midspan.calibration.sensors.camera_scale import CameraScale
from midspan.calibration.whitening import BIAS_WALK_RATIO
from midspan.fusion.streams import KalmanSettings
from midspan.records import Acceleration, Displacement
from midspan.signals.acceleration import PreparedAcceleration
from midspan.signals.averaging import at_instants


def camera_blocks(
    targets: Sequence[SeenTarget], camera: CameraCalibration, acceleration: Acceleration
) -> list[Displacement]:
    """The displacement that each target in use says, on the accelerometer's clock, without the exposure's averaging."""
    pairs = zip(targets, camera.mappings(), strict=True)
    return [target_block(target, mapping, camera.exposure_s, acceleration) for target, mapping in pairs]


def target_block(
    target: SeenTarget, mapping: CameraScale, exposure_s: float, acceleration: Acceleration
) -> Displacement:
    """The displacement that one target says; exposure_s: as estimated, that of a camera of which none was declared."""
    blur_s = float(np.hypot(target.blur_s, exposure_s))
    block = at_instants(mapping.displacement(target.rows), blur_s, acceleration)
    # What the reference frame makes is not among what the factor was estimated from.
    more = mapping.scale_m_per_px**2 * target.reference_px2[:, "xy".index(mapping.direction)]
    return replace(block, variance_m2=block.variance_m2 + more)


def filter_settings(prepared: PreparedAcceleration, density: float, bias: float | None = None) -> KalmanSettings:
    """First guesses for the filter: the bias (the mean when left out) and how well it is known.

    density: of the acceleration's noise, (m/s²)²/Hz. Without any acceleration the motion is that noise, and its slow
    part is left to the bias as it was when the density was estimated.
    """
    value = prepared.value_m_s2
    if not value.any():
        return KalmanSettings(bias_walk=BIAS_WALK_RATIO * density, bias_std=float(np.sqrt(density)) + 1e-9)
    noise = float(np.sqrt(density * prepared.rate_hz))
    # A mean over motion is off by some of the motion.
    return KalmanSettings(
        bias=float(np.mean(value)) if bias is None else bias, bias_std=float(0.3 * np.std(value) + 10.0 * noise + 1e-4)
    )
