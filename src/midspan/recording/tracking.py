"""Tracking a recording's camera: the reference frame, the region, and the frames in their order."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from midspan.errors import DataError
from midspan.recording.progress import Progress, silent
from midspan.records import NANOSECONDS, Floats, Frame, Nanoseconds, PixelTrack, PixelTranslation, Region
from midspan.sources.camera.frames import FrameSource
from midspan.vision.region import check_region
from midspan.vision.roi import RegionChoice, RoiSettings, choose_region
from midspan.vision.tracker import open_tracker

# The automatic region looks at this many frames, spread over this many seconds from the first frame used.
CHOICE_FRAMES = 16
CHOICE_S = 8.0
# A variance below this share of the usual one is the mark of a frame that matches itself, not of a quiet one.
SUSPICIOUS_SHARE = 0.25


@dataclass(frozen=True, slots=True)
class TrackingSettings:
    """What to track: the tracker's name, the measured image axis, the region (None: chosen) and the frames used.

    first: index of the reference frame; last: index after the last frame used. readout_s: rolling shutter, s from the
    first row (which the stamps belong to) to the last: the track's times are those of the target's middle row.
    """

    tracker: str
    direction: str = "y"
    region: Region | None = None
    first: int = 0
    last: int | None = None
    readout_s: float = 0.0


class CameraTracking:
    """Frames from the first one used, tracked one after another; the rows tracked so far stay in `rows`."""

    def __init__(self, source: FrameSource, settings: TrackingSettings, progress: Progress = silent) -> None:
        self.source, self.settings, self.progress = source, settings, progress
        self.time_ns: Nanoseconds = source.times_ns()[settings.first : settings.last]
        if len(self.time_ns) < 2:
            raise DataError(f"The camera has {len(self.time_ns)} usable frames; at least 2 are needed.")
        self.rows: list[PixelTranslation] = []
        self.choice: RegionChoice | None = None
        region = settings.region or self._choose()
        self._frames = self._read()
        self.reference = self._next_frame()
        check_region(region, self.reference.pixels.shape[1], self.reference.pixels.shape[0])
        self.tracker = open_tracker(settings.tracker, self.reference, region)
        self._pending: Frame | None = self.reference

    @property
    def track(self) -> PixelTrack:
        """The rows tracked so far as one block."""
        track = with_fair_variance(PixelTrack.stack(self.rows))
        region, height = self.tracker.region, max(self.source.info.height - 1, 1)
        row = region.y + 0.5 * (region.height - 1) + np.nan_to_num(track.y_px)
        late_ns = np.rint(self.settings.readout_s * NANOSECONDS * row / height).astype(np.int64)
        return replace(track, time_ns=track.time_ns + late_ns)

    def until(self, time_ns: int) -> PixelTrack:
        """Track, without a prediction, all frames up to `time_ns` on the camera's clock; returns all rows so far."""
        while len(self.rows) < len(self.time_ns) and self.time_ns[len(self.rows)] <= time_ns:
            frame = self.take()
            if frame is None:
                break
            self.rows.append(self.tracker.push(frame))
        return self.track

    def take(self) -> Frame | None:
        """The next frame that has not been tracked, None at the end."""
        self.progress(len(self.rows), len(self.time_ns), "tracking")
        frame, self._pending = self._pending, None
        if frame is not None:
            return frame
        try:
            return self._next_frame()
        except DataError:
            if len(self.rows) < 2:
                raise
            return None

    def close(self) -> None:
        """Let the file go."""
        self._frames.close()  # type: ignore[attr-defined]

    def _read(self) -> Iterator[Frame]:
        return iter(self.source.frames(self.settings.first, self.settings.last))

    def _next_frame(self) -> Frame:
        frame = next(self._frames, None)
        if frame is None:
            raise DataError("The camera's frames ended before anything could be tracked.")
        return frame

    def _choose(self) -> Region:
        until = self.time_ns[0] + int(CHOICE_S * NANOSECONDS)
        count = max(int(np.searchsorted(self.time_ns, until, side="right")), min(len(self.time_ns), CHOICE_FRAMES))
        wanted = set(np.unique(np.linspace(0, count - 1, CHOICE_FRAMES).astype(int)).tolist())
        frames = []
        for index, frame in enumerate(self.source.frames(self.settings.first, self.settings.first + count)):
            self.progress(index, count, "choosing the region")
            if index in wanted:
                frames.append(frame)
        self.choice = choose_region(frames, RoiSettings(direction=self.settings.direction))
        return self.choice.region


def with_fair_variance(track: PixelTrack) -> PixelTrack:
    """The track with the usual variance where a frame matched the reference without noise.

    The reference frame (and any frame equal to it) matches itself perfectly and would seem to be known exactly; but its
    noise is the noise of the template, and the zero of the displacement is no better known than that.
    """

    def fair(variance: Floats) -> Floats:
        known = variance[np.isfinite(variance)]
        usual = float(np.median(known)) if len(known) else 0.0
        return np.where(variance < SUSPICIOUS_SHARE * usual, usual, variance)

    return replace(track, variance_x_px2=fair(track.variance_x_px2), variance_y_px2=fair(track.variance_y_px2))
