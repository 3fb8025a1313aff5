"""Named arrays of a file that keeps them in a tree (HDF5, MATLAB, npz): to channels with unit and rate.

Only what the file says of an array (its shape and type) is read at first; its numbers when a channel is used.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from midspan.sources.accelerometer.channel import Channel, ChannelSet, Stored, Values, columns, numbers
from midspan.sources.accelerometer.clock import texts_to_ns
from midspan.sources.accelerometer.dialect import named_unit

_RATES = (
    "rate_hz",
    "sampling_rate",
    "sampling_rate_hz",
    "sample_rate",
    "samplerate",
    "sampling_frequency",
    "fs",
    "rate",
)
_STEPS = ("dt", "delta_t", "sample_interval", "sampling_interval", "wf_increment")
_UNITS = ("unit", "units")
# More columns than any logger has channels: such an array is a matrix or a picture.
_MAX_COLUMNS = 10_000
# Texts that are looked at to see whether they are times.
_TEXTS = 100


@dataclass(frozen=True, slots=True)
class Leaf:
    """An array of the tree under its full path, with its attributes, then those of the groups around it.

    shape, dtype: as the file declares them; read: gives the array.
    """

    name: str
    shape: tuple[int, ...]
    dtype: np.dtype[Any]
    read: Callable[[], NDArray[np.generic]]
    attributes: tuple[dict[str, Any], ...] = ()

    @property
    def size(self) -> int:
        """How many elements the array has."""
        return math.prod(self.shape)


def loaded(name: str, values: NDArray[np.generic], attributes: tuple[dict[str, Any], ...] = ()) -> Leaf:
    """A leaf of an array that is in memory."""
    return Leaf(name, values.shape, values.dtype, lambda: values, attributes)


def channels_of(leaves: Sequence[Leaf], notes: Sequence[str] = ()) -> ChannelSet:
    """Channels of the leaves: columns of arrays (n, k) become `name_1` … `name_k`, single numbers may give the rate.

    Arrays of more than two axes or 10 000 columns, complex numbers and words are left out and named in the notes,
    behind `notes`.
    """
    file_rate = _rate({leaf.name.replace(".", "/").split("/")[-1]: leaf.read() for leaf in leaves if leaf.size == 1})
    channels: list[Channel] = []
    lines, last = list(notes), _Last()
    for leaf in leaves:
        if leaf.size < 2:
            continue
        found, said = _channels(leaf, file_rate, last)
        channels += found
        lines += said
    return ChannelSet(tuple(channels), tuple(lines))


@dataclass(slots=True)
class _Last:
    """The array that was read last: its columns come one after the other."""

    leaf: Leaf | None = None
    values: NDArray[np.generic] | None = None

    def of(self, leaf: Leaf) -> NDArray[np.generic]:
        """The array of a leaf."""
        if self.values is None or self.leaf is not leaf:
            # The one before goes first, so that there is never more than one.
            self.leaf, self.values = leaf, None
            self.values = leaf.read()
        return self.values


def _channels(leaf: Leaf, file_rate: float | None, last: _Last) -> tuple[list[Channel], list[str]]:
    own_unit = next((_text(level[key]) for level in leaf.attributes for key in _UNITS if key in level), None)
    rate_hz = next((rate for level in leaf.attributes if (rate := _rate(level))), file_rate)
    if len(leaf.shape) == 2 and leaf.shape[1] > _MAX_COLUMNS:
        return [], [f"{leaf.name} left out: {leaf.shape[1]} columns"]
    # The columns' names and types from an array like it without a row.
    pairs = columns(leaf.name, np.empty((0, *leaf.shape[1:]), dtype=leaf.dtype)) if leaf.shape else []
    if not pairs:
        return [], [f"{leaf.name} left out: {len(leaf.shape)} axes"]
    channels: list[Channel] = []
    notes: list[str] = []
    for k, (heading, empty) in enumerate(pairs):
        name, heading_unit = named_unit(heading)
        channel, said = _channel(name, _Column(leaf, k, empty.dtype, last), own_unit or heading_unit)
        notes += said
        if channel:
            start_ns = channel.start_ns
            channels.append(Channel(channel.name, channel.stored, channel.unit, rate_hz, start_ns))
    return channels, notes


@dataclass(frozen=True, slots=True)
class _Column:
    """A column of a leaf: its number among `columns`, and its type; last: what was read last of the same file."""

    leaf: Leaf
    number: int
    dtype: np.dtype[Any]
    last: _Last

    def read(self) -> NDArray[np.generic]:
        """The column (n,)."""
        return columns(self.leaf.name, self.last.of(self.leaf))[self.number][1]

    def numbers(self) -> Values:
        """The column as a channel's values; ValueError for complex numbers that the file did not declare."""
        found = numbers(self.read())
        if found is None:
            raise ValueError(f"{self.leaf.name} holds no real numbers")
        return found


def _channel(name: str, column: _Column, unit: str | None) -> tuple[Channel | None, list[str]]:
    if column.dtype.kind in "SUO":
        texts = column.read()
        if texts_to_ns([_text(value) for value in texts[:_TEXTS]]) is None:
            return None, []
        moments = texts_to_ns([_text(value) for value in texts])
        return (Channel(name, moments[0], "ns"), list(moments[1])) if moments else (None, [])
    if column.dtype.kind not in "iufbM":
        return None, [f"{name} left out: its numbers are of type {column.dtype}"]
    # The array as it is, and the column as numbers of eight bytes.
    needed = column.leaf.size * column.leaf.dtype.itemsize + 8 * column.leaf.shape[0]
    stored = Stored(column.leaf.shape[0], needed, column.numbers)
    return Channel(name, stored, "ns" if column.dtype.kind == "M" else unit), []


def _rate(attributes: dict[str, Any]) -> float | None:
    lowered = {key.lower(): value for key, value in attributes.items()}
    for keys, inverse in ((_RATES, False), (_STEPS, True)):
        for key in keys:
            number = _number(lowered.get(key))
            if number is not None and np.isfinite(number) and number > 0:
                return 1.0 / number if inverse else number
    return None


def _number(value: Any) -> float | None:
    try:
        return float(np.asarray(value).reshape(-1)[0])
    except (TypeError, ValueError, IndexError):
        return None


def _text(value: Any) -> str:
    if isinstance(value, np.ndarray) and value.size == 1:
        value = value.reshape(-1)[0]
    return value.decode("utf-8", errors="replace") if isinstance(value, bytes) else str(value)
