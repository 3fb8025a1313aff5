"""A sensor's calibration in a line: what was estimated of it, with its standard deviations."""

import math

from midspan.calibration.sensors.camera import CameraCalibration
from midspan.calibration.sensors.displacement import DisplacementCalibration
from midspan.calibration.sensors.radar import RadarCalibration
from midspan.records import TimeOffset


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
