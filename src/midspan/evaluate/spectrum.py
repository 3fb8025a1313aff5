"""Natural frequencies of a displacement, with damping and their standard deviations.

Around each peak the periodogram is that of an oscillator with white force, on what noise and higher modes (B) and the
flanks of lower ones (C) make:

    S(f) = A / ((f₀² − f²)² + (2 ζ f₀ f)²) + B + C (f₀ / f)⁴

Its ordinates are independent and exponentially distributed (P. Whittle, Estimation and information in stationary time
series, Ark. Mat. 2 (1953) 423-434, doi 10.1007/BF02590998), so that the likelihood of these is known; its
curvature gives the standard deviations. Damping by the width of a smoothed spectrum would be that of the window.
"""

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from midspan.checks import positive
from midspan.errors import DataError
from midspan.records import NANOSECONDS, Floats, TimeSeries

# A peak stands out of the median about it by what chance makes in one of a million records.
CHANCE = 1e-6
# The spectrum that peaks are looked for in has segments of this length, s, or an eighth of the record: at least eight
# are averaged. The level about a peak is the median over 40 widths that they resolve, of which a mode fills a quarter.
SEGMENT_S, SEGMENTS, AROUND = 60.0, 8, 40
# An oscillator is compared over twelve widths of its peak on each side, where it is below a hundredth of its peak, and
# over five ordinates for each of its five parameters.
WIDTHS, MIN_ORDINATES = 12.0, 25
# What is outside these damping ratios is a tone or no peak.
MIN_DAMPING, MAX_DAMPING = 1e-4, 0.2
# Peaks closer than the main lobe of the segments' window, four widths, or than six half widths of a mode, where it
# is at a thirtieth of its peak, are one. What is farther away than a tenth of the frequency is another mode.
LOBE_WIDTHS, OWN_HALF_WIDTHS, OTHER_SHARE = 4.0, 6.0, 0.1
# Of the rate: 2.5 samples a period.
MAX_SHARE = 0.4


@dataclass(frozen=True, slots=True)
class Mode:
    """A natural frequency, Hz, its damping ratio, and their standard deviations; rms_mm: of the displacement in it.

    damping, damping_std: NaN where the peak is no oscillator's under white force: a tone, as of a machine or of people
    in step, or several modes close together; its frequency is known to the record's resolution then.
    """

    frequency_hz: float
    frequency_std_hz: float
    damping: float
    damping_std: float
    rms_mm: float


@dataclass(frozen=True, slots=True, eq=False)
class Spectrum:
    """One-sided power spectral density (k,), mm²/Hz, of a displacement at frequency_hz (k,), by Welch's method with
    segments of segment_s; modes: by frequency.
    """

    frequency_hz: Floats
    density_mm2_hz: Floats
    segment_s: float
    modes: tuple[Mode, ...]

    def to_dict(self) -> dict[str, Any]:
        """The modes as plain values."""
        modes = [{k: v if np.isfinite(v) else None for k, v in asdict(mode).items()} for mode in self.modes]
        return {"segment_s": self.segment_s, "modes": modes}


def spectrum(series: TimeSeries, *, max_modes: int = 6) -> Spectrum:
    """The spectrum of a displacement and its first natural frequencies.

    series: displacement in m at even times; what is not finite is bridged by straight lines. max_modes: as many of the
    strongest peaks are fitted at most. Raises DataError for a record that is too short for a spectrum.
    """
    positive("max_modes", max_modes, "")
    rate_hz, value = _even(series)
    segment = int(min(SEGMENT_S * rate_hz, len(value) / SEGMENTS))
    if segment < 2 * MIN_ORDINATES:
        raise DataError(
            f"A spectrum needs {SEGMENTS} segments of {2 * MIN_ORDINATES} rows or more; the displacement has "
            f"{len(value)} rows. Give a longer record."
        )
    frequency, density = welch(1e3 * value, rate_hz, segment)
    width_hz = rate_hz / segment
    peaks = frequency[_peaks(frequency, density, (2 * len(value)) // segment - 1, rate_hz)]
    # The whole record, tapered over a twentieth at each end.
    edge = 0.05 * (len(value) - 1)
    near = np.minimum(np.arange(len(value)), np.arange(len(value))[::-1]) / edge
    ordinates = _density(1e3 * value, rate_hz, 0.5 - 0.5 * np.cos(np.pi * np.minimum(near, 1.0)), overlap=0)
    modes: list[Mode] = []
    for peak_hz in peaks.tolist():
        # Chance splits a peak: what lies in one that is fitted is no other.
        apart_hz = [np.fmax(LOBE_WIDTHS * width_hz, OWN_HALF_WIDTHS * one.damping * one.frequency_hz) for one in modes]
        if any(abs(peak_hz - one.frequency_hz) < apart for one, apart in zip(modes, apart_hz, strict=True)):
            continue
        others = np.sort(peaks[np.abs(peaks - peak_hz) > max(LOBE_WIDTHS * width_hz, OTHER_SHARE * peak_hz)])
        modes.append(_fitted(*ordinates, peak_hz, others, width_hz) or _tone(*ordinates, peak_hz, width_hz))
        if len(modes) == max_modes:
            break
    return Spectrum(frequency, density, segment / rate_hz, tuple(sorted(modes, key=lambda one: one.frequency_hz)))


def _even(series: TimeSeries) -> tuple[float, Floats]:
    """Rate (Hz) and values at even times, m."""
    if len(series.time_ns) < 2:
        raise DataError("The displacement has fewer than two rows. Give a longer record.")
    step_ns = float(np.median(np.diff(series.time_ns)))
    known = np.isfinite(series.value)
    if not known.any():
        raise DataError("The displacement has no numeric value. Check its column.")
    at_ns = np.arange(series.time_ns[0], series.time_ns[-1] + 1, step_ns)
    return NANOSECONDS / step_ns, np.interp(at_ns, series.time_ns[known], series.value[known])


def welch(value: Floats, rate_hz: float, segment: int) -> tuple[Floats, Floats]:
    """Frequencies (k,), Hz, and one-sided density (k,) by Welch's method: Hann windows of `segment` values (n,), half
    overlapping.
    """
    return _density(value, rate_hz, hann(segment), segment // 2)


def hann(count: int) -> Floats:
    """Hann's window (n,) of one period."""
    return np.hanning(count + 1)[:-1]


def _density(value: Floats, rate_hz: float, window: Floats, overlap: int) -> tuple[Floats, Floats]:
    # SciPy's own would bring scipy.stats with it, which takes a second to import.
    from matplotlib import mlab

    density, frequency = mlab.psd(value, len(window), rate_hz, "linear", window, overlap)
    return np.asarray(frequency, dtype=np.float64), np.asarray(density, dtype=np.float64)


def _peaks(frequency: Floats, density: Floats, averaged: int, rate_hz: float) -> list[int]:
    """Places of the peaks that chance does not make, the one that stands out most first.

    averaged: how many segments, of which half overlap, the density is the mean of.
    """
    from scipy.ndimage import median_filter
    from scipy.special import chdtri

    # The spectrum of the acceleration is more even, so that a median tells the level about a peak.
    even = density * frequency**4
    level = median_filter(even, AROUND | 1)
    freedom = 2.0 * max(averaged / 2.0, 1.0)
    beyond = chdtri(freedom, CHANCE / len(even)) / chdtri(freedom, 0.5)
    near = 1 + np.flatnonzero((even[1:-1] > even[:-2]) & (even[1:-1] > even[2:]))
    usable = near[(even[near] > beyond * level[near]) & (frequency[near] < MAX_SHARE * rate_hz) & (near > 1)]
    order = np.argsort(-(even[usable] / level[usable]))
    return [int(k) for k in usable[order]]


def _tone(frequency: Floats, power: Floats, peak_hz: float, width_hz: float) -> Mode:
    """A peak that is no oscillator's: its centre and what lies in it. width_hz: resolved by the segments."""
    near = np.abs(frequency - peak_hz) < 0.5 * LOBE_WIDTHS * width_hz
    step, inside = float(frequency[1] - frequency[0]), float(np.sum(power[near]))
    centre = float(np.sum(power[near] * frequency[near])) / inside
    return Mode(centre, step, np.nan, np.nan, float(np.sqrt(inside * step)))


def _fitted(frequency: Floats, power: Floats, peak_hz: float, others: Floats, width_hz: float) -> Mode | None:
    """The oscillator at a peak; None where there is none. others: the peaks of others, Hz; width_hz: resolved."""
    from scipy.optimize import minimize

    step = float(frequency[1] - frequency[0])
    half = max(WIDTHS * max(width_hz, 0.02 * peak_hz), MIN_ORDINATES * step)
    below, above = others[others < peak_hz], others[others > peak_hz]
    low = max(peak_hz - half, 0.5 * (below[-1] + peak_hz) if len(below) else step)
    high = min(peak_hz + half, 0.5 * (above[0] + peak_hz) if len(above) else np.inf)
    near = (frequency > low) & (frequency < high)
    f, p = frequency[near], power[near]
    if len(f) < MIN_ORDINATES:
        return None
    top = float(np.max(p))

    def expected(q: Floats) -> Floats:
        f0, zeta = peak_hz * np.exp(q[0]), np.exp(q[1])
        at_peak = (2.0 * zeta * f0 * f0) ** 2
        mode = np.exp(q[2]) * at_peak / ((f0**2 - f**2) ** 2 + (2.0 * zeta * f0 * f) ** 2)
        return np.asarray(mode + np.exp(q[3]) + np.exp(q[4]) * (peak_hz / f) ** 4)

    def surprise(q: Floats) -> float:
        with np.errstate(all="ignore"):
            s = expected(q)
            total = float(np.sum(np.log(s) + p / s))
        # The search may come to where the model has no number.
        return total if np.isfinite(total) else np.inf

    level = np.log(max(0.5 * float(np.median(p)), 1e-9 * top))
    start = [np.array([0.0, np.log(zeta), np.log(top / 3.0), level, level]) for zeta in (0.002, 0.01, 0.05)]
    found = min((minimize(surprise, one, method="Nelder-Mead", options=_FINE) for one in start), key=lambda r: r.fun)
    q = np.asarray(found.x)
    zeta, f0 = float(np.exp(q[1])), float(peak_hz * np.exp(q[0]))
    covariance = _covariance(expected, q)
    if covariance is None or not MIN_DAMPING < zeta < MAX_DAMPING or not low < f0 < high:
        return None
    std = np.sqrt(np.diag(covariance))
    # ∫ A / (…) df over all f is the variance: π/2 · peak · ζ f₀ for one-sided densities.
    rms = float(np.sqrt(0.5 * np.pi * np.exp(q[2]) * 2.0 * zeta * f0))
    return Mode(f0, f0 * float(std[0]), zeta, zeta * float(std[1]), rms)


RIDGE = 1e-6
_FINE = {"xatol": 1e-6, "fatol": 1e-6, "maxiter": 4000, "maxfev": 4000}


def _covariance(expected: Any, q: Floats) -> Floats | None:
    """Inverse of the information Σ (∂ ln S)(∂ ln S)' of independent exponential ordinates; None where it has none."""
    steps = 1e-4
    units = steps * np.eye(len(q))
    slopes = np.array([(np.log(expected(q + one)) - np.log(expected(q - one))) / (2.0 * steps) for one in units])
    # A level that does not show is no reason to know the rest less.
    found = np.linalg.inv(slopes @ slopes.T + RIDGE * np.eye(len(q)))
    return found if np.all(np.diag(found) > 0.0) else None
