"""The clock offset between a displacement-like sensor and the accelerometer, by maximum likelihood.

The likelihood is evaluated with the accelerometer's full-rate response at the exact instants of the other sensor, so an
aliased camera needs no special care. It has many maxima when the motion is nearly a single tone; all of them are
refined and compared, and the runner-up is reported so that an ambiguity can be refused.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from midspan.calibration.agreement import clearly_better
from midspan.calibration.fit import Fit, Pair, best_corner, corner_range, evaluate, refine
from midspan.records import Floats, TimeOffset

COARSE_CORNERS = 4
CANDIDATES = 6
# An innovation this many robust standard deviations out is left out of the fit; the rest is fitted again.
OUTLIER_LIMIT = 5.0
# A measurement is lonely when it leaves its neighbours by this many times their own range.
LONELY_LIMIT = 2.0
# Rounds of marking outliers and fitting again, at most.
MARKING_ROUNDS = 12
# Rounds of comparing ratios with the best one's, at most; and the pull towards smaller ratios, in standard deviations
# of the offset, that is left as it is.
REFERENCE_ROUNDS = 4
MOST_PULLED = 0.1
# Where the accelerometer's noise would be this share of its signal, the sensors do not agree.
EXPLAINED_BY_NOISE = 0.3
# An offset beyond the largest by less than so many of its standard deviations, of so many s at most, is within.
BEYOND, MOST_BEYOND = 3.0, 0.02
# Above this rate the coarse search runs on averages of neighbouring samples; the refinement always on all samples.
COARSE_RATE_HZ = 250.0


@dataclass(frozen=True, slots=True)
class OffsetSearch:
    """The best fit, its offset with variance, the runner-up (None without a second maximum) and the scanned curve.

    offsets_s (k,), likelihood (k,): the coarse curve for the report; pair: with outliers marked unusable.
    """

    fit: Fit
    offset: TimeOffset
    runner_up: Fit | None
    offsets_s: Floats
    likelihood: Floats
    pair: Pair


def search_offset(pair: Pair, max_offset_s: float, edge_s: float = 0.0) -> OffsetSearch:
    """Find the time offset within ±`max_offset_s` that makes translation and acceleration agree best.

    edge_s: so much farther is searched, so that an offset near the largest is found; one clearly beyond is given only
    where it is clearly better than all within.
    """
    pair = without_lonely_outliers(pair)
    limit_s, max_offset_s = max_offset_s, max_offset_s + edge_s
    offsets, curve = scan(pair, max_offset_s)
    step = float(offsets[1] - offsets[0]) if len(offsets) > 1 else 0.0
    fits = _refined(pair, offsets, curve)
    best = max(fits, key=lambda fit: fit.likelihood)
    cleaned = _cleaned(pair, best, step)
    if cleaned is not pair:
        # What the outliers have hidden shows now: the search starts again without them.
        pair = cleaned
        offsets, curve = scan(pair, max_offset_s)
        fits = _refined(pair, offsets, curve)
        best = max(fits, key=lambda fit: fit.likelihood)
        cleaned = _cleaned(pair, best, step)
        fits = [refine(cleaned, fit, step) for fit in fits] if cleaned is not pair else fits
        pair, best = cleaned, max(fits, key=lambda fit: fit.likelihood)
    for _ in range(REFERENCE_ROUNDS):
        if not _may_shrink(pair, _apart(fits, best, step), best):
            break
        pair = replace(pair, reference=abs(best.ratio))
        offsets, curve = scan(pair, max_offset_s)
        fits = _refined(pair, offsets, curve)
        best = max(fits, key=lambda fit: fit.likelihood)
    if edge_s > 0.0:
        fits = _within(pair, fits, limit_s)
        best = max(fits, key=lambda fit: fit.likelihood)
    runner_up = max(_apart(fits, best, step), key=lambda fit: fit.likelihood, default=None)
    variance, drag = curvature(pair, best)
    best = replace(best, ratio_variance=best.ratio_variance + drag * drag * variance)
    return OffsetSearch(best, TimeOffset(best.offset_s, variance), runner_up, offsets, curve, pair)


def _within(pair: Pair, fits: list[Fit], limit_s: float) -> list[Fit]:
    """The fits within ±`limit_s`, give or take their deviation; the others where one is clearly better than these."""
    near = [f for f in fits if abs(f.offset_s) < limit_s + BEYOND * np.sqrt(min(curvature(pair, f)[0], MOST_BEYOND**2))]
    best = max(fits, key=lambda fit: fit.likelihood)
    inner = max(near, key=lambda fit: fit.likelihood, default=None)
    return fits if inner is None or (inner is not best and clearly_better(best, inner)) else near


def _apart(fits: list[Fit], best: Fit, step_s: float) -> list[Fit]:
    """The fits at other offsets than the best one's."""
    return [fit for fit in fits if abs(fit.offset_s - best.offset_s) > 2.0 * step_s]


def _may_shrink(pair: Pair, others: list[Fit], best: Fit) -> bool:
    """Whether the noise of the accelerometer can have led to an offset with too small a ratio (see `shrinking`)."""
    if pair.ratio is not None or (pair.reference is not None and abs(best.ratio) > 0.99 * pair.reference):
        return False
    rate = (len(pair.samples) - 1) / float(pair.samples[-1, 0] - pair.samples[0, 0])
    if np.sqrt(best.input_density * rate) > EXPLAINED_BY_NOISE * np.std(pair.samples[:, 1]):
        # Nothing agrees here, and all of the acceleration counts as noise.
        return False
    share = float(np.sum(best.whitened.input_part / best.whitened.variance))
    if any(fit.likelihood + share * np.log(abs(fit.ratio / best.ratio)) > best.likelihood for fit in others):
        return True
    variance, drag = curvature(pair, best)
    return bool(share * abs(drag / best.ratio) * np.sqrt(variance) > MOST_PULLED)


def scan(pair: Pair, max_offset_s: float) -> tuple[Floats, Floats]:
    """Offsets tried (k,), and the likelihood at the best of a few noise ratios (k,)."""
    outside = None if pair.outside is None else thinned(pair.outside, COARSE_RATE_HZ)
    coarse = replace(pair, samples=thinned(pair.samples, COARSE_RATE_HZ), outside=outside)
    rate = (len(coarse.samples) - 1) / float(coarse.samples[-1, 0] - coarse.samples[0, 0])
    count = 2 * int(np.ceil(max_offset_s * min(rate, 200.0))) + 1
    offsets = np.linspace(-max_offset_s, max_offset_s, max(count, 3))
    low, high = corner_range(pair)
    corners = np.geomspace(max(3.0 * low, 0.3), high / 1.5, COARSE_CORNERS)
    table = np.array([[evaluate(coarse, t, w).likelihood for w in corners] for t in offsets])
    return offsets, table.max(axis=1)


def _refined(pair: Pair, offsets: Floats, curve: Floats) -> list[Fit]:
    """The highest maxima of the scanned curve, each refined.

    Half a step off, a misfit looks like accelerometer noise; so the noise ratio is sought anew at the refined offset.
    """
    padded = np.concatenate(([-np.inf], curve, [-np.inf]))
    peaks = np.flatnonzero((padded[1:-1] >= padded[:-2]) & (padded[1:-1] > padded[2:]))
    step = float(offsets[1] - offsets[0])
    best = peaks[np.argsort(curve[peaks])[::-1][:CANDIDATES]]
    near = [refine(pair, best_corner(pair, float(offsets[i])), step) for i in best]
    return [refine(pair, best_corner(pair, fit.offset_s), step) for fit in near]


def _cleaned(pair: Pair, fit: Fit, bound_s: float) -> Pair:
    """The pair without outliers; each round takes out the largest, which had hidden the smaller ones."""
    for _ in range(MARKING_ROUNDS):
        cleaned = mark_outliers(pair, fit)
        if cleaned is pair:
            break
        pair = cleaned
        fit = refine(pair, fit, bound_s)
    return pair


def curvature(pair: Pair, fit: Fit) -> tuple[float, float]:
    """Variance of the time offset (s²) from the curvature of the likelihood, and d(ratio)/d(offset) there."""
    step = 1e-4
    while True:
        before, after = (evaluate(pair, fit.offset_s + sign * step, fit.corner) for sign in (-1.0, 1.0))
        middle = evaluate(pair, fit.offset_s, fit.corner)
        drop = middle.likelihood - 0.5 * (before.likelihood + after.likelihood)
        # A drop of about one is far above rounding and still near the summit.
        if drop > 0.5 or step > 0.05:
            break
        step *= 2.0
    variance = step * step / (2.0 * drop) if drop > 0 else np.inf
    return float(variance), float((after.ratio - before.ratio) / (2.0 * step))


def mark_outliers(pair: Pair, fit: Fit) -> Pair:
    """The pair with measurements far outside the fit marked unusable; the same object when there are none.

    A wrong measurement kicks the filter, and the next innovations with it: only the largest of neighbours is marked.
    """
    residual = fit.residual
    spread = 1.4826 * float(np.median(np.abs(residual - np.median(residual))))
    size = np.abs(residual)
    largest = sliding_window_view(np.pad(size, 2), 5).max(axis=1) if len(size) else size
    bad = (size > OUTLIER_LIMIT * max(spread, 1e-12)) & (size == largest)
    if not bad.any() or spread == 0.0:
        return pair
    rows = pair.rows.copy()
    rows[fit.whitened.index[bad].astype(np.int64), 2] = np.inf
    return replace(pair, rows=rows)


def without_lonely_outliers(pair: Pair) -> Pair:
    """Mark single measurements that leave their three neighbours on each side far more than these differ.

    What the neighbours do is the measure, not the whole record: a passing vehicle in a quiet minute is no outlier.
    """
    return replace(pair, rows=without_lonely(pair.rows))


def without_lonely(rows: Floats) -> Floats:
    """Rows (m, 3) of time, value and variance with the lonely outliers' variance made infinite."""
    rows = rows.copy()
    for _ in range(MARKING_ROUNDS):
        bad = _lonely(rows)
        rows[bad, 2] = np.inf
        if not len(bad):
            break
    return rows


def _lonely(rows: Floats) -> NDArray[np.int64]:
    index = np.flatnonzero(np.isfinite(rows[:, 2]))
    if len(index) < 8:
        return np.empty(0, dtype=np.int64)
    place, value = np.arange(len(index)), rows[index, 1]
    # At both ends the neighbours are the six nearest: the filter starts from the first ones, they must be right.
    first = np.clip(place - 3, 0, len(index) - 7)
    near = first[:, None] + np.arange(7)
    around = np.sort(value[near[near != place[:, None]].reshape(-1, 6)], axis=1)
    # One more outlier among the six neighbours does no harm.
    low, high = around[:, 1], around[:, -2]
    excess = np.maximum(value - high, low - value)
    lonely: NDArray[np.int64] = index[excess > LONELY_LIMIT * np.maximum(high - low, np.median(high - low))]
    return lonely


def thinned(samples: Floats, rate_hz: float) -> Floats:
    """Averages of neighbouring samples (n/k, 3) so that their rate stays near `rate_hz`."""
    rate = (len(samples) - 1) / float(samples[-1, 0] - samples[0, 0])
    group = int(rate // rate_hz)
    if group < 2:
        return samples
    count = len(samples) // group
    means: Floats = samples[: count * group].reshape(count, group, 3).mean(axis=1)
    return means
