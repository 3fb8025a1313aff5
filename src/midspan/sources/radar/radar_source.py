"""What every source of radar data offers, whatever it reads from."""

from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from midspan.radar.chirp import SPEED_OF_LIGHT_M_S, ChirpProfile, RangeAxis
from midspan.records import Floats, Nanoseconds, RangeFrames


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


@dataclass(frozen=True, slots=True)
class RadarInfo:
    """What is known of a source of radar frames.

    carrier_hz: what the phase moves with; frame_count None where it is not known; channels: transmitters times
    receivers; range_m (bins,): of each bin, NaN where the file does not say; missing_frames: with a hole in one
    channel or all; profile: the chirp where there is one; notes, warnings: sentences.
    """

    kind: str
    carrier_hz: float
    frame_rate_hz: float
    frame_count: int | None
    channels: int
    range_m: Floats
    iq_order: str = ""
    profile: ChirpProfile | None = None
    missing_frames: int = 0
    notes: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()

    @property
    def bins(self) -> int:
        """Number of range bins."""
        return len(self.range_m)

    @property
    def axis(self) -> RangeAxis:
        """Ranges and carrier, as the radar's functions take them."""
        return RangeAxis(self.range_m, self.carrier_hz, self.profile.slope_hz_s if self.profile else 0.0)

    @property
    def cycle_m(self) -> float:
        """Change of range that turns the phase once: half a wavelength, m."""
        return SPEED_OF_LIGHT_M_S / (2.0 * self.carrier_hz)

    @property
    def limit_speed_m_s(self) -> float:
        """Line-of-sight speed from which plain unwrapping fails, m/s."""
        return 0.5 * self.cycle_m * self.frame_rate_hz


class RadarSource(ABC):
    """Frames in the order of time, in blocks; never a whole recording in memory."""

    @property
    @abstractmethod
    def info(self) -> RadarInfo:
        """What is known by now; notes can be added while frames are read."""

    @abstractmethod
    def times_ns(self) -> Nanoseconds:
        """Time stamps (frames,) in ns of the radar's clock, of the middle of each frame's chirps."""

    @abstractmethod
    def profiles(self, start: int = 0, stop: int | None = None) -> Iterator[RangeFrames]:
        """Whole range profiles of the frames start … stop-1, for calibration and inspection."""

    @abstractmethod
    def slow_time(self, bins: Floats, start: int = 0, stop: int | None = None) -> Iterator[RangeFrames]:
        """The phasors at the bins (k,), whole or between two, of the frames start … stop-1: what a replay runs on."""


def at_bins(phasors: NDArray[np.complex64], bins: Floats) -> NDArray[np.complex64]:
    """Phasors (n, channels, k) at the bins (k,) of profiles (n, channels, bins), linearly between two."""
    places = np.clip(np.asarray(bins, dtype=np.float64), 0.0, phasors.shape[2] - 1.0)
    low = np.minimum(np.floor(places).astype(np.int64), max(phasors.shape[2] - 2, 0))
    high = np.minimum(low + 1, phasors.shape[2] - 1)
    share = (places - low).astype(np.float32)
    return np.asarray((1.0 - share) * phasors[..., low] + share * phasors[..., high], dtype=np.complex64)
