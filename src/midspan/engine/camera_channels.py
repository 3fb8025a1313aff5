"""A camera's sensor and its channels from what was calibrated and tracked."""

from collections.abc import Sequence

import numpy as np

from midspan._core import TEMPLATE_NOISE
from midspan.calibration.sensors.camera import CameraCalibration
from midspan.engine.channels import Table, ages, as_first_term, clock_std_s, interval_s
from midspan.engine.sensors import MIN_STD_PX, CameraSensor
from midspan.engine.tracking import CameraTracking
from midspan.fusion.model import ParameterKind
from midspan.records import Channel


def camera_channels(
    table: Table,
    tracking: CameraTracking,
    calibrations: Sequence[CameraCalibration],
    exposure_s: float | None,
    *,
    first: bool,
    min_std_px: float = MIN_STD_PX,
) -> CameraSensor:
    """A camera's sensor, and its channels in the table.

    calibrations: along each axis, the main one first; first: whether its zero is the zero of the displacement.
    min_std_px: see `CameraSensor`.
    """
    sensor = tracking.settings.sensor
    step_s = interval_s(tracking.time_ns)
    coasting_s, lost_s = ages(step_s)
    rows: list[list[int]] = [[] for _ in tracking.targets]
    along: list[list[int]] = []
    for axis, camera in enumerate(calibrations):
        along.append([])
        own_s = camera.exposure_s if exposure_s is None else exposure_s
        mappings = camera.mappings()
        noise = [abs(m.scale_m_per_px) * camera.used[k].noise_std_px for k, m in enumerate(mappings)]
        best = camera.best_used
        for k, (target, mapping) in enumerate(zip(tracking.targets, mappings, strict=True)):
            zero_std_m = 0.0 if k == best else TEMPLATE_NOISE * float(np.hypot(noise[k], noise[best]))
            channel = Channel(
                sensor=sensor,
                source=camera.source,
                units_per_m=1.0 / mapping.scale_m_per_px,
                target=target.name,
                axis=axis,
                variance_factor=mapping.variance_factor,
                exposure_s=as_first_term(target.chain.blur_s(own_s), table.motion_hz),
                zero_std_m=zero_std_m if first else np.inf,
                coasting_s=coasting_s,
                lost_s=lost_s,
            )
            rows[k].append(table.add(channel))
            along[axis].append(rows[k][-1])
    for numbers, camera in zip(along, calibrations, strict=True):
        # An axis without an accelerometer has the other's scale factor.
        shared = numbers if camera.fused else []
        table.scaled(shared or [*numbers, *along[-1]], camera.relative_std)
    every = [number for numbers in along for number in numbers]
    table.uncertain(ParameterKind.CLOCK_OFFSET, every, clock_std_s(calibrations[0].offset))
    directions = [camera.direction for camera in calibrations]
    return CameraSensor(sensor, tracking.chain, rows, directions, step_s=step_s, min_std_px=min_std_px)
