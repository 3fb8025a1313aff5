"""What a phone's own log holds: a folder or zip as the apps Sensor Logger and phyphox write it."""

import csv
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath

import numpy as np

from midspan.errors import DataError
from midspan.records import Floats, Nanoseconds
from midspan.sources.accelerometer.channel import Channel, ChannelSet
from midspan.sources.accelerometer.clock import TIME_UNITS, numbers_to_ns
from midspan.sources.accelerometer.formats import list_channels
from midspan.sources.accelerometer.select import REVERSED
from midspan.sources.accelerometer.units import measures, si_factor
from midspan.sources.camera.formats import is_video
from midspan.sources.zipped import SUFFIX, members, on_disk, zip_of

SENSOR_LOGGER, PHYPHOX = "Sensor Logger", "phyphox"
FORMATS = ((f"{SENSOR_LOGGER}, {PHYPHOX}: CSV exports", (SUFFIX,), "midspan"),)
"""Rows of (name, suffixes, what it is read with)."""
AXES = ("x", "y", "z")
# Sensor Logger names its files after the sensors; the raw reading comes first, as no filter has been over it.
ACCELERATIONS = ("TotalAcceleration.csv", "Accelerometer.csv", "AccelerometerUncalibrated.csv")
GYROSCOPES = ("Gyroscope.csv", "GyroscopeUncalibrated.csv")
GRAVITY, METADATA = "Gravity.csv", "Metadata.csv"
# Its column of nanoseconds since 1970, and the one by which its tables are known.
TIME, ELAPSED = "time", "seconds_elapsed"
# What either app always writes.
SIGNS = re.compile(rf"(^|/)({'|'.join((*ACCELERATIONS, 'Raw Data.csv', 'meta/(time|device).csv'))})$", re.IGNORECASE)
NO_TABLES = ("meta", "camera")
# An app has one table for each sensor.
MAX_TABLES = 64
AXIS = re.compile(r"(?P<what>.*?)(^|[ _])(?P<axis>[xyz])$", re.IGNORECASE)
REMEDY = (
    "Record the acceleration with Sensor Logger (Accelerometer.csv or TotalAcceleration.csv) or phyphox (Acceleration) "
    "and export it as CSV."
)
# The mean of what is without gravity is near 0, with gravity 9.8 m/s², or 1 where it is in g.
WITH_GRAVITY_M_S2 = 3.0
# Farther from the vertical than this no axis is the vertical one.
MAX_SLANT_DEG = 45.0


@dataclass(frozen=True, slots=True)
class ThreeAxes:
    """A table of a sensor with three axes: its file, the columns of time and of the phone's x, y, z, and their unit.

    channels: those columns, as they were read; the phone's axes are right, up along the screen, and out of it.
    """

    path: Path
    time: str
    columns: tuple[str, ...]
    unit: str
    channels: tuple[Channel, ...]

    def along(self, axis: int) -> str:
        """The column of an axis 1, 2 or 3, with the sign of the opposite sense where that is negative."""
        return f"{REVERSED if axis < 0 else ''}{self.columns[abs(axis) - 1]}"

    @property
    def mean(self) -> tuple[float, ...]:
        """The mean along each axis, in the unit."""
        return tuple(float(np.nanmean(one.values)) for one in self.channels[1:])

    @property
    def mean_m_s2(self) -> Floats:
        """The mean (3,) of an acceleration, m/s²."""
        return np.array(self.mean) * si_factor(self.unit, "acceleration", None)

    @property
    def time_ns(self) -> Nanoseconds:
        """The stamps (n,)."""
        clock = self.channels[0]
        return numbers_to_ns(clock.values, clock.unit)[0]


@dataclass(frozen=True, slots=True)
class Vertical:
    """The axis that is nearest to the vertical: its number, gravity's part along it (m/s²), and its angle to it.

    up: whether the phone's axis points up.
    """

    axis: int
    gravity_m_s2: float
    angle_deg: float
    up: bool


@dataclass(frozen=True, slots=True)
class PhoneLog:
    """One recording of a phone: its acceleration, and gravity, gyroscope and films where it has them.

    pauses: how often it was paused, with a clock that leaves the pauses out; reversed: whether accelerations have the
    sign of an iPhone, which reads -g along an axis that points up (its rotation rates have the usual one).
    """

    path: Path
    app: str
    acceleration: ThreeAxes
    gravity: ThreeAxes | None
    gyroscope: ThreeAxes | None
    films: tuple[Path, ...]
    pauses: int = 0
    reversed: bool = False

    @property
    def with_gravity(self) -> bool:
        """Whether the acceleration itself contains gravity."""
        return float(np.linalg.norm(self.acceleration.mean_m_s2)) > WITH_GRAVITY_M_S2

    @property
    def vertical(self) -> Vertical | None:
        """The axis along gravity, which the acceleration itself shows, or its own table; None where neither does."""
        for table in (self.acceleration, self.gravity):
            mean = np.zeros(3) if table is None else table.mean_m_s2
            size = float(np.linalg.norm(mean))
            if size > WITH_GRAVITY_M_S2:
                axis = int(np.argmax(np.abs(mean)))
                angle = np.arccos(min(1.0, abs(mean[axis]) / size))
                up = bool((mean[axis] > 0.0) != self.reversed)
                return Vertical(axis, float(mean[axis]), float(np.degrees(angle)), up)
        return None

    @property
    def camera_axes(self) -> tuple[int, int, int] | None:
        """The phone's axes along those of its rear camera's image: right, down, along the view; None where unknown.

        Each is 1 (x), 2 (y) or 3 (z), negative in the opposite sense. A player shows the image upright; the camera
        looks from the phone's back, against z.
        """
        upright = self.vertical
        if upright is None or upright.angle_deg > MAX_SLANT_DEG or upright.axis == 2:
            return None
        sense = 1 if upright.up else -1
        # With x up the phone's top, y, points to the left.
        return (-sense * 2, -sense * 1, -3) if upright.axis == 0 else (sense * 1, -sense * 2, -3)


def is_phone_log(path: object) -> bool:
    """Whether this is the path of a zip, or of a folder with files by the names that the apps give them."""
    if not isinstance(path, str | Path):
        return False
    return holds_phone_log(Path(path)) and not (Path(path) / "recording.toml").is_file()


def holds_phone_log(path: Path) -> bool:
    """The same, whether or not a recording is described together with the files."""
    try:
        if path.suffix.lower() == SUFFIX and path.is_file():
            return True
        return path.is_dir() and any(map(SIGNS.search, _names(path)))
    except (OSError, ValueError):
        return False


def open_phone_log(path: Path) -> PhoneLog:
    """What is in a phone's log. Raises DataError where it holds no acceleration, or is no log of either app."""
    names = _names(path)
    top = path / _top(path, names)
    inside = [path / name for name in names if top in (path / name).parents]
    tables = {one.name: one for one in inside if one.parent == top and _is_table(one.name)}
    known = [name for name in (*ACCELERATIONS, *GYROSCOPES, GRAVITY) if name in tables]
    failed: list[str] = []
    read = {name: found for name in known or sorted(tables)[:MAX_TABLES] if (found := _read(tables[name], failed))}
    if (known and not read) or any(ELAPSED in one.names for one in read.values()):
        log = _sensor_logger(path, tables, read)
    else:
        read |= {name: one for name in sorted(set(tables) - {*known})[:MAX_TABLES] if (one := _read(tables[name], []))}
        log = _phyphox(path, tables, read)
    if log is None:
        raise DataError(f"{path} holds no acceleration that can be used: {_what(names, failed)}. {REMEDY}")
    return replace(log, films=tuple(one for one in inside if is_video(one)), pauses=_pauses(top))


def _top(path: Path, names: tuple[str, ...]) -> PurePosixPath:
    """The folder of the tables in a log; DataError where it holds several recordings."""
    folders = {PurePosixPath(name).parent for name in names if _is_table(name)} or {PurePosixPath()}
    depth = min(len(one.parts) for one in folders)
    highest = sorted(str(one) for one in folders if len(one.parts) == depth)
    if len(highest) > 1:
        raise DataError(
            f"{path} holds {len(highest)} recordings, in {', '.join(highest[:6])}. Unpack it and give one of these "
            "folders."
        )
    return PurePosixPath(highest[0])


def _what(names: tuple[str, ...], failed: list[str]) -> str:
    """Why a log holds no acceleration."""
    if failed:
        return "; ".join(failed)
    if books := [name for name in names if name.lower().endswith((".xls", ".xlsx"))]:
        return f"{books[0]} is a workbook"
    tables = [name for name in names if _is_table(name)]
    return f"of its tables ({', '.join(tables[:8])}) none has x, y and z in m/s² or g" if tables else "it has no table"


def _names(path: Path) -> tuple[str, ...]:
    """The files of a folder, two folders deep, or of a zip, as paths relative to it."""
    if zip_of(path) is not None:
        found = list(members(path))
    elif path.is_dir():
        levels = ("*", "*/*", "*/[Cc]amera/*")
        found = [one.relative_to(path).as_posix() for level in levels for one in path.glob(level) if one.is_file()]
    else:
        raise DataError(f"{path} is no folder and no zip. Give the archive that the phone's app exported.")
    parts = {name: PurePosixPath(name).parts for name in found}
    return tuple(sorted(name for name in found if not any(one.startswith((".", "__MACOSX")) for one in parts[name])))


def _is_table(name: str) -> bool:
    own = PurePosixPath(name)
    return own.suffix.lower() == ".csv" and own.parent.name.lower() not in NO_TABLES


def _read(path: Path, failed: list[str]) -> ChannelSet | None:
    """The columns of a table; None, with the reason in `failed`, where it is empty or damaged."""
    try:
        return list_channels(path)
    except DataError as error:
        failed.append(str(error).rstrip(".").replace(f"{path.parent}/", "").split(". ")[0])
        return None


def _three(
    path: Path, found: ChannelSet, fits: Callable[[Channel], bool], unit: str | None = None
) -> Iterator[ThreeAxes]:
    """The groups of columns x, y, z that fit, with the table's time, in the order of the file."""
    groups: dict[str, dict[str, Channel]] = {}
    for one in found.channels:
        match = AXIS.match(one.name)
        if match and fits(one):
            groups.setdefault(match["what"], {})[match["axis"].lower()] = one
    first = next((one for one in found.channels if one.name == TIME), found.channels[0])
    for axes in groups.values():
        if set(axes) == set(AXES) and (first.unit in (None, "ns") or first.unit.lower() in TIME_UNITS):
            own = tuple(axes[axis] for axis in AXES)
            yield ThreeAxes(path, first.name, tuple(one.name for one in own), unit or str(own[0].unit), (first, *own))


def _sensor_logger(path: Path, tables: dict[str, Path], read: dict[str, ChannelSet]) -> PhoneLog | None:
    """The log of an app whose tables state no units: m/s² and rad/s."""

    def first(names: tuple[str, ...], unit: str) -> ThreeAxes | None:
        groups = (
            _three(tables[name], read[name], lambda one: one.unit is None, unit) for name in names if name in read
        )
        return next((one for group in groups for one in group), None)

    acceleration = first(ACCELERATIONS, "m/s^2")
    if acceleration is None:
        return None
    if acceleration.path.name == ACCELERATIONS[-1] and np.linalg.norm(acceleration.mean) < WITH_GRAVITY_M_S2:
        # Raw readings of an iPhone are in g.
        acceleration = replace(acceleration, unit="g")
    gravity, gyroscope = first((GRAVITY,), "m/s^2"), first(GYROSCOPES, "rad/s")
    own = _metadata(acceleration.path.parent / METADATA)
    # An iPhone's signs stay unless the app's setting for units and frames changes them.
    reversed_ = own.get("platform") == "ios" and own.get("standardisation") != "true"
    return PhoneLog(path, SENSOR_LOGGER, acceleration, gravity, gyroscope, films=(), reversed=reversed_)


def _metadata(path: Path) -> dict[str, str]:
    """What Sensor Logger says of the recording, in lower case; nothing where it cannot be read."""
    try:
        with on_disk(path) as file, file.open(encoding="utf-8", errors="replace", newline="") as opened:
            return {str(key): str(value).lower() for key, value in next(csv.DictReader(opened), {}).items()}
    except (DataError, OSError, csv.Error):
        return {}


def _phyphox(path: Path, tables: dict[str, Path], read: dict[str, ChannelSet]) -> PhoneLog | None:
    """The log of an app that names its columns in the phone's language, with their units."""

    def groups(fits: Callable[[Channel], bool]) -> list[ThreeAxes]:
        return [one for name, found in read.items() for one in _three(tables[name], found, fits)]

    accelerations = groups(lambda one: measures(one.unit, "acceleration"))
    gravity = next((one for one in accelerations if "grav" in one.path.name.lower()), None)
    measured = [one for one in accelerations if one is not gravity]
    if not measured:
        return None
    # The reading with gravity in it comes first, as no filter has been over it.
    acceleration = max(measured, key=lambda one: float(np.linalg.norm(one.mean_m_s2)))
    gyroscope = next(iter(groups(lambda one: (one.unit or "").lower() in ("rad/s", "deg/s", "°/s"))), None)
    return PhoneLog(path, PHYPHOX, acceleration, gravity, gyroscope, films=())


def _pauses(top: Path) -> int:
    """How often phyphox was paused and started again."""
    path = top / "meta" / "time.csv"
    try:
        with on_disk(path) as file:
            return max(0, file.read_text(encoding="utf-8", errors="replace").upper().count("START") - 1)
    except (DataError, OSError):
        return 0
