"""The update of one hypothesis by a measurement that it accepts: states, noise, parameters, and steps of the zero.

The variance of each channel's noise is followed in each hypothesis by the variational Bayes filter (S. Särkkä, A.
Nummenmaa, Recursive noise adaptive Kalman filtering by variational Bayesian approximations, IEEE Trans. Automat.
Contr. 54 (2009) 596-600, doi 10.1109/TAC.2008.2008348): a mean, over the measurements that are remembered, of what
is left of each innovation after its update and of what the updated state's variance adds to it.
"""

import numpy as np
from numba import njit

from midspan.fusion.forward import (
    AT,
    AXIS,
    CHANNEL,
    CLEAR,
    FROM_S,
    UNITS_PER_M,
    VARIANCE,
    WALK,
    begin_zero,
    move_to_updated,
    update,
)
from midspan.fusion.forward import SENSOR as SENSOR_OF
from midspan.fusion.hypothesis import (
    ACCEPTED_AT,
    ACCEPTED_VARIANCE,
    BEGAN_AT,
    BEGUN,
    CODE,
    DISTURBED,
    ERROR,
    FACTOR,
    LAST_AT,
    MEMORY,
    RECENT,
    REFERENCE_NOW,
    RESTS_ON,
    SHARE,
    SHIFT_AT,
    SHIFT_BY,
    SHIFT_OF,
    SHIFT_RATE,
    SHIFTED,
    STEP_AGO,
    STEP_BY,
    STEP_VARIANCE,
    STEPPED,
    STEPPED_BEFORE,
    TOTAL,
    WRONG_RATE,
)
from midspan.fusion.steps import (
    APART_BY,
    INSTANTS,
    NUMBER,
    SINCE,
    TAKEN_OVER,
    begin_instant,
    carry,
    group_of,
    meet_innovation,
    moved_probability,
    step_of,
    take_step,
)
from midspan.fusion.weighing import DECADES, OUTLIER_MEMORY, SHORTEST_S, met_within

# What the noise's factor rests on after a sudden rise or fall, in measurements. It has fallen where over them the
# mean square of the innovations is less than this share of their variance: by chance once in 100 000 measurements.
ANEW, FALLEN = 12.0, 0.25
# Logarithm of the density of the logarithm of a step's size, which is alike in all decades.
EVEN = -np.log(2.0 * DECADES * np.log(10.0))
# Iterations of the variance's fixed point: the third changes it by less than a thousandth.
ITERATIONS = 3


@njit(cache=True, inline="always")
def adapt(marks, c, error, known, own, memory):  # type: ignore[no-untyped-def]
    """Follow the variance of a channel's noise after an accepted innovation; known, own: parts of its variance."""
    # Noise that is taken as declared does not fall.
    if marks[c, RECENT] < FALLEN and memory < np.inf:
        marks[c, RESTS_ON] = min(marks[c, RESTS_ON], ANEW)
    rests = min(marks[c, RESTS_ON], memory - 1.0)
    ratio = 1.0
    for _ in range(ITERATIONS):
        share = ratio * own / (known + ratio * own)
        left = (error * share) ** 2 / own + share * known / own
        ratio = (rests + left) / (rests + 1.0)
    marks[c, FACTOR] *= ratio
    marks[c, RESTS_ON] = rests + 1.0
    if known < own:
        # Else the innovation tells more of the prediction than of the noise.
        marks[c, RECENT] += (error * error / (known + own) - marks[c, RECENT]) / ANEW


@njit(cache=True)
def learn_parameters(theta, spread, e, error, variances, times, learning):  # type: ignore[no-untyped-def]
    """Estimate those parameters (k,) that are to be from an innovation, and let them walk since the last one.

    e (1 + k): the innovation's sensitivities; variances = (that of the prediction without the parameters, of the
    innovation with all that is uncertain); times = (now, last, s); learning (k, 4): the table of the parameters. The
    gain of those that are not estimated is 0, and the covariance stays that of the errors (S. F. Schmidt's consider
    parameters).
    """
    known, total = variances
    k = len(theta)
    gain, mu = np.zeros(k), np.zeros(k)
    for q in range(k):
        spread[q, q] += learning[q, WALK] * max(times[0] - times[1], 0.0)
        for r in range(k):
            mu[q] += spread[q, r] * e[1 + r]
        if times[0] >= learning[q, FROM_S] and e[1 + q] * e[1 + q] >= learning[q, CLEAR] * known:
            gain[q] = mu[q] / total
    for q in range(k):
        theta[q] -= gain[q] * error
        for r in range(k):
            spread[q, r] += gain[q] * gain[r] * total - gain[q] * mu[r] - mu[q] * gain[r]


@njit(cache=True, inline="always")
def ask_for_step(hyp, row, share, tables, options):  # type: ignore[no-untyped-def]
    """Let a step of the sensor's zero be asked for from this measurement on, where the last such instant is far enough
    away; share: what the update takes over of the innovation.
    """
    _, p, marks, memory, theta, _, tests = hyp
    c, axes = int(row[CHANNEL]), len(tables[5])
    own, k, n = tests[group_of(tables[1][c], axes)], len(theta), len(p)
    carry(tests, row[AT], axes, k, n)
    if marks[c, STEPPED] > 0.0 or marks[c, BEGUN] == 0.0:
        # What it measures is of another instant, or begins its zero.
        own[:] = 0.0
        return
    newest = (int(own[INSTANTS, NUMBER]) - 1) % INSTANTS
    own[INSTANTS, TAKEN_OVER] += share
    if own[INSTANTS, TAKEN_OVER] >= APART_BY and own[newest, SINCE] != row[AT]:
        last = max(marks[c, ACCEPTED_AT], memory[BEGAN_AT])
        lapse = max(row[AT] - last, SHORTEST_S)
        moved = moved_probability(lapse, tables[1][c], options[SHIFT_RATE])
        priors = (np.log(moved), np.log(min(met_within(options[WRONG_RATE], lapse), 0.5)))
        begin_instant(tests, c, tables[1], axes, (row[AT], row[AT] - lapse), priors, k, n)


@njit(cache=True, inline="always")
def find_step(hyp, row, tables, least):  # type: ignore[no-untyped-def]
    """Whether innovations tell by odds (logarithm) of `least` that the sensor's zero has stepped; then it is taken out
    of the states, what it may be off by included, and the hypothesis remembers it.
    """
    _, p, _, _, theta, spread, tests = hyp
    channels, axes, c = tables[1], len(tables[5]), int(row[CHANNEL])
    own, a = tests[group_of(channels[c], axes)], int(channels[c, AXIS])
    best = step_of(own, (theta, spread), tables[5][a], EVEN, least, len(p))
    if best >= 0:
        take_found_step(hyp, row, own[best], tables)
    return best >= 0


@njit(cache=True)
def take_found_step(hyp, row, test, tables):  # type: ignore[no-untyped-def]
    """Take a step that began at the instant `test` out of a hypothesis, which remembers it."""
    x, p, marks, memory, theta, _, tests = hyp
    channels, axes, c = tables[1], len(tables[5]), int(row[CHANNEL])
    since = test[SINCE]
    memory[STEP_BY], memory[STEP_VARIANCE] = take_step(x, p, test, theta)
    memory[STEP_AGO], memory[CODE] = row[AT] - since, STEPPED_BEFORE
    memory[SHIFT_AT], memory[SHIFT_OF], memory[SHIFT_BY] = since, channels[c, SENSOR_OF], memory[STEP_BY]
    for o in range(len(channels)):
        if group_of(channels[o], axes) == group_of(channels[c], axes):
            marks[o, SHIFTED] = 1.0
    # The states have changed: all other sums were of those before.
    tests[:] = 0.0


@njit(cache=True, inline="always")
def accept(hyp, row, seen, tables, options, scratch):  # type: ignore[no-untyped-def]
    """Update one hypothesis with a measurement; seen: what `look` returned, P h and sensitivities in `scratch`.

    Returns the innovation's variance that it was taken with, infinite where it began the channel's zero.
    """
    x, p, marks, memory, theta, spread, tests = hyp
    gain, e = scratch
    c = int(row[CHANNEL])
    error, known, wider, own = seen
    if options[SHIFT_RATE] > 0.0:
        ask_for_step(hyp, row, known / (known + own), tables, options)
    g = tables[1][c, UNITS_PER_M]
    memory[ERROR], memory[TOTAL] = error, wider + own
    total = np.inf
    if marks[c, BEGUN] == 0.0:
        marks[c, BEGUN] = 1.0
        begin_zero(x, p, tables[1], c, gain, e, own)
    else:
        adapt(marks, c, error, wider, own, options[MEMORY])
        own = row[VARIANCE] * marks[c, FACTOR]
        total = known + own
        if len(theta) > 0:
            learn_parameters(theta, spread, e, error, (known, wider + own), (row[AT], memory[LAST_AT]), tables[4])
            memory[LAST_AT] = row[AT]
            move_to_updated(e, tables[2][c], row[AT] >= tables[4][:, FROM_S], error * known / total)
        update(x, p, gain, e, total)
    if options[SHIFT_RATE] > 0.0:
        meet_innovation(tests, c, tables[1], len(tables[5]), gain, e, total)
    marks[c, DISTURBED] = 0.0
    marks[c, SHARE] -= marks[c, SHARE] / OUTLIER_MEMORY
    marks[c, ACCEPTED_AT], marks[c, ACCEPTED_VARIANCE] = row[AT], own / (g * g) + marks[c, REFERENCE_NOW]
    return total
