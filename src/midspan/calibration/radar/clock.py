"""Long recordings: a radar's clock that runs faster or slower than the accelerometer's, from the phase itself.

In each window the second differences of the wrapped phase give the clock offset in closed form, so that the clock is
right before anything is unwrapped.
"""

from dataclasses import dataclass

import numpy as np

from midspan.calibration.one_clock import SIGNIFICANT
from midspan.radar.alignment import align
from midspan.radar.blockage import blocked
from midspan.radar.frames import even_places
from midspan.records import NANOSECONDS, Floats, Nanoseconds, seconds
from midspan.signals.medians import MEDIAN_OF_SQUARE

# Length of the windows, s; a short record has at least this many, a long one at most that many spread over it.
WINDOW_S, MIN_WINDOWS, MAX_WINDOWS = 60.0, 4, 120
# A shorter record has one clock offset, s.
MIN_S = 40.0
# Largest standard deviation of the offset of a window that counts, s; reach of the search about the calibrated one, s.
MAX_STD_S, REACH_S = 2e-3, 0.15
# A drift is corrected when it reaches this, s.
MIN_LATE_S = 1e-4


@dataclass(frozen=True, slots=True)
class Seen:
    """The best target's phasors (n,), without what is static, at stamps (n,) ns of the radar's clock.

    amplitude, noise, offset_s: as calibrated, noise being the variance of a phasor; ratio: range change per
    displacement; phase_per_m: rad per m.
    """

    time_ns: Nanoseconds
    phasors: np.ndarray[tuple[int, ...], np.dtype[np.complexfloating]]
    amplitude: float
    noise: float
    offset_s: float
    ratio: float
    phase_per_m: float


def clock_skew(seen: Seen, samples: Floats) -> float:
    """By how much the radar's clock runs too slow, s/s; 0 where the record is short or shows no drift.

    samples (m, 2): time in s on the accelerometer's clock, counted as the stamps are, and acceleration in m/s².
    """
    length_s = float(seen.time_ns[-1] - seen.time_ns[0]) / NANOSECONDS
    if length_s < MIN_S:
        return 0.0
    window_s = min(length_s / MIN_WINDOWS, WINDOW_S)
    begins = np.linspace(0.0, length_s - window_s, min(int(length_s // window_s), MAX_WINDOWS))
    found = [late for begin in begins if (late := _lateness(seen, samples, (begin, window_s))) is not None]
    if len(found) < 3:
        return 0.0
    middle, late, std = np.array(found).T
    line, covariance = _line(middle - middle.mean(), late, std)
    at = np.array([0.0, length_s]) - middle.mean()
    ends = line[0] + line[1] * at
    spread = np.sqrt(covariance[0, 0] + 2.0 * covariance[0, 1] * at + covariance[1, 1] * at**2)
    drifts = np.any((np.abs(ends) > SIGNIFICANT * spread) & (np.abs(ends) > MIN_LATE_S))
    return float(line[1]) if drifts else 0.0


def _lateness(seen: Seen, samples: Floats, window: tuple[float, float]) -> tuple[float, float, float] | None:
    """Middle of a window (s after the first frame), lateness relative to the calibrated offset and its deviation, s."""
    begin_s, window_s = window
    first = int(seen.time_ns[0])
    edges = first + np.array([round(begin_s * NANOSECONDS), round((begin_s + window_s) * NANOSECONDS)])
    own = slice(*np.searchsorted(seen.time_ns, edges))
    if own.stop - own.start < 2:
        return None
    places = even_places(seen.time_ns[own])
    phase = np.full(int(places[-1]) + 1, np.nan)
    hidden = blocked(np.abs(np.nan_to_num(seen.phasors[own])), seen.amplitude, seen.noise)
    phase[places] = np.where(hidden, np.nan, np.angle(seen.phasors[own]))
    time_s = np.interp(np.arange(len(phase)), places, seconds(seen.time_ns[own], 0)) + seen.offset_s
    near = slice(*np.searchsorted(samples[:, 0], (time_s[0] - 2.0 * REACH_S, time_s[-1] + 2.0 * REACH_S)))
    if near.stop - near.start < 10:
        return None
    found = align(
        time_s, phase, samples=samples[near], phase_per_m=seen.phase_per_m, max_offset_s=REACH_S, prior=seen.ratio
    )
    if found is None or not found.offset_std_s < MAX_STD_S:
        return None
    return begin_s + 0.5 * window_s, found.offset_s, found.offset_std_s


def _line(time_s: Floats, late_s: Floats, std_s: Floats) -> tuple[Floats, Floats]:
    """Offset and skew (2,) of a line that outliers do not move, and their covariance (2, 2), widened by the scatter."""
    columns = np.stack((np.ones_like(time_s), time_s), axis=1)
    weight = 1.0 / std_s**2
    line = np.zeros(2)
    for _ in range(10):
        covariance = np.linalg.pinv((columns * weight[:, None]).T @ columns, hermitian=True)
        line = covariance @ (columns * weight[:, None]).T @ late_s
        rest = np.abs(late_s - columns @ line) / std_s
        # Cauchy's weights: an outlying window has no weight.
        weight = 1.0 / (std_s**2 * (1.0 + (rest / 3.0) ** 2))
    scatter = float(np.median(rest**2)) / MEDIAN_OF_SQUARE if len(rest) > 2 else 1.0
    return line, np.asarray(covariance * max(1.0, scatter))
