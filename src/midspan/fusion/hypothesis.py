"""One hypothesis: the kinds of what happened, and the columns of what it remembers, as compiled functions take them."""

from numba import njit

GOOD, OUTLIER, SHIFT, RETURN, WRONG, LOST, NOISE, CLOCK = range(8)
KINDS = 8
# In the code of what happened: the error of the acceleration has just ended.
ENDED = KINDS
# The setting of the datum.
DATUM = 2 * KINDS
# A good measurement, by which the innovations up to it tell that the sensor's zero has stepped at an earlier one.
STEPPED_BEFORE = 3 * KINDS
# The prediction was wrong, and the samples' noise has it since the last good measurement (see `second_pass`).
SPREAD = 4 * KINDS
# A shift of a size that its own measurement does not tell, but those after it (see `second_pass`).
SINCE_THEN = 8 * KINDS
# How many hypotheses are kept while the first measurements are judged, any of which may be outliers, and later.
MOST, LATER = 64, 32
# Columns of what each hypothesis remembers besides its filter: logarithm of its weight; density of the error of the
# acceleration that goes on (0: none) and along which axis; of the last measurement the hypothesis before it, what it
# was taken for, its innovation (with the parameters as estimated) and its predicted variance; then what happened to
# several targets of a sensor in the same frame: time, sensor and size (m) of the last shift, time and sensor of the
# last outlier; how many measurements were good since anything else was; when the parameters were met last; when the
# record began; of a step found by the last measurement size (m), variance (m²), and how long ago (s) it was.
(
    WEIGHT,
    DENSITY,
    ALONG,
    PARENT,
    CODE,
    ERROR,
    TOTAL,
    SHIFT_AT,
    SHIFT_OF,
    SHIFT_BY,
    OUTLIER_AT,
    OUTLIER_OF,
    AGE,
    LAST_AT,
    BEGAN_AT,
    STEP_BY,
    STEP_VARIANCE,
    STEP_AGO,
) = range(18)
MEMORY_COLUMNS = 18
# And for each channel: factor on its variance, and how many measurements it rests on; how many outliers in a row the
# last ones were, and the value of the first of these; whether its zero has shifted; whether it was met; variance of its
# reference (m²); when it was last met, when last accepted, and with which variance (m²), its reference's included;
# whether its clock has stepped, and whether that is in doubt: stamps were missing or went back since the last
# measurement; share of its last measurements that were outliers; mean square of its last innovations over variance.
(
    FACTOR,
    RESTS_ON,
    DISTURBED,
    KEPT,
    SHIFTED,
    BEGUN,
    REFERENCE_NOW,
    MET_AT,
    ACCEPTED_AT,
    ACCEPTED_VARIANCE,
    STEPPED,
    DOUBTED,
    SHARE,
    RECENT,
) = range(14)
MARK_COLUMNS = 14
# In DOUBTED, besides 0: in doubt at the next measurement; through a gap of measurements. After it ONCE and the instant
# (s) until which the clock is in doubt, see `outcomes.settle_doubt`.
ONCE, LASTING = 1.0, float("inf")
# Options, see `Rates`; MEMORY: as of `EstimatorSettings.noise_memory`.
(
    P_OUTLIER,
    P_STAYS,
    SHIFT_RATE,
    RETURN_RATE,
    WRONG_RATE,
    NOISE_RATE,
    LOST_RATE,
    CLOCK_RATE,
    ODDS,
    MEMORY,
) = range(10)


@njit(cache=True, inline="always")
def one_of(hyps, b):  # type: ignore[no-untyped-def]
    """Hypothesis `b`: its states X (n, 1 + k), P (n, n), marks (c, ...), memory, parameters (k,), their covariance, and
    the sums of steps that may have been (groups, ...), see `steps`.
    """
    return hyps[0][b], hyps[1][b], hyps[2][b], hyps[3][b], hyps[4][b], hyps[5][b], hyps[6][b]


@njit(cache=True)
def copy_hypothesis(hyps, to, of):  # type: ignore[no-untyped-def]
    """Hypothesis `to` becomes a copy of `of`."""
    xs, ps, marks, memory, thetas, spreads, tests = hyps
    xs[to], ps[to], marks[to], memory[to] = xs[of], ps[of], marks[of], memory[of]
    thetas[to], spreads[to], tests[to] = thetas[of], spreads[of], tests[of]
