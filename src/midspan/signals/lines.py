"""Narrow lines of an acceleration that are no motion, such as an aliased machine, taken out of a record.

A line is what a narrow band of the record holds. It is taken out by its spectrum, without any delay, so that motion at
other frequencies stays as it was. Near the ends of the record the band does not resolve the line.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from midspan.records import NANOSECONDS, Floats, Nanoseconds, seconds

# Share of a band on either side over which it fades out: a sharp edge would ring for the length of the record.
FADING = 0.2
# A filter of a constant-acceleration model with white noise of density S has a variance of S over this times the cube
# of its corner frequency (rad/s).
VARIANCE_SHARE = 2.0 * np.sqrt(2.0)


@dataclass(frozen=True, slots=True)
class Line:
    """A line between low_hz and high_hz, of std_m_s2 (rms).

    taken_out: whether it is taken out of the acceleration; else the structure moves in its band too, and it is noise.
    """

    low_hz: float
    high_hz: float
    std_m_s2: float
    taken_out: bool = True

    @property
    def middle_hz(self) -> float:
        """The middle of its band."""
        return 0.5 * (self.low_hz + self.high_hz)

    @property
    def density(self) -> float:
        """Density of white noise, (m/s²)²/Hz, whose error of the displacement is no less than the line's.

        Of a line of variance A² at ω a filter of corner frequency ω_c errs by A²/max(ω, ω_c)⁴, of white noise S by
        S/(2√2 ω_c³): S = 2√2 A²/ω is enough for any corner.
        """
        return float(VARIANCE_SHARE * self.std_m_s2**2 / (2.0 * np.pi * self.middle_hz))

    @property
    def width_hz(self) -> float:
        """The width of its band."""
        return self.high_hz - self.low_hz

    @property
    def unresolved_s(self) -> float:
        """How long after its start, and before its end, a record does not tell what is the line, s."""
        return 1.0 / self.width_hz

    def near(self, hertz: Floats) -> NDArray[np.bool_]:
        """Which frequencies (k,) lie in its band, or no farther from it than that is wide."""
        return np.asarray((hertz > self.low_hz - self.width_hz) & (hertz < self.high_hz + self.width_hz))


def unresolved(time_ns: Nanoseconds, lines: Sequence[Line]) -> tuple[tuple[int, int, float], ...]:
    """First and last stamp (ns) of each end of a record (n,) in which a line is not resolved, and its density."""
    found = []
    for line in (line for line in lines if line.taken_out):
        length_ns, begin, end = round(line.unresolved_s * NANOSECONDS), int(time_ns[0]), int(time_ns[-1])
        found += [(begin, begin + length_ns, line.density), (end - length_ns, end, line.density)]
    return tuple(found)


def without_lines(time_ns: Nanoseconds, value: Floats, lines: Sequence[Line]) -> Floats:
    """Acceleration (n,) at times (n,) without the content of the lines' bands; NaN stays NaN."""
    known, lines = np.isfinite(value), [line for line in lines if line.taken_out]
    if not lines or np.count_nonzero(known) < 2:
        return value
    time_s = seconds(time_ns, int(time_ns[0]))
    step_s = float(np.median(np.diff(time_ns))) / NANOSECONDS
    even_s = np.arange(0.0, time_s[-1] + step_s, step_s)
    even = np.interp(even_s, time_s[known], value[known])
    # Mirrored ends: what differs between the ends would leak into all bands.
    spectrum = np.fft.rfft(np.r_[even, even[::-1]])
    hertz = np.asarray(np.fft.rfftfreq(2 * len(even), step_s), dtype=np.float64)
    share = np.max([_share(hertz, line) for line in lines], axis=0)
    content = np.fft.irfft(share * spectrum, 2 * len(even))[: len(even)]
    return np.asarray(value - np.interp(time_s, even_s, content))


def away_from_lines(hertz: Floats, lines: Sequence[Line]) -> NDArray[np.bool_]:
    """Which frequencies (k,) are not near any line."""
    return np.asarray(~np.any([line.near(hertz) for line in lines], axis=0)) if lines else np.ones(len(hertz), bool)


def _share(hertz: Floats, line: Line) -> Floats:
    """The share (k,) of each frequency that is taken out: 1 inside the band, falling to 0 on either side."""
    fading = FADING * line.width_hz
    distance = np.maximum(line.low_hz - hertz, hertz - line.high_hz)
    return np.asarray(0.5 + 0.5 * np.cos(np.pi * np.clip(distance / fading, 0.0, 1.0)))
