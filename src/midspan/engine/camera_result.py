"""What a result keeps of a camera: plain records of arrays, made from its tracking at the end."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from midspan.calibration.sensors.camera import CameraCalibration
from midspan.engine.sensor_series import SensorSeries, agreed_series
from midspan.engine.tracking import CameraTracking
from midspan.records import Displacement, Estimate, Event, Floats, PixelTrack, Region, Source
from midspan.thermal.temperature_range import RangeSurface
from midspan.vision.active_pixels import ActivePixels
from midspan.vision.roi import RegionChoice


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
        single = mapping.displacement(replace(found.track, variance_x_px2=x, variance_y_px2=y))
        # The estimated factor is of single frames; what the reference makes is not among them.
        shared = mapping.scale_m_per_px**2 * (more_x, more_y)["xy".index(mapping.direction)]
        return replace(single, variance_m2=single.variance_m2 + shared)


def camera_result(
    tracking: CameraTracking,
    sensor: str,
    calibrations: Sequence[CameraCalibration],
    events: Sequence[Event] = (),
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


def camera_series(camera: CameraResult, path: Estimate, axis: int = 0) -> SensorSeries:
    """What a camera measured along the axis of this number: in each frame the mean of those targets that agree.

    path: the displacement along this axis; it bridges the milliseconds between the rows of a rolling shutter that the
    targets lie in, and decides where two targets contradict each other. The stamps are the best target's.
    """
    blocks = [camera.displacement(number, axis) for number in range(len(camera.targets))]
    best = best_target([target.region for target in camera.targets], camera.calibrations[axis])
    return agreed_series(camera.sensor, camera.source, (blocks, best), path)
