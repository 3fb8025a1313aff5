"""How the accelerometer's motion shows in the wrapped phase: ratio and clock offset, without unwrapping anything.

The second difference of the phase over a lag holds no displacement and no velocity, only the acceleration of that
time. Over one frame it hardly ever wraps; each longer lag sharpens the ratio so much that the next one can be met too.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from midspan.checks import positive
from midspan.radar.unwrap import wrapped
from midspan.records import Floats

# A correlation of the first search is accepted from this many standard deviations on; some hundred offsets are tried.
MIN_SIGNIFICANCE = 6.0
# The longest lag, s: beyond it the drift of the accelerometer and the wrapping of what it does not explain take over.
MAX_LAG_S = 0.25
# Of the ratio that is known beforehand, the share by which the found one may differ.
PRIOR_SHARE = 0.6
# Lags of the first search, frames, and the fewest second differences that it needs.
SEARCHED_LAGS, MIN_FRAMES = (1, 4, 16), 20
# Frames of the search of a motion so strong that its differences wrap, at most; it tries a grid of ratios too.
MAX_SEARCHED = 4096
# The scatter of the result is that of sums over segments of this many lags, of which there must be a few; from so few
# it comes out a little small.
SEGMENT_LAGS, MIN_SEGMENTS, MARGIN = 8, 10, 1.08
# The accelerometer's noise is what its quieter frequencies hold: this percentile of its spectrum, from records of so
# many samples on. The correction for it is trusted to this share.
QUIET_PERCENTILE, SPECTRUM_SAMPLES, CORRECTION_SHARE = 30.0, 256, 0.3


@dataclass(frozen=True, slots=True)
class Alignment:
    """ratio: range change per displacement (the inverse conversion factor, signed), with its standard deviation.

    offset_s: to be added to the radar's clock to get the accelerometer's, with its standard deviation, s.
    """

    ratio: float
    ratio_std: float
    offset_s: float
    offset_std_s: float


@dataclass(frozen=True, slots=True)
class Integrals:
    """The first and second integral of the acceleration without its mean, as splines."""

    velocity: object
    place: object
    span: tuple[float, float]
    noise_density: float

    @classmethod
    def of(cls, samples: Floats) -> "Integrals":
        """From samples (m, 2) of time (s) and acceleration (m/s²)."""
        from scipy.interpolate import CubicSpline

        spline = CubicSpline(samples[:, 0], samples[:, 1] - np.mean(samples[:, 1]))
        span = (samples[0, 0], samples[-1, 0])
        return cls(spline.antiderivative(1), spline.antiderivative(2), span, _noise_density(samples))

    def second_difference(self, time_s: Floats, lag_s: float, order: int = 0) -> Floats:
        """Displacement before, minus twice now, plus after, at times (n,); its derivative in time with `order` 1."""
        f = (self.place, self.velocity)[order]
        low, high = self.span

        def at(t: Floats) -> Floats:
            return np.asarray(f(np.clip(t, low, high)))  # type: ignore[operator]

        return at(time_s - lag_s) - 2.0 * at(time_s) + at(time_s + lag_s)

    def displacement(self, time_s: Floats) -> Floats:
        """Displacement at times (n,), m, but for a drift."""
        return np.asarray(self.place(np.clip(time_s, *self.span)))  # type: ignore[operator]

    def noise_variance(self, lag_s: float) -> float:
        """Variance (m²) that white noise of the accelerometer gives a second difference: its weight is a triangle."""
        return self.noise_density * 2.0 * lag_s**3 / 3.0


def _noise_density(samples: Floats) -> float:
    """Two-sided density of the accelerometer's noise, (m/s²)²/Hz; 0 for records too short for a spectrum."""
    if len(samples) < 2 * SPECTRUM_SAMPLES:
        return 0.0
    parts = np.lib.stride_tricks.sliding_window_view(samples[:, 1], SPECTRUM_SAMPLES)[:: SPECTRUM_SAMPLES // 2]
    window = np.sin(np.pi * (np.arange(SPECTRUM_SAMPLES) + 0.5) / SPECTRUM_SAMPLES) ** 2
    spectrum = np.fft.rfft((parts - parts.mean(axis=1, keepdims=True)) * window, axis=1)
    power = np.mean(np.abs(spectrum[:, 1:-1]) ** 2, axis=0) / np.sum(window**2)
    return float(np.percentile(power, QUIET_PERCENTILE) * np.median(np.diff(samples[:, 0])))


def align(
    frame_s: Floats,
    phase_rad: Floats,
    *,
    samples: Floats,
    phase_per_m: float,
    max_offset_s: float = 0.15,
    prior: float | None = None,
) -> Alignment | None:
    """Ratio and clock offset between the wrapped phase and an accelerometer, or None where the motion does not tell.

    frame_s (n,): evenly spaced instants of the frames on the radar's clock, s; phase_rad (n,): wrapped, NaN where there
    is none; samples (m, 2): time on the accelerometer's clock (s) and acceleration (m/s²); phase_per_m: rad per m of
    range; max_offset_s: largest clock offset searched for; prior: the ratio where it is roughly known, with its sign;
    without it the range must not accelerate by more than a quarter of a wavelength a frame² (9.5 m/s² at 100 Hz).
    """
    positive("phase_per_m", phase_per_m, "rad/m")
    integrals = Integrals.of(np.asarray(samples, dtype=np.float64))
    time, phase = np.asarray(frame_s, dtype=np.float64), np.asarray(phase_rad, dtype=np.float64)
    period = float(np.median(np.diff(time)))
    found = _search(time, phase, integrals, (phase_per_m, period, max_offset_s), prior)
    if found is None and prior is not None:
        found = _search_strong(time, phase, integrals, (phase_per_m, period, max_offset_s), prior)
    if found is None:
        return None
    alignment, lag = found
    while lag * period <= MAX_LAG_S:
        sharper = _sharpened(time, phase, integrals, (phase_per_m, period, lag), alignment)
        if sharper is None or abs(sharper.offset_s) > max_offset_s + period:
            break
        alignment, lag = sharper, 2 * lag
    return alignment


def _differences(phase: Floats, lag: int) -> tuple[Floats, NDArray[np.int64]]:
    """Wrapped second differences of the phase over `lag` frames, and the frames (k,) that they belong to."""
    second = wrapped(phase[2 * lag :] - 2.0 * phase[lag:-lag] + phase[: -2 * lag])
    known = np.flatnonzero(np.isfinite(second))
    return second[known], known + lag


def _search(
    time: Floats, phase: Floats, integrals: Integrals, known: tuple[float, float, float], prior: float | None
) -> tuple[Alignment, int] | None:
    """The most significant correlation over clock offsets and a few lags (short: strong motion, long: weak)."""
    found, sharpest = None, MIN_SIGNIFICANCE
    for lag in SEARCHED_LAGS:
        if lag * known[1] > MAX_LAG_S or len(phase) <= 4 * lag:
            break
        second, frame = _differences(phase, lag)
        if len(second) < MIN_FRAMES:
            continue
        offsets = _offsets(known[1], known[2])
        ratio, std = _regressions(second / known[0], frame, (time, known[1], lag), integrals, offsets)
        # Neighbouring second differences share their noise; lags apart they do not.
        std *= np.sqrt(max(1.0, lag / 2.0))
        fits = np.abs(ratio) > sharpest * std
        if prior is not None:
            fits &= np.abs(ratio - prior) <= PRIOR_SHARE * abs(prior) + 3.0 * std
        if fits.any():
            k = int(np.argmax(np.where(fits, np.abs(ratio) / std, 0.0)))
            found, sharpest = (Alignment(ratio[k], std[k], offsets[k], known[1]), lag), abs(ratio[k]) / std[k]
    return found


def _regressions(
    value: Floats,
    frame: NDArray[np.int64],
    known: tuple[Floats, float, int],
    integrals: Integrals,
    offsets: Floats,
) -> tuple[Floats, Floats]:
    """Slope (o,) of values (k,) at frames (k,) on the accelerometer's second differences, for each offset; its std.

    known: instants of all frames (n,), their period (s) and the lag in frames. Frames are evenly spaced and the offsets
    half a frame apart, so that all sums are correlations of whole records, which cost no more for many offsets.
    """
    from scipy.signal import correlate

    time, period, lag = known
    count, some = len(time), len(offsets)
    # Half frames from before the first to after the last, on the stamps as they are.
    place = 0.5 * (np.arange(2 * count + some) - some // 2)
    inside = np.clip(place, 0, count - 1)
    at = np.interp(inside, np.arange(count), time) + period * (place - inside)
    response = integrals.second_difference(at, lag * period)
    response -= response.mean()
    there, seen = np.zeros((2, count))
    there[frame], seen[frame] = 1.0, value - value.mean()
    sums = np.empty((3, some))
    for half in (0, 1):
        x = response[half::2][: count + (some - half + 1) // 2 - 1]
        for row, (left, right) in enumerate(((x, there), (x * x, there), (x, seen))):
            sums[row, half::2] = correlate(left, right, mode="valid", method="fft")
    # Sums by Fourier transform are exact to about this share.
    exact = 1e-12
    least = exact * float(response @ response)
    if not least > 0.0:
        return np.zeros(some), np.full(some, np.inf)
    total, power = float(seen @ seen), np.maximum(sums[1] - sums[0] ** 2 / len(value), least)
    slope = sums[2] / power
    rest = np.maximum(total - slope * sums[2], exact * total)
    return slope, np.sqrt(rest / len(value) / power)


def _search_strong(
    time: Floats, phase: Floats, integrals: Integrals, known: tuple[float, float, float], prior: float
) -> tuple[Alignment, int] | None:
    """The same for second differences that wrap (beyond 9.5 m/s² at 77 GHz, 100 Hz): phasors that are left align."""
    second, frame = _differences(phase, 1)
    if len(second) < MIN_FRAMES:
        return None
    lively = _liveliest(np.abs(integrals.second_difference(time[frame], known[1])), known[2] / known[1])
    second, frame = second[lively], frame[lively]
    turns = np.exp(1j * second)
    found, best = None, float(np.abs(turns.mean())) + MIN_SIGNIFICANCE / np.sqrt(2.0 * len(second))
    ratios = prior * np.linspace(1.0 - PRIOR_SHARE, 1.0 + PRIOR_SHARE, 25)
    for offset in _offsets(known[1], known[2]):
        response = known[0] * integrals.second_difference(time[frame] + offset, known[1])
        for ratio in ratios:
            together = float(np.abs(np.mean(turns * np.exp(-1j * ratio * response))))
            if together > best:
                found, best = (Alignment(float(ratio), abs(prior) / len(ratios), float(offset), known[1]), 1), together
    return found


def _liveliest(size: Floats, reach: float) -> slice | NDArray[np.int64]:
    """The `MAX_SEARCHED` values or so of which segments (longer than the search reaches) have the largest mean."""
    if len(size) <= MAX_SEARCHED:
        return slice(None)
    length = max(int(4.0 * reach), MAX_SEARCHED // 32)
    starts = np.arange(0, len(size), length)
    mean = np.add.reduceat(size, starts) / np.diff(np.append(starts, len(size)))
    best = np.sort(starts[np.argsort(-mean)[: max(1, MAX_SEARCHED // length)]])
    return np.concatenate([np.arange(k, min(k + length, len(size))) for k in best])


def _offsets(period_s: float, most_s: float) -> Floats:
    """Clock offsets that are tried, half a frame apart."""
    count = max(int(np.ceil(2.0 * most_s / period_s)), 1)
    return np.asarray(0.5 * period_s * np.arange(-count, count + 1, dtype=np.float64))


def _sharpened(
    time: Floats, phase: Floats, integrals: Integrals, known: tuple[float, float, int], start: Alignment
) -> Alignment | None:
    """Gauss-Newton on ratio, offset and a constant, the residual wrapped; None where it does not settle."""
    unit, period, lag = known
    if len(phase) <= 4 * lag:
        return None
    second, frame = _differences(phase, lag)
    value = np.array([start.ratio, start.offset_s, 0.0])
    for _ in range(6):
        at = time[frame] + value[1]
        response = integrals.second_difference(at, lag * period)
        slope = integrals.second_difference(at, lag * period, 1)
        columns = unit * np.column_stack((response, value[0] * slope, np.ones(len(at))))
        rest = wrapped(second - np.asarray(columns[:, [0, 2]] @ value[[0, 2]], dtype=np.float64))
        try:
            inverse = np.asarray(np.linalg.inv(columns.T @ columns), dtype=np.float64)
        except np.linalg.LinAlgError:
            return None
        value = value + inverse @ (columns.T @ rest)
    spread = float(np.sqrt(np.mean(rest**2)))
    if spread > 1.5 or not np.all(np.isfinite(value)):  # 1.81 is the spread of angles that are all alike
        return None
    std = _scatter(columns, rest, inverse, frame, lag)
    shrunk = _shrunk(time, phase, integrals, (unit, period, lag), (value, spread, float(np.var(response))))
    ratio = float(value[0]) / (1.0 - shrunk)
    ratio_std = float(np.hypot(std[0], CORRECTION_SHARE * shrunk * ratio))
    return Alignment(ratio, ratio_std, float(value[1]), float(std[1]))


def _scatter(columns: Floats, rest: Floats, inverse: Floats, frame: NDArray[np.int64], lag: int) -> Floats:
    """Standard deviations (k,) of least squares with residuals (n,) that hang together, by sums over segments."""
    segment = frame // (SEGMENT_LAGS * lag)
    starts = np.flatnonzero(np.diff(segment, prepend=-1))
    if len(starts) < MIN_SEGMENTS:
        return np.asarray(np.sqrt(np.mean(rest**2) * np.abs(np.diag(inverse)) * max(1.0, lag / 2.0)))
    sums = np.add.reduceat(columns * rest[:, None], starts)
    spread = sums.T @ sums * len(starts) / (len(starts) - columns.shape[1])
    return np.asarray(MARGIN * np.sqrt(np.diag(inverse @ spread @ inverse)))


def _shrunk(
    time: Floats,
    phase: Floats,
    integrals: Integrals,
    known: tuple[float, float, int],
    found: tuple[Floats, float, float],
) -> float:
    """By what share the accelerometer's own noise makes the ratio too small, 0 … ½.

    found: the values, the spread of what is left (rad), the variance of the response (m²). The noise is what the quiet
    frequencies hold, and not more than what is left over this lag beyond what is left over one frame, where the noise
    of the phase is alone.
    """
    (unit, period, lag), (value, spread, power) = known, found
    second, frame = _differences(phase, 1)
    response = integrals.second_difference(time[frame] + value[1], period)
    rest = wrapped(second - unit * value[0] * response)
    excess = (spread**2 - float(np.var(rest))) / (unit * value[0]) ** 2
    noise = min(integrals.noise_variance(lag * period), max(excess, 0.0))
    return min(noise / power, 0.5) if power > 0 else 0.0
