"""Tracking a recording's camera: the reference frame, the region, and the frames in their order."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from midspan.errors import DataError
from midspan.recording.progress import Progress, silent
from midspan.records import NANOSECONDS, Floats, Frame, Nanoseconds, PixelTrack, PixelTranslation, Region, Status
from midspan.signals.health import Mask, runs
from midspan.sources.camera.frames import FrameSource
from midspan.vision.region import check_region
from midspan.vision.roi import RegionChoice, RoiSettings, choose_region
from midspan.vision.tracker import open_tracker

# The automatic region looks at this many frames, spread over this many seconds from the first frame used.
CHOICE_FRAMES = 16
CHOICE_S = 8.0
# A variance below this share of the usual one is the mark of a frame that matches itself, not of a quiet one.
SUSPICIOUS_SHARE = 0.25
# Noise of the template over the noise of a frame, as standard deviations.
TEMPLATE_NOISE = 1.15
# This many equal pictures in a row are a frozen camera (or a codec that skipped them), not a structure at rest.
FROZEN_FRAMES = 3
# A frame whose mean is below this share of full scale is dark; at most this many are skipped at the start.
DARK_SHARE = 0.02
MOST_DARK = 1000


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
    """Frames from the first one used, tracked one after another; the rows tracked so far are in `track`.

    Dark frames before the first lit one are skipped (`skipped` tells how many): nothing could be found in them.
    """

    def __init__(self, source: FrameSource, settings: TrackingSettings, progress: Progress = silent) -> None:
        self.source, self.progress = source, progress
        self.skipped = dark_start(source, settings.first)
        self.settings = settings = replace(settings, first=settings.first + self.skipped)
        self.time_ns: Nanoseconds = source.times_ns()[settings.first : settings.last]
        if len(self.time_ns) < 2:
            raise DataError(f"camera: has {len(self.time_ns)} usable frames; at least 2 are needed.")
        self.choice: RegionChoice | None = None
        region = settings.region or self._choose()
        self._frames = iter(source.frames(settings.first, settings.last))
        self.reference = self._next_frame()
        check_region(region, self.reference.pixels.shape[1], self.reference.pixels.shape[0])
        self.tracker = open_tracker(settings.tracker, self.reference, region)
        self._pending: Frame | None = self.reference
        self._rows: list[PixelTranslation] = []
        self._repeats: list[bool] = []
        self._seen = np.empty((0, 0))

    @property
    def done(self) -> int:
        """How many frames have been tracked."""
        return len(self._rows)

    @property
    def track(self) -> PixelTrack:
        """The rows tracked so far as one block; frames of a frozen picture are lost."""
        track = with_fair_variance(lost_where(PixelTrack.stack(self._rows), self.frozen))
        region, height = self.tracker.region, max(self.source.info.height - 1, 1)
        row = region.y + 0.5 * (region.height - 1) + np.nan_to_num(track.y_px)
        late_ns = np.rint(self.settings.readout_s * NANOSECONDS * row / height).astype(np.int64)
        return replace(track, time_ns=track.time_ns + late_ns)

    @property
    def frozen(self) -> Mask:
        """Frames (n,) so far that only repeat the picture before them, in runs of at least `FROZEN_FRAMES`."""
        mask = np.zeros(len(self._repeats), dtype=bool)
        for start, end in runs(np.array(self._repeats, dtype=bool)):
            mask[start:end] = end - start + 1 >= FROZEN_FRAMES
        return mask

    def blur_s(self, exposure_s: float | None) -> float:
        """The time a measured translation is averaged over: the exposure, and the read-out of the region's rows.

        Both are box averages; their widths add as squares.
        """
        rows = self.settings.readout_s * self.tracker.region.height / max(self.source.info.height, 1)
        return float(np.hypot(exposure_s or 0.0, rows))

    def until(self, time_ns: int) -> PixelTrack:
        """Track, without a prediction, all frames up to `time_ns` on the camera's clock; returns all rows so far."""
        while self.done < len(self.time_ns) and self.time_ns[self.done] <= time_ns:
            frame = self.take()
            if frame is None:
                break
            self.add(frame, self.tracker.push(frame))
        return self.track

    def take(self) -> Frame | None:
        """The next frame that has not been tracked, None at the end."""
        self.progress(self.done, len(self.time_ns), "tracking")
        frame, self._pending = self._pending, None
        if frame is not None:
            return frame
        return next(self._frames, None)

    def add(self, frame: Frame, translation: PixelTranslation) -> None:
        """Keep what the tracker found in `frame`."""
        region = self.tracker.region
        seen = np.asarray(frame.pixels[region.y : region.y + region.height, region.x : region.x + region.width])
        self._repeats.append(bool(np.array_equal(seen, self._seen)))
        self._seen = seen.copy()
        self._rows.append(translation)

    def close(self) -> None:
        """Let the file go."""
        self._frames.close()  # type: ignore[attr-defined]

    def warnings(self) -> list[str]:
        """What of the frames tracked so far is worth telling."""
        found = []
        if self.skipped:
            found.append(
                f"camera: the first {self.skipped} frames are dark and were skipped; the zero is at the first lit one."
            )
        frozen = int(np.count_nonzero(self.frozen))
        if frozen:
            found.append(f"camera: {frozen} frames only repeat the picture before them (frozen); they were not used.")
        return found

    def _next_frame(self) -> Frame:
        frame = next(self._frames, None)
        if frame is None:
            raise DataError("camera: no frame can be decoded. Play the video to check it, or copy it again.")
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


def dark_start(source: FrameSource, first: int) -> int:
    """How many frames from `first` on are dark; 0 when none of the first `MOST_DARK` is lit."""
    for index, frame in enumerate(source.frames(first, first + MOST_DARK)):
        if not is_dark(np.asarray(frame.pixels)):
            return index
    return 0


def is_dark(pixels: NDArray[Any]) -> bool:
    """Whether an integer frame (rows, columns) is black: neither its mean nor its brightest pixels leave the bottom.

    Cameras put 10 or 12 bits into files of 16, so full scale is not known; a dark frame also has no contrast.
    """
    if pixels.dtype.kind == "f":
        return False
    mean, bright = float(np.mean(pixels)), float(np.percentile(pixels[::4, ::4], 99))
    scale = 255.0 if pixels.dtype.itemsize == 1 else 1023.0
    return mean < DARK_SHARE * scale and bright < 2.0 * DARK_SHARE * scale


def lost_where(track: PixelTrack, mask: Mask) -> PixelTrack:
    """The track with the frames of `mask` (n,) marked lost."""
    if not mask.any():
        return track
    empty = {
        name: np.where(mask, np.nan, getattr(track, name))
        for name in ("x_px", "y_px", "variance_x_px2", "variance_y_px2")
    }
    return replace(track, status=np.where(mask, np.uint8(Status.LOST), track.status), **empty)


def with_fair_variance(track: PixelTrack) -> PixelTrack:
    """The track with the usual variance where a frame matched the reference without noise.

    The reference frame (and any frame equal to it) matches itself perfectly and would seem to be known exactly; but its
    noise is the noise of the template, and the zero of the displacement is no better known than that. A template's
    noise also enters through the edge of its window, which moves over the frame: measured 1.2 to 1.4 times a frame's
    own.
    """

    def fair(variance: Floats) -> Floats:
        known = variance[np.isfinite(variance)]
        usual = float(np.median(known)) if len(known) else 0.0
        return np.where(variance < SUSPICIOUS_SHARE * usual, TEMPLATE_NOISE**2 * usual, variance)

    return replace(track, variance_x_px2=fair(track.variance_x_px2), variance_y_px2=fair(track.variance_y_px2))
