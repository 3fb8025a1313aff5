"""`inspect`: what is in a recording, stream by stream, without changing or judging anything."""

from collections.abc import Callable, Iterator
from functools import partial

from midspan.errors import MidspanError
from midspan.progress import Progress, silent
from midspan.recording.observed import observed
from midspan.recording.streams.recording import Recording
from midspan.recording.tracking.posed import six_degrees
from midspan.records import Frame, Nanoseconds, RangeFrame, Readings
from midspan.settings.camera import InfraredSettings
from midspan.settings.kinds import AUXILIARY, KINDS
from midspan.sources.accelerometer.units import SI_UNITS
from midspan.sources.inspect import Tree, acceleration_tree, frames_tree, overlap, radar_tree, series_tree


def inspect_recording(recording: Recording, every_frame: bool = False, progress: Progress = silent) -> Tree:
    """What is in a recording: a tree of plain values, one branch a stream.

    A stream that cannot be read has a branch with `error`. every_frame: look at all frames for frozen ones, not only at
    the first 600.
    """
    tree: Tree = {"recording": str(recording.file), "name": recording.name}
    spans: dict[str, tuple[int, int]] = {}
    for section, file, read in _streams(recording, every_frame, progress):
        try:
            branch, time_ns = read()
            tree[section] = {"file": file, **branch}
            if words := next((six_degrees(one) for one in recording.cameras if one.sensor == section), ""):
                tree[section]["notes"] = [*branch.get("notes", ()), words]
            spans[section] = (int(time_ns[0]), int(time_ns[-1]))
        except MidspanError as error:
            tree[section] = {"file": file, "error": str(error), "exit_code": error.exit_code}
    tree["overlap"] = overlap({name: span for name, span in spans.items() if name != "reference"})
    for name, text in observed(recording.settings).items():
        tree[name].setdefault("notes", []).append(text)
    return tree


Reader = Callable[[], tuple[Tree, Nanoseconds]]


def _axis_tree(recording: Recording, axis: str) -> tuple[Tree, Nanoseconds]:
    """What is in the column of another axis of the accelerometer."""
    return acceleration_tree(recording.accelerometer_axes[axis])


def _streams(recording: Recording, every_frame: bool, progress: Progress) -> Iterator[tuple[str, str, Reader]]:
    """Name, file and reader of each stream; a sensor's name is its section where there is one of its kind."""
    settings = recording.settings
    if settings.accelerometer is not None:
        file = settings.accelerometer.file
        yield "accelerometer", file, lambda: acceleration_tree(recording.acceleration)
        main = settings.acceleration_column
        for axis in settings.accelerometer.named_axes:
            if settings.accelerometer.column(axis) != main:
                yield f"accelerometer_{axis}", file, partial(_axis_tree, recording, axis)
    readers: dict[type, Callable[[Recording], tuple[Tree, Nanoseconds]]] = {
        Frame: lambda view: frames_tree(
            view.frames, every_frame, progress, thermal=isinstance(view.own.settings, InfraredSettings)
        ),
        RangeFrame: lambda view: radar_tree(view.radar_file, every_frame, progress),
        Readings: lambda view: series_tree(view.displacement, "m"),
    }
    for view in recording.views:
        yield view.sensor, view.own.settings.file, partial(readers[KINDS[view.kind].brings], view)
    for kind, own in settings.auxiliary.items():
        unit = SI_UNITS[AUXILIARY[kind].quantity]
        yield kind, own.file, partial(lambda kind, unit: series_tree(recording.auxiliary[kind], unit), kind, unit)
    if settings.reference is not None:
        yield "reference", settings.reference.file, lambda: series_tree(recording.reference, "m")
