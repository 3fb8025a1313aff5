"""Targets that stop being fixed in the middle of a record: a parked car drives off, a phase slips a cycle.

The accelerometer knows what the structure did. What a target shows beyond it changes slowly, by the drift of a double
integral; a target that sets out, or jumps, shows in the second difference of the rest over half a second. Which of two
targets it was is then known too. Constant speed cannot be felt, so a target that has set out stays left out until it
has been seen to stop.
"""

import numpy as np
from numpy.typing import NDArray

from midspan.radar.alignment import Integrals
from midspan.records import Floats

# Second differences of the rest are taken over these times, s: the long one feels who sets out, the short one jumps of
# less than the accelerometer drifts by in the long one. A speed is taken over the long one on either side.
LAGS_S = (0.5, 0.1)
# A target has left from so many standard deviations on, and from so many metres; noise is never believed to be less
# than what the whole record shows.
LIMIT, LEAST_M = 8.0, 2e-4
# Another target agrees with the accelerometer while it contradicts it by less than this share of what the one does.
AGREEING = 0.25
# The change of speed of a target that came to rest again elsewhere is within this many standard deviations of none.
RESTING = 4.0
NORMAL = 1.4826
_LEAST_FRAMES = 50


def departures(
    frame_s: Floats, value_m: Floats, variance_m2: Floats, *, samples: Floats, relative_std: Floats
) -> NDArray[np.bool_]:
    """Frames (targets, n) at which a target moved by itself, or its value jumped: not to be used.

    frame_s (n,): evenly spaced instants on the accelerometer's clock, s; value_m, variance_m2 (targets, n):
    displacement that each target shows, NaN where not seen; samples (m, 2): time (s) and acceleration (m/s²);
    relative_std (targets,): of the conversion factors. What all that are seen show alike is the accelerometer's error.
    """
    value, variance = np.asarray(value_m, dtype=np.float64), np.asarray(variance_m2, dtype=np.float64)
    lag = _frames(frame_s, LAGS_S[0])
    if len(frame_s) < 4 * lag + 1:
        return np.zeros(value.shape, dtype=np.bool_)
    integrals = Integrals.of(samples)
    seen = np.isfinite(value) & np.isfinite(variance)
    rest = np.where(seen, value - integrals.displacement(frame_s), np.nan)
    far = np.zeros(value.shape, dtype=np.bool_)
    for lag_s in LAGS_S:
        far |= _far(frame_s, (rest, variance), lag_s, (integrals, relative_std))
    speed_std = float(np.sqrt(integrals.noise_density * 4.0 * LAGS_S[0]))
    alone = seen.sum(axis=0) <= 1
    return np.stack([_left(far[j], rest[j], lag, (frame_s, speed_std, alone)) for j in range(len(value))])


def _frames(frame_s: Floats, lag_s: float) -> int:
    return max(1, round(lag_s / float(np.median(np.diff(frame_s))))) if len(frame_s) > 1 else 1


def _far(
    frame_s: Floats, known: tuple[Floats, Floats], lag_s: float, given: tuple[Integrals, Floats]
) -> NDArray[np.bool_]:
    """Frames (targets, n) about a second difference that is too large; known: rest and variance (targets, n).

    given: the accelerometer's integrals, and the relative standard deviations of the factors (targets,).
    """
    (rest, variance), (integrals, relative_std), lag = known, given, _frames(frame_s, lag_s)
    response = integrals.second_difference(frame_s[lag:-lag], lag_s)
    second = rest[:, 2 * lag :] - 2.0 * rest[:, lag:-lag] + rest[:, : -2 * lag]
    ratio = np.empty(second.shape)
    for j, spread in enumerate(_second_variance(variance, lag, integrals.noise_variance(lag_s))):
        ratio[j] = _ratio(second[j], spread + (relative_std[j] * response) ** 2)
    far = (np.abs(ratio) > LIMIT) & (np.abs(second) > LEAST_M)
    far &= _vouched(second, ratio)
    out = np.zeros(rest.shape, dtype=np.bool_)
    for j, k in zip(*np.nonzero(far), strict=True):
        out[j, k : k + 2 * lag + 1] = True
    return out


def _vouched(second: Floats, ratio: Floats) -> NDArray[np.bool_]:
    """Where (targets, k) another target agrees with the accelerometer, or none is seen that could.

    An error of the accelerometer is in all targets alike: one that agrees is well within the limit, and far from the
    target in question.
    """
    out = np.zeros(second.shape, dtype=np.bool_)
    for j in range(len(second)):
        others = [i for i in range(len(second)) if i != j]
        agrees = (np.abs(ratio[others]) < 0.5 * LIMIT) & (np.abs(second[others]) < AGREEING * np.abs(second[j]))
        out[j] = agrees.any(axis=0) | ~np.isfinite(ratio[others]).any(axis=0)
    return out


def _second_variance(variance: Floats, lag: int, inertial: float) -> Floats:
    """Variance (targets, n − 2 lag) of a second difference of displacements less those of the accelerometer."""
    return np.asarray(variance[:, 2 * lag :] + 4.0 * variance[:, lag:-lag] + variance[:, : -2 * lag] + inertial)


def _ratio(second: Floats, variance: Floats) -> Floats:
    """Second differences (k,) over their standard deviation, which the record may show to be larger than stated."""
    ratio = second / np.sqrt(np.where(np.isfinite(second), variance, np.nan))
    known = np.abs(ratio[np.isfinite(ratio)])
    scale = NORMAL * float(np.median(known)) if len(known) >= _LEAST_FRAMES else 1.0
    return np.asarray(ratio / max(scale, 1.0))


def _left(
    far: NDArray[np.bool_], rest: Floats, lag: int, known: tuple[Floats, float, NDArray[np.bool_]]
) -> NDArray[np.bool_]:
    """Frames (n,) that one target is left out for; far (n,): about second differences that are too large.

    known: instants of the frames, s, the standard deviation of a change of speed by the accelerometer, m/s, and where
    no other target is seen.
    """
    from midspan.signals.health import runs

    frame_s, std, alone = known
    out = far.copy()
    speed, changes, since = 0.0, 0, -1
    for start, end in runs(far):
        if since < 0 and alone[start:end].mean() > 0.5 and not _jumped(rest, (start, end), lag, (frame_s, std)):
            # Nobody tells whether it or the accelerometer is wrong: left to the gate of the fusion.
            out[start:end] = False
            continue
        before, after = _speed(frame_s, rest, start - lag, start), _speed(frame_s, rest, end, end + lag)
        if since < 0:
            speed, changes = 0.0, 0
        # What is not seen again after it set out, or before it stopped, tells nothing.
        speed, changes = speed + np.nan_to_num(after - before), changes + 1
        length_s = frame_s[min(end, len(rest) - 1)] - frame_s[start]
        moving = abs(speed) > RESTING * std * np.sqrt(changes * max(1.0, length_s / (4.0 * LAGS_S[0])))
        if since >= 0:
            out[since:end] = True
        since = (start if since < 0 else since) if moving else -1
    if since >= 0:
        out[since:] = True
    return out


def _jumped(rest: Floats, run: tuple[int, int], lag: int, known: tuple[Floats, float]) -> bool:
    """Whether the only target seen jumped and went on as before; an accelerometer's error would change the speed."""
    (start, end), (frame_s, std) = run, known
    before, after = _speed(frame_s, rest, start - lag, start), _speed(frame_s, rest, end, end + lag)
    return end - start <= 4.5 * lag and abs(after - before) <= RESTING * std


def _speed(frame_s: Floats, rest: Floats, first: int, last: int) -> float:
    """Speed (m/s) in frames first … last, NaN where less than half of them show it."""
    part = slice(max(first, 0), max(last, 0))
    known = np.isfinite(rest[part])
    if np.count_nonzero(known) < max(3, (last - first) // 2):
        return float("nan")
    return float(np.polyfit(frame_s[part][known] - frame_s[part][known][0], rest[part][known], 1)[0])
