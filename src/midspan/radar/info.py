"""What is known of a radar: carrier, rate, channels, ranges of its bins, chirp."""

from dataclasses import dataclass

from midspan.notices import Notice
from midspan.radar.chirp import SPEED_OF_LIGHT_M_S, ChirpProfile, RangeAxis
from midspan.records import Floats


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
    warnings: tuple[Notice, ...] = ()

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
