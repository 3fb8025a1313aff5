"""How frames are asked for, what they are timed by, and what of a colour image is used."""

from abc import abstractmethod
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from midspan.errors import DataError, UsageError
from midspan.records import NANOSECONDS, Frame, Nanoseconds
from midspan.sources.accelerometer.channel import even_ns
from midspan.sources.accelerometer.clock import NOT_A_TIME, numbers_to_ns
from midspan.sources.accelerometer.formats import list_channels
from midspan.vision.frame_source import FrameSource

# A frame of which a larger share is no number is passed over: what would be filled in would be tracked.
MAX_MISSING = 0.2
# Frames or pixels that a message names.
MAX_NAMED = 5


@dataclass(frozen=True, slots=True)
class FrameRequest:
    """How to read frames: `times` a file with column time_s, one row a frame; `rate_hz` and `start_s` (s) without one.

    Stamps of the container come before `rate_hz`; `start_s` is added to them. Every n-th frame is used (`every`).
    with_missing: give out frames without numbers too, for a reader that fills or passes over them itself.
    """

    times: Path | None = None
    rate_hz: float | None = None
    start_s: float = 0.0
    every: int = 1
    with_missing: bool = False

    def check(self, path: Path) -> None:
        """Raise UsageError for a rate, start or step outside its range."""
        rate_hz = self.rate_hz
        if not isinstance(self.every, int) or self.every < 1:
            raise UsageError(f"every must be 1 or more (use every n-th frame); received {self.every!r} for {path}.")
        is_number = isinstance(rate_hz, int | float | np.number)
        if rate_hz is not None and not (is_number and np.isfinite(rate_hz) and rate_hz > 0):
            raise UsageError(f"rate_hz must be above zero (Hz); received {rate_hz!r} for {path}.")
        if not np.isfinite(self.start_s):
            raise UsageError(f"start_s must be a finite time in s; received {self.start_s!r} for {path}.")


class StoredFrames(FrameSource):
    """Frames of which each can be read on its own, by its number in the file.

    A subclass sets `_count`, the number of frames in the file, and reads them in `_image`.
    """

    _count: int

    def __init__(self, path: Path, request: FrameRequest) -> None:
        self._path, self._request = path, request

    @abstractmethod
    def _image(self, number: int) -> NDArray[np.generic] | None:
        """The pixels (rows, columns) of a frame; None where it is passed over."""

    def _own_times(self) -> Nanoseconds:
        """Time stamps of all frames of the file where the request names no file of times."""
        return rate_times(self._path, self._request, self._count)

    def times_ns(self) -> Nanoseconds:
        """Time stamps from `times`, else the source's own, else from the rate."""
        times = self._request.times
        all_ns = self._own_times() if times is None else file_times(times, self._path, self._count)
        return all_ns[:: self._request.every]

    def frames(self, start: int = 0, stop: int | None = None) -> Iterator[Frame]:
        """The frames, one at a time; DataError for one that cannot be read or has another size than the first."""
        times = self.times_ns()
        for index in range(*slice(start, stop).indices(times.size)):
            pixels = self._image(index * self._request.every)
            if pixels is not None:
                yield Frame(int(times[index]), pixels, index)


def timed_or_counted(opened: Callable[[float | None], FrameSource]) -> tuple[FrameSource, bool]:
    """A source with its own times, or counting frames, one a second, where it has none; and whether they are its own.

    opened: opens it at a rate, Hz; None: with its own times.
    """
    try:
        source = opened(None)
        source.times_ns()
        return source, True
    except UsageError:
        source = opened(1.0)
        source.times_ns()
        return source, False


def file_times(times: Path, source: Path, count: int) -> Nanoseconds:
    """Time stamps (count,) from the column time_s (else the only or first column) of a text file, one row a frame.

    Raises DataError where the rows are not as many as the frames or the times do not increase.
    """
    found = list_channels(times)
    named = [c for c in found.channels if c.name.lower() == "time_s"]
    channel = (named or [c for c in found.channels if c.name.lower().startswith("time")] or list(found.channels))[0]
    time_ns, _ = numbers_to_ns(channel.values, channel.unit)
    if time_ns.size != count:
        raise DataError(
            f"{times} must have one row for each frame of {source}; it has {time_ns.size} rows and there are {count} "
            "frames. Give the times of this file, before `every` is applied."
            + "".join(f" The file of times: {line}." for line in found.damage)
        )
    return require_increasing(f"{times}: times", time_ns)


def rate_times(path: Path, request: FrameRequest, count: int) -> Nanoseconds:
    """Time stamps (count,) from `rate_hz` and `start_s`; UsageError without a rate."""
    if request.rate_hz is None:
        raise UsageError(f"{path} has no time stamps. Give rate_hz (frames per second), or times with one row a frame.")
    return grid(count, Fraction(request.rate_hz), round(request.start_s * 1e9))


def grid(count: int, rate_hz: Fraction, start_ns: int) -> Nanoseconds:
    """Time stamps (count,) of an exact rate, each rounded on its own so that nothing adds up."""
    if rate_hz.numerator * count < 1 << 53:
        whole, rest = divmod(np.arange(count, dtype=np.int64) * rate_hz.denominator, rate_hz.numerator)
        fraction_ns = np.rint(rest * (1e9 / rate_hz.numerator)).astype(np.int64)
        return np.asarray(np.int64(start_ns) + whole * NANOSECONDS + fraction_ns, dtype=np.int64)
    return even_ns(start_ns, count, float(rate_hz))


def luma(image: NDArray[np.generic], reversed_colours: bool) -> NDArray[np.generic]:
    """Luma (rows, columns) of an image (rows, columns[, 1, 3 or 4]): uint8, uint16 or float32, contiguous.

    Colour is weighted as in ITU-R BT.601; `reversed_colours` says that blue comes first.
    """
    if image.ndim == 3 and image.shape[2] in (1, 2):
        image = image[:, :, 0]
    elif image.ndim == 3:
        weights = np.array([0.299, 0.587, 0.114], dtype=np.float32)
        colours = image[:, :, 2::-1] if reversed_colours else image[:, :, :3]
        mixed = colours.astype(np.float32) @ weights
        image = np.rint(mixed).astype(image.dtype) if image.dtype.kind in "iu" else mixed
    if image.dtype not in (np.uint8, np.uint16, np.float32):
        # What single precision cannot hold is no picture's value: it becomes infinite, a pixel without one.
        with np.errstate(over="ignore"):
            image = image.astype(np.uint8 if image.dtype in (np.bool_, np.int8) else np.float32)
    return np.ascontiguousarray(image)


def named(items: Sequence[object]) -> str:
    """The first of some frames or pixels, and how many more there are."""
    more = f" and {len(items) - MAX_NAMED} more" if len(items) > MAX_NAMED else ""
    return ", ".join(map(str, items[:MAX_NAMED])) + more


def passed_over(frames: set[int]) -> list[str]:
    """A sentence on frames of which too much was missing; none where there are none."""
    if not frames:
        return []
    share = f"{100 * MAX_MISSING:g} %"
    return [
        f"{len(frames)} frames ({named(sorted(frames))}) have more than {share} of their values missing (NaN) and "
        "were skipped"
    ]


def require_increasing(name: str, time_ns: Nanoseconds) -> Nanoseconds:
    """The stamps (n,) of rows or frames, where each is a time and later than the one before; DataError else."""
    wrong = np.flatnonzero((time_ns[1:] <= time_ns[:-1]) | (time_ns[1:] == NOT_A_TIME))
    if wrong.size or time_ns[0] == NOT_A_TIME:
        row = int(wrong[0]) + 2 if wrong.size else 1
        raise DataError(
            f"{name} must increase from row to row (s); row {row} does not. Correct the file; if frames are stamped "
            "at arrival and can overtake each other, give rate_hz and start_s instead."
        )
    return time_ns
