"""A camera before anything is estimated: its first frame with a pixel grid, places to track, and a strip of motion."""

import textwrap
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from midspan.engine.camera import Target
from midspan.engine.tracking import CameraTracking, TrackingSettings
from midspan.errors import DataError, MidspanError, UsageError
from midspan.progress import Progress
from midspan.recording.calibrate import calibrate_and_track
from midspan.recording.cameras import tracking_by_acceleration
from midspan.recording.streams.recording import Recording
from midspan.recording.tracking.opening import given_targets, settings_of
from midspan.records import NANOSECONDS, Floats, Region
from midspan.report.camera_figures import box, image, label
from midspan.report.drawing import Colour, sheet, style, write_picture
from midspan.sources.camera.frames import FrameRequest, timed_or_counted
from midspan.sources.thermal.formats import is_thermal, open_pictures
from midspan.vision.candidates import Candidate
from midspan.vision.frame_source import FrameSource
from midspan.vision.region_choice import CHOICE_S
from midspan.vision.tracker import DEFAULT_TRACKER

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# The strip of motion: at most this number of frames of the first seconds that the choice of the region looks at.
MAX_STRIP_FRAMES = 400
# Lines of the pixel grid along the longer side of the image.
GRID_LINES = 16
WIDTH_IN, HEIGHT_IN = 11.0, 8.0
# Places that are listed; the choice tries fewer.
MAX_LISTED = 12


@dataclass(frozen=True, slots=True)
class FirstLook:
    """What is seen before anything is estimated.

    pixels (rows, columns): the first frame used; axis: the measured image axis; given: the targets that the settings
    name; places: those that were tried, the best first; chosen: the regions that would be tracked; strip (positions,
    frames): the image along the axis through the middle of the first region, frame by frame; strip_s (frames,): their
    times from the first one; notes: what the choice rests on, or why there is none.
    """

    pixels: Any
    axis: str
    given: tuple[Target, ...]
    places: tuple[Candidate, ...]
    chosen: tuple[Region, ...]
    strip: Floats
    strip_s: Floats
    notes: tuple[str, ...]

    def to_dict(self) -> dict[str, Any]:
        """The places as plain values."""
        return {
            "chosen": [_listed(region) for region in self.chosen],
            "given": [_listed(target.region) for target in self.given],
            "places": [
                {
                    "roi": _listed(place.region),
                    "predicted_std_px": place.predicted_std_px,
                    "displacement_std_mm": 1e3 * place.displacement_std_m,
                    "verdict": verdict(place),
                }
                for place in self.places
            ],
            "notes": list(self.notes),
        }


def verdict(place: Candidate) -> str:
    """Why a place was taken or not."""
    return place.verdict or (
        "moves like most of the image" if place.fixed else "moves differently from most of the image"
    )


def look_at_recording(recording: Recording, progress: Progress) -> FirstLook:
    """The first camera of a recording; the places are those of its calibration, as an estimate makes it.

    Raises UsageError where there is no camera with images, what reading the frames raises.
    """
    if not recording.cameras or recording.cameras[0].frames.tracks:
        raise UsageError(f"{recording.file}: --picture must have a [camera] or [infrared] with images; it has none.")
    given = recording.cameras[0].settings.camera
    assert given is not None
    chosen = _without_targets(recording)
    view, notes = chosen.cameras[0], list[str]()
    camera = view.settings.camera
    assert camera is not None
    settings = settings_of(view, camera)
    ways: list[Callable[[], CameraTracking | None]] = [lambda: CameraTracking(view.frames, settings, progress)]
    if recording.has("accelerometer"):
        # Where no calibration is found, what it would have begun with is seen.
        ways = [lambda: _calibrated(chosen, progress), lambda: tracking_by_acceleration(view, progress)[1], *ways]
    tracking = next((found for way in ways if (found := _tried(way, notes)) is not None), None)
    return _look(view.frames, view.axis, tracking, given_targets(given), notes)


def _calibrated(recording: Recording, progress: Progress) -> CameraTracking | None:
    """The tracking of the first camera that a calibration ends with; None where it leaves that camera out."""
    _, first = calibrate_and_track(recording, progress)
    assert first is not None
    return first if first.settings.sensor == recording.cameras[0].sensor else None


def look_at_file(path: Path, progress: Progress) -> FirstLook:
    """A video, a stack or a folder of images; the image alone decides between the places."""
    source, _ = timed_or_counted(lambda rate_hz: open_pictures(path, FrameRequest(rate_hz=rate_hz)))
    settings, notes = TrackingSettings(DEFAULT_TRACKER, thermal=is_thermal(path)), list[str]()
    tracking = _tried(lambda: CameraTracking(source, settings, progress), notes)
    return _look(source, settings.direction, tracking, (), notes)


def _without_targets(recording: Recording) -> Recording:
    """The recording with its targets left to be chosen."""
    settings, untold = recording.settings, {"roi": None, "target": ()}
    cameras = tuple(camera.model_copy(update=untold) for camera in settings.cameras)
    infrareds = tuple(camera.model_copy(update=untold) for camera in settings.infrareds)
    return Recording(recording.file, settings.model_copy(update={"cameras": cameras, "infrareds": infrareds}))


def _tried(opened: Callable[[], CameraTracking | None], notes: list[str]) -> CameraTracking | None:
    """The tracking with its choice; None, with a note, where nothing can be chosen."""
    try:
        return opened()
    except MidspanError as error:
        if str(error) not in notes:
            notes.append(str(error))
        return None


def _look(
    source: FrameSource, axis: str, tracking: CameraTracking | None, given: tuple[Target, ...], notes: list[str]
) -> FirstLook:
    first = 0 if tracking is None else tracking.settings.first
    choice = None if tracking is None else tracking.choice
    if tracking is not None:
        tracking.close()
    frame = next(iter(source.frames(first, first + 1)), None)
    if frame is None:
        raise DataError("camera: no frame can be decoded. Play the video to check it, or copy it again.")
    chosen = () if choice is None else choice.regions
    rows, columns = frame.pixels.shape
    middle = (*(one.region for one in given), *chosen, Region(0, 0, columns, rows))[0]
    strip, strip_s = _strip(source, first, middle, axis)
    places = () if choice is None else choice.candidates[:MAX_LISTED]
    reasons = () if choice is None else choice.reasons
    return FirstLook(frame.pixels, axis, given, places, chosen, strip, strip_s, (*notes, *reasons))


def _strip(source: FrameSource, first: int, region: Region, axis: str) -> tuple[Floats, Floats]:
    """The image along the axis through the middle of a region (positions, frames), and the frames' times, s."""
    times = source.times_ns()[first:]
    count = min(int(np.searchsorted(times, times[0] + round(CHOICE_S * NANOSECONDS))), MAX_STRIP_FRAMES)
    line: tuple[int | slice, int | slice] = (
        (region.y + region.height // 2, slice(region.x, region.x + region.width))
        if axis == "x"
        else (slice(region.y, region.y + region.height), region.x + region.width // 2)
    )
    strip = np.array([frame.pixels[line] for frame in source.frames(first, first + count)], dtype=np.float64).T
    return strip, (times[: strip.shape[1]] - times[0]) / NANOSECONDS


def draw_first_look(found: FirstLook, path: Path) -> Path:
    """Write the picture: the frame with grid and places, the list of the places, the strip of motion."""
    with style():
        figure = sheet(HEIGHT_IN, WIDTH_IN)
        parts: Any = figure.subfigures(2, 1, height_ratios=(2.4, 1.0))
        upper, lower = parts
        image, words = upper.subplots(1, 2, width_ratios=(1.7, 1.0))
        _frame(image, found)
        _list(words, found)
        _draw_strip(lower.subplots(), found)
        return write_picture(figure, path, 110)


def _frame(axes: "Axes", found: FirstLook) -> None:
    from matplotlib.ticker import MaxNLocator

    rows, columns = found.pixels.shape
    image(axes, found.pixels)
    for ticks, count in ((axes.xaxis, columns), (axes.yaxis, rows)):
        lines = max(2, round(GRID_LINES * count / max(rows, columns)))
        ticks.set_major_locator(MaxNLocator(nbins=lines, integer=True, steps=(1, 2, 5, 10)))
    axes.grid(True, color="white", alpha=0.35, linewidth=0.5)
    axes.set_axisbelow(False)
    for number, place in enumerate(found.places, start=1):
        if place.region not in found.chosen:
            _box(axes, place.region, Colour.ORANGE, str(number), "--")
    for region in found.chosen:
        number = next((k for k, place in enumerate(found.places, start=1) if place.region == region), 0)
        _box(axes, region, Colour.SKY, str(number or ""), "-")
    for target in found.given:
        _box(axes, target.region, Colour.VERMILLION, target.name or "given", "-")
    axes.set_title(f"first frame used, {columns} × {rows} px", fontsize=9)


def _box(axes: "Axes", region: Region, colour: str, text: str, line: str) -> None:
    box(axes, region, color=colour, linewidth=1.8, linestyle=line, zorder=3)
    label(axes, region, text)


def _list(axes: "Axes", found: FirstLook) -> None:
    """The places with their scores and verdicts, and what the choice rests on."""
    axes.axis("off")
    lines = list[str]()
    for number, place in enumerate(found.places, start=1):
        r = place.region
        text = f"{number}  {r.x},{r.y},{r.width},{r.height}: {place.predicted_std_px:.4f} px; {verdict(place)}"
        lines += textwrap.wrap(text, 62, subsequent_indent="    ")
    for note in found.notes:
        lines += ["", *textwrap.wrap(note, 62)]
    if not lines:
        lines = ["No region was found."]
    axes.text(0.0, 1.0, "\n".join(lines), va="top", ha="left", fontsize=7, transform=axes.transAxes)
    axes.set_title("solid: selected; dashed: candidate; red: given", fontsize=9, loc="left")


def _draw_strip(axes: "Axes", found: FirstLook) -> None:
    last_s = float(found.strip_s[-1]) if len(found.strip_s) > 1 else 1.0
    axes.imshow(found.strip, cmap="gray", aspect="auto", extent=(0.0, last_s, found.strip.shape[0], 0.0))
    axes.grid(False)
    axes.set_xlabel("time from the first frame (s)")
    axes.set_ylabel(f"{found.axis} in the region (px)")
    axes.set_title("one image line through the centre of the region, frame by frame; motion bends the line", fontsize=9)


def _listed(region: Region) -> list[int]:
    return [region.x, region.y, region.width, region.height]
