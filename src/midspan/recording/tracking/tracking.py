"""Tracking a recording's camera: the reference frame, the targets, and the frames in their order."""

from collections import deque
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, fields, replace
from operator import attrgetter
from typing import Any

import numpy as np

from midspan.errors import DataError
from midspan.recording.streams.progress import Progress, silent
from midspan.recording.streams.sensor_words import worded
from midspan.recording.tracking.fair_variance import lost_where, more_variance, with_fair_variance
from midspan.recording.tracking.first_frame import begun, is_dark
from midspan.recording.tracking.light import LightWatch, light_warnings
from midspan.recording.tracking.region_choice import ChoiceRequest, Judge, choose_targets
from midspan.recording.tracking.target_opening import Opening, refuse_empty_range
from midspan.records import (
    NANOSECONDS,
    Event,
    Floats,
    Frame,
    Nanoseconds,
    PixelTrack,
    PixelTranslation,
    Prediction,
    Region,
    ScaleFactor,
    Status,
)
from midspan.signals.growing import Columns
from midspan.signals.health import Mask, runs
from midspan.sources.camera.frames import FrameSource
from midspan.thermal.limits import Limits
from midspan.thermal.temperature_range import RangeSurface
from midspan.vision.lens import Lens, ideal_translation, lens_warnings, shown_prediction
from midspan.vision.picture_quality import PictureWatch
from midspan.vision.picture_warnings import picture_warnings
from midspan.vision.region import check_region
from midspan.vision.roi import RegionChoice
from midspan.vision.target import lost
from midspan.vision.tracker import Tracker

# This many equal pictures in a row are a frozen camera (or a codec that skipped them), not a structure at rest.
FROZEN_FRAMES = 3
# The column that tells them, after those of a translation.
REPEATS = 7
_numbers = attrgetter(*(field.name for field in fields(PixelTrack)))
# Every so many rows and columns tell a black frame from a lit one.
THINNED = 4
# Frames that trackers learn from are kept until they are tracked; so much memory at most.
MOST_AHEAD_BYTES = 200_000_000


@dataclass(frozen=True, slots=True)
class Target:
    """A target to be tracked: its region in the reference frame and what it is called."""

    region: Region
    name: str = "1"


@dataclass(frozen=True, slots=True)
class TrackingSettings:
    """What to track: the tracker's name, the measured image axis, the targets (none: chosen) and the frames used.

    reference: how the reference frame is kept, see `Opening`; thermal: frames are temperatures, of which `levels` are
    shown in grey (None: all, as they are). sensor: what messages call it.
    automatic_targets: how many are chosen; trial_from_ns: where the calibration begins, on the camera's clock.
    first: index of the reference frame; last: index after the last frame used. readout_s: rolling shutter, s from the
    first row (which the stamps belong to) to the last: the track's times are those of the target's middle row.
    tracker_settings: the tracker's settings record, None for its defaults. lens: its distortion is taken out of the
    translations (None: is not).
    """

    tracker: str
    direction: str = "y"
    targets: tuple[Target, ...] = ()
    automatic_targets: int = 1
    first: int = 0
    last: int | None = None
    readout_s: float = 0.0
    trial_from_ns: int | None = None
    tracker_settings: Any = None
    lens: Lens | None = None
    reference: str = "first"
    thermal: bool = False
    levels: Limits | None = None
    sensor: str = "camera"

    @property
    def opening(self) -> Opening:
        """What each target is tracked with."""
        return Opening(self.tracker, self.tracker_settings, self.reference, self.thermal, self.levels, self.lens)


class TargetTracking:
    """One target: its tracker, and the rows found so far, one a frame."""

    def __init__(self, tracker: Tracker, name: str, settings: TrackingSettings, *, lossless: bool = False) -> None:
        self.tracker, self.name = tracker, name
        self._lens, self._readout_s = settings.lens, settings.readout_s
        # A frame's time, translation along x and y, their variances, quality, status; whether its picture repeats.
        self._rows = Columns("qdddddBB")
        # How strong it was, the part of its variances along x and y that the reference makes, whether it was dark.
        self._pushed = Columns("dddB")
        self._track: PixelTrack | None = None
        self._quick: PixelTrack | None = None
        self._seen = np.empty((0, 0))
        self.events: list[Event] = []
        self._lit = not is_dark(tracker.reference.pixels)
        # Temperatures are stored as they are: no codec, no full scale.
        self._watch: PictureWatch | None = None
        if not settings.opening.radiometric(tracker.reference):
            self._watch = PictureWatch(tracker.reference, tracker.region, lossless=lossless)
        self._shown = lost(tracker.reference.time_ns)
        # Trackers whose reference changes know themselves what it is off by; temperatures throw no shadows.
        self._light: LightWatch | None = None
        if self._watch is not None and settings.reference == "first":
            self._light = LightWatch(tracker.reference, tracker.region)

    @property
    def region(self) -> Region:
        """The target's region in the reference frame."""
        return self.tracker.region

    def push(self, frame: Frame, prediction: Prediction | None = None) -> PixelTranslation:
        """Find the target in `frame`; the translation is dated by the row that the target's middle was read out at."""
        dark = self._in_the_dark(frame)
        expected = shown_prediction(prediction, self.region, self._lens)
        self._shown = lost(frame.time_ns) if dark else self.tracker.push(frame, expected)
        self.events += self._shown.events
        found = self._in_this_light(frame, ideal_translation(self._shown, self.region, self._lens))
        self._pushed.append(found.strength, found.reference_variance_x_px2, found.reference_variance_y_px2, dark)
        self._track = self._quick = None
        down_px = self._shown.y_px
        row = self.region.y + 0.5 * (self.region.height - 1) + (down_px if np.isfinite(down_px) else 0.0)
        last_row = max(frame.pixels.shape[0] - 1, 1)
        late_ns = round(self._readout_s * NANOSECONDS * row / last_row)
        return replace(found, time_ns=frame.time_ns + late_ns)

    def _in_this_light(self, frame: Frame, found: PixelTranslation) -> PixelTranslation:
        """What was found, with the variance (px²) that light adds to a fixed reference."""
        more = 0.0 if self._light is None else self._light.push(frame, self._shown)
        if found.status is not Status.TRACKING or not more:
            return found
        return replace(found, reference_variance_x_px2=more, reference_variance_y_px2=more)

    def _in_the_dark(self, frame: Frame) -> bool:
        """Whether a frame is black, which the reference is not: what a tracker found in its noise would be wrong."""
        return self._lit and is_dark(frame.pixels[::THINNED, ::THINNED])

    def add(self, frame: Frame, translation: PixelTranslation) -> None:
        """Keep what was found in `frame`: the one place where a frame's picture and its translation meet."""
        region = self.region
        seen = np.asarray(frame.pixels[region.y : region.y + region.height, region.x : region.x + region.width])
        self._rows.append(*_numbers(translation), bool(np.array_equal(seen, self._seen)))
        self._seen = seen.copy()
        self._track = self._quick = None
        if self._watch is not None:
            self._watch.push(frame, self._shown)

    @property
    def track(self) -> PixelTrack:
        """The rows so far as one block, finished: frames of a frozen picture are lost, the variances fair."""
        if self._track is None:
            self._track = more_variance(self.quick, self.wandering_px2)
        return self._track

    @property
    def quick(self) -> PixelTrack:
        """The same with the variances of the single frames only, without what the reference frame makes."""
        if self._quick is None:
            self._quick = self._narrow if self._watch is None else self._watch.widened(self._narrow)
        return self._quick

    @property
    def strengths(self) -> Floats:
        """Good matches in each frame (n,), of trackers without matches the quality in percent."""
        return self._pushed.column(0)

    @property
    def wandering_px2(self) -> Floats:
        """The part of the variances (n, 2) along x and y that the reference frame makes, for many frames alike."""
        return np.column_stack((self._pushed.column(1), self._pushed.column(2)))

    @property
    def dark(self) -> Mask:
        """Which frames (n,) were black, so that nothing was looked for."""
        return self._pushed.column(3).astype(bool)

    @property
    def _narrow(self) -> PixelTrack:
        """The rows with the variances of the single frames that the tracker believes in."""
        rows = PixelTrack(*(self._rows.column(number) for number in range(REPEATS)))
        return with_fair_variance(lost_where(rows, self.frozen))

    @property
    def frozen(self) -> Mask:
        """Frames (n,) so far that only repeat the picture before them, in runs of at least `FROZEN_FRAMES`."""
        repeats = self._rows.column(REPEATS).astype(bool)
        mask = np.zeros(len(repeats), dtype=bool)
        for start, end in runs(repeats):
            mask[start:end] = end - start + 1 >= FROZEN_FRAMES
        return mask

    def blur_s(self, exposure_s: float | None) -> float:
        """The time a measured translation is averaged over: the exposure, and the read-out of the region's rows.

        Both are box averages; their widths add as squares.
        """
        rows = self._readout_s * self.region.height / max(self.tracker.reference.pixels.shape[0], 1)
        return float(np.hypot(exposure_s or 0.0, rows))

    def with_codec_error(self, scale: ScaleFactor, direction: str) -> ScaleFactor:
        """A scale factor learnt along an image axis from the frames so far, with what compression may do to it."""
        if self._watch is None:
            return scale
        relative = self._watch.relative_scale_std(self._narrow.along(direction)[0])
        return replace(scale, variance=scale.variance + (relative * scale.value_m_per_px) ** 2)

    def warnings(self, axes: str) -> list[str]:
        """What of the frames tracked so far is worth telling, measured along the image axes "x", "y" or "xy"."""
        frozen = int(np.count_nonzero(self.frozen))
        told = [f"camera: {frozen} frames only repeat the picture before them (frozen); they were not used."]
        seen = picture_warnings(self._watch, self._narrow, axes) if len(self._rows) and self._watch else []
        lit = light_warnings(self.wandering_px2, self._rows.column(0)) if self._light else []
        return (told if frozen else []) + seen + lit


class CameraTracking:
    """Frames from the first one used, every target tracked through one after another; `targets` hold the rows.

    Frames before the first usable one are skipped (`skipped` tells how many), see `begun`.
    judge: what decides between places by more than the picture; left out, the picture alone decides.
    """

    def __init__(
        self,
        source: FrameSource,
        settings: TrackingSettings,
        progress: Progress = silent,
        judge: Judge | None = None,
    ) -> None:
        self.source, self.progress = source, progress
        start = begun(source, settings.first, settings.last, [target.region for target in settings.targets])
        self.skipped, self._frames = start.skipped, start.frames
        self._skipped_for = start.reason
        self.settings = settings = replace(settings, first=settings.first + self.skipped)
        self.time_ns: Nanoseconds = source.times_ns()[settings.first : settings.last]
        if len(self.time_ns) < 2:
            raise DataError(f"camera: has {len(self.time_ns)} usable frames; at least 2 are needed.")
        self.choice: RegionChoice | None = None
        targets = settings.targets or self._choose(judge)
        self.reference = self._next_frame()
        rows, columns = self.reference.pixels.shape
        for target in targets:
            check_region(target.region, columns, rows)
            if settings.thermal and settings.levels is not None:
                refuse_empty_range(self.reference, target.region, settings.levels)
        self.chosen = tuple(targets)
        self.targets = tuple(self._opened(target) for target in targets)
        self._ahead = deque([self.reference])
        self._teach()
        self.done, self.ended = 0, False
        # The tracking of a second camera of the same recording; how a thermal camera's range was found.
        self.beside: CameraTracking | None = None
        self.range_surface: RangeSurface | None = None

    @property
    def tracks(self) -> tuple[PixelTrack, ...]:
        """The rows tracked so far, one block a target."""
        return tuple(target.track for target in self.targets)

    def leave_out(self, places: Sequence[int]) -> None:
        """Track the targets of these numbers (from 0) no further."""
        self.targets = tuple(target for k, target in enumerate(self.targets) if k not in places)

    def until(self, time_ns: int) -> tuple[PixelTrack, ...]:
        """Track, without a prediction, all frames up to `time_ns` on the camera's clock; returns all rows so far."""
        while self.done < len(self.time_ns) and self.time_ns[self.done] <= time_ns:
            frame = self.take()
            if frame is None:
                break
            self.add(frame, [target.push(frame) for target in self.targets])
        return self.tracks

    def take(self) -> Frame | None:
        """The next frame that has not been tracked, None at the end."""
        self.progress(self.done, len(self.time_ns), "tracking")
        return self._ahead.popleft() if self._ahead else next(self._frames, None)

    def add(self, frame: Frame, translations: Sequence[PixelTranslation]) -> None:
        """Keep what was found in `frame`, one translation a target."""
        self.done += 1
        for target, translation in zip(self.targets, translations, strict=True):
            target.add(frame, translation)

    def close(self) -> None:
        """Let the file go, and that of a second camera."""
        self._frames.close()
        if self.beside is not None:
            self.beside.close()

    def warnings(self, axes: str | None = None) -> list[str]:
        """What of the frames tracked so far is worth telling, along the image `axes` (left out: the measured one)."""
        found = []
        if self.skipped:
            found.append(f"camera: {self._skipped_for}.")
        found += [f"camera: {line}." for line in self.source.info.damage]
        for target in self.targets:
            own = target.warnings(axes or self.settings.direction)
            if self.settings.lens is not None:
                own += lens_warnings(target.region, self.settings.lens)
            found += own if len(self.targets) == 1 else [f"target {target.name}: {line}" for line in own]
        return [worded(line, self.settings.sensor) for line in found]

    def _opened(self, target: Target) -> TargetTracking:
        tracker = self.settings.opening.opened(self.reference, target.region)
        lossless = self.source.info.lossless is True
        return TargetTracking(tracker, target.name, self.settings, lossless=lossless)

    def _teach(self) -> None:
        """Show the first frames to the trackers that learn from them; they are kept to be tracked afterwards."""
        learners = [target.tracker for target in self.targets if target.tracker.frames_to_learn]
        wanted = max((learner.frames_to_learn for learner in learners), default=0)
        wanted = min(wanted, MOST_AHEAD_BYTES // self.reference.pixels.nbytes)
        while len(self._ahead) < wanted:
            self.progress(len(self._ahead), wanted, "learning the target")
            frame = next(self._frames, None)
            if frame is None:
                break
            self._ahead.append(frame)
        for learner in learners:
            # Frames that do not show the target teach nothing; the tracker then stays with its reference.
            with suppress(DataError):
                learner.learn(list(self._ahead))

    def _next_frame(self) -> Frame:
        frame = next(self._frames, None)
        if frame is None:
            raise DataError("camera: no frame can be decoded. Play the video to check it, or copy it again.")
        return frame

    def _choose(self, judge: Judge | None) -> tuple[Target, ...]:
        settings = self.settings
        request = ChoiceRequest(settings.direction, settings.automatic_targets, settings.first, settings.trial_from_ns)
        self.choice = choose_targets(self.source, self.time_ns, request, self.progress, judge)
        return tuple(Target(region, str(k)) for k, region in enumerate(self.choice.regions, start=1))
