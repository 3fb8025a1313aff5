"""The slow error of a displacement sensor: noise that is correlated over seconds, as that of a GNSS receiver.

It is modelled as a first-order Gauss-Markov process together with the white noise. A record mostly shows only how fast
the error drifts, variance over correlation time: what is slower than the frequency at which the accelerometer's noise
exceeds the sensor's looks like the motion's own start. So variance and time are not the most likely ones but means over
all of them, each weighed by its likelihood, with an even prior of the standard deviation and of the time. A drift that
does not show is reported where none is taken into account.

Noise of the measurements that is not alike all along the record: the instants at which its level changes.

Innovations of a segment with its own variance s against one variance of the whole (m of n innovations): the logarithm
of the likelihood gains n/2 ln s − Σ m/2 ln sᵢ. The likeliest instant splits the record, and each part again, as long as
that gains more than a change of unknown place and size would by chance (half the logarithm of n for each and for the
segment: N. R. Zhang, D. O. Siegmund, A modified Bayes information criterion, Biometrics 63 (2007) 22-32, doi
10.1111/j.1541-0420.2006.00662.x). Taken for one level, a change looks like an error that is correlated over seconds.

The noise whose level changes is the sensor's, or the accelerometer's where that is likelier: an accelerometer that errs
with a cross motion or its attitude leaves innovations that are correlated, which a noisier sensor does not.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from midspan.calibration.fit import Fit, Pair, aligned, best_corner, best_corner_here
from midspan.calibration.outliers import cleaned
from midspan.calibration.whitening import NO_SLOW_ERROR
from midspan.records import Floats

# A level is shown by this many innovations at least: its variance is then known to a quarter. And it holds for this
# share of them: what is briefer, as a sensor that is stuck for some seconds, is no level of the noise.
MIN_SEGMENT, MIN_SHARE = 30, 0.1
# Unknowns of a change, half a ln n each: its instant, and the variance on both sides for one.
UNKNOWNS = 3.0
# An innovation's variance is more than the noise's alone: a level is found in rounds. Of one that is 25 times another
# the first round leaves a factor of 2.5, the fourth less than 1.1.
ROUNDS = 4
# Correlation times: the shortest in intervals, the longest as a share of the record, how many are tried.
MIN_INTERVALS, MAX_SHARE, TIMES_TRIED = 2.0, 0.5, 8
# Standard deviations in units of the white noise: the smallest tried, the factor to the next one, the largest.
SMALLEST, FACTOR, LARGEST = 0.1, 1.6, 1000.0
# Larger ones are not tried where the likelihood (logarithm) has fallen by this from its largest value.
FALLEN = 12.0
# What a record does not exclude with 99 %, by the ratio of likelihoods: half the chi-square of one degree of freedom.
NOT_EXCLUDED = 3.32
# A mean over all deviations has a long tail: it may drift this much farther (variance) than the readings.
TAIL = 4.0
# A drift that does not show is reported for this time, s.
DRIFT_S = 10.0
# A slow error is there all along: without the tenth of the record that gains most by it, the rest gains this share of
# the whole at least (nine tenths are its due). What happens once is no error of all rows.
ONCE, LASTS = 0.1, 0.25
# Chi-square of one degree of freedom at which the estimator takes a step for likelier than none (`fusion.steps`).
STEP_SHOWS = 26.0
# Twice that it does so beyond doubt; what happens once and may not be taken out stays in the band as a slow error.
BEYOND_DOUBT = 2.0
# Measurements are missing where the next one comes after this number of intervals.
MISSING = 3.0


def _with_noise_levels(pair: Pair, fit: Fit, whole: Floats | None = None) -> tuple[Pair, Fit]:
    """The pair with the levels of its noise, of mean 1, and its fit; as they are where one level explains all."""
    inner = fit.whitened.index[_edges(fit.residual**2)[1:-1]]
    if not len(inner):
        return pair, fit
    edges = np.r_[0, inner, len(pair.rows)]
    felt = _levelled_acceleration(pair, fit, edges)
    pair, fit = _levelled(pair, fit, edges)
    if felt[1].likelihood > fit.likelihood:
        return felt
    if whole is not None:
        pair = _with_outliers(pair, whole)
        pair = cleaned(pair, best_corner(pair, fit.offset_s, fit.corner))
        pair, fit = _levelled(pair, best_corner(pair, fit.offset_s, fit.corner), edges)
    return pair, fit


def _levelled(pair: Pair, fit: Fit, edges: NDArray[np.int64]) -> tuple[Pair, Fit]:
    for _ in range(ROUNDS):
        level = _level(fit, edges)
        rows = pair.rows.copy()
        rows[:, 2] *= np.repeat(level, np.diff(edges))
        rows[:, 2] /= np.mean(rows[fit.whitened.index, 2])
        pair = pair.changed(rows=rows)
        fit = best_corner(pair, fit.offset_s, fit.corner)
    return pair, fit


def _levelled_acceleration(pair: Pair, fit: Fit, edges: NDArray[np.int64]) -> tuple[Pair, Fit]:
    """The pair and its fit with a level of the accelerometer's noise during each segment of rows."""
    begins_s = pair.rows[edges[1:-1], 0] + fit.offset_s
    segment = np.searchsorted(begins_s, pair.samples[:, 0], side="right")
    for _ in range(ROUNDS):
        level = _level(fit, edges)[segment] * (1.0 if pair.level is None else pair.level)
        pair = pair.changed(level=level / np.mean(level))
        fit = best_corner(pair, fit.offset_s, fit.corner)
    return pair, fit


def _level(fit: Fit, edges: NDArray[np.int64]) -> Floats:
    """Mean square (k,) of the innovations of each segment of rows, the numbers of whose first ones are `edges`."""
    segment = np.searchsorted(edges, fit.whitened.index, side="right") - 1
    count = np.bincount(segment, minlength=len(edges) - 1)
    level = np.bincount(segment, fit.residual**2, minlength=len(edges) - 1) / np.maximum(count, 1)
    # Of a segment of which nothing is left no level shows.
    return np.where(level > 0.0, level, 1.0)


def _with_outliers(pair: Pair, whole: Floats) -> Pair:
    """The pair with the rows of `whole` (m, 3) that were left out, each at the relative variance of the one before."""
    rows, used = pair.rows.copy(), np.flatnonzero(np.isfinite(pair.rows[:, 2]))
    before = used[np.maximum(np.searchsorted(used, np.arange(len(rows)), side="right") - 1, 0)]
    left = np.isinf(rows[:, 2]) & np.isfinite(whole[:, 2])
    rows[left, 2] = rows[before[left], 2]
    return pair.changed(rows=rows)


def _edges(square: Floats) -> list[int]:
    edges, open_ones = [0, len(square)], [(0, len(square))]
    least = 0.5 * UNKNOWNS * float(np.log(max(len(square), 1)))
    brief = max(MIN_SEGMENT, round(MIN_SHARE * len(square)))
    while open_ones:
        first, last = open_ones.pop()
        cut = _cut(square[first:last], brief, least)
        if cut:
            edges.append(first + cut)
            open_ones += [(first, first + cut), (first + cut, last)]
    return sorted(edges)


def _cut(square: Floats, brief: int, least: float) -> int:
    """Where squares (k,) split into two levels of at least `brief` that gain more than `least`; 0: nowhere."""
    count = len(square)
    if count < 2 * brief:
        return 0
    first = np.arange(brief, count - brief + 1)
    total = np.cumsum(square)
    before, after = total[first - 1] / first, (total[-1] - total[first - 1]) / (count - first)
    if not (np.all(before > 0.0) and np.all(after > 0.0)):
        # Without any noise there are no levels.
        return 0
    gains = 0.5 * (count * np.log(total[-1] / count) - first * np.log(before) - (count - first) * np.log(after))
    best = int(np.argmax(gains))
    return int(first[best]) if gains[best] > least else 0


@dataclass(frozen=True, slots=True)
class SlowError:
    """The pair with the slow error of its measurements, and its fit.

    unseen: how far the measurements may drift once in DRIFT_S without the record showing it, how far they may step, and
    step while they are missing (0: they never are), in the translation's unit; 0 where a slow error is taken into
    account or there is none.
    """

    pair: Pair
    fit: Fit
    unseen: tuple[float, float, float] = (0.0, 0.0, 0.0)


def find_slow_error(pair: Pair, fit: Fit, time_s: float | None = None, whole: Floats | None = None) -> SlowError:
    """The slow error of the measurements; time_s: its correlation time where that is known, 0: there is none.

    whole: rows as of `Pair` with those that were left out as outliers, where steps are looked for.

    Without one the noise stays white unless the slow error gains more likelihood than a parameter without effect would
    (as in `fit.with_input_noise`) not in one place only, and no quiet part speaks against it: the sensor's own error is
    there as well, what an accelerometer errs by with the motion is not. White noise may change its level (see the
    module): the rows of the pair that is returned have it in their relative variances, or its samples a level.
    """
    white = pair.changed(slow=NO_SLOW_ERROR)
    levelled, fit = _with_noise_levels(white, fit, whole)
    if levelled is not white:
        pair, white = levelled.changed(slow=pair.slow), levelled
    if time_s == 0.0:
        return SlowError(white, fit)
    rows = pair.rows[pair.used(fit.offset_s), 0]
    times = _times(pair, rows) if time_s is None else np.array([time_s])
    tried = [_along(white, fit, float(lasting)) for lasting in times]
    best = max(float(np.max(one.likelihood)) for one in tried)
    # Sums over standard deviations and times, each for the width of its part of the scale.
    weights = [t * one.width * np.exp(one.likelihood - best) for t, one in zip(times, tried, strict=True)]
    moments = [float(np.sum(weight * one.std**2)) for weight, one in zip(weights, tried, strict=True)]
    white_moment = sum(float(np.sum(weight * one.noise)) for weight, one in zip(weights, tried, strict=True))
    if not white_moment > 0.0:
        # Measurements without any noise have no slow error that could be distinguished from it.
        return SlowError(white, fit)
    rate = sum(moment / lasting for moment, lasting in zip(moments, times, strict=True)) / sum(moments)
    slow = pair.changed(slow=(sum(moments) / white_moment, float(rate), 0.0))
    found = best_corner(slow, fit.offset_s)
    if time_s is None:
        none = aligned(white, fit.offset_s).fit(fit.corner)
        # An accelerometer whose noise changes its level may err slowly as well: both unknowns count then.
        least = (0.5 if white.level is None else 1.0) * np.log(max(len(rows), 1))
        gained = found.likelihood - none.likelihood
        if gained < least or _is_none(
            white, slow, white if whole is None else _with_outliers(white, whole), none, found
        ):
            return SlowError(white, fit, _unseen(white, fit, rows, np.sqrt(2.0 * (least + NOT_EXCLUDED))))
    return SlowError(slow, found)


def _times(pair: Pair, rows: Floats) -> Floats:
    shortest = MIN_INTERVALS / pair.rate_hz
    return np.geomspace(shortest, max(MAX_SHARE * float(rows[-1] - rows[0]), 2.0 * shortest), TIMES_TRIED)


def likeliest_slow_error(pair: Pair, fit: Fit) -> tuple[float, float]:
    """The largest likelihood (logarithm) with a slow error of the translation, and that one's standard deviation."""
    white, times = pair.changed(slow=NO_SLOW_ERROR), _times(pair, pair.rows[pair.used(fit.offset_s), 0])
    tried = [_along(white, fit, float(lasting)) for lasting in times]
    return max((float(np.max(one.likelihood)), float(one.std[np.argmax(one.likelihood)])) for one in tried)


def _is_none(pair: Pair, slow: Pair, whole: Pair, none: Fit, found: Fit) -> bool:
    """Whether what a slow error gains is none of the sensor's: it gains in one place only, the quietest measurements
    become less likely, or it drifts twice as far in DRIFT_S as the readings themselves.
    """
    rows = slow.rows[slow.used(found.offset_s)]
    steps = min(max(round(DRIFT_S * slow.rate_hz), 1), len(rows) // 2)
    own = float(np.mean((rows[steps:, 1] - rows[:-steps, 1]) ** 2))
    drift = -2.0 * np.expm1(-steps / slow.rate_hz * slow.slow[1]) * slow.slow[0] * found.noise
    return bool(drift > TAIL * own or _happened_once(whole, none, found) or lost(pair, none, found) > NOT_EXCLUDED)


def _unseen(pair: Pair, fit: Fit, rows: Floats, drift_shows: float) -> tuple[float, float, float]:
    """As of `SlowError`; rows (k,): times (s) of the measurements; drift_shows: deviations at which a drift does."""
    lapses = np.diff(rows)
    longest = int(np.argmax(lapses))
    # Among the measurements, not in time: one of these instants at most lies at the longest gap.
    instants = [float(rows[int(share * (len(rows) - 1))]) for share in (0.25, 0.5, 0.75)]
    drift = float(np.median([change_shown(pair, fit, at_s - 0.5 * DRIFT_S, DRIFT_S).std for at_s in instants]))
    steps = [change_shown(pair, fit, at_s).std for at_s in instants]
    missing = lapses[longest] > MISSING * float(np.median(lapses))
    gap = change_shown(pair, fit, rows[longest] + 0.5 * lapses[longest]).std if missing else 0.0
    shows = float(np.sqrt(STEP_SHOWS))
    return float(drift_shows) * drift, shows * float(np.median(steps)), shows * gap


@dataclass(frozen=True, slots=True)
class Change:
    """A change of the measurements: its size and that one's standard deviation, in the translation's unit.

    Where the measurements tell nothing of it the size is 0 and the deviation infinite.
    """

    size: float
    std: float

    @property
    def chi_square(self) -> float:
        """Twice the logarithm of how much likelier it makes the measurements, of one degree of freedom."""
        return (self.size / self.std) ** 2


def change_shown(pair: Pair, fit: Fit, from_s: float, lasting_s: float = 0.0) -> Change:
    """What the innovations show of a change from an instant on (s, on the sensor's own clock) that takes so long (s; 0:
    a step): the generalised likelihood ratio (A. S. Willsky, H. L. Jones, 1976, doi 10.1109/TAC.1976.1101146).
    """

    def change(time_s: Floats) -> Floats:
        since = time_s - fit.offset_s - from_s
        done: Floats = np.clip(since / lasting_s, 0.0, 1.0) if lasting_s > 0.0 else (since >= 0.0).astype(float)
        return done

    w = aligned(pair, fit.offset_s, change).whitened(fit.corner)
    root = np.sqrt(w.variance)
    signature, innovations = w.columns[:, -1] / root, (w.translation - fit.ratio * w.response) / root
    known = float(signature @ signature)
    if not (known > 0.0 and fit.noise > 0.0):
        return Change(0.0, np.inf)
    return Change(float(signature @ innovations) / known, float(np.sqrt(fit.noise / known)))


def _happened_once(pair: Pair, without: Fit, found: Fit) -> bool:
    """Whether a fit gains in one place only, by what the estimator takes out there as a step."""
    gains = _deviance(without) - _deviance(found)
    long = max(round(ONCE * len(gains)), 1)
    total = np.r_[0.0, np.cumsum(gains)]
    within = total[long:] - total[:-long]
    if total[-1] - np.max(within) >= LASTS * total[-1]:
        return False
    first = int(np.argmax(within))
    used = found.whitened.index
    rows = pair.rows[used[max(first - 1, 0)] + 1 : used[min(first + long, len(used) - 1)] + 1, 0]
    least = BEYOND_DOUBT * STEP_SHOWS
    return any(change_shown(pair, without, float(at_s)).chi_square > least for at_s in rows)


def lost(pair: Pair, without: Fit, found: Fit) -> float:
    """By how much a fit makes the quietest measurements, however many, less likely at most (logarithm)."""
    # Where the fit is right this exceeds c with a probability of exp(-c) at most (J. Ville, 1939).
    at = np.searchsorted(pair.samples[:, 0], pair.rows[found.whitened.index, 0] + found.offset_s)
    order = np.argsort(pair.lively[np.minimum(at, len(pair.lively) - 1)], kind="stable")
    return float(np.max(np.cumsum((_deviance(found) - _deviance(without))[order])))


def _deviance(fit: Fit) -> Floats:
    return 0.5 * fit.residual**2 + 0.5 * np.log(fit.noise * fit.whitened.variance)


@dataclass(frozen=True, slots=True)
class _Along:
    """Slow errors of one correlation time: their deviation (k,), the white noise's variance (k,), likelihood (k,)."""

    std: Floats
    noise: Floats
    likelihood: Floats

    @property
    def width(self) -> Floats:
        """The part (k,) of the standard deviation's scale that each stands for."""
        return np.maximum(np.gradient(self.std), 0.0)


def _along(white: Pair, fit: Fit, lasting_s: float) -> _Along:
    here, found, best = aligned(white, fit.offset_s), [], -np.inf
    size, corner = SMALLEST, fit.corner
    while size < LARGEST:
        with np.errstate(invalid="ignore"):
            one = best_corner_here(here.of(white.changed(slow=(size * size, 1.0 / lasting_s, 0.0))), corner)
        if not np.isfinite(one.likelihood):
            # Its covariance is lost in rounding.
            break
        found.append((size * np.sqrt(one.noise), one.noise, one.likelihood))
        best, corner, size = max(best, one.likelihood), one.corner, FACTOR * size
        if one.likelihood < best - FALLEN:
            break
    return _Along(*np.array(found).T)
