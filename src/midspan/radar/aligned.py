"""A whole record unwrapped: the accelerometer aligned with the phase first, then a filter forwards and backwards.

The filter's state is the range change u (m), its rate v (m/s) and the bias b (m/s²) of the acceleration in the line of
sight; the wrapped phase corrects its prediction from the accelerometer. Only the innovation is wrapped, so no speed is
too high while the prediction is within a quarter of a wavelength, and the prediction averages over many frames: it
stays right at signal-to-noise ratios and through fades where the last two phases alone lead astray. Where the two
directions disagree about the cycle it is a guess: a slip, or an outage that was too long.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from midspan import _core
from midspan.checks import same_length
from midspan.radar.alignment import Alignment, align
from midspan.radar.unwrap import BLIND_RAD, TURN, inertial_steps
from midspan.records import Floats

# Errors of the alignment that are allowed for where it has been found, at least.
MIN_SCALE_ERROR, MIN_TIME_ERROR_S = 0.002, 1e-4
# Frames that tell the speed at the start, and how well they do, m/s.
START_FRAMES, START_SPEED_STD_M_S = 32, 0.01
# A motion that turns the phase by less needs no unwrapping.
QUIET_RAD = 1.6
# The shortest record whose trend tells a drift from a swing, s.
MIN_TREND_S = 8.0
# A filter settles within this time, s: before it the other direction is accepted.
SETTLED_S = 2.0
# The directions are compared as medians of this many frames; noise takes single ones a cycle off.
COMPARED_FRAMES = 11


@dataclass(frozen=True, slots=True)
class _Trust:
    """How far the accelerometer is trusted.

    noise_density: of the acceleration in the line of sight, (m/s²)²/Hz; scale_error, time_error_s: relative error of
    the conversion factor and error of the time offset that are allowed for; start_inflation: natural logarithm of the
    factor on all of these at the first frame, estimated from then on; speed_m_s, speed_std_m_s: of the range there;
    bias_walk, bias_std_m_s2: growth of the bias' variance, (m/s²)² a second, and its deviation at the first frame.
    """

    noise_density: float = 1e-6
    scale_error: float = 0.02
    time_error_s: float = 1e-3
    start_inflation: float = 4.6
    speed_m_s: float = 0.0
    speed_std_m_s: float = 0.05
    bias_walk: float = 1e-8
    bias_std_m_s2: float = 0.05


# The radar alone: the range changes at a speed that drifts slowly, or fast.
WITHOUT_ACCELEROMETER = tuple(_Trust(noise_density=density, start_inflation=0.0) for density in (1e-2, 1.0))


@dataclass(frozen=True, slots=True)
class Unwrapped:
    """Unwrapped phase (n,) in rad since the first frame used, its variance, the filter's range change and its variance.

    phase_rad is NaN where the frame was not used; filtered_m (n,) goes on by the accelerometer. `restarts` are the
    frames from which on the cycle is a guess, because the prediction had become too wide; `surprise` is the mean of log
    variance + squared innovation over variance: the smaller, the better predicted; explained: whether the accelerometer
    accounts for the motion, or there is too little of it for a cycle to be lost.
    """

    phase_rad: Floats
    variance_rad2: Floats
    filtered_m: Floats
    filtered_variance_m2: Floats
    restarts: tuple[int, ...]
    surprise: float = np.nan
    explained: bool = True


@dataclass(frozen=True, slots=True)
class _Record:
    """What is unwrapped: arrays (n,), and the acceleration in the line of sight on the radar's clock (m, 2)."""

    frame_s: Floats
    phase: Floats
    variance: Floats
    los: Floats
    unit: float

    def mirrored(self) -> "_Record":
        """The record with time running backwards: accelerations stay, speeds change their sign."""
        los = np.column_stack((-self.los[::-1, 0], self.los[::-1, 1]))
        return _Record(-self.frame_s[::-1], self.phase[::-1], self.variance[::-1], los, self.unit)


def unwrap_aligned(
    frame_s: Floats,
    phase_rad: Floats,
    *,
    variance_rad2: Floats,
    samples: Floats,
    phase_per_m: float,
    ratio: float,
    max_offset_s: float = 0.15,
) -> tuple[Unwrapped, Alignment | None]:
    """Unwrap a record (n,) of evenly spaced frames after aligning the accelerometer with the phase itself.

    samples (m, 2): time on the accelerometer's clock (s) and acceleration (m/s²); ratio: range change per displacement
    as far as it is known, signed (the inverse conversion factor). A factor that is 60 % wrong or a clock that is
    `max_offset_s` off does no harm where there is motion enough to tell; the alignment is None where there is not.
    `restarts` also holds the frames at which the two directions of time disagree about the cycle; `explained` tells
    whether the accelerometer accounts for the phase, without which slips are likely and not always seen.
    """
    time, variance = np.asarray(frame_s, dtype=np.float64), np.asarray(variance_rad2, dtype=np.float64)
    same_length(frame_s=time, phase_rad=phase_rad, variance_rad2=variance)
    phase = np.where(variance < BLIND_RAD**2, phase_rad, np.nan)
    found = align(time, phase, samples=samples, phase_per_m=phase_per_m, max_offset_s=max_offset_s, prior=ratio)
    offset, ratio = (found.offset_s, found.ratio) if found is not None else (0.0, ratio)
    level = float(np.mean(samples[:, 1]))
    los = np.column_stack((samples[:, 0] - offset, ratio * (samples[:, 1] - level)))
    record = _Record(time, phase, variance, los, phase_per_m)
    runs = [_passed(record, found, kind) for kind in range(1 + len(WITHOUT_ACCELEROMETER))]
    # An accelerometer that is dead, or of another event, predicts worse than none.
    kind = int(np.argmin([np.inf if np.isnan(run.surprise) else run.surprise for run in runs]))
    agreed = _agreed(runs[kind], _passed(record.mirrored(), found, kind), time, phase_per_m)
    quiet = len(time) == 0 or float(np.ptp(agreed.filtered_m)) * phase_per_m < QUIET_RAD
    return replace(agreed, explained=quiet or (found is not None and kind == 0)), found


def _passed(record: _Record, found: Alignment | None, kind: int) -> Unwrapped:
    """One pass of the filter: kind 0 with the accelerometer, else one of those without."""
    time, phase, unit = record.frame_s, record.phase, record.unit
    steps, trust = inertial_steps(time, record.los), _Trust()
    if kind > 0:
        steps, trust = np.zeros_like(steps), WITHOUT_ACCELEROMETER[kind - 1]
    elif found is not None:
        trust = _Trust(
            scale_error=max(3.0 * found.ratio_std / abs(found.ratio), MIN_SCALE_ERROR),
            time_error_s=max(3.0 * found.offset_std_s, MIN_TIME_ERROR_S),
            start_inflation=0.0,
            speed_m_s=_first_speed(time, phase, steps, unit),
            speed_std_m_s=START_SPEED_STD_M_S,
        )
    follower = _core.PhaseFollower(
        unit,
        (trust.noise_density, trust.scale_error, trust.time_error_s, trust.bias_walk),
        (trust.speed_m_s, trust.speed_std_m_s, trust.bias_std_m_s2, trust.start_inflation),
    )
    rows = follower.push(np.column_stack((np.diff(time, prepend=time[:1]), phase, record.variance, steps)))
    surprise = rows[:, 4]
    run = Unwrapped(
        phase_rad=rows[:, 0] - follower.origin,
        variance_rad2=np.where(np.isfinite(rows[:, 0]), record.variance, np.inf),
        filtered_m=rows[:, 1],
        filtered_variance_m2=rows[:, 2],
        restarts=tuple(int(k) for k in np.flatnonzero(rows[:, 3])),
        surprise=float(np.nanmean(surprise)) if np.isfinite(surprise).any() else np.nan,
    )
    return _without_drift(run, time, unit)


def _agreed(forward: Unwrapped, backward: Unwrapped, time: Floats, unit: float) -> Unwrapped:
    """The forward pass with its start from the other direction, and restarts where the directions disagree."""
    from scipy.ndimage import median_filter

    used = np.flatnonzero(np.isfinite(forward.phase_rad) & np.isfinite(backward.phase_rad[::-1]))
    if len(used) < COMPARED_FRAMES:
        return forward
    apart = (forward.phase_rad - backward.phase_rad[::-1])[used] / TURN
    cycles = median_filter(np.rint(apart - np.median(apart)).astype(np.int64), COMPARED_FRAMES, mode="nearest")
    begin = int(np.searchsorted(time[used], time[used[0]] + SETTLED_S))
    end = int(np.searchsorted(time[used], time[used[-1]] - SETTLED_S))
    restarts = set(forward.restarts)
    if begin < end:
        restarts |= {_after_gap(used, int(k) + 1) for k in np.flatnonzero(np.diff(cycles[begin : end + 1])) + begin}
        if np.any(early := cycles[:begin] - cycles[begin]):
            # The start less its cycles, its first frame being zero again.
            first, last = used[0], used[begin - 1] + 1
            shift = np.zeros(len(time))
            shift[:last] = early[np.searchsorted(used[:begin], np.arange(last), side="right").clip(1) - 1]
            forward = _shifted(forward, shift - shift[first], unit)
    return replace(forward, restarts=tuple(sorted(restarts)))


def _after_gap(used: NDArray[np.int64], k: int) -> int:
    """The frame of the k-th used one, or the first after a gap that is near: the median may be some frames off."""
    low = max(k - COMPARED_FRAMES, 1)
    gaps = np.flatnonzero(np.diff(used[low - 1 : k + COMPARED_FRAMES]) > 1) + low
    return int(used[k] if len(gaps) == 0 else used[gaps[np.argmin(np.abs(gaps - k))]])


def _shifted(run: Unwrapped, cycles: Floats, unit: float) -> Unwrapped:
    """The run less cycles (n,)."""
    return replace(run, phase_rad=run.phase_rad - TURN * cycles, filtered_m=run.filtered_m - TURN * cycles / unit)


def _without_drift(run: Unwrapped, frame_s: Floats, unit: float) -> Unwrapped:
    """The run less whole cycles a frame, where its trend is nearest to them: wrapped phases tell no such drift."""
    known = np.flatnonzero(np.isfinite(run.phase_rad))
    if len(known) < 2 or frame_s[known[-1]] - frame_s[known[0]] < MIN_TREND_S:
        return run
    turns = run.phase_rad[known] / TURN
    cycles = np.rint(np.polyfit(known - known[0], turns, 1)[0])
    return _shifted(run, cycles * (np.arange(len(run.phase_rad)) - known[0]), unit)


def _first_speed(frame_s: Floats, phase: Floats, steps: Floats, unit: float) -> float:
    """The range's smallest speed at the first usable frame, m/s, that turns the first frames' phasors alike."""
    known = np.flatnonzero(np.isfinite(phase))[:START_FRAMES]
    if len(known) < START_FRAMES:
        return 0.0
    first, last = known[0], known[-1] + 1
    gained = np.concatenate(([0.0], np.cumsum(steps[first + 1 : last, 0])))
    dt = np.diff(frame_s[first:last])
    moved = np.concatenate(([0.0], np.cumsum(gained[:-1] * dt + steps[first + 1 : last, 1])))
    phasors = np.exp(1j * (phase[known] - unit * moved[known - first]))
    limit = np.pi / (unit * float(np.median(dt)))
    speeds = np.linspace(-limit, limit, 8 * START_FRAMES, endpoint=False)
    turns = np.exp(-1j * unit * np.multiply.outer(speeds, frame_s[known] - frame_s[first]))
    return float(speeds[np.argmax(np.abs(turns @ phasors))])
