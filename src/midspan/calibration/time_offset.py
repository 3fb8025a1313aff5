"""The clock offset between a displacement-like sensor and the accelerometer, by maximum likelihood.

The likelihood is evaluated with the accelerometer's full-rate response at the exact instants of the other sensor, so an
aliased camera needs no special care. It has many maxima when the motion is nearly a single tone; all of them are
refined and compared, and the runner-up is reported so that an ambiguity can be refused.
"""

from dataclasses import dataclass, replace

import numpy as np

from midspan.calibration.agreement import clearly_better
from midspan.calibration.fit import (
    MIN_RATIO,
    PRIOR_POWER,
    Fit,
    Pair,
    best_corner,
    corner_range,
    evaluate,
    gauss_newton,
    refine,
    with_corner_doubt,
    with_input_noise,
)
from midspan.calibration.outliers import cleaned, without_lonely_outliers
from midspan.calibration.own_noise import exceeds_own_noise
from midspan.calibration.whitening import levelled, whiten_columns
from midspan.records import Floats, TimeOffset

# Noise ratios tried at each offset, and values whitened at once, for memory. Offsets are tried at the rate of the
# accelerometer, at this one at most: 5 ms are an eighth of the period of 25 Hz.
COARSE_CORNERS, AT_ONCE, MAX_RATE_HZ = 4, 1_000_000, 200.0
# At an offset this share of the measurements must lie within the acceleration.
OVERLAP = 0.5
# Maxima of the coarse curve that are refined, and of these the ones that are with a noise ratio sought anew.
CANDIDATES, CONTENDERS = 6, 3
# Rounds of searching anew without outliers and with a new reference, at most.
ROUNDS = 6
# The pull towards smaller ratios, in standard deviations of the offset, that is left as it is.
MAX_PULLED = 0.1
# Where the accelerometer's noise would be this share of its signal, the sensors do not agree.
EXPLAINED_BY_NOISE = 0.3
# An offset beyond the largest by less than this many of its standard deviations, of this many s at most, is within.
BEYOND, MAX_BEYOND = 3.0, 0.02
# How much farther than the longest offset is looked, in s and as a share of it, and in so much of the record at most.
FARTHER_S, FARTHER_SHARE, FARTHER_WINDOW_S = 5.0, 0.5, 120.0
# A clock that drifts has another offset in a part of the record than in the whole: by so much, s.
DRIFTED_S = 0.1


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

    def on_clock(self, late_s: float) -> "OffsetSearch":
        """The same where the other sensor's stamps are earlier by `late_s`, so that all offsets are larger."""
        offset = TimeOffset(self.offset.value_s + late_s, self.offset.variance)
        fit, other = (
            None if one is None else replace(one, offset_s=one.offset_s + late_s) for one in (self.fit, self.runner_up)
        )
        assert fit is not None
        pair = replace(self.pair, rows=self.pair.rows - np.array([late_s, 0.0, 0.0]))
        return OffsetSearch(fit, offset, other, self.offsets_s + late_s, self.likelihood, pair)


def search_offset(pair: Pair, max_offset_s: float, edge_s: float = 0.0) -> OffsetSearch:
    """Find the time offset within ±`max_offset_s` that makes translation and acceleration agree best.

    edge_s: so much farther is searched, so that an offset near the largest is found; one clearly beyond is given only
    where it is clearly better than all within.
    """
    pair = without_lonely_outliers(pair)
    offsets = _grid(pair, -max_offset_s - edge_s, max_offset_s + edge_s)
    step = float(offsets[1] - offsets[0])
    for turn in range(ROUNDS):
        curve, corner = scan(pair, offsets)
        fits = _refined(pair, offsets, curve, corner)
        best = max(fits, key=_likelihood)
        # What is lively is no outlier. What outliers have hidden shows in a search without them.
        again = cleaned(with_input_noise(pair, best)[0] if turn == 0 else pair, best, step)
        if _may_shrink(pair, _apart(fits, best, step), best):
            again = replace(again, reference=abs(best.ratio))
        if again is pair:
            break
        pair = again
    pair = with_input_noise(pair, best)[0]
    fits = [refine(pair, fit, step) for fit in fits]
    best = max(fits, key=_likelihood)
    if edge_s > 0.0:
        fits = _within(pair, fits, max_offset_s)
        best = max(fits, key=_likelihood)
    runner_up = max(_apart(fits, best, step), key=_likelihood, default=None)
    variance, drag = curvature(pair, best)
    best = with_corner_doubt(pair, best, disputed=exceeds_own_noise(pair, best))
    best = replace(best, ratio_variance=best.ratio_variance + drag * drag * variance)
    return OffsetSearch(best, TimeOffset(best.offset_s, variance), runner_up, offsets, curve, pair)


def _likelihood(fit: Fit) -> float:
    return fit.likelihood


def _grid(pair: Pair, first_s: float, last_s: float) -> Floats:
    """Offsets (k,) from the first to the last, a sample apart."""
    count = int(np.ceil((last_s - first_s) * min(pair.sample_rate_hz, MAX_RATE_HZ))) + 1
    return np.linspace(first_s, last_s, max(count, 3))


def scan(pair: Pair, offsets: Floats) -> tuple[Floats, Floats]:
    """Likelihood (k,) at offsets (k,) with the best of a few corner frequencies, and that corner frequency (k,).

    Minus infinity where too little of both signals overlaps.
    """
    corners = coarse_corners(pair)
    index = np.intersect1d(pair.used(float(offsets[0])), pair.used(float(offsets[-1])))
    middle = pair.used(float(np.mean(offsets)))
    rows = pair.rows[index if len(index) > OVERLAP * len(middle) else middle]
    parts = np.array_split(offsets, min(len(offsets), -(-len(offsets) * len(rows) // AT_ONCE)))
    table = np.concatenate([likelihoods(pair, rows, part, corners)[0] for part in parts], axis=1)
    overlap = np.array([len(pair.used(float(offset))) for offset in offsets])
    curve = np.where(overlap >= OVERLAP * len(middle), table.max(axis=0), -np.inf)
    return curve, corners[np.argmax(table, axis=0)]


def coarse_corners(pair: Pair) -> Floats:
    """The few corner frequencies (rad/s) that are tried at every offset."""
    low, high = corner_range(pair)
    return np.asarray(np.geomspace(max(3.0 * low, 0.3), high / 1.5, COARSE_CORNERS))


def likelihoods(pair: Pair, rows: Floats, offsets: Floats, corners: Floats) -> tuple[Floats, Floats]:
    """Likelihood (corners, offsets) with and without the acceleration.

    All offsets in one run of the filter for each corner frequency (rad/s).
    """
    count, time_s = len(offsets), rows[:, :1] + offsets
    responses = [response.at(time_s, pair.exposure_s, pair.logger) for response in pair.responses]
    values = levelled(rows[:, 0], np.column_stack((rows[:, 1], *responses)), drifts=pair.bias_drifts)[0]
    at = np.column_stack((rows[:, 0] + float(np.mean(offsets)), rows[:, 2]))
    table, without = np.empty((len(corners), count)), np.empty((len(corners), count))
    for k, corner in enumerate(corners):
        w = whiten_columns(at, values, pair.pieces, corner**4 / pair.rate_hz)
        standard = w.columns / np.sqrt(w.variance)[:, None]
        translation, response, outside = np.split(standard, (1, 1 + count), axis=1)
        total, cross, power = _sums(translation, translation), _sums(translation, response), _sums(response, response)
        if pair.outside is not None:
            own, seen, shared = _sums(outside, outside), _sums(translation, outside), _sums(response, outside)
            total, cross, power = total - seen**2 / own, cross - seen * shared / own, power - shared**2 / own
        ratio = cross / np.maximum(power, 1e-300) if pair.ratio is None else pair.ratio
        left = np.maximum(total - 2.0 * ratio * cross + ratio * ratio * power, 1e-300)
        n = len(w.variance)
        alike = PRIOR_POWER * np.log(corner) - w.entropy
        table[k], without[k] = (alike - 0.5 * n * np.log(np.maximum(one, 1e-300) / n) for one in (left, total))
        if pair.ratio is None and pair.reference is not None:
            table[k] += w.input_share * np.log(np.maximum(np.abs(ratio) / pair.reference, MIN_RATIO))
    return table, without


def _sums(first: Floats, second: Floats) -> Floats:
    """Sums of the products of columns (m, c)."""
    return np.asarray(np.einsum("mc,mc->c", *np.broadcast_arrays(first, second)))


def _refined(pair: Pair, offsets: Floats, curve: Floats, corner: Floats) -> list[Fit]:
    """The highest maxima of the scanned curve, each refined.

    Half a step off, a misfit looks like accelerometer noise; so the noise ratio is sought anew at the refined offset.
    """
    padded = np.concatenate(([-np.inf], curve, [-np.inf]))
    peaks = np.flatnonzero((padded[1:-1] >= padded[:-2]) & (padded[1:-1] > padded[2:]))
    step = float(offsets[1] - offsets[0])
    best = peaks[np.argsort(curve[peaks])[::-1][:CANDIDATES]]
    near = [refine(pair, evaluate(pair, float(offsets[i]), float(corner[i])), step) for i in best]
    near = sorted(near, key=_likelihood, reverse=True)[:CONTENDERS]
    return [refine(pair, best_corner(pair, fit.offset_s), step) for fit in near]


def _within(pair: Pair, fits: list[Fit], limit_s: float) -> list[Fit]:
    """The fits within ±`limit_s`, give or take their deviation; the others where one is clearly better than these."""
    near = [f for f in fits if abs(f.offset_s) < limit_s + BEYOND * np.sqrt(min(curvature(pair, f)[0], MAX_BEYOND**2))]
    best = max(fits, key=_likelihood)
    inner = max(near, key=_likelihood, default=None)
    return fits if inner is None or (inner is not best and clearly_better(best, inner)) else near


def _apart(fits: list[Fit], best: Fit, step_s: float) -> list[Fit]:
    """The fits at other offsets than the best one's."""
    return [fit for fit in fits if abs(fit.offset_s - best.offset_s) > 2.0 * step_s]


def _may_shrink(pair: Pair, others: list[Fit], best: Fit) -> bool:
    """Whether the noise of the accelerometer can have led to an offset with too small a ratio (see `shrinking`)."""
    if pair.ratio is not None or (pair.reference is not None and abs(best.ratio) > 0.99 * pair.reference):
        return False
    if np.sqrt(best.input_density * pair.sample_rate_hz) > EXPLAINED_BY_NOISE * np.std(pair.samples[:, 1]):
        # Nothing agrees here, and all of the acceleration counts as noise.
        return False
    share = best.whitened.input_share
    if any(fit.likelihood + share * np.log(abs(fit.ratio / best.ratio)) > best.likelihood for fit in others):
        return True
    variance, drag = curvature(pair, best)
    pulled = share * abs(drag / best.ratio)
    return bool(pulled > 0.0 and pulled * np.sqrt(variance) > MAX_PULLED)


def curvature(pair: Pair, fit: Fit) -> tuple[float, float]:
    """Variance of the time offset (s²) from the curvature of the likelihood, and d(ratio)/d(offset) there."""
    # One expected standard deviation is far above rounding and still near the summit.
    step = float(np.clip(1.0 / np.sqrt(gauss_newton(pair, fit)[1]), 1e-6, 0.05))
    before, middle, after = (evaluate(pair, fit.offset_s + k * step, fit.corner) for k in (-1.0, 0.0, 1.0))
    drop = middle.likelihood - 0.5 * (before.likelihood + after.likelihood)
    variance = step * step / (2.0 * drop) if drop > 0 else np.inf
    return float(variance), float((after.ratio - before.ratio) / (2.0 * step))


def farther_s(max_offset_s: float) -> float:
    """How far beyond the largest offset (s) `farther` looks."""
    return max(FARTHER_S, FARTHER_SHARE * max_offset_s)


def farther(pair: Pair, near: Fit, within_s: float, until_s: float) -> Fit | None:
    """A clock offset between `within_s` and `until_s` that fits far better than the best one nearer, if there is one.

    pair: measurements that keep `until_s` from both ends of the acceleration; near: the best fit within.
    """
    if until_s - within_s < 3.0 / pair.sample_rate_hz:
        return None
    pair = replace(pair, ratio=None, reference=None)
    pair = with_input_noise(pair, best_corner(pair, near.offset_s))[0]
    sides = [_grid(pair, -until_s, -within_s), _grid(pair, within_s, until_s)]
    best = max((fit for side in sides for fit in _refined(pair, side, *scan(pair, side))), key=_likelihood)
    beside = [best_corner(pair, near.offset_s + aside) for aside in (-DRIFTED_S, 0.0, DRIFTED_S)]
    own = max((refine(pair, fit, 0.5 * DRIFTED_S) for fit in beside), key=_likelihood)
    return best if abs(best.offset_s) > within_s and clearly_better(best, own) else None
