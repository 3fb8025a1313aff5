"""The chirp settings of a radar and everything that follows from them: carrier, ranges, rates, limit speed."""

import json
from dataclasses import asdict, dataclass

import numpy as np

from midspan.checks import positive, refuse
from midspan.notices import Notice
from midspan.records import Floats

SPEED_OF_LIGHT_M_S = 299_792_458.0


@dataclass(frozen=True, slots=True)
class ChirpProfile:
    """One frame of a linear chirp radar. The reference of range and phase is the centre of the sampled window.

    start_frequency_hz: at the start of the ramp; slope_hz_s: its rise, Hz/s; sample_rate_hz, samples: of the ADC;
    adc_start_s: from the start of the ramp to the first sample; receivers: channels stored; transmitters: the mask of
    antennas that send, one for each chirp of a frame; chirp_period_s: from chirp to chirp; frame_period_s: from frame
    to frame; bits: of the ADC (12, 14 or 16); complex_samples: I and Q, else I alone.
    """

    start_frequency_hz: float
    slope_hz_s: float
    sample_rate_hz: float
    samples: int
    frame_period_s: float
    adc_start_s: float = 6e-6
    receivers: int = 4
    transmitters: tuple[int, ...] = (1,)
    chirp_period_s: float = 1e-4
    bits: int = 16
    complex_samples: bool = True

    def __post_init__(self) -> None:
        positive("start_frequency_hz", self.start_frequency_hz, "Hz")
        positive("slope_hz_s", self.slope_hz_s, "Hz/s")
        positive("sample_rate_hz", self.sample_rate_hz, "Hz")
        positive("frame_period_s", self.frame_period_s, "s")
        if self.samples < 8:
            raise refuse("samples", "8 or more samples a chirp", self.samples)
        if self.receivers < 1 or not self.transmitters:
            raise refuse("receivers and chirps", "one or more", (self.receivers, len(self.transmitters)))
        if self.bits not in (12, 14, 16):
            raise refuse("bits", "12, 14 or 16", self.bits)

    @property
    def chirps(self) -> int:
        """Chirps in one frame."""
        return len(self.transmitters)

    @property
    def frame_rate_hz(self) -> float:
        """Frames in a second."""
        return 1.0 / self.frame_period_s

    @property
    def bandwidth_hz(self) -> float:
        """Sweep that is sampled, Hz."""
        return self.slope_hz_s * self.samples / self.sample_rate_hz

    @property
    def bins(self) -> int:
        """Range bins of a profile: all of them for complex samples, half of them for real ones."""
        return self.samples if self.complex_samples else self.samples // 2

    @property
    def bin_m(self) -> float:
        """Range from bin to bin, m."""
        return SPEED_OF_LIGHT_M_S / (2.0 * self.bandwidth_hz)

    @property
    def carrier_hz(self) -> float:
        """Frequency at the centre of the sampled window: what the phase of a range bin moves with, Hz.

        The start frequency of the ramp, which is often taken instead, is 2 % lower for a chirp of 2.8 GHz at 77 GHz.
        """
        return self.start_frequency_hz + self.slope_hz_s * self.centre_s

    @property
    def centre_s(self) -> float:
        """From the start of the ramp to the centre of the sampled window, s."""
        return self.adc_start_s + (self.samples - 1) / (2.0 * self.sample_rate_hz)

    @property
    def middle_s(self) -> float:
        """From the start of the frame to the middle of all its chirps, s."""
        return self.centre_s + 0.5 * (self.chirps - 1) * self.chirp_period_s

    def phase_per_m(self, range_m: float = 0.0) -> float:
        """Phase in rad that one metre more of range adds, for a target at `range_m`."""
        return self.axis.phase_per_m(range_m)

    @property
    def axis(self) -> "RangeAxis":
        """The ranges of the bins and what the phase of each moves with."""
        return RangeAxis(np.arange(self.bins, dtype=np.float64) * self.bin_m, self.carrier_hz, self.slope_hz_s)

    @property
    def limit_speed_m_s(self) -> float:
        """Line-of-sight speed from which plain unwrapping fails: a quarter of a wavelength a frame, m/s."""
        return 0.5 * self.axis.cycle_m * self.frame_rate_hz


@dataclass(frozen=True, slots=True)
class RangeAxis:
    """Ranges of the bins (bins,) in m, NaN where not known, the carrier (Hz) and the slope of the chirp (Hz/s).

    The slope is 0 for radars without a chirp.
    """

    range_m: Floats
    carrier_hz: float
    slope_hz_s: float = 0.0

    @property
    def cycle_m(self) -> float:
        """Change of range that turns the phase once: half a wavelength, m."""
        return SPEED_OF_LIGHT_M_S / (2.0 * self.carrier_hz)

    def range_at(self, place_bin: float) -> float:
        """Range in m at a fractional bin."""
        return float(np.interp(place_bin, np.arange(len(self.range_m)), self.range_m))

    def phase_per_m(self, range_m: float = 0.0) -> float:
        """Phase in rad that one metre more of range adds, for a target at `range_m` (not known: NaN).

        The echo is late on the ramp by its delay: slope · delay is 7e-5 of the carrier at 12 m with 65 MHz/µs.
        """
        delay = 2.0 * range_m / SPEED_OF_LIGHT_M_S if np.isfinite(range_m) else 0.0
        return float(4.0 * np.pi * (self.carrier_hz - self.slope_hz_s * delay) / SPEED_OF_LIGHT_M_S)


def profile_to_json(profile: ChirpProfile) -> str:
    """The fields of a chirp's settings as JSON, as `profile_from_json` reads them."""
    return json.dumps(asdict(profile))


def profile_from_json(text: str) -> ChirpProfile:
    """The chirp's settings of their fields as JSON. Raises UsageError, TypeError and ValueError for others."""
    fields = json.loads(text)
    return ChirpProfile(**{**fields, "transmitters": tuple(fields["transmitters"])})


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
    def limit_speed_m_s(self) -> float:
        """Line-of-sight speed from which plain unwrapping fails, m/s."""
        return 0.5 * self.axis.cycle_m * self.frame_rate_hz
