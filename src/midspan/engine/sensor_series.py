"""What one sensor measured over a record, in metres, and what a result keeps of a camera: plain records of arrays."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from midspan.calibration.sensors.camera import CameraCalibration
from midspan.engine.averaging import in_displacement_alone
from midspan.engine.tracking import CameraTracking
from midspan.fusion.path import at
from midspan.fusion.targets import agreeing, combine, relative_zeros
from midspan.records import (
    Acceleration,
    Channel,
    Displacement,
    Estimate,
    Event,
    Floats,
    Measured,
    Nanoseconds,
    PixelTrack,
    Region,
    Source,
    part,
)
from midspan.signals.averaging import at_instants
from midspan.thermal.temperature_range import RangeSurface
from midspan.vision.active_pixels import ActivePixels
from midspan.vision.roi import RegionChoice


@dataclass(frozen=True, slots=True, eq=False)
class SensorSeries:
    """Measurements value_m (n,) of one sensor at time_ns (n,) on the accelerometer's clock, std_m (n,) of each.

    sensor: its name; source: how the result's rows that rest on it are marked. NaN where nothing was measured. The zero
    is the sensor's own.
    """

    sensor: str
    source: Source
    time_ns: Nanoseconds
    value_m: Floats
    std_m: Floats

    @property
    def displacement(self) -> Displacement:
        """The series as measurements; variances are infinite where nothing was measured."""
        variance = np.where(np.isfinite(self.value_m), self.std_m**2, np.inf)
        source = np.full(len(self.time_ns), self.source, dtype=np.uint8)
        return Displacement(self.time_ns, self.value_m, variance, source)


def series_of(sensor: str, source: Source, measured: Displacement) -> SensorSeries:
    """The measurements of a sensor as a series."""
    seen = np.isfinite(measured.value_m) & np.isfinite(measured.variance_m2)
    value = np.where(seen, measured.value_m, np.nan)
    std = np.sqrt(np.where(seen, measured.variance_m2, np.nan))
    return SensorSeries(sensor, source, measured.time_ns, value, std)


def agreed_series(
    sensor: str, source: Source, targets: tuple[Sequence[Displacement], int], path: Estimate
) -> SensorSeries:
    """What a sensor's targets measured together: at each instant the mean of those that agree.

    targets: the displacements of each, one row a frame, and the number of the best. path: the displacement; it bridges
    the milliseconds between targets, and decides where two contradict each other. The stamps are the best target's.
    """
    blocks, best = targets
    if len(blocks) == 1:
        return series_of(sensor, source, blocks[0])
    residual = np.array([block.value_m - at(path, block.time_ns)[0] for block in blocks])
    variance = np.array([block.variance_m2 for block in blocks])
    residual -= relative_zeros(residual, variance)[:, None]
    expected, spread = at(path, blocks[best].time_ns)
    value, own = combine(residual, variance, agreeing(residual, variance, spread))
    return series_of(sensor, source, replace(blocks[best], value_m=value + expected, variance_m2=own))


def channel_series(measured: Measured, channels: Sequence[Channel], sensor: str, path: Estimate) -> SensorSeries:
    """What the channels of a sensor measured, each one row a frame, together; the first one is the best.

    What is uncertain of the zero of all of them is no noise of a frame; of one relative to the others it takes its
    weight.
    """
    rows = [(c, part(measured, measured.channel == k)) for k, c in enumerate(channels) if c.sensor == sensor]
    zeros = np.array([own.reference_variance / channel.units_per_m**2 for channel, own in rows])
    blocks = []
    for (channel, own), zero in zip(rows, zeros - zeros.min(axis=0), strict=True):
        source = np.full(len(own.time_ns), channel.source, dtype=np.uint8)
        variance = channel.variance_factor * own.variance / channel.units_per_m**2 + zero
        blocks.append(Displacement(own.time_ns, own.value / channel.units_per_m, variance, source))
    return agreed_series(sensor, Source(int(blocks[0].source[0])), (blocks, 0), path)


def series_at_instants(
    series: Mapping[str, SensorSeries], channels: Sequence[Channel], axis: int, acceleration: Acceleration
) -> dict[str, SensorSeries]:
    """The series of sensors along an axis, by name, without what their exposures take from fast motion."""
    # The first one of a sensor is its best target's.
    exposures = {one.sensor: one.exposure_s for one in reversed(channels) if one.axis == axis}
    first, found = not in_displacement_alone(channels), {}
    for name, one in series.items():
        measured = at_instants(one.displacement, exposures[name], acceleration, first_term=first)
        found[name] = series_of(name, one.source, measured)
    return found


@dataclass(frozen=True, slots=True, eq=False)
class TargetResult:
    """One target of a camera, frame by frame.

    region: in the reference frame, px; track: its translation on the camera's own clock, with whole variances; strength
    (n,): good matches, of trackers without matches the quality in percent, 0 where it was lost; reference_px2 (n, 2):
    the part of the variances along x and y that the reference frame makes, for many frames alike. active_pixels: those
    whose phase was used; None for other trackers.
    """

    name: str
    region: Region
    track: PixelTrack
    strength: Floats
    reference_px2: Floats
    active_pixels: ActivePixels | None = None


@dataclass(frozen=True, slots=True, eq=False)
class CameraResult:
    """One camera of a recording at the end of an estimate.

    sensor: its name; source: how the rows that rest on it are marked; calibrations: what was estimated along each
    measured axis, the main one first; reference (rows, columns): pixels of the first frame used; best: number of the
    best target along the main axis. choice: how the regions were chosen, None where they were given; range_surface: how
    the temperature range was found, None where it was not looked for. events: what happened to its targets, on the
    accelerometer's clock.
    """

    sensor: str
    source: Source
    calibrations: tuple[CameraCalibration, ...]
    reference: NDArray[np.generic]
    targets: tuple[TargetResult, ...]
    best: int = 0
    choice: RegionChoice | None = None
    range_surface: RangeSurface | None = None
    events: tuple[Event, ...] = ()

    @property
    def track(self) -> PixelTrack:
        """The best target's track, on the camera's own clock."""
        return self.targets[self.best].track

    def displacement(self, target: int, axis: int = 0) -> Displacement:
        """What a target says along the axis of this number, on the accelerometer's clock."""
        mapping, found = self.calibrations[axis].mappings()[target], self.targets[target]
        more_x, more_y = found.reference_px2.T
        x, y = found.track.variance_x_px2 - more_x, found.track.variance_y_px2 - more_y
        levers = (mapping.lever_px, 0.0) if mapping.direction == "x" else (0.0, mapping.lever_px)
        single = mapping.displacement(replace(found.track, variance_x_px2=x, variance_y_px2=y).without_zoom(levers))
        # The estimated factor is of single frames; what the reference makes is not among them.
        shared = mapping.scale_m_per_px**2 * (more_x, more_y)["xy".index(mapping.direction)]
        return replace(single, variance_m2=single.variance_m2 + shared)


def camera_result(
    tracking: CameraTracking, sensor: str, calibrations: Sequence[CameraCalibration], events: Sequence[Event] = ()
) -> CameraResult:
    """What is kept of a camera that was tracked to its end; the targets are those that the calibrations use.

    events: what happened to them, on the accelerometer's clock.
    """
    return CameraResult(
        sensor=sensor,
        source=calibrations[0].source,
        calibrations=tuple(calibrations),
        reference=tracking.reference.pixels,
        targets=tuple(
            TargetResult(
                name=target.name,
                region=target.region,
                track=target.track,
                strength=target.strengths,
                reference_px2=target.reference_px2,
                active_pixels=target.tracker.active_pixels,
            )
            for target in tracking.targets
        ),
        best=best_target([target.region for target in tracking.targets], calibrations[0]),
        choice=tracking.choice,
        range_surface=tracking.range_surface,
        events=tuple(events),
    )


def best_target(regions: Sequence[Region], camera: CameraCalibration) -> int:
    """Number of the best target along an axis; a single one may have been moved a little by the recording."""
    return list(regions).index(camera.region) if camera.region in regions else 0


def _without_tilt(blocks: Sequence[Displacement], calibration: CameraCalibration, path: Estimate) -> Displacement:
    """The difference of the two targets of a tilting camera that tells the displacement best."""
    ratio = [1.0 / one.scale_m_per_px for one in calibration.mappings()]
    usual = [float(np.nanmedian(np.where(np.isfinite(one.variance_m2), one.variance_m2, np.nan))) for one in blocks]

    def variance(i: int, k: int) -> float:
        return (ratio[i] ** 2 * usual[i] + ratio[k] ** 2 * usual[k]) / max((ratio[i] - ratio[k]) ** 2, 1e-300)

    i, k = min(combinations(range(len(blocks)), 2), key=lambda pair: variance(*pair))
    shares = ratio[i] / (ratio[i] - ratio[k]), -ratio[k] / (ratio[i] - ratio[k])
    one, other = blocks[i], blocks[k]
    value = at(path, one.time_ns)[0]
    for share, block in zip(shares, (one, other), strict=True):
        value = value + share * (block.value_m - at(path, block.time_ns)[0])
    own = shares[0] ** 2 * one.variance_m2 + shares[1] ** 2 * other.variance_m2
    return replace(one, value_m=value, variance_m2=own)


def camera_series(camera: CameraResult, path: Estimate, axis: int = 0) -> SensorSeries:
    """What a camera measured along the axis of this number: in each frame the mean of those targets that agree, of one
    that tilts the difference of two.

    path: the displacement along this axis; it bridges the milliseconds between the rows of a rolling shutter that the
    targets lie in, and decides where two targets contradict each other. The stamps are the best target's.
    """
    blocks = [camera.displacement(number, axis) for number in range(len(camera.targets))]
    if camera.calibrations[axis].tilt_std_px > 0.0 and len(blocks) > 1:
        return series_of(camera.sensor, camera.source, _without_tilt(blocks, camera.calibrations[axis], path))
    best = best_target([target.region for target in camera.targets], camera.calibrations[axis])
    return agreed_series(camera.sensor, camera.source, (blocks, best), path)
