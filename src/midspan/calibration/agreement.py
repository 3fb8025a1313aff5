"""Whether a clock offset that was found is to be believed: what is left of the motion, and what lies farther off.

The noise of a displacement sensor is not declared, so that at a wrong offset everything that is left would pass for
noise. But it is motion: innovations of a right model are white, whatever the noise levels (Kailath 1968,
doi:10.1109/TAC.1968.1099025), and at a wrong offset they are not.
"""

from dataclasses import dataclass, replace

import numpy as np

from midspan.calibration.fit import Fit, Pair, best_corner, evaluate, refine
from midspan.records import Floats
from midspan.signals.health import dominant_frequency

# The less likely of two offsets must be so by this much, and its residual power larger by this share (a model never
# fits to the last digit, and with a very quiet camera the likelihood alone would be over-confident).
AMBIGUOUS_BELOW = 8.0
AMBIGUOUS_SHARE = 0.05
AMBIGUOUS_DRAWS = 3.0
# Innovations are compared with this many that follow; their squared correlations times their number sum up to this
# many when they are white (Box and Pierce 1970). Five times in a hundred thousand white ones reach the limit.
FOLLOWING = 10
MOST_FOLLOWING = 35.0
# In a long record noise that is a little coloured exceeds any limit: the correlations themselves must be large too.
MOST_CORRELATED = 0.15
# Innovations beyond this many robust standard deviations count as that many.
CLIPPED = 4.0
# How much farther than the longest offset is looked, in s and as a share of it, and in so much of the record at most.
FARTHER_S, FARTHER_SHARE, FARTHER_WINDOW_S = 5.0, 0.5, 120.0
# Corner frequencies tried there, over the best one's: a wrong fit takes motion for the accelerometer's noise.
FARTHER_CORNERS = (0.35, 0.7, 1.4)
FARTHER_PEAKS = 3
# Offsets tried per period of the main tone.
PER_PERIOD = 20.0
# A record longer than this is looked at in pieces of this length, as clocks run apart.
LONG_S, PIECE_S = 100.0, 40.0
# To see whether they do, the record is looked at in so many pieces with at least so many measurements each.
PIECES, LEAST_IN_PIECE = 8, 40
# Above this sum of squares per degree of freedom offset and ratio change along the record.
MOST_UNSTEADY = 2.5


def clearly_better(fit: Fit, other: Fit) -> bool:
    """Whether a fit is so much more likely than another that no noise can have decided between them."""
    share = other.noise / fit.noise * np.exp(_entropy(other.whitened.variance) - _entropy(fit.whitened.variance)) - 1.0
    # Alternatives of a single tone differ by what the noise looks like at shifted instants, which grows with sqrt(n).
    least = max(AMBIGUOUS_BELOW, AMBIGUOUS_DRAWS * np.sqrt(len(fit.whitened.variance)))
    return bool(fit.likelihood - other.likelihood >= least and share >= AMBIGUOUS_SHARE)


def _entropy(variance: Floats) -> float:
    """Mean logarithm of the innovations' variances, so that residual powers at two offsets compare."""
    return float(np.mean(np.log(variance)))


def colour(fit: Fit) -> tuple[float, float]:
    """Sum of squared autocorrelations of the innovations times their number, and their number."""
    residual = fit.residual
    residual = residual - np.median(residual)
    limit = CLIPPED * 1.4826 * float(np.median(np.abs(residual)))
    left = np.clip(residual, -limit, limit)
    power = float(np.sum(left**2))
    if len(left) <= 2 * FOLLOWING or power == 0.0:
        return 0.0, float(len(left))
    total = sum(float(np.sum(left[k:] * left[:-k]) / power) ** 2 for k in range(1, FOLLOWING + 1))
    return len(left) * total, float(len(left))


def unexplained(pair: Pair, fit: Fit) -> bool:
    """Whether what the fit leaves is motion, not noise; each piece of a long record may have its own clock offset."""
    length = float(pair.rows[-1, 0] - pair.rows[0, 0])
    count = int(length // PIECE_S) if length > LONG_S else 1
    fits = [fit]
    if count > 1:
        usable = pair.rows[np.isfinite(pair.rows[:, 2])]
        fits = [_in_piece(pair, fit, rows)[1] for rows in np.array_split(usable, count) if len(rows) > LEAST_IN_PIECE]
    found = np.array([colour(one) for one in fits] or [colour(fit)])
    statistic, measured = float(found[:, 0].sum()), float(found[:, 1].sum())
    most = FOLLOWING * len(found) + (MOST_FOLLOWING - FOLLOWING) * np.sqrt(len(found))
    return bool(statistic > most and statistic > MOST_CORRELATED * measured)


def noise_share(pair: Pair, fit: Fit, noise: float) -> float:
    """The share of the response's power that white accelerometer noise (m/s² per sample) alone would make."""
    rate = (len(pair.samples) - 1) / float(pair.samples[-1, 0] - pair.samples[0, 0])
    assumed = fit.corner**4 / pair.rate_hz
    w = fit.whitened
    power = float(np.sum(w.response**2 / w.variance))
    return noise**2 / rate / assumed * float(np.sum(w.input_part / w.variance)) / max(power, 1e-300)


def farther_s(max_offset_s: float) -> float:
    """How far beyond the largest offset (s) `farther` looks."""
    return max(FARTHER_S, FARTHER_SHARE * max_offset_s)


def farther(pair: Pair, near: Fit, within_s: float, until_s: float) -> Fit | None:
    """A clock offset between `within_s` and `until_s` that fits far better than the best one nearer, if there is one.

    pair: measurements that keep `until_s` from both ends of the acceleration; near: the best fit within.
    """
    rate = (len(pair.samples) - 1) / float(pair.samples[-1, 0] - pair.samples[0, 0])
    tone = max(dominant_frequency(pair.samples[:, 1], rate), 0.1)
    step = float(np.clip(1.0 / (PER_PERIOD * tone), 1.0 / rate, 0.05))
    if until_s - within_s < 3.0 * step:
        return None
    pair = replace(pair, ratio=None, reference=None)
    side = np.arange(within_s, until_s, step)
    starts = np.concatenate([_peaks(pair, sign * side, near.corner) for sign in (-1.0, 1.0)])
    highest = starts[np.argsort(starts[:, 1])[::-1][:FARTHER_PEAKS], 0]
    fits = [refine(pair, best_corner(pair, float(start)), step) for start in highest]
    best = max(fits, key=lambda fit: fit.likelihood)
    # Half a step off, a misfit looks like accelerometer noise; so the noise ratio is sought anew.
    best = refine(pair, best_corner(pair, best.offset_s), step)
    # A clock that runs apart has another offset here than in the whole record.
    beside = [refine(pair, best_corner(pair, near.offset_s + aside), 0.05) for aside in (-0.1, 0.0, 0.1)]
    own = max(beside, key=lambda fit: fit.likelihood)
    return best if abs(best.offset_s) > within_s and clearly_better(best, own) else None


def _peaks(pair: Pair, offsets: Floats, corner: float) -> Floats:
    """Offset and likelihood (k, 2) of the maxima along offsets (n,)."""
    curve = np.array([max(evaluate(pair, t, share * corner).likelihood for share in FARTHER_CORNERS) for t in offsets])
    padded = np.concatenate(([-np.inf], curve, [-np.inf]))
    peaks = (padded[1:-1] >= padded[:-2]) & (padded[1:-1] > padded[2:])
    return np.column_stack((offsets[peaks], curve[peaks]))


@dataclass(frozen=True, slots=True)
class Course:
    """Offset and ratio in pieces of a record where they change: rate of the offset (s/s), ratio and its deviation."""

    skew: float
    ratio: float
    ratio_std: float


def course(pair: Pair, fit: Fit) -> Course | None:
    """What pieces of the record say, where they contradict each other; None where one offset and ratio are enough."""
    pair = replace(pair, ratio=None, reference=None)
    count = min(PIECES, len(fit.whitened.variance) // LEAST_IN_PIECE)
    if count < 3 or _unsteadiness(pair, fit, count) < MOST_UNSTEADY:
        return None
    fits = [_in_piece(pair, fit, rows) for rows in np.array_split(pair.rows[np.isfinite(pair.rows[:, 2])], count)]
    middle = np.array([found[0] for found in fits])
    offset = np.array([found[1].offset_s for found in fits])
    ratio, variance = (np.array(v) for v in zip(*((f.ratio, f.ratio_variance) for _, f in fits), strict=True))
    weight = 1.0 / variance
    mean = float(np.sum(weight * ratio) / np.sum(weight))
    spread = np.sum(weight * (ratio - mean) ** 2) / (count - 1)
    return Course(
        skew=float(np.polyfit(middle, offset, 1, w=np.sqrt(weight))[0]),
        ratio=mean,
        ratio_std=float(np.sqrt(max(spread, 1.0) / np.sum(weight))),
    )


def _in_piece(pair: Pair, fit: Fit, rows: Floats) -> tuple[float, Fit]:
    """The middle of a piece (s), and its own best fit near the whole record's."""
    bound = 0.1
    first, last = rows[0, 0] + fit.offset_s - 2.0, rows[-1, 0] + fit.offset_s + 2.0
    inside = (pair.samples[:, 0] >= first) & (pair.samples[:, 0] <= last)
    piece = replace(pair, samples=pair.samples[inside], rows=rows)
    return float(rows[:, 0].mean()), refine(piece, evaluate(piece, fit.offset_s, fit.corner), bound)


def _unsteadiness(pair: Pair, fit: Fit, count: int) -> float:
    """Sum of squares per degree of freedom of what pieces add to offset and ratio, to first order."""
    step = 1e-4
    before, here, after = (evaluate(pair, fit.offset_s + sign * step, fit.corner).whitened for sign in (-1.0, 0.0, 1.0))
    n = min(len(w.variance) for w in (before, here, after))
    std = np.sqrt(fit.noise * here.variance[:n])
    slope = (after.translation - fit.ratio * after.response)[:n] - (before.translation - fit.ratio * before.response)[
        :n
    ]
    by = np.column_stack((here.response[:n], -slope / (2.0 * step))) / std[:, None]
    left = (here.translation - fit.ratio * here.response)[:n] / std
    limit = CLIPPED * 1.4826 * float(np.median(np.abs(left)))
    left = np.clip(left, -limit, limit)
    left = left - by @ np.linalg.lstsq(by, left, rcond=None)[0]
    total = 0.0
    for piece in np.array_split(np.arange(n), count):
        seen = by[piece] @ np.linalg.lstsq(by[piece], left[piece], rcond=None)[0]
        total += float(np.sum(seen**2))
    return total / (2.0 * (count - 1))
