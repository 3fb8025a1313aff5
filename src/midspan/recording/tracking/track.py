"""`track`: the camera alone, translation in pixels for each frame, no accelerometer needed."""

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from midspan._version import __version__
from midspan.engine.camera_target import Target
from midspan.engine.tracking import CameraTracking, TrackingSettings
from midspan.errors import UsageError
from midspan.progress import Progress, silent
from midspan.recording.streams.recording import open_with_cameras
from midspan.recording.tracking.opening import settings_of
from midspan.recording.tracking.temperatures import levels_of
from midspan.records import PixelTrack, Region, Status, seconds
from midspan.settings.load import RECORDING_FILE
from midspan.settings.sensor_words import in_words_of, worded
from midspan.sinks.table import ResultTable
from midspan.sources.camera.frames import FrameRequest, timed_or_counted
from midspan.sources.thermal.formats import is_thermal, open_pictures
from midspan.vision.frame_source import FrameSource
from midspan.vision.tracker import DEFAULT_TRACKER


@dataclass(frozen=True, slots=True)
class TrackRequest:
    """What to track. region: chosen when None; tracker: the recording's or the default when None; every: n-th frame.

    rate_hz, start_s: frame times where the source has none.
    """

    region: Region | None = None
    tracker: str | None = None
    every: int | None = None
    rate_hz: float | None = None
    start_s: float = 0.0


@dataclass(frozen=True, slots=True)
class Tracked:
    """The first target's track (one row a frame), its region, and what is worth telling; `tracking` has the others."""

    track: PixelTrack
    region: Region
    tracker: str
    warnings: tuple[str, ...]
    tracking: CameraTracking = field(repr=False)

    def table(self) -> ResultTable:
        """The columns of a track file."""
        columns: dict[str, Any] = {"time_s": seconds(self.track.time_ns, 0)}
        for number, target in enumerate(self.tracking.targets):
            # The first target has the plain names; the others' end with their own.
            columns |= _columns(target.track, "" if number == 0 else f"_{target.name}")
        metadata = {
            "midspan": __version__,
            "tracker": self.tracker,
            "roi": _listed(self.region),
            "targets": [{"name": t.name, "roi": _listed(t.region)} for t in self.tracking.targets],
            "warnings": list(self.warnings),
            "events": [
                {"time_s": event.time_ns / 1e9, "kind": event.kind, "text": f"target {target.name}: {event.text}"}
                for target in self.tracking.targets
                for event in target.events
            ],
        }
        track = self.track
        return ResultTable(columns=columns, time_ns=track.time_ns, metadata=metadata)


def _columns(track: PixelTrack, end: str) -> dict[str, Any]:
    return {
        f"x_px{end}": track.x_px,
        f"y_px{end}": track.y_px,
        f"std_x_px{end}": np.sqrt(track.variance_x_px2),
        f"std_y_px{end}": np.sqrt(track.variance_y_px2),
        f"status{end}": track.status,
    }


def _listed(region: Region) -> list[int]:
    return [region.x, region.y, region.width, region.height]


def track(source: str | Path, request: TrackRequest | None = None, progress: Progress = silent) -> Tracked:
    """Track a target through a recording's camera, a video, a folder or glob of images, or a stack.

    Raises UsageError for a region outside the image, DataError for a source that cannot be read.
    """
    request = request or TrackRequest()
    path = Path(source)
    if path.name == RECORDING_FILE or (path / RECORDING_FILE).is_file():
        frames, settings, warnings = _of_recording(path, request)
    else:
        frames, warnings = _of_file(path, request)
        given = (Target(request.region),) if request.region else ()
        settings = TrackingSettings(request.tracker or DEFAULT_TRACKER, targets=given)
        if is_thermal(path):
            settings = replace(settings, thermal=True, reference="key-frames", sensor="infrared")
    with in_words_of(settings.sensor):
        tracking = CameraTracking(frames, settings, progress)
        rows = _all_rows(tracking)
    progress(1, 1, "tracking")
    warnings += [worded(line, settings.sensor) for line in tracking.warnings("xy")]
    for target, found in zip(tracking.targets, rows, strict=True):
        lost = int(np.count_nonzero(found.status == Status.LOST))
        if lost:
            which = "The target" if len(rows) == 1 else f"Target {target.name}"
            warnings.append(f"{which} was lost in {lost} of {len(found.time_ns)} frames; their values are empty.")
    return Tracked(rows[0], tracking.targets[0].region, settings.tracker, tuple(warnings), tracking)


def _all_rows(tracking: CameraTracking) -> tuple[PixelTrack, ...]:
    while (frame := tracking.take()) is not None:
        tracking.push(frame)
    tracking.close()
    return tracking.tracks


def _of_recording(path: Path, request: TrackRequest) -> tuple[FrameSource, TrackingSettings, list[str]]:
    changed = {"every": request.every, "tracker": request.tracker}
    recording = open_with_cameras(path, {key: value for key, value in changed.items() if value is not None})
    views = recording.cameras
    camera = views[0].settings.camera if views else None
    if camera is None:
        hint = " `midspan estimate` follows the radar's targets." if recording.has("radar") else ""
        raise UsageError(
            f"{recording.file}: has no [camera] or [infrared] section, so there is nothing to track.{hint}"
        )
    view = views[0]
    others = [f"Only the [{view.sensor}] was tracked; for [{one.sensor}] give its file as SOURCE." for one in views[1:]]
    settings = replace(settings_of(view, camera), levels=levels_of(view, None))
    return view.frames, replace(settings, targets=(Target(request.region),)) if request.region else settings, others


def _of_file(path: Path, request: TrackRequest) -> tuple[FrameSource, list[str]]:
    """The source with its own times, or counting frames where it has none."""

    def opened(rate_hz: float | None) -> FrameSource:
        wanted = FrameRequest(rate_hz=rate_hz, start_s=request.start_s, every=request.every or 1)
        return open_pictures(path, wanted)

    if request.rate_hz is not None:
        source = opened(request.rate_hz)
        source.times_ns()
        return source, []
    source, timed = timed_or_counted(opened)
    return source, [] if timed else [
        "The frames have no time stamps: time_s counts the frames. Give --rate-hz for seconds."
    ]
