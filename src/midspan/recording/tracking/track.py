"""`track`: the camera alone, translation in pixels for each frame, no accelerometer needed."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from midspan._version import __version__
from midspan.checks import option, path_of
from midspan.engine.camera import Target
from midspan.engine.tracking import CameraTracking, TrackingSettings
from midspan.errors import UsageError
from midspan.notices import Notice, notice_trees
from midspan.progress import Progress, silent
from midspan.recording.streams.recording import open_with_cameras
from midspan.recording.tracking.opening import levels_of, settings_of
from midspan.records import Nanoseconds, PixelTrack, Region, Status, joined, part, seconds
from midspan.settings.load import RECORDING_FILE
from midspan.settings.messages import in_words_of, renamed
from midspan.sinks.table import ResultTable
from midspan.sinks.write import write_result
from midspan.sources.camera.frames import FrameRequest, timed_or_counted
from midspan.sources.thermal.formats import is_thermal, open_pictures
from midspan.vision.frame_source import FrameSource
from midspan.vision.region import region_of
from midspan.vision.target import lost
from midspan.vision.tracker import DEFAULT_TRACKER, TRACKERS

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True, slots=True)
class Tracked:
    """The targets' tracks (one row a frame), the first one's region, and what is worth reporting."""

    tracks: tuple[PixelTrack, ...]
    region: Region
    tracker: str
    warnings: tuple[Notice, ...]
    tracking: CameraTracking = field(repr=False)

    @property
    def track(self) -> PixelTrack:
        """The first target's track."""
        return self.tracks[0]

    def __repr__(self) -> str:
        lost, place = int(np.count_nonzero(self.track.status == Status.LOST)), ", ".join(map(str, _listed(self.region)))
        return f"Tracked({len(self.track.time_ns)} frames, {lost} lost, roi {place} px, {self.tracker})"

    def to_pandas(self) -> "pd.DataFrame":
        """The columns of a track file as a data frame indexed by time_s."""
        return self.table().to_pandas()

    def save(self, path: str | Path) -> Path:
        """Write the track; the suffix chooses the format (.csv, .parquet, .h5, .mat, .xlsx, .tdms)."""
        return write_result(path, self.table())

    def table(self) -> ResultTable:
        """The columns of a track file."""
        columns: dict[str, Any] = {"time_s": seconds(self.track.time_ns, 0)}
        for number, (target, track) in enumerate(zip(self.tracking.targets, self.tracks, strict=True)):
            # The first target has the plain names; the others' end with their own.
            end = "" if number == 0 else f"_{target.name}"
            columns |= {
                f"x_px{end}": track.x_px,
                f"y_px{end}": track.y_px,
                f"std_x_px{end}": np.sqrt(track.variance_x_px2),
                f"std_y_px{end}": np.sqrt(track.variance_y_px2),
                f"status{end}": track.status,
            }
        metadata = {
            "midspan": __version__,
            "tracker": self.tracker,
            "roi": _listed(self.region),
            "targets": [{"name": t.name, "roi": _listed(t.region)} for t in self.tracking.targets],
            "warnings": list(self.warnings),
            "notices": notice_trees(self.warnings),
            "events": [
                {"time_s": event.time_ns / 1e9, "kind": event.kind, "text": f"target {target.name}: {event.text}"}
                for target in self.tracking.targets
                for event in target.events
            ],
        }
        return ResultTable(columns=columns, time_ns=self.track.time_ns, metadata=metadata)


def _listed(region: Region) -> list[int]:
    return [region.x, region.y, region.width, region.height]


def track(
    source: str | Path,
    *,
    roi: Region | Sequence[int] | None = None,
    tracker: str | None = None,
    every: int | None = None,
    rate_hz: float | None = None,
    start_s: float = 0.0,
    progress: Progress = silent,
) -> Tracked:
    """Track a target through a recording's camera, a video, a folder or glob of images, or a stack.

    roi: x, y, width, height in px of the first frame; left out: the recording's, else chosen. tracker: a name of
    `midspan methods`; every: use every n-th frame; both left out: the recording's own. rate_hz, start_s: frame times
    where the source has none. Raises UsageError for a region outside the image, DataError for a source that cannot be
    read.
    """
    path, region = path_of("source", source), None if roi is None else region_of(roi)
    changed = {"every": every, "tracker": tracker}
    if tracker is not None:
        option("tracker", tracker, TRACKERS)
    request = FrameRequest(rate_hz=rate_hz, start_s=start_s, every=1 if every is None else every)
    if path.name == RECORDING_FILE or (path / RECORDING_FILE).is_file():
        frames, settings, warnings = _of_recording(path, {key: one for key, one in changed.items() if one is not None})
    else:
        frames, warnings = _of_file(path, request)
        settings = TrackingSettings(tracker or DEFAULT_TRACKER)
        if is_thermal(path):
            settings = replace(settings, thermal=True, reference="key-frames", sensor="infrared")
    if region is not None:
        settings = replace(settings, targets=(Target(region),))
    with in_words_of(settings.sensor):
        tracking = CameraTracking(frames, settings, progress)
        while block := tracking.take_block(len(tracking.time_ns)):
            tracking.push_block(block)
        tracking.close()
        rows = tuple(_with_those_passed_over(one, tracking.time_ns) for one in tracking.tracks)
    progress(1, 1, "tracking")
    warnings += [renamed(line, settings.sensor) for line in tracking.warnings("xy")]
    for target, found in zip(tracking.targets, rows, strict=True):
        count = int(np.count_nonzero(found.status == Status.LOST))
        if count:
            which = "The target" if len(rows) == 1 else f"Target {target.name}"
            text = f"{which} was lost in {count} of {len(found.time_ns)} frames; their values are empty."
            warnings.append(Notice("lost", text))
    return Tracked(rows, tracking.targets[0].region, settings.tracker, tuple(warnings), tracking)


def _with_those_passed_over(track: PixelTrack, time_ns: Nanoseconds) -> PixelTrack:
    """A track with a LOST row for each frame of these stamps (n,) that has none, as it could not be read.

    Rows are later than their frames by up to a read-out.
    """
    near = np.searchsorted(track.time_ns, time_ns)
    before, after = (track.time_ns[np.clip(near - k, 0, len(track.time_ns) - 1)] for k in (1, 0))
    late_ns = track.time_ns[0] - time_ns[np.searchsorted(time_ns, track.time_ns[0], side="right") - 1]
    off = np.minimum(np.abs(time_ns + late_ns - before), np.abs(time_ns + late_ns - after))
    missed = time_ns[off > 0.5 * np.median(np.diff(time_ns))]
    if not len(missed):
        return track
    whole = joined((track, PixelTrack.stack([lost(int(stamp)) for stamp in missed])))
    return part(whole, np.argsort(whole.time_ns, kind="stable"))


def _of_recording(path: Path, changed: dict[str, Any]) -> tuple[FrameSource, TrackingSettings, list[Notice]]:
    recording = open_with_cameras(path, changed)
    views = recording.cameras
    camera = views[0].settings.camera if views else None
    if camera is None:
        hint = " `midspan estimate` follows the radar's targets." if recording.has("radar") else ""
        raise UsageError(
            f"{recording.file}: has no [camera] or [infrared] section, so there is nothing to track.{hint}"
        )
    view = views[0]
    texts = [f"Only [{view.sensor}] was tracked; for [{one.sensor}] give its file as SOURCE." for one in views[1:]]
    others = [Notice("part-left-out", text) for text in texts]
    return view.frames, replace(settings_of(view, camera), levels=levels_of(view, None)), others


def _of_file(path: Path, request: FrameRequest) -> tuple[FrameSource, list[Notice]]:
    """The source with its own times, or counting frames where it has none."""

    def opened(rate_hz: float | None) -> FrameSource:
        return open_pictures(path, replace(request, rate_hz=rate_hz))

    if request.rate_hz is not None:
        source = opened(request.rate_hz)
        source.times_ns()
        return source, []
    source, timed = timed_or_counted(opened)
    text = "The frames have no time stamps: time_s counts the frames. Give --rate-hz for seconds."
    return source, [] if timed else [Notice("frames-untimed", text)]
