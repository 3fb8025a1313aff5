"""What a reader hands over: the channels of one file, with unit and clock where the file tells them."""

from collections.abc import Callable, Collection
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from midspan.records import Nanoseconds

Values = NDArray[np.float64] | NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class Stored:
    """Values that are still in their file: their count, the bytes that reading them takes, and what reads them."""

    size: int
    needed_bytes: int
    load: Callable[[], Values]


@dataclass(frozen=True, slots=True)
class Channel:
    """One channel of a file: `values` (n,) in `unit` (None: the file does not say), read when they are asked for.

    `values` are float64, or int64 where every digit counts: time stamps, with unit "ns" for nanoseconds since 1970.
    The channel's own clock is `time_ns` (n,), or `rate_hz` in samples per second with `start_ns`; None where unknown.
    """

    name: str
    stored: Values | Stored
    unit: str | None = None
    rate_hz: float | None = None
    start_ns: int | None = None
    time_ns: NDArray[np.int64] | None = None

    @property
    def size(self) -> int:
        """How many values the channel has."""
        return self.stored.size

    @property
    def values(self) -> Values:
        """The values (n,); from the file each time where they are not in memory."""
        return self.stored.load() if isinstance(self.stored, Stored) else self.stored


@dataclass(frozen=True, slots=True)
class ChannelSet:
    """All channels of one file, in plain sentences what the reader found and assumed, and what is wrong with the file.

    `damage` says which data are damaged or cut off; they are not among the channels' values.
    """

    channels: tuple[Channel, ...]
    notes: tuple[str, ...] = ()
    damage: tuple[str, ...] = ()

    @property
    def names(self) -> tuple[str, ...]:
        """The channels' names in the order of the file."""
        return tuple(channel.name for channel in self.channels)


def columns(name: str, values: NDArray[Any]) -> list[tuple[str, NDArray[np.generic]]]:
    """Name and values (n,) of each column of an array: `name` for one, `name_1` … `name_k` for (n, k).

    Fields of a structured array become `name.field` (`field` where `name` is empty). Arrays of more axes give nothing.
    """
    if values.dtype.names:
        prefix = f"{name}." if name else ""
        return [pair for f in values.dtype.names for pair in columns(f"{prefix}{f}", values[f])]
    if values.ndim == 1:
        return [(name or "column_1", values)]
    if values.ndim == 2 and values.shape[1] == 1:
        return [(name or "column_1", values[:, 0])]
    if values.ndim == 2:
        return [(f"{name or 'column'}_{k + 1}", values[:, k]) for k in range(values.shape[1])]
    return []


def numbers(values: NDArray[np.generic]) -> Values | None:
    """Values (n,) as float64, or int64 where they may be time stamps; None for what is not a real number.

    Whole numbers from 1e9 on can be epoch stamps whose last digits float64 would lose.
    """
    if values.dtype.kind == "M":
        return values.astype("datetime64[ns]").astype(np.int64)
    if values.dtype.kind in "iu" and values.size and int(np.abs(values[-1]).astype(np.uint64)) >= 1_000_000_000:
        return values.astype(np.int64)
    if values.dtype.kind in "iufb":
        return np.ascontiguousarray(values, dtype=np.float64)
    return None


def even_ns(start_ns: int, count: int, rate_hz: float) -> Nanoseconds:
    """Time stamps (count,) from `start_ns` on at a rate in Hz."""
    steps = np.rint(np.arange(count) * (1e9 / rate_hz)).astype(np.int64)
    return np.asarray(np.int64(start_ns) + steps, dtype=np.int64)


def distinct(name: str, taken: Collection[str]) -> str:
    """The name, or with `_2`, `_3` … where it is taken."""
    if name not in taken:
        return name
    return next(f"{name}_{k}" for k in range(2, len(taken) + 3) if f"{name}_{k}" not in taken)
