"""The displacement's noise learnt while the filter runs: a factor on the declared variance of each source.

The mean square of the innovations cannot tell a noisier sensor from a bias or from acceleration noise that was told too
small. Their steps from one to the next can: what comes from the acceleration is alike in neighbours and cancels, the
sensor's own noise does not. With innovations e of predicted variance S, of which R is the sensor's,

    d = (e_k - e_(k-1))² / (S_k + S_(k-1)),      R <- R · (1 + (d - 1) / n)

leaves R where it is in the mean if it is right, and remembers n measurements; d is cut off above, so that outliers
which pass the gate hardly count. A sudden change is seen by the last dozen steps: where most are far above their
median, or four in a row, R follows at once, and where nearly all are below it, n is shortened. Only accepted
measurements enter the mean, and of the rejected ones only those near the gate show a sudden change.
"""

import numpy as np
from numba import njit

from midspan.records import Floats, Source

# A row a source: the factor on its declared variance, how many measurements it rests on, the last two innovations with
# their predicted variances, and a ring of the last steps, each the smaller one of those to the two innovations before
# it: an outlier then counts once, not twice.
FACTOR, COUNT, LAST, LAST_TOTAL, BEFORE, BEFORE_TOTAL, FILLED, NEXT, FIRST_STEP = range(9)
RING = 24
LEARNT_COLUMNS = FIRST_STEP + RING
# The declared variance weighs as much as so many measurements, and so many are remembered: the factor then scatters by
# an eighth, which costs a thousandth of the error.
PRIOR, MEMORY = 50.0, 100.0
# Steps squared count up to this many predicted variances; mean of what is left of a normal variable's square, and the
# share by which that mean follows the variance.
MOST_STEP, USUAL, SLOPE = 2.25, 0.7784, 0.614
# Shares of the noise in the innovation's variance: below the first a prediction tells nothing of it, and below the
# second less, and not that it has fallen.
LEAST_SHARE, SHARP = 0.05, 0.2
# Floor and ceiling of the noise's deviation over the declared one.
LEAST, MOST = 0.1, 30.0
# Median of the smaller squared step over the sum of the variances, for normal innovations.
LEAST_OF_TWO = 0.15
# A sudden rise: so many of the recent steps, or so many in a row, beyond this many times their median. A fall: nearly
# the whole ring below the median.
FAR, MANY, RECENT, IN_A_ROW, FEW = 3.0, 7, 12, 4, 20
# What the factor rests on after a sudden change.
ANEW = 12.0
# Variance that a sudden change adds at most, as a factor: chance and outliers can look like one, and more would let
# outliers through the gate. Five near rejections in a row, the filter's own error or noise, count as that much.
DOUBTED = 9.0


def nothing_learnt() -> Floats:
    """Rows (sources, columns) before the first measurement: every source's noise is as declared."""
    learnt = np.zeros((max(Source) + 1, LEARNT_COLUMNS))
    learnt[:, FACTOR], learnt[:, COUNT] = 1.0, PRIOR
    learnt[:, [LAST, BEFORE]] = np.nan
    return learnt


def learning_off() -> Floats:
    """Rows (0, columns): every measurement is taken with its declared variance."""
    return np.empty((0, LEARNT_COLUMNS))


@njit(cache=True, inline="always")
def _keep_factor(n, factor):  # type: ignore[no-untyped-def]
    n[FACTOR] = min(max(factor, LEAST * LEAST), MOST * MOST)


@njit(cache=True, inline="always")
def doubt(n):  # type: ignore[no-untyped-def]
    """After five near rejections in a row: take the source for noisier until more is known."""
    _keep_factor(n, DOUBTED * n[FACTOR])
    n[COUNT] = ANEW


@njit(cache=True, inline="always")
def forget_steps(learnt):  # type: ignore[no-untyped-def]
    """After the filter's position was given up, the next innovation is no step from the last."""
    learnt[:, LAST] = np.nan


@njit(cache=True)
def _remember(n, step):  # type: ignore[no-untyped-def]
    """Put a squared step into the ring."""
    place = int(n[NEXT])
    n[FIRST_STEP + place] = step
    n[NEXT] = (place + 1) % RING
    n[FILLED] = min(n[FILLED] + 1.0, RING)


@njit(cache=True)
def _sudden(n):  # type: ignore[no-untyped-def]
    """How many of the last steps show a rise of the noise; -1 where the ring shows a fall, 0 where neither."""
    far = low = since = row = 0
    for i in range(int(n[FILLED])):
        step = n[FIRST_STEP + (int(n[NEXT]) - 1 - i) % RING]
        if i < RECENT and step > FAR * FAR * LEAST_OF_TWO:
            row += row == i
            far += 1
            since = i + 1
        low += step < LEAST_OF_TWO
    if far >= MANY or row >= IN_A_ROW:
        return since
    return -1 if low >= FEW else 0


@njit(cache=True)
def _median_step(n, count):  # type: ignore[no-untyped-def]
    """Median of the last `count` steps in the ring."""
    recent = np.empty(count)
    for i in range(count):
        recent[i] = n[FIRST_STEP + (int(n[NEXT]) - 1 - i) % RING]
    return np.median(recent)


@njit(cache=True)
def learn(n, innovation, variances, accepted):  # type: ignore[no-untyped-def]
    """Learn from one innovation of the source with the row `n`; returns whether its noise rose suddenly.

    variances: of the innovation as predicted, and the measurement's own part of it; accepted: else it is near the gate.
    """
    total, share = variances[0], variances[1] / variances[0]
    last, before, sudden = n[LAST], n[BEFORE], 0
    # Innovations of nothing but zeros are those of a run without values, which is made for its variances.
    if np.isfinite(last) and share > LEAST_SHARE and (innovation != 0.0 or last != 0.0):
        size = (innovation - last) ** 2 / (total + n[LAST_TOTAL])
        if np.isfinite(before):
            step = min(size, (innovation - before) ** 2 / (total + n[BEFORE_TOTAL]))
            if share > SHARP or step > LEAST_OF_TWO:
                _remember(n, step)
        if accepted:
            beyond = (min(size, MOST_STEP) / USUAL - 1.0) / SLOPE
            _keep_factor(n, n[FACTOR] * (1.0 + min(1.0, share / SHARP) * beyond / n[COUNT]))
            n[COUNT] = min(n[COUNT] + 1.0, MEMORY)
        sudden = _sudden(n)
        if sudden > 0:
            _keep_factor(n, n[FACTOR] * min(_median_step(n, sudden) / LEAST_OF_TWO, DOUBTED))
        if sudden != 0:
            n[FILLED] = n[NEXT] = 0.0
            n[COUNT] = min(n[COUNT], ANEW)
    n[BEFORE], n[BEFORE_TOTAL], n[LAST], n[LAST_TOTAL] = last, n[LAST_TOTAL], innovation, total
    if sudden > 0:
        n[LAST] = np.nan
    return sudden > 0
