"""The clock offset between a displacement-like sensor and the accelerometer, by maximum likelihood.

The likelihood is evaluated with the accelerometer's full-rate response at the exact instants of the other sensor, so an
aliased camera needs no special care. It has many maxima when the motion is nearly a single tone; all of them are
refined and compared, and the runner-up is reported so that an ambiguity can be refused.

Beyond the range that is searched other measurements lie within the acceleration; the others are as likely as without
any. What counts there is the evidence: by how much (logarithm of the likelihood) the acceleration explains the
measurements better than the smoothest motion of no acceleration does.
"""

from dataclasses import dataclass, replace

import numpy as np

from midspan.calibration.agreement import clearly_better, least_lead
from midspan.calibration.fit import (
    MIN_RATIO,
    PRIOR_POWER,
    Fit,
    Pair,
    best_corner,
    corner_range,
    evaluate,
    gauss_newton,
    likelihood_of,
    refine,
    with_corner_doubt,
    with_input_noise,
)
from midspan.calibration.outliers import cleaned, without_lonely_outliers
from midspan.calibration.own_noise import exceeds_own_noise
from midspan.calibration.whitening import levelled, products_of
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
# Offsets are tried with the measurements that lie within the acceleration at all offsets of a segment, s.
SEGMENT_S = 1.0
# This many measurements are needed to look for another offset.
MIN_ROWS = 20
# So much of a long record is compared at all offsets, s.
PART_S = 120.0
# An offset is that of the clocks, whatever is left, where the acceleration explains more than this share of the
# innovations' power there and at no other offset more than this share of the evidence is found. A tone's alternatives
# have nearly all of it, those of another event hardly any anywhere.
MIN_EXPLAINED, MAX_SHARE = 0.5, 0.5


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

        def later(fit: Fit) -> Fit:
            return replace(fit, offset_s=fit.offset_s + late_s)

        return replace(
            self,
            fit=later(self.fit),
            offset=TimeOffset(self.offset.value_s + late_s, self.offset.variance),
            runner_up=None if self.runner_up is None else later(self.runner_up),
            offsets_s=self.offsets_s + late_s,
            pair=self.pair.changed(rows=self.pair.rows - np.array([late_s, 0.0, 0.0])),
        )


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
        best = max(fits, key=likelihood_of)
        # What is lively is no outlier. What outliers have hidden shows in a search without them.
        again = cleaned(with_input_noise(pair, best)[0] if turn == 0 else pair, best, step)
        if _may_shrink(pair, _apart(fits, best, step), best):
            again = replace(again, reference=abs(best.ratio))
        if again is pair:
            break
        pair = again
    if turn > 0:
        # In the first turn it is as it was there.
        pair = with_input_noise(pair, best)[0]
    fits = [refine(pair, fit, step) for fit in fits]
    best = max(fits, key=likelihood_of)
    if edge_s > 0.0:
        # Those within, give or take their deviation, unless one is clearly better than these.
        reach = [max_offset_s + BEYOND * np.sqrt(min(curvature(pair, fit)[0], MAX_BEYOND**2)) for fit in fits]
        near = [fit for fit, reach_s in zip(fits, reach, strict=True) if abs(fit.offset_s) < reach_s]
        inner = max(near, key=likelihood_of, default=None)
        if inner is not None and (inner is best or not clearly_better(best, inner)):
            fits, best = near, inner
    runner_up = max(_apart(fits, best, step), key=likelihood_of, default=None)
    variance, drag = curvature(pair, best)
    best = with_corner_doubt(pair, best, disputed=exceeds_own_noise(pair, best))
    best = replace(best, ratio_variance=best.ratio_variance + drag * drag * variance)
    return OffsetSearch(best, TimeOffset(best.offset_s, variance), runner_up, offsets, curve, pair)


def _grid(pair: Pair, first_s: float, last_s: float) -> Floats:
    count = int(np.ceil((last_s - first_s) * min(pair.sample_rate_hz, MAX_RATE_HZ))) + 1
    return np.linspace(first_s, last_s, max(count, 3))


def scan(pair: Pair, offsets: Floats) -> tuple[Floats, Floats]:
    """Likelihood (k,) at offsets (k,) with the best of a few corner frequencies, and that corner frequency (k,).

    Minus infinity where too little of both signals overlaps.
    """
    corners = _coarse_corners(pair)
    index = np.intersect1d(pair.used(float(offsets[0])), pair.used(float(offsets[-1])))
    middle = pair.used(float(np.mean(offsets)))
    rows = pair.rows[index if len(index) > OVERLAP * len(middle) else middle]
    parts = _in_parts(offsets, len(rows))
    table = np.concatenate([_likelihoods(pair, rows, part, corners)[0] for part in parts], axis=1)
    first_s, last_s = float(pair.responses[0].edges_s[0]), float(pair.samples[-1, 0])
    time_s = pair.rows[np.isfinite(pair.rows[:, 2]), 0]
    at_s = (np.add.outer(part, time_s) for part in parts)
    overlap = np.concatenate([np.count_nonzero((at >= first_s) & (at <= last_s), axis=1) for at in at_s])
    curve = np.where(overlap >= OVERLAP * len(middle), table.max(axis=0), -np.inf)
    return curve, corners[np.argmax(table, axis=0)]


def _in_parts(offsets: Floats, rows: int) -> list[Floats]:
    return np.array_split(offsets, min(len(offsets), -(-len(offsets) * rows // AT_ONCE)))


def _coarse_corners(pair: Pair) -> Floats:
    low, high = corner_range(pair)
    return np.asarray(np.geomspace(max(3.0 * low, 0.3), high / 1.5, COARSE_CORNERS))


def _likelihoods(pair: Pair, rows: Floats, offsets: Floats, corners: Floats) -> tuple[Floats, Floats]:
    """Likelihood (corners, offsets) with and without the acceleration: one run of the filter for each corner, rad/s."""
    count, time_s = len(offsets), rows[:, :1] + offsets
    responses = [response.at(time_s, pair.exposure_s, pair.logger) for response in pair.responses]
    values = levelled(rows[:, 0], np.column_stack((rows[:, 1], *responses)), drifts=pair.bias_drifts)[0]
    at = np.column_stack((rows[:, 0] + float(np.mean(offsets)), rows[:, 2]))
    table, without = np.empty((len(corners), count)), np.empty((len(corners), count))
    apart = count if pair.outside is not None else 0
    for k, corner in enumerate(corners):
        w = products_of(at, values, pair.pieces, corner**4 / pair.rate_hz, apart)
        total, response = w.squares[0], slice(1, 1 + count)
        cross, power = w.with_first[response], w.squares[response]
        if pair.outside is not None:
            own, seen, shared = w.squares[1 + count :], w.with_first[1 + count :], w.with_later[response]
            total, cross, power = total - seen**2 / own, cross - seen * shared / own, power - shared**2 / own
        ratio = cross / np.maximum(power, 1e-300) if pair.ratio is None else pair.ratio
        left = np.maximum(total - 2.0 * ratio * cross + ratio * ratio * power, 1e-300)
        alike = PRIOR_POWER * np.log(corner) - w.entropy
        table[k], without[k] = (
            alike - 0.5 * w.count * np.log(np.maximum(one, 1e-300) / w.count) for one in (left, total)
        )
        if pair.ratio is None and pair.reference is not None:
            table[k] += w.input_share * np.log(np.maximum(np.abs(ratio) / pair.reference, MIN_RATIO))
    return table, without


def _refined(pair: Pair, offsets: Floats, curve: Floats, corner: Floats) -> list[Fit]:
    """The highest maxima of the scanned curve, each refined."""
    padded = np.concatenate(([-np.inf], curve, [-np.inf]))
    peaks = np.flatnonzero((padded[1:-1] >= padded[:-2]) & (padded[1:-1] > padded[2:]))
    step = float(offsets[1] - offsets[0])
    best = peaks[np.argsort(curve[peaks])[::-1][:CANDIDATES]]
    near = [refine(pair, evaluate(pair, float(offsets[i]), float(corner[i])), step) for i in best]
    near = sorted(near, key=likelihood_of, reverse=True)[:CONTENDERS]
    return [refine(pair, best_corner(pair, fit.offset_s), step) for fit in near]


def _apart(fits: list[Fit], best: Fit, step_s: float) -> list[Fit]:
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
    pair = pair.changed(ratio=None, reference=None)
    pair = with_input_noise(pair, best_corner(pair, near.offset_s))[0]
    sides = [_grid(pair, -until_s, -within_s), _grid(pair, within_s, until_s)]
    best = max((fit for side in sides for fit in _refined(pair, side, *scan(pair, side))), key=likelihood_of)
    companions = [best_corner(pair, near.offset_s + aside) for aside in (-DRIFTED_S, 0.0, DRIFTED_S)]
    own = max((refine(pair, fit, 0.5 * DRIFTED_S) for fit in companions), key=likelihood_of)
    return best if abs(best.offset_s) > within_s and clearly_better(best, own) else None


@dataclass(frozen=True, slots=True)
class Rival:
    """The likeliest fit beyond a range of offsets, its evidence, and that of the best one within the range.

    lead: by how much it is the likelier one (logarithm); better: beyond doubt; alike: noise may have decided.
    """

    fit: Fit
    evidence: float
    within: float
    lead: float
    better: bool
    alike: bool


def likeliest_beyond(pair: Pair, near: Fit, within_s: float) -> Rival | None:
    """The likeliest fit at a clock offset beyond ±`within_s`, as far as half of the measurements still overlap.

    pair: with the outliers of the best fit within, `near`, marked, and the ratio None where it is unknown. None where
    nothing farther explains anything.
    """
    # A smaller ratio leaves less of the accelerometer's noise, whichever is true: see `fit.shrinking`.
    reference = abs(near.ratio) if pair.ratio is None else None
    pair = pair.changed(reference=reference, motion_share=0.0, bias_drifts=False)
    offsets = _offsets(pair, within_s)
    step = 1.0 / min(pair.sample_rate_hz, MAX_RATE_HZ)
    if not offsets:
        return None
    evidence, corner = (np.concatenate(one) for one in zip(*(_scan(pair, part) for part in offsets), strict=True))
    at_s = np.concatenate(offsets)
    fits = [refine(pair, evaluate(pair, float(at_s[k]), float(corner[k])), step) for k in _peaks(at_s, evidence, step)]
    apart = [fit for fit in fits if abs(fit.offset_s) > within_s and abs(fit.offset_s - near.offset_s) > 2.0 * step]
    if not apart:
        return None
    best = max(apart, key=lambda fit: _evidence(pair, fit))
    # Each with what the accelerometer errs by at its offset.
    near, best = (refine(*with_input_noise(pair, best_corner(pair, fit.offset_s)), step) for fit in (near, best))
    certain = least_lead(len(pair.used(near.offset_s)))
    beyond, within = _evidence(pair, best), _evidence(pair, near)
    lead = beyond - within
    return Rival(best, beyond, within, lead, better=lead >= certain, alike=abs(lead) < certain)


def stands_alone(pair: Pair, fit: Fit) -> bool:
    """Whether the acceleration explains most of the measurements at a fit's offset, and at no other half as well.

    What is left then is an error of a sensor in proportion to the motion, for no offset of another motion does that.
    """
    pair = first_part(pair)
    if not len(pair.used(fit.offset_s)):
        return False
    rival = likeliest_beyond(pair, fit, 0.0)
    if rival is None:
        return False
    explained = 1.0 - float(np.exp(-2.0 * rival.within / len(pair.used(fit.offset_s))))
    return explained > MIN_EXPLAINED and rival.evidence < MAX_SHARE * rival.within


def first_part(pair: Pair) -> Pair:
    """The pair's first measurements, with the acceleration for as long before and after: a long scan takes long."""
    first, last = float(pair.rows[0, 0]), float(pair.rows[0, 0]) + PART_S
    if pair.rows[-1, 0] <= last:
        return pair
    rows = pair.rows[pair.rows[:, 0] <= last]
    near = (pair.samples[:, 0] >= first - PART_S) & (pair.samples[:, 0] <= last + PART_S)
    outside = None if pair.outside is None else pair.outside[near]
    return pair.changed(rows=rows, samples=pair.samples[near], outside=outside, cross=None)


def _evidence(pair: Pair, fit: Fit) -> float:
    return fit.likelihood - best_corner(pair.changed(ratio=0.0), fit.offset_s).likelihood


def _offsets(pair: Pair, within_s: float) -> list[Floats]:
    """Offsets beyond ±`within_s`, in parts, at which at least OVERLAP of the measurements are in the acceleration."""
    time_s = pair.rows[np.isfinite(pair.rows[:, 2]), 0]
    if len(time_s) < MIN_ROWS:
        return []
    first, last = float(pair.responses[0].edges_s[0]), float(pair.samples[-1, 0])
    rate = min(pair.sample_rate_hz, MAX_RATE_HZ)
    grid = np.arange(first - time_s[-1], last - time_s[0], 1.0 / rate)
    count = np.searchsorted(time_s, last - grid, side="right") - np.searchsorted(time_s, first - grid, side="left")
    enough = count >= max(OVERLAP * float(np.max(count, initial=0)), MIN_ROWS)
    found = grid[enough & (np.abs(grid) > within_s)]
    ends = np.flatnonzero(np.diff(found) > 1.5 / rate) + 1
    length = max(round(SEGMENT_S * rate), 1)
    return [part[k : k + length] for part in np.split(found, ends) for k in range(0, len(part), length)]


def _scan(pair: Pair, offsets: Floats) -> tuple[Floats, Floats]:
    """Evidence (k,) at offsets (k,) that follow each other, and the likeliest corner frequency (k,), rad/s."""
    corners = _coarse_corners(pair)
    rows = pair.rows[np.intersect1d(pair.used(float(offsets[0])), pair.used(float(offsets[-1])))]
    tables = [_likelihoods(pair, rows, part, corners) for part in _in_parts(offsets, len(rows))]
    found, without = (np.concatenate(one, axis=1) for one in zip(*tables, strict=True))
    return found.max(axis=0) - without.max(axis=0), corners[np.argmax(found, axis=0)]


def _peaks(at_s: Floats, evidence: Floats, step_s: float) -> list[int]:
    """The highest maxima of evidence (k,) at offsets (k,), in segments of which each goes on by a step."""
    close = np.diff(at_s) < 1.5 * step_s
    before = np.r_[-np.inf, np.where(close, evidence[:-1], -np.inf)]
    after = np.r_[np.where(close, evidence[1:], -np.inf), -np.inf]
    peaks = np.flatnonzero((evidence >= before) & (evidence > after))
    return [int(k) for k in peaks[np.argsort(evidence[peaks])[::-1][:CANDIDATES]]]
