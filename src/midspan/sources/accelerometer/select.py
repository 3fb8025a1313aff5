"""One channel of a logger file as a time series: choice of the columns, time to nanoseconds, values to SI."""

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from midspan.checks import nearest, option
from midspan.errors import DataError, UsageError
from midspan.notices import Notice
from midspan.records import Floats, Nanoseconds, TimeSeries
from midspan.sources.accelerometer.channel import Channel, ChannelSet, Stored, even_ns
from midspan.sources.accelerometer.clock import NOT_A_TIME, TEXT, TIME_NAMES, is_time_name, numbers_to_ns
from midspan.sources.accelerometer.dialect import SPLIT, named_unit
from midspan.sources.accelerometer.formats import list_channels
from midspan.sources.accelerometer.stamps import repeated_rows, spread_equal_stamps
from midspan.sources.accelerometer.units import SI_UNITS, likely_units, measures, si_factor

_VALUE_NAMES = {
    "acceleration": re.compile(r"acc|beschl|(^|[_./ ])a([xyz]|_|$)", re.IGNORECASE),
    "displacement": re.compile(r"disp|defl|height|hoehe|höhe|level|verschieb|durchbieg|lvdt|laser|pos", re.IGNORECASE),
    "velocity": re.compile(r"vel|speed|geschw|vitesse|(^|[_./ ])v([xyz]|_|$)", re.IGNORECASE),
    "angle": re.compile(r"pitch|roll|yaw|tilt|angle|incl|neig|winkel", re.IGNORECASE),
    "rotation rate": re.compile(r"gyr|omega|rot|rate|(^|[_./ ])g([xyz])", re.IGNORECASE),
}
_NOT_VALUES = re.compile(r"(^|[_ ])(std|sigma|err|error|var|variance)([_ ]|$)", re.IGNORECASE)
_COLUMN = re.compile(r"^(?P<name>.+)\[(?::\s*,)?\s*(?P<index>\d+)\s*\]$")
# No structure moves by 1e9 m or is accelerated by 1e9 m/s²; the Earth's radius is 6.4e6 m.
_MAX_VALUE = 1e9
# Before the name of a channel: its values with the other sign.
REVERSED = "-"
# A file's own rate and the one given may differ by this much before it is reported.
RATE_TOLERANCE = 0.01


@dataclass(frozen=True, slots=True)
class SeriesRequest:
    """What to take from a file: the channel of `time` and of `value` (None: found by name, unit or being the only one).

    `value` may be `-NAME`: the channel in the opposite sense, where none is called so.
    `quantity` is one of `SI_UNITS`, as "acceleration". `unit` wins over the file's. `sensitivity` in V per SI unit with
    a voltage. `rate_hz` and `start_s` (s) make the time where no time channel is named; `start_s` shifts a clock that
    comes with the file's own rate. optional: the channel may hold no number.
    """

    quantity: str
    time: str | None = None
    value: str | None = None
    unit: str | None = None
    sensitivity: float | None = None
    rate_hz: float | None = None
    start_s: float = 0.0
    optional: bool = False


def read_series(path: Path, request: SeriesRequest, *, channels: ChannelSet | None = None) -> TimeSeries:
    """The requested channel of `path`: time in ns, strictly increasing, values in m/s² or m, else NaN.

    channels: those of the file where they are listed already.
    Raises UsageError for an unknown column or unit or when a choice cannot be made, DataError for a file that cannot be
    read, time that runs backwards, repeats or is missing, and fewer than two numbers.
    """
    option("quantity", request.quantity, SI_UNITS)
    if request.rate_hz is not None and not (np.isfinite(request.rate_hz) and request.rate_hz > 0):
        raise UsageError(f"rate_hz must be above zero (Hz); received {request.rate_hz!r}. Correct it or leave it out.")
    found = channels or list_channels(path)
    require_unsplit_numbers(path, found)
    notes = list(found.notes)
    clock = None
    own_clock = any(c.time_ns is not None or c.rate_hz is not None for c in found.channels)
    if request.time is not None:
        # The usual word for time, where there is no such channel, means the file's own clock.
        is_meant = own_clock and request.time not in found.names and request.time.lower() in TIME_NAMES
        clock = None if is_meant else find_channel(path, found, request.time, "time")
    channel, sense = _value_channel(path, found, request, clock)
    clock = clock or _guessed_time(found, request, channel)
    time_ns = _times(path, channel, clock, request, notes)
    unit, factor = _unit(path, channel, request, notes)
    value = _si(channel, sense * factor, notes)
    _check_values(path, channel.name, time_ns, value, least=0 if request.optional else 2)
    # The columns of its file that are in memory tell whether two rows are one, so that all its channels lose the same
    # rows; clocks do not, nor a column that rises throughout: it counts the rows.
    in_memory = [c for c in found.channels if c.size == channel.size and not isinstance(c.stored, Stored)]
    others = [c.values for c in in_memory if c is not channel and not _is_clock(c) and not _rising(c)]
    repeated = repeated_rows(time_ns, [channel.values, *others])
    spread_ns, spread = spread_equal_stamps(time_ns[~repeated])
    _check_order(path, spread_ns, np.flatnonzero(~repeated) + 1)
    dropped = f"{int(repeated.sum())} duplicate rows were dropped"
    notices = [Notice("stamps-corrected", text) for text in (dropped if repeated.any() else "", spread) if text]
    value = value[~repeated]
    name = channel.name if sense > 0.0 else f"{REVERSED}{channel.name}"
    return TimeSeries(spread_ns, value, name, unit, (*notes, *notices), found.damage, tuple(notices))


def require_unsplit_numbers(path: Path, found: ChannelSet) -> None:
    """UsageError where the columns are the halves of numbers, which a comma parts as it parts columns."""
    split = next((note for note in found.notes if note.startswith(SPLIT)), None)
    if split is not None:
        raise UsageError(f"{path}: {split}.")


def find_channel(path: Path, found: ChannelSet, wanted: str, key: str) -> Channel:
    """The channel called `wanted`: its name, the last part of its path if unique, or `name[k]` from 0.

    Raises UsageError that names the nearest and lists what is there, DataError for one that the reader left out; `key`
    is the setting's name in the message.
    """
    bare, unit = named_unit(wanted)
    matches = [c for c in found.channels if c.name == wanted]
    matches = matches or [c for c in found.channels if c.name == bare and unit in (None, c.unit)]
    matches = matches or [c for c in found.channels if re.split(r"[/.]", c.name)[-1] == wanted]
    matches = matches or [c for c in found.channels if c.name.lower() == bare.lower() and unit in (None, c.unit)]
    if not matches and (column := _COLUMN.match(wanted)):
        numbered = f"{column['name'].strip()}_{int(column['index']) + 1}"
        matches = [c for c in found.channels if numbered in (c.name, re.split(r"[/.]", c.name)[-1])]
    if len(matches) == 1:
        return matches[0]
    names = found.names
    left_out = next((note for note in found.notes if note.startswith(f"{wanted} left out")), None)
    if left_out is not None and not matches:
        raise DataError(f"{path}: {key} = {wanted!r}: {left_out}.")
    problem = f"stands for {len(matches)} channels" if matches else "is not in the file"
    parts = [name for name in names if re.search(rf"(?<!\w){re.escape(wanted)}(?!\w)", name, re.IGNORECASE)]
    hint = f"Did you mean {parts[0]!r}?" if len(parts) == 1 and not matches else nearest(wanted, names)
    raise UsageError(f"{path}: {key} = {wanted!r} {problem}. {hint} It holds {_listing(names)}.".replace("  ", " "))


def _listing(names: tuple[str, ...]) -> str:
    shown = ", ".join(repr(name) for name in names[:12])
    return f"{shown} and {len(names) - 12} more" if len(names) > 12 else shown


def _is_clock(channel: Channel) -> bool:
    return channel.unit == "ns" or is_time_name(channel.name)


def named_after(name: str, quantity: str) -> bool:
    """Whether a channel's name says that it holds a quantity ("acceleration", "displacement")."""
    return bool(_VALUE_NAMES[quantity].search(name))


def candidates(
    found: ChannelSet, quantity: str, clock: Channel | None = None, *, timed: bool = False
) -> tuple[Channel, ...]:
    """The channels that a quantity ("acceleration", "displacement") could be in, the more likely ones alone.

    clock: the channel of times, where it is named; timed: whether the times are known otherwise. Those in the
    quantity's unit and by its name come before those of either, and these before all the others.
    """
    left = [c for c in found.channels if c is not clock and not _is_clock(c) and not _NOT_VALUES.search(c.name)]
    untimed = clock is None and not timed and not any(_is_clock(c) for c in found.channels)
    if len(left) == 2 and untimed and _rising(left[0]):
        left = left[1:]
    by_unit = [c for c in left if measures(c.unit, quantity)]
    by_name = [c for c in left if named_after(c.name, quantity)]
    both = [c for c in by_unit if c in by_name]
    ways = [left, by_unit, by_name, both]
    alone = next((choice for choice in ways if len(choice) == 1), None)
    return tuple(alone or next((choice for choice in reversed(ways) if choice), []))


def _value_channel(
    path: Path, found: ChannelSet, request: SeriesRequest, clock: Channel | None
) -> tuple[Channel, float]:
    """The channel of the values, and 1, or -1 where it is taken in the opposite sense."""
    name = request.value
    if name is not None and name.startswith(REVERSED) and name not in found.names:
        return find_channel(path, found, name.removeprefix(REVERSED), "value"), -1.0
    if name is not None:
        return find_channel(path, found, name, "value"), 1.0
    choice = candidates(found, request.quantity, clock, timed=request.rate_hz is not None)
    if len(choice) == 1:
        return choice[0], 1.0
    units = {one.unit for one in choice}
    alike = f" (all in {choice[0].unit})" if len(units) == 1 and choice and choice[0].unit else ""
    raise UsageError(
        f"{path}: value must name the channel of {request.quantity}; it was left out and {len(choice)} could be meant. "
        f"Give value as one of {_listing(tuple(one.name for one in choice) or found.names)}{alike}."
    )


def _rising(channel: Channel) -> bool:
    values = channel.values
    return values.size > 1 and bool(np.all(values[1:] > values[:-1]))


def _guessed_time(found: ChannelSet, request: SeriesRequest, value: Channel) -> Channel | None:
    """A channel of times by its name, else a first channel that rises throughout; none where a rate is given."""
    if request.rate_hz is not None or value.time_ns is not None:
        return None
    same = [c for c in found.channels if c is not value and c.size == value.size]
    named = [c for c in same if _is_clock(c)]
    if named:
        return named[0]
    if value.rate_hz is not None or not same or same[0] is not found.channels[0]:
        return None
    return same[0] if _rising(same[0]) else None


def _times(
    path: Path, channel: Channel, clock: Channel | None, request: SeriesRequest, notes: list[str]
) -> Nanoseconds:
    start_ns = round(request.start_s * 1e9)
    if clock is not None:
        return _clock_times(path, channel, clock, notes)
    if channel.time_ns is not None:
        _note_rates(channel, request, notes)
        return channel.time_ns + np.int64(start_ns)
    if channel.rate_hz is not None and (channel.start_ns is not None or request.rate_hz is None):
        _note_rates(channel, request, notes)
        notes.append(f"time from the file's rate of {channel.rate_hz:.9g} Hz")
        return even_ns((channel.start_ns or 0) + start_ns, channel.size, channel.rate_hz)
    if request.rate_hz is None:
        if text := next((note for note in notes if note.endswith(TEXT)), None):
            raise UsageError(f"{path}: {text}. Write its times as seconds or ISO 8601, or give rate_hz (Hz).")
        raise UsageError(f"{path}: {channel.name!r} has no time. Give rate_hz (Hz), or time with a channel of times.")
    notes.append(f"time from rate_hz = {request.rate_hz:.9g} Hz and start_s = {request.start_s:g} s")
    return even_ns(start_ns, channel.size, request.rate_hz)


def _clock_times(path: Path, channel: Channel, clock: Channel, notes: list[str]) -> Nanoseconds:
    if clock.size != channel.size:
        raise DataError(
            f"{path}: time {clock.name!r} and value {channel.name!r} must be of equal length; received "
            f"{clock.size} and {channel.size}. Name channels that belong together."
        )
    unit = clock.unit or named_unit(clock.name)[1]
    if unit is not None and any(measures(unit, quantity) for quantity in SI_UNITS):
        raise UsageError(
            f"{path}: time must be in a unit of time; {clock.name!r} is in {unit!r}. Name the channel of times as time."
        )
    try:
        time_ns, said = numbers_to_ns(clock.values, unit)
    except DataError as error:
        raise DataError(f"{path}: {clock.name!r}: {error}") from error
    notes.append(f"{said} (channel {clock.name})")
    return time_ns


def _note_rates(channel: Channel, request: SeriesRequest, notes: list[str]) -> None:
    wanted_hz, own_hz = request.rate_hz, channel.rate_hz
    if wanted_hz is not None and own_hz is not None and abs(wanted_hz / own_hz - 1.0) > RATE_TOLERANCE:
        notes.append(f"rate_hz = {wanted_hz:g} Hz not used: the file's own time gives {own_hz:.6g} Hz")


def _unit(path: Path, channel: Channel, request: SeriesRequest, notes: list[str]) -> tuple[str, float]:
    unit = request.unit or channel.unit
    if not unit:
        said, likely = f"such as {SI_UNITS[request.quantity]!r}", tuple[str, ...]()
        if request.quantity == "acceleration":
            reading = float(np.nanmean(channel.values))
            likely = likely_units(reading)
        if likely:
            said = f"{likely[0]!r}: at rest the values are {reading:.4g}, 1 g in {' or '.join(likely)}"
        raise UsageError(f"{path}: the unit of {channel.name!r} is not in the file. Give unit, {said}.")
    if request.unit and channel.unit and request.unit != channel.unit:
        notes.append(f"unit {request.unit} as given; the file says {channel.unit}")
    elif not request.unit:
        notes.append(f"unit {unit} from the file")
    try:
        return unit, si_factor(unit, request.quantity, request.sensitivity)
    except UsageError as error:
        raise UsageError(f"{path}, {channel.name!r}: {error}") from error


def _si(channel: Channel, factor: float, notes: list[str]) -> Floats:
    with np.errstate(over="ignore", invalid="ignore"):
        value = channel.values.astype(np.float64) * factor
    impossible = np.abs(value) > _MAX_VALUE
    if impossible.any():
        value[impossible] = np.nan
        notes.append(
            f"{int(impossible.sum())} values of {channel.name} are infinite or beyond ±{_MAX_VALUE:g} (SI) and count "
            "as missing"
        )
    return value


def _check_values(path: Path, name: str, time_ns: Nanoseconds, value: Floats, *, least: int) -> None:
    missing, present = np.flatnonzero(time_ns == NOT_A_TIME), np.count_nonzero(~np.isnan(value))
    if missing.size:
        raise DataError(
            f"{path}: {missing.size} of {time_ns.size} time stamps are missing or invalid, the first in row "
            f"{missing[0] + 1} of the data. Correct or remove these rows, or give rate_hz instead of time."
        )
    if present < least:
        raise DataError(
            f"{path}: {name!r} must have two numbers or more; received {present} in {value.size} rows. Choose another "
            "channel as value."
        )


def _check_order(path: Path, time_ns: Nanoseconds, numbers: NDArray[np.int64]) -> None:
    """DataError where stamps (n,) do not increase; numbers (n,): of their rows in the file, from 1."""
    wrong = np.flatnonzero(time_ns[1:] <= time_ns[:-1])
    if wrong.size:
        row = int(wrong[0]) + 1
        raise DataError(
            f"{path}: time must increase from row to row; row {numbers[row]} of the data has {_stamp(time_ns[row])} "
            f"after {_stamp(time_ns[row - 1])} ({wrong.size} such rows). Sort or correct the rows, or give rate_hz "
            "instead."
        )


def _stamp(time_ns: np.int64) -> str:
    """Nanoseconds as seconds with all digits that are not zero, computed in whole numbers."""
    whole, fraction = divmod(abs(int(time_ns)), 1_000_000_000)
    return f"{'-' if time_ns < 0 else ''}{whole}.{fraction:09d}".rstrip("0").rstrip(".") + " s"
