"""A camera's tracking that was done before: rows from a track in place of frames."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from midspan.engine.camera import CameraState, Target, TargetReport
from midspan.engine.tracking import CameraTracking, TargetTracking, TrackingSettings
from midspan.errors import DataError
from midspan.progress import Progress, silent
from midspan.records import Frame, PixelTranslation, Region, Status
from midspan.vision.active_pixels import ActivePixels
from midspan.vision.frame_source import FrameSource, StoredTrack


class StoredTracker:
    """What stands for a tracker where only its rows are known."""

    phase_gain_px_per_rad: tuple[float, float] | None = None
    active_pixels: ActivePixels | None = None
    # Of a fixed pattern nothing is known.
    scale_share_std = 0.0
    learns_by_acceleration = False

    def __init__(self, reference: Frame, region: Region) -> None:
        self.reference, self.region = reference, region


class StoredTarget:
    """What stands for a target's chain: nothing is left to be tracked."""

    report = TargetReport()

    def __init__(self, reference: Frame, target: StoredTrack, readout_s: float, first: int = 0) -> None:
        self.name, self.region = target.name, target.region
        # The rows of a track are dated as they were tracked.
        self.first_late_ns = int(target.rows.time_ns[first]) - reference.time_ns
        self.tracker: Any = StoredTracker(reference, target.region)
        self._readout_s = readout_s

    def blur_s(self, exposure_s: float | None) -> float:
        """The time a translation is averaged over: the exposure, and the read-out of the region's rows."""
        rows = self._readout_s * self.region.height / max(self.tracker.reference.pixels.shape[0], 1)
        return math.hypot(exposure_s or 0.0, rows)


class StoredChain:
    """What stands for a camera's chain."""

    state = CameraState(())

    def __init__(self, targets: Sequence[StoredTarget]) -> None:
        self.targets = tuple(targets)

    def restore(self, state: CameraState) -> None:
        """Nothing changes from frame to frame."""

    def push(self, frame: Frame, predictions: object = None) -> tuple[PixelTranslation, ...]:
        """There is nothing to track with."""
        raise DataError("A track holds what was found in frames; new frames cannot be tracked with it.")

    def leave_out(self, places: Sequence[int]) -> None:
        """Use the targets of these numbers (from 0) no further."""
        self.targets = tuple(target for k, target in enumerate(self.targets) if k not in places)


class StoredTracking(CameraTracking):
    """The tracking of a track: all its rows are there from the beginning."""

    def __init__(self, source: FrameSource, settings: TrackingSettings, progress: Progress = silent) -> None:
        self.source, self.progress, self.settings = source, progress, settings
        used = slice(settings.first, settings.last)
        self.time_ns = source.times_ns()[used]
        info = source.info
        self.reference = Frame(int(self.time_ns[0]), np.zeros((info.height, info.width), dtype=np.uint8))
        # The tracks of the targets that a calibration uses, all where none are named.
        names = [target.name for target in settings.targets]
        named = tuple(track for track in source.tracks if track.name in names)
        tracks = named if named and len(named) == len(names) else tuple(source.tracks)
        targets = [StoredTarget(self.reference, track, settings.readout_s, settings.first) for track in tracks]
        self.chain: Any = StoredChain(targets)
        self.targets = tuple(TargetTracking(target) for target in targets)  # type: ignore[arg-type]
        self.chosen = tuple(Target(track.region, track.name) for track in tracks)
        self.skipped, self.ended, self.done = 0, True, len(self.time_ns)
        self.choice = self.range_surface = None
        self.beside = ()
        for number in range(settings.first, settings.first + self.done):
            for target, track in zip(self.targets, tracks, strict=True):
                target.add(translation(track, number))

    def take(self) -> None:
        """There are no further frames."""

    def close(self) -> None:
        """There is no file to let go."""


def translation(track: StoredTrack, number: int) -> PixelTranslation:
    """What was found in the frame of this number."""
    rows = track.rows
    return PixelTranslation(
        int(rows.time_ns[number]),
        float(rows.x_px[number]),
        float(rows.y_px[number]),
        float(rows.variance_x_px2[number]),
        float(rows.variance_y_px2[number]),
        float(rows.quality[number]),
        Status(rows.status[number]),
        float(track.strength[number]),
        float(track.reference_px2[number, 0]),
        float(track.reference_px2[number, 1]),
    )
