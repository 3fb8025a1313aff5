"""Long recordings: a radar's clock that runs faster or slower than the accelerometer's, from the phase itself.

In each window the second differences of the wrapped phase tell the clock offset in closed form, so that the clock is
right before anything is unwrapped.
"""

from dataclasses import dataclass

import numpy as np

from midspan.calibration.running_clock import SIGNIFICANT
from midspan.radar.alignment import align
from midspan.radar.blockage import blocked
from midspan.radar.frames import even_places
from midspan.records import NANOSECONDS, Floats, Nanoseconds, seconds
from midspan.signals.medians import MEDIAN_OF_SQUARE

# Windows have this length, s, or so many go into the record; those of a long one are spread over it.
WINDOW_S, LEAST_WINDOWS, MOST_WINDOWS = 60.0, 4, 120
# A shorter record is told by its one offset, s.
LEAST_S = 40.0
# A window counts that knows its offset this well, s; the search about the calibrated offset reaches this far.
LEAST_CERTAIN_S, REACH_S = 2e-3, 0.15
# A drift is corrected when it reaches this, s; a window that leaves the line by more than this is told.
LEAST_LATE_S, LEAST_JUMP_S = 1e-4, 2e-3


@dataclass(frozen=True, slots=True)
class RadarClock:
    """The radar's stamps as corrected (n,), ns; how uncertain they still are, s (None: as calibrated); sentences.

    skew: by which its clock runs too slow, s/s; 0 where that was not corrected.
    """

    time_ns: Nanoseconds
    std_s: float | None = None
    skew: float = 0.0
    warnings: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Seen:
    """The best target's phasors (n,), what stands still taken out, at stamps (n,) ns of the radar's clock.

    amplitude: as calibrated; offset_s: as calibrated; ratio: range change per displacement; phase_per_m: rad per m.
    """

    time_ns: Nanoseconds
    phasors: np.ndarray[tuple[int, ...], np.dtype[np.complexfloating]]
    amplitude: float
    offset_s: float
    ratio: float
    phase_per_m: float


def radar_clock(seen: Seen, samples: Floats) -> RadarClock:
    """The radar's stamps without the drift of its clock, where the record is long and shows one.

    samples (m, 2): time in s on the accelerometer's clock, counted as the stamps are, and acceleration in m/s².
    """
    length_s = float(seen.time_ns[-1] - seen.time_ns[0]) / NANOSECONDS
    if length_s < LEAST_S:
        return RadarClock(seen.time_ns)
    window_s = min(length_s / LEAST_WINDOWS, WINDOW_S)
    begins = np.linspace(0.0, length_s - window_s, min(int(length_s // window_s), MOST_WINDOWS))
    found = [late for begin in begins if (late := _lateness(seen, samples, (begin, window_s))) is not None]
    if len(found) < 3:
        return RadarClock(seen.time_ns)
    middle, late, std = np.array(found).T
    line, covariance = _line(middle - middle.mean(), late, std)
    at = np.array([0.0, length_s]) - middle.mean()
    ends, spread = line[0] + line[1] * at, np.sqrt(_variance(covariance, at))
    told = _jumps(middle, late - line[0] - line[1] * (middle - middle.mean()), std)
    if not np.any((np.abs(ends) > SIGNIFICANT * spread) & (np.abs(ends) > LEAST_LATE_S)):
        return RadarClock(seen.time_ns, warnings=tuple(told))
    time_s = seconds(seen.time_ns, int(seen.time_ns[0])) - middle.mean()
    moved = seen.time_ns + np.rint(NANOSECONDS * (line[0] + line[1] * time_s)).astype(np.int64)
    text = (
        f"radar: its clock leaves the calibrated offset by {1e3 * ends[0]:+.2f} ms at the start and "
        f"{1e3 * ends[1]:+.2f} ms at the end ({1e6 * line[1]:+.1f} ± {1e6 * np.sqrt(covariance[1, 1]):.1f} ppm); "
        "this was corrected."
    )
    std_s = float(np.sqrt(np.mean(_variance(covariance, time_s))))
    return RadarClock(moved, std_s, float(line[1]), (text, *told))


def _lateness(seen: Seen, samples: Floats, window: tuple[float, float]) -> tuple[float, float, float] | None:
    """Middle of a window (s after the first frame), lateness beside the calibrated offset and its deviation, s.

    window: its start after the first frame and its length, s.
    """
    begin_s, window_s = window
    first = int(seen.time_ns[0])
    edges = first + np.array([round(begin_s * NANOSECONDS), round((begin_s + window_s) * NANOSECONDS)])
    own = slice(*np.searchsorted(seen.time_ns, edges))
    if own.stop - own.start < 2:
        return None
    places = even_places(seen.time_ns[own])
    phase = np.full(int(places[-1]) + 1, np.nan)
    hidden = blocked(np.abs(np.nan_to_num(seen.phasors[own])), seen.amplitude)
    phase[places] = np.where(hidden, np.nan, np.angle(seen.phasors[own]))
    time_s = np.interp(np.arange(len(phase)), places, seconds(seen.time_ns[own], 0)) + seen.offset_s
    near = slice(*np.searchsorted(samples[:, 0], (time_s[0] - 2.0 * REACH_S, time_s[-1] + 2.0 * REACH_S)))
    if near.stop - near.start < 10:
        return None
    found = align(
        time_s,
        phase,
        samples=samples[near],
        phase_per_m=seen.phase_per_m,
        max_offset_s=REACH_S,
        prior=seen.ratio,
    )
    if found is None or not found.offset_std_s < LEAST_CERTAIN_S:
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
        # Cauchy's weights: a window that was led astray has no say.
        weight = 1.0 / (std_s**2 * (1.0 + (rest / 3.0) ** 2))
    scatter = float(np.median(rest**2)) / MEDIAN_OF_SQUARE if len(rest) > 2 else 1.0
    return line, np.asarray(covariance * max(1.0, scatter))


def _variance(covariance: Floats, time_s: Floats) -> Floats:
    return np.asarray(covariance[0, 0] + 2.0 * covariance[0, 1] * time_s + covariance[1, 1] * time_s**2)


def _jumps(middle_s: Floats, rest_s: Floats, std_s: Floats) -> list[str]:
    """A sentence where windows leave the straight line by more than noise: the clock was set, or frames were lost."""
    far = (np.abs(rest_s) > 2.0 * SIGNIFICANT * std_s) & (np.abs(rest_s) > LEAST_JUMP_S)
    if not far.any():
        return []
    worst = int(np.argmax(np.where(far, np.abs(rest_s), 0.0)))
    return [
        f"radar: its clock does not run evenly: around {middle_s[worst]:.0f} s after its first frame it is off by "
        f"{1e3 * rest_s[worst]:+.2f} ms beside a straight line. Check for lost frames, or split the recording there."
    ]
