"""Motion that a target makes on its own, as a tree in the wind or ground that settles, frequency by frequency.

What two targets show differently is motion of one of them; three tell which. Of two the accelerometer tells it, where
its noise is less than they differ. An only target is compared with the accelerometer itself, above 0.1 Hz; and there no
target of several moves by what the accelerometer would have shown as a difference from it, and does not.
"""

from dataclasses import dataclass
from itertools import combinations, pairwise

import numpy as np
from numpy.typing import NDArray

from midspan.radar.alignment import Integrals
from midspan.records import Floats
from midspan.signals.health import runs
from midspan.signals.lines import Line, away_from_lines

# Edges of the bands, Hz; the accelerometer alone is asked from the third edge on.
EDGES_HZ = (0.0, 0.05, 0.1, 0.2, 0.4, 0.8, 1.6, 3.2, 6.4)
# Below this frequency the noise of an accelerometer rises, Hz.
CORNER_HZ = 0.3
# Segments without a hole that are used, s.
MIN_SEGMENT_S = 5.0
# Second differences over this time tell accelerometer and radar apart without the drift of a double integral, s.
LAG_S = 0.07
# What is found counts as motion beyond this many times what noise makes, and this many of its standard deviations.
EXCESS, SIGNIFICANCE = 1.5, 4.0
# The accelerometer decides between two targets where their shares are known to this standard deviation.
DECIDED_STD = 0.2
# Every factor and clock offset may be off by this much more than is stated.
MIN_RELATIVE, MIN_CLOCK_S = 3e-4, 5e-5
# A filter takes this much off the variance of white noise, but nothing off a motion; one target is left out together
# with another whose error is this many times less (variances).
AVERAGED, LEFT_OUT_RATIO = 25.0, 4.0
# Frames that two targets must both be seen in; the smallest motions that count, and for which a target is left out, m.
MIN_FRAMES, MIN_M, MIN_LEFT_OUT_M = 400, 1e-6, 1e-5


@dataclass(frozen=True, slots=True, eq=False)
class Shown:
    """What the targets show, on evenly spaced frames.

    frame_s (n,): on the accelerometer's clock; value_m, variance_m2 (targets, n): displacement, NaN where not seen;
    steps (targets, n): frames at which a target's zero is a new one;
    relative_std, lasting_m (targets,): of the factors, and error of what else is in the bins; lines: of the
    acceleration, where it tells nothing.
    """

    frame_s: Floats
    value_m: Floats
    variance_m2: Floats
    steps: NDArray[np.bool_]
    relative_std: Floats
    lasting_m: Floats
    lines: tuple[Line, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class OwnMotions:
    """power_m2 (targets, bands): variance of each target's own motion; frequency_hz (bands,): where it lies.

    left_out (targets,): those compared with which another is so much better that they are not to be used; undecided
    (bands,): that one of two moves is sure, but not which: both hold the whole.
    """

    power_m2: Floats
    frequency_hz: Floats
    left_out: NDArray[np.bool_]
    undecided: NDArray[np.bool_]

    def std_m(self, target: int) -> float:
        """Standard deviation of a target's own motion, m."""
        return float(np.sqrt(self.power_m2[target].sum()))

    def main_hz(self, target: int) -> float:
        """Frequency of the largest part of a target's own motion, Hz."""
        return float(self.frequency_hz[np.argmax(self.power_m2[target])])


def own_motions(shown: Shown, samples: Floats) -> OwnMotions:
    """What each target moves on its own; samples (m, 2): time (s) and acceleration (m/s²)."""
    targets, bands = len(shown.value_m), len(EDGES_HZ) - 1
    frequency = np.sqrt(np.maximum(EDGES_HZ[:-1], 0.02) * np.array(EDGES_HZ[1:]))
    power, undecided = np.zeros((targets, bands)), np.zeros(bands, dtype=np.bool_)
    integrals = Integrals.of(samples)
    if targets == 1:
        power[0], _, frequency = _alone(shown, 0, integrals, frequency)
    else:
        apart = np.zeros((targets, targets, bands))
        for i, j in combinations(range(targets), 2):
            apart[i, j], at = _apart(shown, i, j, frequency)
            apart[j, i] = apart[i, j]
            frequency = np.where(apart[i, j] >= apart.max(axis=(0, 1)), at, frequency)
        if targets == 2:
            power, undecided = _of_two(shown, integrals, apart[0, 1])
        else:
            power = _of_several(apart)
        # No target moves by more than the accelerometer leaves of it, where that could tell: differences of pairs hold
        # by how much two of them happened to move together in a short record.
        alone = [_alone(shown, k, integrals, frequency) for k in range(targets)]
        left, limit = (np.array([one[k] for one in alone]) for k in (0, 1))
        power = np.where(power > limit, np.minimum(power, left), power)
        undecided &= (power > MIN_M**2).all(axis=0)
    power = np.where(power > MIN_M**2, power, 0.0)
    return OwnMotions(power, frequency, _left_out(shown, power), undecided)


def _of_several(apart: Floats) -> Floats:
    """Powers (targets, bands) of which the differences (targets, targets, bands) are the sums in pairs."""
    count = len(apart)
    each, total = apart.sum(axis=1), apart.sum(axis=(0, 1)) / (2.0 * (count - 1))
    # No target moves by more than it differs from any other.
    most = np.where(np.eye(count, dtype=np.bool_)[..., None], np.inf, apart).min(axis=1)
    return np.asarray(np.clip((each - total) / (count - 2), 0.0, most))


def _left_out(shown: Shown, power: Floats) -> NDArray[np.bool_]:
    own = power.sum(axis=1)
    error = own + _typical(shown.variance_m2) / AVERAGED + shown.lasting_m**2
    best = int(np.argmin(error))
    clearly = own > np.maximum(LEFT_OUT_RATIO * own[best], MIN_LEFT_OUT_M**2)
    return np.asarray((error > LEFT_OUT_RATIO * error[best]) & clearly)


def _typical(variance: Floats) -> Floats:
    """Usual variance (targets,) of the frames in which each is seen; infinite for one that is never seen."""
    known = [row[np.isfinite(row)] for row in variance]
    return np.array([float(np.median(row)) if len(row) else np.inf for row in known])


def _apart(shown: Shown, i: int, j: int, frequency: Floats) -> tuple[Floats, Floats]:
    """Variance (bands,) by which two targets differ beyond their noise, and the frequencies (bands,) where they do."""
    value, period = shown.value_m, _period(shown)
    difference = _levelled(_bridged(value[i] - value[j], _lag(shown)), shown.steps[i] | shown.steps[j])
    if np.count_nonzero(np.isfinite(difference)) < MIN_FRAMES:
        return np.zeros(len(frequency)), frequency
    found, moved = _power(difference, period), _power(value[i], period)
    typical = _typical(shown.variance_m2)
    relative = shown.relative_std[[i, j]] ** 2 + MIN_RELATIVE**2
    noise = (typical[i] + typical[j]) / len(found)
    lasting = shown.lasting_m[i] ** 2 + shown.lasting_m[j] ** 2
    power, _, at = _excess(found, noise + relative.sum() * moved, (len(difference), period, lasting), frequency)
    return power, at


def _excess(
    found: Floats, expected: Floats, known: tuple[int, float, float], frequency: Floats
) -> tuple[Floats, Floats, Floats]:
    """Variance (bands,) beyond what is expected, zero where that is chance; up to which it may be; where it lies, Hz.

    found, expected (bins,): of a spectrum; known: frames, their period (s), and a variance that may lie anywhere.
    """
    count, period, lasting = known
    hz = np.fft.rfftfreq(count, period)[1:]
    power, limits, at = np.zeros(len(frequency)), np.full(len(frequency), np.inf), frequency.copy()
    for k, (low, high) in enumerate(pairwise(EDGES_HZ)):
        own = (hz >= low) & (hz < min(high, 0.45 / period))
        if not own.any():
            continue
        chance = EXCESS + SIGNIFICANCE * np.sqrt(1.5 / np.count_nonzero(own))
        limits[k], total = expected[own].sum() * chance + 2.0 * lasting, float(found[own].sum())
        if total > limits[k]:
            power[k] = total - expected[own].sum()
            at[k] = float(np.average(hz[own], weights=found[own]))
    return power, limits, at


def _alone(shown: Shown, target: int, integrals: Integrals, frequency: Floats) -> tuple[Floats, Floats, Floats]:
    """Variance (bands,) of what the accelerometer does not explain of a target, up to which chance makes one (infinite
    where the accelerometer cannot tell), and where it lies, Hz.
    """
    period, silent = _period(shown), np.full(len(frequency), np.inf)
    rest = _second(shown, target, integrals)
    known = np.isfinite(rest)
    if np.count_nonzero(known) < MIN_FRAMES:
        return np.zeros(len(frequency)), silent, frequency
    hz = np.asarray(np.fft.rfftfreq(len(rest), period)[1:], dtype=np.float64)
    found, expected = _power(rest, period) / _transfer(hz, shown), _unexplained(shown, target, integrals, hz)
    lasting, away = float(shown.lasting_m[target] ** 2), away_from_lines(hz, shown.lines)
    found, expected = found * away, expected * away
    power, limits, at = _excess(found, expected, (len(rest), period, lasting), frequency)
    heard = np.arange(len(frequency)) >= 2
    return np.where(heard, power, 0.0), np.where(heard, limits, np.inf), at


def _unexplained(shown: Shown, target: int, integrals: Integrals, hz: Floats) -> Floats:
    """Power (bins,) at frequencies by which a target that does not move on its own differs from the accelerometer."""
    period, step_hz = _period(shown), float(hz[0])
    inertial = 2.0 * step_hz * integrals.noise_density / (2.0 * np.pi * hz) ** 4 * (1.0 + (CORNER_HZ / hz) ** 2)
    late = (2.0 * np.pi * hz * MIN_CLOCK_S) ** 2
    moved = _power(shown.value_m[target], period)
    moved = np.interp(hz, np.fft.rfftfreq(len(shown.frame_s), period)[1:], moved)
    expected = _typical(shown.variance_m2)[target] / len(hz) + inertial
    return np.asarray(expected + (shown.relative_std[target] ** 2 + MIN_RELATIVE**2 + late) * moved)


def _of_two(shown: Shown, integrals: Integrals, apart: Floats) -> tuple[Floats, NDArray[np.bool_]]:
    """Powers (2, bands) of the differences (bands,) of two targets by the accelerometer; where it cannot tell."""
    power, undecided = np.stack((apart, apart)), apart > MIN_M**2
    if not undecided.any():
        return power, undecided
    first, second = _second(shown, 0, integrals), _second(shown, 1, integrals)
    if np.count_nonzero(np.isfinite(first + second)) < MIN_FRAMES:
        return power, undecided
    period = _period(shown)
    difference = _spectrum(first - second, period)
    rest = _spectrum(np.where(np.isfinite(first), second, np.nan), period)
    hz = np.asarray(np.fft.rfftfreq(len(first), period)[1:], dtype=np.float64)
    turned = np.sqrt(_transfer(hz, shown))
    difference, rest = difference / turned, rest / turned
    expected = _unexplained(shown, 1, integrals, hz)
    for k in np.flatnonzero(undecided):
        own = (hz >= EDGES_HZ[k]) & (hz < EDGES_HZ[k + 1])
        total = max(float(np.sum(np.abs(difference[own]) ** 2)), 1e-30)
        # What the second shows beyond the accelerometer holds its own part of the difference, with a minus.
        share = -float(np.real(np.sum(rest[own] * difference[own].conj()))) / total
        left = float(np.sum(np.abs(rest[own] + share * difference[own]) ** 2))
        # What is left is the accelerometer's noise, which falls steeply with the frequency.
        spread = left * float(np.average(hz[own] ** -4.0, weights=np.abs(difference[own]) ** 2))
        spread /= float(np.sum(hz[own] ** -4.0))
        # It may happen to be less than what factor, clock and accelerometer make.
        spread = max(spread, float(np.average(expected[own], weights=np.abs(difference[own]) ** 2)))
        std = float(np.sqrt(0.75 * spread / total))
        if std < DECIDED_STD:
            # A small share is as good as none.
            share = 0.0 if share < 2.0 * std else 1.0 if share > 1.0 - 2.0 * std else share
            undecided[k] = False
            power[:, k] = (1.0 - share) * apart[k], share * apart[k]
    guilty = np.where(undecided, 0.0, power).sum(axis=1)
    for j in (0, 1):
        if guilty[j] > max(LEFT_OUT_RATIO * guilty[1 - j], MIN_LEFT_OUT_M**2):
            # One that surely moves at other frequencies is the one that moves.
            power[1 - j, undecided], undecided = 0.0, np.zeros_like(undecided)
    return power, undecided


def _period(shown: Shown) -> float:
    return float(np.median(np.diff(shown.frame_s)))


def _lag(shown: Shown) -> int:
    return max(1, round(LAG_S / _period(shown)))


def _transfer(hz: Floats, shown: Shown) -> Floats:
    """What a second difference does to the power at frequencies, at least so much that noise is not blown up."""
    return np.asarray(16.0 * np.sin(np.pi * np.minimum(hz * _lag(shown) * _period(shown), 0.5)) ** 4)


def _second(shown: Shown, target: int, integrals: Integrals) -> Floats:
    """Second differences (n - 2 lag,) of what a target shows beyond the accelerometer, NaN where not known."""
    lag = _lag(shown)
    rest = _bridged(shown.value_m[target] - integrals.displacement(shown.frame_s), lag)
    second = rest[2 * lag :] - 2.0 * rest[lag:-lag] + rest[: -2 * lag]
    spoilt = near(shown.steps[target], lag + 1)[lag:-lag]
    return np.where(spoilt, np.nan, second)


def near(mask: NDArray[np.bool_], reach: int) -> NDArray[np.bool_]:
    """Frames (n,) within `reach` of one of the mask (n,)."""
    edges = np.concatenate(([0], np.cumsum(mask)))
    place = np.arange(len(mask))
    return np.asarray(edges[np.minimum(place + reach + 1, len(mask))] > edges[np.maximum(place - reach, 0)])


def _levelled(value: Floats, steps: NDArray[np.bool_]) -> Floats:
    """Values (n,) less the mean of each segment between steps (n,), whose level says nothing."""
    out = value.copy()
    edges = [0, *(int(k) for k in np.flatnonzero(steps)), len(value)]
    for a, b in pairwise(edges):
        part = out[a:b]
        if np.isfinite(part).any():
            out[a:b] = part - np.nanmean(part)
    return out


def _bridged(value: Floats, most: int) -> Floats:
    """Values (n,) with a straight line over holes of up to this many frames."""
    known = np.flatnonzero(np.isfinite(value))
    if not len(known):
        return value
    line = np.interp(np.arange(len(value)), known, value[known], left=np.nan, right=np.nan)
    out = value.copy()
    for a, b in runs(~np.isfinite(value)):
        if b - a <= most:
            out[a:b] = line[a:b]
    return out


def _spectrum(value: Floats, period: float) -> NDArray[np.complex128]:
    """Spectrum (bins,) from the first frequency on, whose squares add up to the variance; a window a segment."""
    window = np.zeros(len(value))
    for a, b in runs(np.isfinite(value)):
        if (b - a) * period >= MIN_SEGMENT_S:
            window[a:b] = np.sin(np.pi * (np.arange(b - a) + 0.5) / (b - a)) ** 2
    used = window > 0.0
    if not used.any():
        return np.zeros(len(value) // 2, dtype=np.complex128)
    whole = np.where(used, value - value[used].mean(), 0.0) * window
    size = np.sqrt(2.0 / (len(value) * np.sum(window**2)))
    return np.asarray(size * np.fft.rfft(whole)[1:], dtype=np.complex128)


def _power(value: Floats, period: float) -> Floats:
    return np.asarray(np.abs(_spectrum(value, period)) ** 2)
