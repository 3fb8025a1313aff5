"""A radar's stage and its channels from a calibration."""

import math
from dataclasses import replace

import numpy as np

from midspan.calibration.sensors.radar import RadarCalibration
from midspan.engine.channels import Table, ages, clock_std_s
from midspan.engine.radar import RadarChain
from midspan.engine.radar_target import FollowedTarget
from midspan.engine.sensors import RadarSensor
from midspan.errors import UsageError
from midspan.fusion.model import Parameter, ParameterKind
from midspan.radar.chirp import RadarInfo
from midspan.radar.frames import bin_m_of
from midspan.radar.target import Target
from midspan.records import Channel, Source

# Where the structure is when a target is first used, relative to the best target's first frame, m: more than structures
# move by, and little enough for the estimator's arithmetic together with variances of (1 µm)².
OTHER_ZERO_STD_M = 0.1
# Density of the random walk of a radar's clock relative to the accelerometer's, s²/s: it follows a drift of 60 ppm at
# once.
CLOCK_WALK = 3.6e-9
# A target calibrated for another radar, or moved since, differs in carrier by this share or in range by this many bins.
SAME_CARRIER, SAME_BINS = 1e-5, 0.5


def radar_chain(
    calibration: RadarCalibration, info: RadarInfo, sensor: str = "radar", moved_m: float = 0.0
) -> tuple[RadarChain, tuple[Channel, ...]]:
    """The stage of the calibrated targets, best first, and one channel each, whose measurements are phases in rad.

    The frames must hold the stage's `bins`: `source.slow_time(chain.bins)`. moved_m: standard deviation of the
    structure's usual displacement.
    """
    bin_m = bin_m_of(info)
    targets = tuple(
        FollowedTarget.of(
            target,
            info.axis.phase_per_m(target.range_m),
            bin_m,
            period_s=1.0 / info.frame_rate_hz,
            bins=info.bins,
            moved_m=moved_m,
        )
        for target in calibration.used
    )
    channels = tuple(
        Channel(
            sensor,
            Source.RADAR,
            units_per_m=item.phase_per_m / item.target.conversion_factor,
            target=str(k + 1),
            variance_factor=calibration.variance_factor,
            zero_std_m=OTHER_ZERO_STD_M if k else first_zero_std_m(item),
        )
        for k, item in enumerate(targets)
    )
    return RadarChain(targets, sensor), channels


def radar_channels(
    table: Table,
    calibration: RadarCalibration,
    info: RadarInfo,
    *,
    sensor: str,
    step_s: float,
    moved_m: float,
    first: bool,
) -> RadarSensor:
    """A radar's sensor, and its channels in the table.

    step_s: its usual interval; moved_m: standard deviation of the usual displacement; first: whether its zero is that
    of the displacement.
    """
    coasting_s, lost_s = ages(step_s)
    chain, channels = radar_chain(calibration, info, sensor, moved_m)
    numbers = [
        table.add(
            replace(channel, coasting_s=coasting_s, lost_s=lost_s, zero_std_m=channel.zero_std_m if first else np.inf)
        )
        for channel in channels
    ]
    table.scaled(numbers, calibration.relative_std)
    clock = ParameterKind.CLOCK_OFFSET
    table.parameters.append(Parameter(clock, tuple(numbers), clock_std_s(calibration.offset), 0, CLOCK_WALK))
    return RadarSensor(sensor, chain, numbers)


def require_same_radar(info: RadarInfo, calibration: RadarCalibration) -> None:
    """UsageError where the calibration belongs to other settings of the radar."""
    if abs(info.carrier_hz / calibration.carrier_hz - 1.0) > SAME_CARRIER:
        raise UsageError(
            f"radar: the calibration was made at a carrier of {calibration.carrier_hz / 1e9:.6g} GHz, this recording "
            f"has {info.carrier_hz / 1e9:.6g} GHz. Calibrate again."
        )
    if info.channels != calibration.channels:
        raise UsageError(
            f"radar: the calibration was made with {calibration.channels} channels, this recording has "
            f"{info.channels}. Calibrate again."
        )
    bin_m = float(np.median(np.diff(info.range_m))) if info.bins > 1 else np.nan
    for target in calibration.used:
        if target.place_bin > info.bins - 1:
            raise UsageError(
                f"radar: the calibration's target is at bin {target.place_bin:.1f}, this recording has {info.bins} "
                "bins. Calibrate again."
            )
        apart = abs(info.axis.range_at(target.place_bin) - target.range_m)
        if apart > SAME_BINS * bin_m:
            raise UsageError(
                f"radar: the calibration's target at {target.range_m:.3f} m would be at "
                f"{info.axis.range_at(target.place_bin):.3f} m with this recording's settings. Calibrate again."
            )


def first_zero_std_m(item: FollowedTarget) -> float:
    """Standard deviation of the zero that the best target's first frame gives, m of displacement."""
    target: Target = item.target
    bent_m = abs(target.conversion_factor) * target.bent_rad / item.phase_per_m
    return math.hypot(target.noise_m, bent_m)
