"""Tracking a recording's camera: the reference frame, the targets, and the frames in their order."""

import math
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, fields, replace
from itertools import islice
from operator import attrgetter
from struct import Struct
from typing import Any

import numpy as np
from numpy.typing import NDArray

from midspan.calibration.camera.view import SeenTarget
from midspan.engine.camera import CameraChain, CameraState, Target, TargetChain
from midspan.engine.first_frame import begun
from midspan.engine.target_opening import Opening, refuse_empty_range
from midspan.errors import DataError, UsageError
from midspan.notices import Notice
from midspan.progress import Progress, silent
from midspan.records import Event, Floats, Frame, Nanoseconds, PixelTrack, PixelTranslation
from midspan.signals.stamps import shown
from midspan.thermal.temperature_range import Expected, RangeSurface
from midspan.vision.frame_source import NOWHERE, FrameSource, StoredTrack
from midspan.vision.lens import lens_warnings
from midspan.vision.picture_report import LightReport, picture_warnings
from midspan.vision.region import check_region
from midspan.vision.region_choice import ChoiceRequest, Judge, choose_targets
from midspan.vision.roi import RegionChoice
from midspan.vision.target import UNSEEN, translation_of

# Frames that were looked at are kept until they are tracked; so much memory at most.
MAX_AHEAD_BYTES = 200_000_000
# Frames that the core is given at once: the calls around it then cost nothing, and of large ones few are in memory.
BLOCK_FRAMES, BLOCK_BYTES = 64, 32_000_000
# The first columns of a target's rows.
_track_row = attrgetter(*(field.name for field in fields(PixelTrack)))
STRENGTH, REFERENCE_X, REFERENCE_Y = range(len(fields(PixelTrack)), len(fields(PixelTrack)) + 3)
Felt = Callable[[Nanoseconds], Expected]


class Columns:
    """Columns that grow by a row at a time; `codes`: a letter each, "q" int64, "d" float64, "B" uint8.

    Numbers come out as they were put in, to the last bit.
    """

    def __init__(self, codes: str) -> None:
        self._row = Struct(f"={codes}")
        self.kind = np.dtype([(str(k), f"={code}") for k, code in enumerate(codes)])
        self._rows, self._count = bytearray(), 0

    def __len__(self) -> int:
        return self._count

    def append(self, *row: float) -> None:
        """Add a row, a number for each column."""
        self._rows += self._row.pack(*row)
        self._count += 1

    def extend(self, rows: bytes) -> int:
        """Add packed rows; how many."""
        count = len(rows) // self._row.size
        self._rows += rows
        self._count += count
        return count

    def row(self, number: int) -> tuple[Any, ...]:
        """The row of this number, from 0."""
        return self._row.unpack_from(self._rows, number * self._row.size)

    def column(self, number: int) -> NDArray[Any]:
        """The rows so far (n,) of the column with this number, a copy."""
        return np.frombuffer(self._rows, dtype=self.kind)[str(number)].copy()


@dataclass(frozen=True, slots=True)
class TrackingSettings(Opening):
    """What to track, and with what (see `Opening`): the measured image axis, the targets and the frames used.

    targets: none: `automatic_targets` are chosen. first: index of the reference frame; last: index after the last frame
    used. trial_from_ns: where the calibration begins, on the camera's clock. sensor: what messages call it.
    """

    direction: str = "y"
    targets: tuple[Target, ...] = ()
    automatic_targets: int = 1
    first: int = 0
    last: int | None = None
    trial_from_ns: int | None = None
    sensor: str = "camera"


class TargetTracking:
    """One target: its part of the camera's chain, and the rows found so far, one a frame, as they came."""

    def __init__(self, chain: TargetChain) -> None:
        self.chain, self.name, self.region, self.tracker = chain, chain.name, chain.region, chain.tracker
        # The fields of a track, how strong it was, the reference's variances along x and y, why it was not seen.
        self._columns = Columns("qdddddBdddddB")
        self._track: PixelTrack | None = None
        # What happened in frames, by their numbers.
        self._events: dict[int, tuple[Event, ...]] = {}

    def add(self, found: PixelTranslation) -> None:
        """Keep what was found in a frame."""
        reference = (found.reference_variance_x_px2, found.reference_variance_y_px2)
        if found.events:
            self._events[len(self._columns)] = found.events
        self._columns.append(*_track_row(found), found.strength, *reference, UNSEEN.index(found.unseen))
        self._track = None

    def add_stored(self, track: StoredTrack, used: slice) -> None:
        """Keep rows of a track."""
        columns = [getattr(track.rows, field.name) for field in fields(PixelTrack)]
        columns += [track.strength, *track.reference_px2.T, np.zeros(len(track.strength))]
        self._columns.extend(np.rec.fromarrays([c[used] for c in columns], dtype=self._columns.kind).tobytes())

    def push_all(self, frames: Sequence[Frame]) -> None:
        """Keep what is found in frames, without predictions."""
        done = 0
        while done < len(frames):
            if rows := self.chain.rows(frames[done:]):
                done += self._columns.extend(rows)
                self._track = None
            if done < len(frames):
                self.add(self.chain.push(frames[done]))
                done += 1

    @property
    def events(self) -> list[Event]:
        """What happened in the frames so far."""
        return [event for reported in self._events.values() for event in reported]

    @property
    def rows(self) -> PixelTrack:
        """The rows so far as one block, with the variances of the single frames, without what the reference makes."""
        return PixelTrack(*(self._columns.column(number) for number in range(STRENGTH)))

    @property
    def track(self) -> PixelTrack:
        """The rows so far with their whole variances."""
        if self._track is None:
            rows, (more_x, more_y) = self.rows, self.reference_px2.T
            x, y = rows.variance_x_px2 + more_x, rows.variance_y_px2 + more_y
            self._track = replace(rows, variance_x_px2=x, variance_y_px2=y)
        return self._track

    @property
    def strengths(self) -> Floats:
        """Good matches in each frame (n,), of trackers without matches the quality in percent."""
        return self._columns.column(STRENGTH)

    @property
    def reference_px2(self) -> Floats:
        """The part of the variances (n, 2) along x and y that the reference frame makes, for many frames alike."""
        return np.column_stack((self._columns.column(REFERENCE_X), self._columns.column(REFERENCE_Y)))

    def translation(self, number: int) -> PixelTranslation:
        """What was found in the frame of this number."""
        row = self._columns.row(number)
        return translation_of((*row[:7], row[7:9], *row[9:]), self._events.get(number, ()))

    def warnings(self, axes: str, *, compressed: bool = False) -> list[Notice]:
        """What of the frames tracked so far is worth reporting, measured along the image axes "x", "y" or "xy".

        compressed: whether a codec may have left out what hardly changes.
        """
        found, chain = list[Notice](), self.chain
        if chain.frozen_frames:
            found.append(Notice("frozen", f"camera: {_repeated(chain.frozen_frames, len(self._columns), compressed)}"))
        if (picture := chain.picture) is not None:
            found += picture_warnings(picture, axes)
        return found if (light := chain.light) is None else found + light_warnings(light)


def _repeated(count: int, frames: int, compressed: bool) -> str:
    """A sentence on frames that repeat the target of the frame before to the last bit."""
    if compressed:
        return (
            f"{count} of {frames} frames repeat the target of the previous frame exactly and were not used: "
            "compression drops small changes, as where nothing moves; "
            "converted and slow-motion videos also repeat frames."
        )
    return (
        f"{count} frames repeat the previous image or part of it and were not used. Check camera and recorder; "
        "converted and slow-motion videos also repeat frames."
    )


def light_warnings(light: LightReport) -> list[Notice]:
    """A sentence where light may have moved a target with a fixed reference."""
    if light.notable_ns is None:
        return []
    text = (
        f"camera: from {shown(light.notable_ns)} on the light on the target differs from the reference frame; shading "
        f"may shift the result by up to {math.sqrt(light.largest_px2):.2g} px (σ, included in the error band). Set "
        'camera.reference = "key-frames".'
    )
    return [Notice("light-changed", text)]


# The code of what compression does, which is said once for all targets.
COMPRESSED = "video-compressed"


class CameraTracking:
    """Frames from the first one used, every target tracked through one after another; `targets` hold the rows.

    Frames before the first usable one are skipped (`skipped` tells how many), see `begun`.
    judge: what decides between places by more than the picture; left out, the picture alone decides. felt: gives the
    translation in frames of these stamps (n,), as the accelerometer shows it, to trackers that learn from that.
    """

    def __init__(
        self,
        source: FrameSource,
        settings: TrackingSettings,
        progress: Progress = silent,
        judge: Judge | None = None,
        felt: Felt | None = None,
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
        # Frames that were looked at before they are tracked.
        self._ahead: deque[Frame] = deque()
        targets = settings.targets
        if not targets:
            request = ChoiceRequest(
                settings.direction, settings.automatic_targets, settings.first, settings.trial_from_ns
            )
            self.choice = choose_targets(self._read, self.time_ns, request, progress, judge)
            targets = tuple(Target(region, str(k)) for k, region in enumerate(self.choice.regions, start=1))
        if not self._read_ahead(1):
            raise DataError("camera: no frame can be decoded. Play the video to check it, or copy it again.")
        self.reference = self._ahead[0]
        rows, columns = self.reference.pixels.shape
        for target in targets:
            check_region(target.region, columns, rows)
            if settings.thermal and settings.levels is not None:
                refuse_empty_range(self.reference, target.region, settings.levels)
        self.chosen = tuple(targets)
        info = source.info
        opening = replace(settings, lossless=info.lossless is True, quarter_turns=info.quarter_turns)
        self.chain = CameraChain(self.reference, targets, opening)
        self.targets = tuple(TargetTracking(target) for target in self.chain.targets)
        # The chain learns from the first frames, which are kept to be tracked afterwards.
        wanted = self._read_ahead(self.chain.frames_to_learn, "learning the target")
        frames = list(islice(self._ahead, wanted))
        stamps = np.array([frame.time_ns for frame in frames], dtype=np.int64)
        self.chain.learn(frames, felt(stamps) if felt is not None and self.learns_by_acceleration else None)
        self.done = 0
        # The trackings of further cameras of the same recording; how a thermal camera's range was found.
        self.companions: tuple[CameraTracking, ...] = ()
        self.range_surface: RangeSurface | None = None

    @property
    def tracks(self) -> tuple[PixelTrack, ...]:
        """The rows tracked so far, one block a target."""
        return tuple(target.track for target in self.targets)

    def leave_out(self, places: Sequence[int]) -> None:
        """Track the targets of these numbers (from 0) no further."""
        kept = tuple(target for k, target in enumerate(self.targets) if k not in places)
        self.chain.targets = tuple(target.chain for target in kept)
        self.targets = kept

    def seen(self, target: TargetTracking, exposure_s: float | None) -> SeenTarget:
        """What calibration takes of a target as it was tracked so far; exposure_s: None where it is not stated."""
        settings, chain = self.settings, target.chain
        return SeenTarget(
            name=target.name,
            region=target.region,
            rows=target.rows,
            reference_px2=target.reference_px2,
            blur_s=chain.blur_s(exposure_s),
            picture=chain.picture,
            tracker=target.tracker,
            tracker_name=settings.tracker,
            tracker_settings=settings.tracker_settings,
            lens=settings.lens,
            frame_px=self.reference.pixels.shape[1::-1],
        )

    def until(self, time_ns: int) -> tuple[PixelTrack, ...]:
        """Track, without a prediction, all frames up to `time_ns` on the camera's clock; returns all rows so far."""
        last = int(np.searchsorted(self.time_ns, time_ns, side="right"))
        while (wanted := last - self.done) > 0 and (frames := self.take_block(wanted)):
            self.push_block(frames)
        return self.tracks

    def take_block(self, most: int) -> list[Frame]:
        """The next frames that have not been tracked, as many as are handed to the core at once; none at the end."""
        frames, size = list[Frame](), 0
        while len(frames) < min(most, BLOCK_FRAMES) and size < BLOCK_BYTES:
            frame = self._ahead.popleft() if self._ahead else next(self._frames, None)
            if frame is None:
                break
            frames.append(frame)
            size += frame.pixels.nbytes
        self.progress(self.done, len(self.time_ns), "tracking")
        return frames

    def push_block(self, frames: Sequence[Frame]) -> None:
        """Track the frames that were taken, without predictions; what is found is kept."""
        for target in self.targets:
            target.push_all(frames)
        self.done += len(frames)

    def take(self) -> Frame | None:
        """The next frame that has not been tracked, None at the end."""
        self.progress(self.done, len(self.time_ns), "tracking")
        return self._ahead.popleft() if self._ahead else next(self._frames, None)

    def push(self, frame: Frame) -> tuple[PixelTranslation, ...]:
        """The translation of each target in the `frame` that was taken; it is kept."""
        found = self.chain.push(frame)
        self.keep(found)
        return found

    def keep(self, found: Sequence[PixelTranslation]) -> None:
        """Keep what the chain found in a frame that was taken."""
        self.done += 1
        for target, translation in zip(self.targets, found, strict=True):
            target.add(translation)

    def close(self) -> None:
        """Let the file go, and those of the cameras with it."""
        self._frames.close()
        for one in self.companions:
            one.close()

    def warnings(self, axes: str | None = None) -> list[Notice]:
        """What of the frames tracked so far is worth reporting, along the image `axes` (left out: the measured one).

        They call the sensor by its kind.
        """
        found, compressed, info = list[Notice](), list[Notice](), self.source.info
        if self.skipped:
            found.append(Notice("frames-skipped", f"camera: {self._skipped_for}."))
        found += [Notice("file-damaged", f"camera: {line}.") for line in info.damage]
        found += [one.worded(f"camera: {one}.") for one in info.notices]
        for target in self.targets:
            own = target.warnings(axes or self.settings.direction, compressed=info.lossless is False)
            if self.settings.lens is not None:
                own += lens_warnings(target.region, self.settings.lens)
            # Compression is one cause in all targets.
            shared = [line for line in own if line.code == COMPRESSED]
            compressed = compressed or shared
            own = [line for line in own if line not in shared]
            found += own if len(self.targets) == 1 else [line.worded(f"target {target.name}: {line}") for line in own]
        if info.lossless is False and not compressed:
            # The codec may have lost what the frames themselves do not show.
            text = (
                f"camera: the video is compressed ({info.codec}). Compression freezes parts of the image: motion of a "
                "few hundredths of a pixel may be lost and the scale factor may be wrong by 1 % or more. Record raw "
                "or lossless video."
            )
            compressed = [Notice(COMPRESSED, text)]
        return found + compressed

    @property
    def learns_by_acceleration(self) -> bool:
        """Whether a target's tracker is to be taught with what the accelerometer shows."""
        return any(target.tracker.learns_by_acceleration for target in self.targets)

    def _read_ahead(self, wanted: int, what: str = "") -> int:
        """Have the first `wanted` frames at hand, fewer where they do not fit or end; returns how many there are."""
        while len(self._ahead) < wanted:
            if self._ahead and (len(self._ahead) + 1) * self._ahead[0].pixels.nbytes > MAX_AHEAD_BYTES:
                break
            if what:
                self.progress(len(self._ahead), wanted, what)
            frame = next(self._frames, None)
            if frame is None:
                break
            self._ahead.append(frame)
        return min(wanted, len(self._ahead))

    def _read(self, first: int, last: int) -> Iterator[Frame]:
        """The frames from index `first` up to `last`: from those at hand, else from the source.

        A video is not decoded twice where its first frames fit into memory until they are tracked.
        """
        wanted = last - self.settings.first
        if self._read_ahead(1) and wanted * self._ahead[0].pixels.nbytes > MAX_AHEAD_BYTES:
            yield from self.source.frames(first, last)
            return
        for number in range(wanted):
            if self._read_ahead(number + 1) <= number or self._ahead[number].index >= last:
                return
            if self._ahead[number].index >= first:
                yield self._ahead[number]


class StoredTarget:
    """A target of a track: it stands for the target's chain and its tracker, of which nothing else is known."""

    frozen_frames, picture, light = 0, None, None
    phase_gain_px_per_rad = active_pixels = None
    # Of a fixed pattern nothing is known.
    scale_share_std = 0.0
    learns_by_acceleration = False

    def __init__(self, reference: Frame, track: StoredTrack, readout_s: float, first: int) -> None:
        self.name, self.region, self.reference, self.tracker = track.name, track.region, reference, self
        # The rows of a track are dated as they were tracked.
        self.first_late_ns = int(track.rows.time_ns[first]) - reference.time_ns
        self._readout_s = readout_s

    def blur_s(self, exposure_s: float | None) -> float:
        """The time a translation is averaged over: the exposure, and the read-out of the region's rows."""
        rows = self._readout_s * self.region.height / max(self.reference.pixels.shape[0], 1)
        return math.hypot(exposure_s or 0.0, rows)


def _as_declared(tracks: Sequence[StoredTrack], targets: Sequence[Target]) -> tuple[StoredTrack, ...]:
    """The tracks of targets that a recording or a calibration names, with their regions; all where it names none.

    As many of other names are taken in their order. UsageError where it is open which is which.
    """
    if not targets:
        return tuple(tracks)
    names, known = {track.name for track in tracks}, {target.name for target in targets}
    others = [track for track in tracks if track.name not in known]
    unnamed = [target for target in targets if target.name not in names]
    if unnamed and len(unnamed) != len(others):
        raise UsageError(
            f"camera.target: the track has {', '.join(sorted(names))}, the recording names {', '.join(sorted(known))}. "
            "Use the track's names, which its columns end with, or name as many targets in the same order."
        )
    by_track = {target.name: target for target in targets}
    by_track |= {track.name: target for track, target in zip(others, unnamed, strict=False)}
    return tuple(
        replace(track, name=own.name, region=own.region if track.region == NOWHERE else track.region)
        for track in tracks
        if (own := by_track.get(track.name)) is not None
    )


class StoredTracking(CameraTracking):
    """The tracking of a track, all of whose rows are there from the beginning; it is its own chain."""

    state = CameraState(())

    def __init__(self, source: FrameSource, settings: TrackingSettings, progress: Progress = silent) -> None:
        self.source, self.progress, self.settings = source, progress, settings
        used = slice(settings.first, settings.last)
        self.time_ns = source.times_ns()[used]
        tracks = _as_declared(source.tracks, settings.targets)
        regions = [track.region for track in tracks]
        width = max(source.info.width, *(one.x + one.width for one in regions))
        height = max(source.info.height, *(one.y + one.height for one in regions))
        self.reference = Frame(int(self.time_ns[0]), np.zeros((height, width), dtype=np.uint8))
        targets: list[Any] = [StoredTarget(self.reference, t, settings.readout_s, settings.first) for t in tracks]
        self.chain: Any = self
        self.targets = tuple(TargetTracking(target) for target in targets)
        self.chosen = tuple(Target(track.region, track.name) for track in tracks)
        self.skipped, self.done = 0, len(self.time_ns)
        self.choice = self.range_surface = None
        self.companions = ()
        for target, track in zip(self.targets, tracks, strict=True):
            target.add_stored(track, used)

    def restore(self, state: CameraState) -> None:
        """Nothing changes from frame to frame."""

    def push(self, frame: Frame, predictions: object = None) -> tuple[PixelTranslation, ...]:
        """There is nothing to track with."""
        raise DataError("A track contains results, not images; new frames cannot be tracked with it.")

    def take(self) -> None:
        """There are no further frames."""

    def close(self) -> None:
        """There is no file to let go."""
