"""What every source of radar data offers, whatever it reads from."""

from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from midspan.checks import TIME_S
from midspan.errors import DataError
from midspan.radar.chirp import RadarInfo
from midspan.radar.interference import Interference, floor_of, probed_bins
from midspan.records import Floats, Nanoseconds, RangeFrames, nanoseconds
from midspan.sources.boundary import reading

Item = TypeVar("Item")
# No receiver counts as far; the squares of what is below, and their sums, stay finite in single precision.
MAX_PHASOR = 1e15


@dataclass(frozen=True, slots=True)
class RadarRequest:
    """How to read: `config` the radar's settings (.cfg or .json), `iq_order` auto or one of four, `start_s` the time of
    the first frame (s); rate_hz, carrier_hz: of slow-time I/Q where neither file nor config says them.
    """

    config: Path | None = None
    iq_order: str = "auto"
    start_s: float = 0.0
    rate_hz: float | None = None
    carrier_hz: float | None = None


class RadarSource(ABC):
    """Frames in the order of time, in blocks; never a whole recording in memory.

    A subclass reads in `_phasors`, or in `_profiles`; damage that shows there is one DataError, see `reading`.
    """

    # What messages call the file.
    file_kind: str
    # Frames that are read together.
    at_a_time = 512

    def __init__(self, path: Path, request: RadarRequest) -> None:
        self._path, self._request = path, request

    @property
    @abstractmethod
    def info(self) -> RadarInfo:
        """What is known by now; notes can be added while frames are read."""

    @abstractmethod
    def times_ns(self) -> Nanoseconds:
        """Time stamps (frames,) in ns of the radar's clock, of the middle of each frame's chirps."""

    def profiles(self, start: int = 0, stop: int | None = None) -> Iterator[RangeFrames]:
        """Whole range profiles of the frames start … stop-1, for calibration and inspection.

        Frames with interference are not valid, here and in `slow_time`.
        """
        probed = probed_bins(self.info.bins).astype(np.int64)
        return without_interference(self.guarded(self._profiles(start, stop)), probed, keep=True)

    def slow_time(self, bins: Floats, start: int = 0, stop: int | None = None) -> Iterator[RangeFrames]:
        """The phasors at the bins (k,), whole or between two, of the frames start … stop-1: what a replay runs on."""
        probed = probed_bins(self.info.bins)
        wanted = np.concatenate((np.asarray(bins, dtype=np.float64), probed))
        places = len(wanted) - len(probed) + np.arange(len(probed))
        return without_interference(self.guarded(self._slow_time(wanted, start, stop)), places, keep=False)

    def guarded(self, items: Iterator[Item]) -> Iterator[Item]:
        """The items as they are read; what a library raises on damage becomes a DataError."""
        with reading(self._path, self.file_kind):
            yield from items

    def _phasors(self, first: int, last: int) -> NDArray[np.complexfloating]:
        """Phasors (frames, channels, bins) of the frames first … last-1; what cannot be one is a missing one."""
        raise NotImplementedError

    def _profiles(self, start: int, stop: int | None) -> Iterator[RangeFrames]:
        times = self.times_ns()
        begin, end, _ = slice(start, stop).indices(len(times))
        for first in range(begin, end, self.at_a_time):
            last = min(first + self.at_a_time, end)
            # What does not fit into single precision is a frame that is missing.
            with np.errstate(invalid="ignore", over="ignore"):
                z = np.asarray(self._phasors(first, last), dtype=np.complex64)
            z = np.where(np.abs(z) < MAX_PHASOR, z, np.complex64(np.nan))
            yield RangeFrames(times[first:last], z, np.asarray(np.isfinite(z).all(axis=2)))

    def _slow_time(self, bins: Floats, start: int, stop: int | None) -> Iterator[RangeFrames]:
        for block in self._profiles(start, stop):
            yield RangeFrames(block.time_ns, at_bins(block.phasors, bins), block.valid)


class Restamped(RadarSource):
    """Another source with the steps of its clock taken out of the stamps."""

    def __init__(self, source: RadarSource, time_ns: Nanoseconds) -> None:
        super().__init__(source._path, source._request)
        self._source, self._time_ns, self.file_kind = source, time_ns, source.file_kind

    @property
    def info(self) -> RadarInfo:
        """As of the source."""
        return self._source.info

    def times_ns(self) -> Nanoseconds:
        """The stamps (frames,) as they are corrected."""
        return self._time_ns

    def _profiles(self, start: int, stop: int | None) -> Iterator[RangeFrames]:
        return self._stamped(self._source._profiles(start, stop), start)

    def _slow_time(self, bins: Floats, start: int, stop: int | None) -> Iterator[RangeFrames]:
        return self._stamped(self._source._slow_time(bins, start, stop), start)

    def _stamped(self, blocks: Iterator[RangeFrames], start: int) -> Iterator[RangeFrames]:
        done = slice(start, None).indices(len(self._time_ns))[0]
        for block in blocks:
            yield replace(block, time_ns=self._time_ns[done : done + len(block.time_ns)])
            done += len(block.time_ns)


def without_interference(
    blocks: Iterator[RangeFrames], probed: NDArray[np.int64], *, keep: bool
) -> Iterator[RangeFrames]:
    """The blocks with frames not valid that hold interference; probed (k,): places of the bins that tell it."""
    interference = Interference()
    for block in blocks:
        valid = block.valid
        if len(probed):
            found = interference.found(floor_of(block.phasors[..., probed], valid))
            valid = valid & ~found[:, None] if found.any() else valid
        phasors = block.phasors if keep or not len(probed) else block.phasors[..., : -len(probed)]
        yield RangeFrames(block.time_ns, phasors, valid)


def stamps(path: Path, times_s: Floats, start_s: float) -> Nanoseconds:
    """Times (n,) of frames in s, `start_s` added, as stamps; DataError where they are no increasing times."""
    shifted = times_s + start_s
    ends = shifted[[0, -1]] if len(shifted) else shifted
    if not all(float(end) in TIME_S for end in ends) or not np.all(np.isfinite(shifted)):
        raise DataError(f"{path}: the frames' times must be {TIME_S}; received {ends.tolist()}. Check times and rate.")
    time_ns = nanoseconds(shifted)
    if np.any(np.diff(time_ns) <= 0):
        raise DataError(f"{path}: the frames' times must increase by 1 ns or more. Check times and rate.")
    return time_ns


def at_bins(phasors: NDArray[np.complex64], bins: Floats) -> NDArray[np.complex64]:
    """Phasors (n, channels, k) at the bins (k,) of profiles (n, channels, bins), linearly between two."""
    places = np.clip(np.asarray(bins, dtype=np.float64), 0.0, phasors.shape[2] - 1.0)
    low = np.minimum(np.floor(places).astype(np.int64), max(phasors.shape[2] - 2, 0))
    high = np.minimum(low + 1, phasors.shape[2] - 1)
    share = (places - low).astype(np.float32)
    return np.asarray((1.0 - share) * phasors[..., low] + share * phasors[..., high], dtype=np.complex64)
