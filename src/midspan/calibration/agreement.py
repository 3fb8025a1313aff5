"""Whether a clock offset that was found is to be believed: what is left of the motion, and what lies farther off.

The noise of a displacement sensor is not declared, so that at a wrong offset everything that is left would pass for
noise. But it is motion: innovations of a right model are white, whatever the noise levels (Kailath 1968,
doi:10.1109/TAC.1968.1099025), and at a wrong offset they are not.
"""

from dataclasses import replace

import numpy as np

from midspan.calibration.fit import Fit, Pair, best_corner, evaluate, refine
from midspan.records import Floats

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
# In a record longer than this a clock may run apart, and shows it in pieces of this length with at least so many
# measurements each, by an offset of this much at most.
LONG_S, PIECE_S, LEAST_IN_PIECE, PIECE_OFFSET_S = 100.0, 40.0, 30, 0.1


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
    """Sum of squared autocorrelations of the innovations times their number, and the sum itself."""
    residual = fit.residual
    residual = residual - np.median(residual)
    limit = CLIPPED * 1.4826 * float(np.median(np.abs(residual)))
    left = np.clip(residual, -limit, limit)
    power = float(np.sum(left**2))
    if len(left) <= 2 * FOLLOWING or power == 0.0:
        return 0.0, 0.0
    total = sum(float(np.sum(left[k:] * left[:-k]) / power) ** 2 for k in range(1, FOLLOWING + 1))
    return len(left) * total, total


def unexplained(pair: Pair, fit: Fit) -> bool:
    """Whether what the fit leaves is motion, not noise, even where the sensor's clock may run apart evenly."""
    if not _coloured(fit):
        return False
    straight = straightened(pair, fit)
    return straight is None or _coloured(straight[0])


def _coloured(fit: Fit) -> bool:
    statistic, share = colour(fit)
    return statistic > MOST_FOLLOWING and share > MOST_CORRELATED


def noise_share(pair: Pair, fit: Fit, noise: float) -> float:
    """The share of the response's power that white accelerometer noise (m/s² per sample) alone would make."""
    rate = (len(pair.samples) - 1) / float(pair.samples[-1, 0] - pair.samples[0, 0])
    assumed = fit.corner**4 / pair.rate_hz
    w = fit.whitened
    power = float(np.sum(w.response**2 / w.variance))
    return noise**2 / rate / assumed * float(np.sum(w.input_part / w.variance)) / max(power, 1e-300)


def straightened(pair: Pair, fit: Fit) -> tuple[Fit, float] | None:
    """The fit with a clock that runs apart evenly, and its rate (s/s); None where that is not clearly better."""
    rows = pair.rows[np.isfinite(pair.rows[:, 2])]
    count = min(int((rows[-1, 0] - rows[0, 0]) // PIECE_S), len(rows) // LEAST_IN_PIECE)
    if count * PIECE_S < LONG_S:
        return None
    found = np.array([_in_piece(pair, fit, piece) for piece in np.array_split(rows, count)])
    first, second = np.triu_indices(count, 1)
    rate = float(np.median((found[second, 1] - found[first, 1]) / (found[second, 0] - found[first, 0])))
    moved = pair.rows.copy()
    moved[:, 0] += rate * (moved[:, 0] - moved[:, 0].mean())
    pair = replace(pair, rows=moved)
    other = refine(pair, best_corner(pair, fit.offset_s), 0.02)
    return (other, rate) if clearly_better(other, fit) else None


def _in_piece(pair: Pair, fit: Fit, rows: Floats) -> tuple[float, float]:
    """The middle of a piece (s), and its own clock offset (s) near the whole record's."""
    first, last = rows[0, 0] + fit.offset_s - 2.0, rows[-1, 0] + fit.offset_s + 2.0
    inside = (pair.samples[:, 0] >= first) & (pair.samples[:, 0] <= last)
    piece = replace(pair, samples=pair.samples[inside], rows=rows)
    found = refine(piece, evaluate(piece, fit.offset_s, fit.corner), PIECE_OFFSET_S)
    return float(rows[:, 0].mean()), found.offset_s
