"""The settings of a recording of two files, an accelerometer's and another sensor's, as they are found in these."""

import re
import shlex
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeGuard

from midspan.errors import MidspanError, UsageError
from midspan.settings.load import validate
from midspan.settings.recording import RecordingSettings
from midspan.signals.acceleration import GRAVITY_M_S2
from midspan.trees import toml_value

if TYPE_CHECKING:
    from midspan.records import TimeSeries
    from midspan.sources.accelerometer.channel import Channel
    from midspan.sources.accelerometer.phone import PhoneLog
    from midspan.sources.accelerometer.select import SeriesRequest
    from midspan.vision.frame_source import FrameSource

# Stamps from here on (s) are dates, not seconds after a start: 2001.
DATED_FROM_S = 1e9
# A mean acceleration within this share of gravity's is that of an axis upright to 25 degrees.
UPRIGHT = 0.1
# A video is dated by when it was begun or ended; one that is dated farther away than this, s, is of another clock.
BY_HAND_S = 60.0
# The image axis of the motion where none is given: most structures that are filmed move up and down.
DIRECTION = "y"
# Keys of a recording.toml in a message.
KEYS = re.compile(r"\b((camera|infrared|accelerometer|calibration|fusion)\.[a-z]\w+|rate_hz|max_offset_s|start_s)\b")


@dataclass(frozen=True, slots=True)
class Choices:
    """What is given where two files leave a choice.

    value, unit: the accelerometer's channel along the motion, and its unit; direction: the image axis of the motion;
    rate_hz: of the second file, where it has no times; displacement_value, displacement_unit: channel and unit of the
    second file, where it is a table.
    """

    value: str | None = None
    unit: str | None = None
    direction: str | None = None
    rate_hz: float | None = None
    displacement_value: str | None = None
    displacement_unit: str | None = None

    @property
    def named(self) -> tuple[str, ...]:
        """The names of what is given."""
        return tuple(one.name for one in fields(self) if getattr(self, one.name) is not None)


@dataclass(frozen=True, slots=True)
class Table:
    """A file of columns: its section, the quantity in it, the options for its channel and unit, units it may have."""

    section: str
    quantity: str
    value: str
    unit: str
    units: str


ACCELERATION = Table("accelerometer", "acceleration", "--value", "--unit", "m/s^2 or g; every millimetre depends on it")
DISPLACEMENT = Table("displacement", "displacement", "--displacement-value", "--displacement-unit", "mm or m")


@dataclass(slots=True)
class Draft:
    """Settings of a recording of two files: keys of each section, with a remark on some of them.

    left_out: keys that the files do not tell, with what they mean; needed: those of them that cannot be done without;
    said: what was chosen for the person.
    """

    sections: dict[str, dict[str, Any]] = field(default_factory=dict)
    remarks: dict[tuple[str, str], str] = field(default_factory=dict)
    left_out: dict[tuple[str, str], str] = field(default_factory=dict)
    needed: list[str] = field(default_factory=list)
    said: list[str] = field(default_factory=list)

    @property
    def second(self) -> str:
        """The section of the second file."""
        return next(section for section in self.sections if section != ACCELERATION.section)

    def put(self, section: str, key: str, value: Any, remark: str = "") -> None:
        """Set a key."""
        self.sections.setdefault(section, {})[key] = value
        if remark:
            self.remarks[section, key] = remark

    def need(self, section: str, key: str, meaning: str) -> None:
        """Leave a key to the person who knows it."""
        self.left_out[section, key] = meaning
        self.needed.append(f"{section}.{key}")

    def text(self) -> str:
        """As a commented recording.toml."""
        lines = []
        for section, keys in self.sections.items():
            lines += ["", f"[{section}]"]
            written = [
                (key, f"{key} = {toml_value(value)}", self.remarks.get((section, key))) for key, value in keys.items()
            ]
            open_keys = [(key, f"# {key} = ", why) for (own, key), why in self.left_out.items() if own == section]
            lines += [f"{line:<40}  # {remark}" if remark else line for _, line, remark in [*written, *open_keys]]
        return "\n".join(["# Written by midspan init; `midspan help SECTION` explains every key.", *lines, ""])


def is_sensor_file(given: object) -> bool:
    """Whether this is the path of a file that is no recording.toml, or of a phone's log."""
    from midspan.sources.accelerometer.phone import is_phone_log

    is_file = isinstance(given, str | Path) and Path(given).is_file() and Path(given).suffix != ".toml"
    return is_file or is_phone_log(given)


def is_second_file(given: object) -> TypeGuard[str | Path]:
    """Whether what stands in the place of a calibration is the path of a video or table: no JSON."""
    return isinstance(given, str | Path) and Path(given).suffix.lower() != ".json"


@contextmanager
def in_words_of_two_files(accel: Path, second: Path | None) -> Iterator[None]:
    """Let a refusal that names keys say where two files have them."""
    try:
        yield
    except MidspanError as error:
        text, files = str(error), [one for one in (accel, second) if one is not None]
        named = KEYS.search(text)
        if named and "midspan init" not in text:
            where = f"the recording.toml of `{shlex.join(('midspan', 'init', *map(str, files)))}`"
            error.args = (f"{text.rstrip()} Set keys such as {named[0]} in {where}.",)
        raise


def draft(accel: Path, second: Path | None, given: Choices, *, choose: bool = False) -> Draft:
    """The settings of a recording of an accelerometer's file and a video, an infrared sequence or a table.

    accel: or a phone's log, which may hold its film: second can be left out then. choose: take one of several channels,
    for a person to look at; else UsageError names them. Raises what reading the files does.
    """
    from midspan.settings.keys import described, recording_sections
    from midspan.settings.phone import put_gyroscope
    from midspan.sources.accelerometer.select import SeriesRequest
    from midspan.sources.camera.formats import is_table
    from midspan.sources.camera.track_table import holds_tracks

    found = Draft()
    log, second = _found(accel, second)
    if not (is_table(second) and second.is_file()) or holds_tracks(second):
        _refuse(second, "no table", given, ("displacement_value", "displacement_unit"))
        frames = _frames(second, given.rate_hz)
        _camera(found, second, frames, _acceleration(found, log or accel, second, given, choose), given)
        if log is not None:
            put_gyroscope(found, log, second, given)
        return found
    _refuse(second, "a table, no pictures", given, ("direction",))
    _acceleration(found, log or accel, second, given, choose)
    request = SeriesRequest(
        "displacement", value=given.displacement_value, unit=given.displacement_unit, rate_hz=given.rate_hz
    )
    if given.rate_hz is not None:
        found.put(DISPLACEMENT.section, "rate_hz", given.rate_hz)
    _series(found, DISPLACEMENT, second, request, choose)
    for key in ("receiver", "noise_time_s"):
        found.left_out["displacement", key] = described(recording_sections(), f"displacement.{key}")
    return found


def _found(accel: Path, second: Path | None) -> "tuple[PhoneLog | None, Path]":
    """The phone's log that the first file is, and the second file; UsageError where they are in the wrong order."""
    from midspan.settings.phone import film_of
    from midspan.sources.accelerometer.phone import is_phone_log, open_phone_log
    from midspan.sources.boundary import require_file
    from midspan.sources.camera.formats import is_table, is_video
    from midspan.sources.zipped import is_inside

    if second is not None and is_video(accel) and (is_table(second) or is_phone_log(second)):
        what = "a table of numbers" if is_table(second) else "an archive of a phone"
        raise UsageError(
            f"{accel} is a video and {second} {what}. Name the accelerometer's file first, then the video."
        )
    if is_phone_log(accel):
        log = open_phone_log(accel)
        return log, film_of(log, second)
    if not is_inside(accel):
        require_file(accel)
    if second is None:
        raise UsageError(f"{accel}: is no archive of a phone. Give the video or table that goes with it after it.")
    if is_phone_log(second):
        films = open_phone_log(second).films
        film = f", or give its film alone: `midspan estimate {accel} {films[0]}`" if films else ""
        raise UsageError(f"{second} is an archive of a phone, with an acceleration of its own. Remove {accel}{film}.")
    return None, second


def _acceleration(
    found: Draft, source: "PhoneLog | Path", second: Path, given: Choices, choose: bool
) -> "TimeSeries | None":
    """The keys of the accelerometer; its series as of `_series`."""
    from midspan.settings.phone import put_acceleration
    from midspan.sources.accelerometer.select import SeriesRequest, read_series

    request = SeriesRequest("acceleration", value=given.value, unit=given.unit)
    if isinstance(source, Path):
        return _series(found, ACCELERATION, source, request, choose)
    table, column = source.acceleration, put_acceleration(found, source, second, given, choose)
    request = replace(request, time=table.time, value=column, unit=given.unit or table.unit)
    return _read(found, ACCELERATION, table.path, request, choose, read_series)


def _refuse(second: Path, kind: str, given: Choices, names: tuple[str, ...]) -> None:
    """UsageError for what is given and means nothing for this second file."""
    for name in names:
        if name in given.named:
            raise UsageError(f"--{name.replace('_', '-')} ({name}): {second} is {kind}. Leave it out.")


def _series(found: Draft, table: Table, path: Path, request: "SeriesRequest", choose: bool) -> "TimeSeries | None":
    """The keys of a table's channel; its series, where the settings are not to be looked at or tell all."""
    from midspan.sources.accelerometer.formats import list_channels
    from midspan.sources.accelerometer.select import candidates, find_channel, read_series, require_unsplit_numbers

    channels = list_channels(path)
    require_unsplit_numbers(path, channels)
    found.put(table.section, "file", str(path.absolute()))
    if request.value is not None:
        channel, others = find_channel(path, channels, request.value, table.value), tuple[str, ...]()
    else:
        likely = candidates(channels, table.quantity, timed=request.rate_hz is not None)
        channel, others = _chosen(path, table, likely, choose)
    _channel(found, table, channel, others, request.unit, channels.names)
    return _read(found, table, path, replace(request, value=channel.name), choose, read_series)


def _chosen(path: Path, table: Table, found: "tuple[Channel, ...]", choose: bool) -> "tuple[Channel, tuple[str, ...]]":
    """The channel along the motion, of those that could be; with the names of the others."""
    if not found:
        article = "an" if table is ACCELERATION else "a"
        raise UsageError(
            f"{path}: no channel is {article} {table.quantity} by name or unit. Select one with {table.value}."
        )
    names = tuple(one.name for one in found)
    if len(found) > 1 and not choose:
        units = {one.unit for one in found}
        said = f" (all in {units.pop()})" if len(units) == 1 and found[0].unit else ""
        raise UsageError(
            f"{path}: {len(found)} channels are possible: {', '.join(map(repr, names))}{said}. Select the one along "
            f"the measured motion, for example {table.value} {names[-1]!r}."
        )
    import numpy as np

    from midspan.sources.accelerometer.units import likely_units, measures, si_factor

    upright = []
    for one in found:
        # A channel that reads gravity.
        if one.unit is None and table is ACCELERATION:
            upright += [one] if likely_units(float(np.nanmean(one.values))) else []
        elif measures(one.unit, "acceleration"):
            mean = float(np.nanmean(one.values)) * si_factor(str(one.unit), "acceleration", None)
            upright += [one] if abs(abs(mean) / GRAVITY_M_S2 - 1.0) < UPRIGHT else []
    chosen = upright[0] if len(upright) == 1 else found[0]
    return chosen, tuple(name for name in names if name != chosen.name)


def _channel(
    found: Draft, table: Table, channel: "Channel", others: tuple[str, ...], unit: str | None, names: tuple[str, ...]
) -> None:
    """The keys of a table's channel."""
    remark = f"or {', '.join(map(repr, others))}: the one along the measured motion" if others else ""
    if len(names) > 1:
        found.put(table.section, "value", channel.name, remark)
    if unit is not None:
        found.put(table.section, "unit", unit)
    elif channel.unit:
        found.put(table.section, "unit", channel.unit, "from the file")
    else:
        found.need(table.section, "unit", f"such as {table.units}")


def _read(
    found: Draft, table: Table, path: Path, request: "SeriesRequest", choose: bool, read: Any
) -> "TimeSeries | None":
    """The series; where it has no time or unit and the settings are to be looked at, None."""
    try:
        return read(path, request)  # type: ignore[no-any-return]
    except UsageError as error:
        if not choose:
            text = str(error).replace("Give unit,", f"Give {table.unit},")
            raise UsageError(text) from None
        if "has no time" in str(error):
            found.need(table.section, "rate_hz", "samples a second")
        return None


def _frames(video: Path, given_hz: float | None) -> "tuple[str, FrameSource, bool]":
    """The section of a video, its frames, and whether they have times; given_hz: their rate, where it is given."""
    from midspan.sources.camera.formats import open_frames
    from midspan.sources.camera.frames import FrameRequest, timed_or_counted
    from midspan.sources.thermal.formats import is_thermal, open_thermal
    from midspan.sources.thermal.temperatures import ThermalRequest

    thermal = is_thermal(video)
    section = "infrared" if thermal else "camera"

    def opened(rate_hz: float | None) -> Any:
        request = FrameRequest(rate_hz=given_hz or rate_hz)
        return open_thermal(video, ThermalRequest(frames=request)) if thermal else open_frames(video, request)

    return section, *timed_or_counted(opened)


def _camera(
    found: Draft,
    video: Path,
    frames: "tuple[str, FrameSource, bool]",
    acceleration: "TimeSeries | None",
    given: Choices,
) -> None:
    """The keys of the camera."""
    from midspan.settings.keys import described, recording_sections

    section, source, timed = frames
    info = source.info
    if info.frame_count == 1:
        raise UsageError(f"{video}: is a single picture. Give the video, a folder of images, or `folder/*.png`.")
    found.put(section, "file", str(video.absolute()), f"{info.width} × {info.height} px, {info.codec}")
    keys = recording_sections()
    found.put(section, "direction", given.direction or DIRECTION, described(keys, f"{section}.direction"))
    if given.rate_hz is not None:
        found.put(section, "rate_hz", given.rate_hz)
    if not timed:
        found.need(section, "rate_hz", described(keys, f"{section}.rate_hz"))
    elif acceleration is not None:
        _begin(found, section, video, (float(source.times_ns()[0]) * 1e-9, float(acceleration.time_ns[0]) * 1e-9))
    for key in ("exposure_s", "roi"):
        found.left_out[section, key] = described(keys, f"{section}.{key}")


def _begin(found: Draft, section: str, video: Path, first_s: tuple[float, float]) -> None:
    """When the video began on the accelerometer's clock, where the two count from different instants."""
    from midspan.settings.phone import named_s
    from midspan.sources.camera.video import made_s

    camera_s, accelerometer_s = first_s
    if accelerometer_s < DATED_FROM_S or camera_s >= DATED_FROM_S:
        return
    made = named_s(video) or made_s(video)
    if made is not None and abs(made - accelerometer_s) < BY_HAND_S:
        found.put(section, "start_s", made - camera_s, "the video's date, on the accelerometer's clock")
    else:
        found.put(
            section, "start_s", accelerometer_s - camera_s, "start of the accelerometer's record, which has dates"
        )


def settings_of(found: Draft) -> tuple[Path, RecordingSettings]:
    """The name that stands for a recording.toml, and the settings of the two files.

    Raises UsageError where the files do not tell all that is needed.
    """
    accel, second = (Path(found.sections[section]["file"]) for section in (ACCELERATION.section, found.second))
    where = f"{accel.name} and {second.name}"
    if found.needed:
        option = "Give --rate-hz (rate_hz), or run" if found.needed == [f"{found.second}.rate_hz"] else "Run"
        raise UsageError(
            f"{where}: {', '.join(found.needed)} is in neither file. {option} `midspan init {accel} {second}` and "
            "add the value to recording.toml."
        )
    from midspan.sources.zipped import zip_of

    return (zip_of(accel) or accel).parent / where, validate(found.sections, where)
