"""Time stamps of frames: a file of times, the source's own stamps, or a rate."""

from fractions import Fraction
from pathlib import Path

import numpy as np

from midspan.errors import DataError, UsageError
from midspan.records import Nanoseconds
from midspan.sources.accelerometer.clock import NOT_A_TIME, numbers_to_ns
from midspan.sources.accelerometer.formats import list_channels
from midspan.sources.camera.frames import FrameRequest


def check_request(path: Path, request: FrameRequest) -> None:
    """Raise UsageError for a rate, start or step outside its range."""
    if not isinstance(request.every, int) or request.every < 1:
        raise UsageError(f"every must be 1 or more (use every n-th frame); received {request.every!r} for {path}.")
    known = request.rate_hz is None or isinstance(request.rate_hz, int | float | np.number)
    if not known or (request.rate_hz is not None and not (np.isfinite(request.rate_hz) and request.rate_hz > 0)):
        raise UsageError(f"rate_hz must be above zero (Hz); received {request.rate_hz!r} for {path}.")
    if not np.isfinite(request.start_s):
        raise UsageError(f"start_s must be a finite time in s; received {request.start_s!r} for {path}.")


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
    wrong = np.flatnonzero((time_ns[1:] <= time_ns[:-1]) | (time_ns[1:] == NOT_A_TIME))
    if wrong.size or time_ns[0] == NOT_A_TIME:
        row = int(wrong[0]) + 2 if wrong.size else 1
        raise DataError(f"{times}: times must increase from row to row (s); row {row} does not. Correct the file.")
    return time_ns


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
        return np.asarray(np.int64(start_ns) + whole * 1_000_000_000 + fraction_ns, dtype=np.int64)
    steps = np.rint(np.arange(count) * (1e9 / float(rate_hz))).astype(np.int64)
    return np.asarray(np.int64(start_ns) + steps, dtype=np.int64)
