"""A crowd of outliers: too many readings are wrong for a fit of all of them to separate.

The path that the acceleration gives is fitted to the readings with slow motion left open, by a loss that is bounded and
that narrows (graduated non-convexity: A. Blake and A. Zisserman, Visual Reconstruction, 1987; S. Geman and D. McClure,
1985). The crowd is one where the readings are clearly likelier as white noise about the path together with a share of
them anywhere within their span, than as noise alone, whose size may change from moment to moment: a sensor or an
accelerometer that is noisy for a while, or off its place, is no crowd.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from midspan.calibration.agreement import least_lead
from midspan.calibration.causes import MIN_READINGS, Comparison, slow_motion
from midspan.calibration.fit import Pair
from midspan.calibration.outliers import shaken_rows
from midspan.records import Floats
from midspan.signals.medians import white_noise

# Readings that are fitted at once, and the most of a record, for speed.
PIECE, MAX_READINGS = 600, 100_000
# A reading is wrong beyond this many robust deviations.
LIMIT = 5.0
# The loss narrows by this factor a round, so often: from the readings' span to a hundredth of a percent of it.
NARROWER, ROUNDS = 0.8, 40
# What most readings share is right: fewer than half of them are wrong; of each of BLOCKS parts of the record, at most
# this share, which chance does not reach where it is half of all.
MAX_WRONG, BLOCKS, MAX_OF_BLOCK = 0.5, 6, 0.7
# At least half of the wrong ones lie this many deviations or more from the others.
APART = 7.5
# Fewer are no crowd: a fit of all tells them, and a filter's gate.
MIN_WRONG = 0.1
# Motion is compared down to where the accelerometer's noise, integrated twice, is this share of the readings' variance.
MAX_NOISE_SHARE = 0.01
# Noise alone is of one size in so many readings.
NOISE_READINGS = 20
# The spread is that of the nearest readings: NEAREST of a normal distribution lie within OF_NORMAL deviations.
NEAREST, OF_NORMAL = 0.3, 0.3853


def crowd_of_outliers(pair: Pair) -> NDArray[np.bool_]:
    """Which readings (m,) are a crowd of outliers, with those at both ends; none where there is no crowd.

    pair: in m, on one clock with the acceleration.
    """
    crowd = np.zeros(len(pair.rows), dtype=bool)
    usable = np.flatnonzero(np.isfinite(pair.rows[:, 2]) & np.isfinite(pair.rows[:, 1]))
    if not MIN_READINGS <= len(usable) <= MAX_READINGS:
        return crowd
    rows = pair.rows[usable]
    compared = Comparison.of(replace(pair, rows=rows), len(usable), _clear_hz(pair, rows))
    if len(compared.time_s) < MIN_READINGS:
        return crowd
    differs = compared.value_m - compared.path()(compared.time_s)
    pieces = np.array_split(np.arange(len(differs)), -(-len(differs) // PIECE))
    bases = [slow_motion(compared.time_s[piece], compared.slowest_hz) for piece in pieces]
    left = np.concatenate([_robust(differs[k], q) for k, q in zip(pieces, bases, strict=True)])
    far = np.abs(left) > LIMIT * _spread(left)
    if not far.any():
        return crowd
    # What a slow sensor shows of a structure that rings is no outlier.
    shaken = shaken_rows(replace(pair, rows=rows))[compared.inside]
    if np.mean(shaken[far]) < MAX_WRONG and _scattered(left, far) and _gain(left, far) > least_lead(len(left)):
        # At both ends, where the integral is open, none of them can be separated from the others.
        crowd[usable] = True
        crowd[usable[compared.inside]] = far
    return crowd


def _clear_hz(pair: Pair, rows: Floats) -> float:
    """The frequency above which white noise of the acceleration, integrated twice, is little of the rows' variance.

    Of a density S (one-sided) the variance above f is S / (3 (2π)⁴ f³).
    """
    density = 2.0 * white_noise(pair.samples[:, 1]) ** 2 / pair.sample_rate_hz
    power = max(float(np.var(rows[:, 1])), 1e-300)
    return float(np.cbrt(density / (3.0 * (2.0 * np.pi) ** 4 * MAX_NOISE_SHARE * power)))


def _scattered(left: Floats, far: NDArray[np.bool_]) -> bool:
    """Whether what is `far` (n,) off lies clearly apart from the rest, and is the lesser part everywhere.

    What begins at an instant is another thing: a clock that steps, a sensor that is stuck, a motion that it misses.
    """
    if not MIN_WRONG < np.mean(far) < MAX_WRONG or np.median(np.abs(left[far])) < APART * _spread(left):
        return False
    return all(np.mean(part) < MAX_OF_BLOCK for part in np.array_split(far, BLOCKS))


def _robust(differs: Floats, basis: Floats) -> Floats:
    """What is left of differences (n,) without the slow motion, columns (n, k), that most of them share."""
    left = differs - np.median(differs)
    width = 2.0 * float(np.max(np.abs(left)))
    for _ in range(ROUNDS):
        root = 1.0 / (1.0 + (left / max(width, 1e-300)) ** 2)
        left = differs - basis @ np.linalg.lstsq(basis * root[:, None], differs * root, rcond=None)[0]
        width = max(NARROWER * width, _spread(left))
    return np.asarray(left)


def _spread(left: Floats) -> float:
    """Standard deviation of what is left (n,), whatever up to half of it is."""
    return float(np.quantile(np.abs(left), NEAREST)) / OF_NORMAL


def _gain(left: Floats, far: NDArray[np.bool_]) -> float:
    """By how much the readings are likelier (logarithm) with a crowd than as noise whose size changes.

    left (n,): what the robust fit leaves; far (n,): the crowd, anywhere within the span.
    """
    inner, share, span = left[~far], float(np.mean(far)), float(np.ptp(left))
    pieces = np.array_split(left, -(-len(left) // NOISE_READINGS))
    without = sum(_noise_alone(piece) for piece in pieces)
    about = _noise_alone(inner) + len(inner) * np.log1p(-share)
    return float(about + np.count_nonzero(far) * (np.log(share) - np.log(span)) - without)


def _noise_alone(left: Floats) -> float:
    """Logarithm of the likelihood of readings (n,) as white noise of the size that they have."""
    return float(-0.5 * len(left) * np.log(2.0 * np.pi * np.e * max(np.mean(left**2), 1e-300)))
