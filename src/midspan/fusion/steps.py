"""Steps of a sensor's zero that no single measurement shows: the ratio of likelihoods over many innovations.

A step that began at some instant leaves a signature in all innovations after it, through the filter's own gains. Its
size and the ratio of likelihoods follow from sums of signature times innovation, and the estimate with the step from
the one without it (A. S. Willsky, H. L. Jones, A generalized likelihood ratio approach to the detection and estimation
of jumps in linear systems, IEEE Trans. Automat. Contr. 21 (1976) 108-112, doi 10.1109/TAC.1976.1101146; the exact
correction is Friedland's, doi 10.1109/TAC.1969.1099223). Sums are kept for a bounded number of instants. An error of
the acceleration that left a wrong velocity is weighed against each step: it asks for no correction, as the filter
follows the sensor then.
"""

import numpy as np
from numba import njit

from midspan.fusion.forward import AXIS, BLUR, COASTING_S, SENSOR, UNITS_PER_M, ZERO, quadratic

# Instants at which a step may have begun, of each sensor along each axis.
INSTANTS = 16
# From one of them to the next the updates take over this share of what a measurement is off, all together: a step there
# looks alike. So the instants reach back over four times the filter's memory at least.
APART_BY = 0.25
# A step is taken out where it is likelier than none (logarithm of the odds), as the likeliest hypothesis is taken.
# With one an hour, five measurements a second and sizes alike in all decades that is at 5.1 deviations of its size.
SURE = 0.0
# After this share of the gaps a sensor has been moved or set up anew, as its clock may have been (`P_STEPPED`).
P_MOVED = 0.1
# Causes at an instant: the zero's step (1 m), and of the acceleration that of the velocity (1 m/s).
STEP, VELOCITY = range(2)
CAUSES = 2
# Columns of an instant: time (s); logarithm of the probability of a step, of a wrong acceleration (0: not in use); then
# of each cause the sum of its information, of signature times innovation (1 + k), and what it has changed of the
# states that the filter does not know (n).
SINCE, P_STEP, P_VELOCITY, SUMS = range(4)
LOG_2PI = np.log(2.0 * np.pi)
# The last row of a group: time (s) up to which all are carried, shares taken over since the last instant, its number.
CARRIED, TAKEN_OVER, NUMBER = range(3)


@njit(cache=True)
def group_of(channel, axes):  # type: ignore[no-untyped-def]
    """The group of a channel: all targets of a sensor along an axis step together."""
    return int(channel[SENSOR]) * axes + int(channel[AXIS])


@njit(cache=True, inline="always")
def changed_at(cause, k, n):  # type: ignore[no-untyped-def]
    """The first column of what a cause of one size has changed of the states (n,); k: number of parameters."""
    return SUMS + cause * (2 + k + n) + 2 + k


@njit(cache=True)
def changed_by(test, cause, k, n):  # type: ignore[no-untyped-def]
    """The same as a view of an instant."""
    return test[changed_at(cause, k, n) : changed_at(cause, k, n) + n]


@njit(cache=True)
def carry(tests, at, axes, k, n):  # type: ignore[no-untyped-def]
    """Move what all causes have changed to an instant."""
    for g in range(len(tests)):
        i, dt = 3 * (g % axes), at - tests[g, INSTANTS, CARRIED]
        half = 0.5 * dt * dt
        tests[g, INSTANTS, CARRIED] = at
        if dt == 0.0:
            continue
        for t in range(INSTANTS):
            if tests[g, t, P_STEP] != 0.0:
                for cause in range(CAUSES):
                    w = changed_at(cause, k, n) + i
                    v, b = tests[g, t, w + 1], tests[g, t, w + 2]
                    tests[g, t, w] += dt * v - half * b
                    tests[g, t, w + 1] = v - dt * b


@njit(cache=True)
def scale_changed(tests, j, factor, k, n):  # type: ignore[no-untyped-def]
    """State `j` has been scaled by a factor."""
    for g in range(len(tests)):
        for t in range(INSTANTS):
            for cause in range(CAUSES):
                changed_by(tests[g, t], cause, k, n)[j] *= factor


@njit(cache=True)
def begin_instant(tests, c, channels, axes, when, priors, k, n):  # type: ignore[no-untyped-def]
    """Begin a candidate at a measurement of channel `c`, in the place of the oldest; when = (now, last measurement, s),
    priors: logarithms of the probabilities of the causes (2,).
    """
    own = tests[group_of(channels[c], axes)]
    number = int(own[INSTANTS, NUMBER])
    own[INSTANTS, NUMBER], own[INSTANTS, TAKEN_OVER] = (number + 1) % INSTANTS, 0.0
    test, i = own[number], 3 * int(channels[c, AXIS])
    test[:] = 0.0
    test[SINCE], test[P_STEP], test[P_VELOCITY] = when[0], priors[STEP], priors[VELOCITY]
    for o in range(len(channels)):
        if group_of(channels[o], axes) == group_of(channels[c], axes):
            changed_by(test, STEP, k, n)[int(channels[o, ZERO]) + 1] = 1.0
    faster = changed_by(test, VELOCITY, k, n)
    # It happened some time since the measurement before.
    faster[i], faster[i + 1] = 0.5 * (when[0] - when[1]), 1.0


@njit(cache=True)
def meet_innovation(tests, c, channels, axes, gain, e, total):  # type: ignore[no-untyped-def]
    """Add an innovation `e` (1 + k) of channel `c` and variance `total` to the sums; gain (n,): K of its update."""
    n, k, g = len(gain), len(e) - 1, channels[c, UNITS_PER_M]
    i, z, blur = 3 * int(channels[c, AXIS]), int(channels[c, ZERO]), channels[c, BLUR]
    moving, others = 3 * axes, False
    for j in range(moving, n):
        others = others or gain[j] != 0.0
    for group in range(int(channels[c, AXIS]), len(tests), axes):
        for t in range(INSTANTS):
            if tests[group, t, P_STEP] == 0.0:
                continue
            for cause in range(CAUSES):
                w = changed_at(cause, k, n)
                first = w - 2 - k
                f = tests[group, t, w + i] - blur * tests[group, t, w + i + 2]
                f = g * (f + tests[group, t, w + z] + tests[group, t, w + z + 1] + tests[group, t, w + z + 2])
                share = f / total
                tests[group, t, first] += f * share
                for q in range(1 + k):
                    tests[group, t, first + 1 + q] += share * e[q]
                for j in range(moving):
                    tests[group, t, w + j] -= gain[j] * f
                if others:
                    for j in range(moving, n):
                        tests[group, t, w + j] -= gain[j] * f


@njit(cache=True)
def ratio(test, cause, theta, n):  # type: ignore[no-untyped-def]
    """Size of a cause, its variance, and chi-square of one degree of freedom by which it makes the record likelier."""
    first = SUMS + cause * (2 + len(theta) + n)
    known, matched = test[first], test[first + 1]
    for q in range(len(theta)):
        matched += test[first + 2 + q] * theta[q]
    if known == 0.0:
        return 0.0, np.inf, 0.0
    return matched / known, 1.0 / known, matched * matched / known


@njit(cache=True, inline="always")
def odds_of(own, t, cause, p, parameters, misfit, even, least, n):  # type: ignore[no-untyped-def]
    """Logarithm of the odds of a cause of any size, each decade of which is as likely, at instant `t` of a group; `p`:
    the column of its probability; parameters = (as estimated (k,), their covariance). -inf where the odds are below
    `least` or the size is below its deviation.
    """
    theta, spread = parameters
    first = SUMS + cause * (2 + len(theta) + n)
    known, matched = own[t, first], own[t, first + 1]
    for q in range(len(theta)):
        matched += own[t, first + 2 + q] * theta[q]
    chi = matched * matched / known if known > 0.0 else 0.0
    if chi > 1.0 and own[t, p] + even + 0.5 * (chi / misfit + LOG_2PI) > least:
        # The innovations have the parameters' errors in common: they are no step.
        chi = matched * matched / (known + quadratic(own[t, first + 2 : first + 2 + len(theta)], spread))
    most = own[t, p] + even + 0.5 * (chi / misfit + LOG_2PI)
    # The variance over the square of the size is 1 / chi.
    return most - 0.5 * np.log(chi) if chi > 1.0 and most > least else -np.inf


@njit(cache=True, inline="always")
def step_of(own, parameters, misfit, even, least, n):  # type: ignore[no-untyped-def]
    """The likeliest instant of a step among a group's (INSTANTS + 1, ...), or -1 where the odds (logarithm) of each,
    against no step or against a wrong acceleration, whichever is likelier, are below `least`; parameters: as of
    `odds_of`; even: logarithm of the density of the size's logarithm.
    """
    best, odds, other = -1, -np.inf, 0.0
    for t in range(INSTANTS):
        if own[t, P_STEP] != 0.0:
            one = odds_of(own, t, STEP, P_STEP, parameters, misfit, even, least, n)
            if one > odds:
                best, odds = t, one
    if best >= 0:
        for t in range(INSTANTS):
            if own[t, P_STEP] != 0.0:
                other = max(other, odds_of(own, t, VELOCITY, P_VELOCITY, parameters, misfit, even, -np.inf, n))
    return best if odds - other >= least else -1


@njit(cache=True)
def take_step(x, p, test, theta):  # type: ignore[no-untyped-def]
    """Correct states X (n, 1 + k) and P (n, n) by a step; returns its size (m) and the variance of that (m²)."""
    n, k = len(p), len(theta)
    size, variance, _ = ratio(test, STEP, theta, n)
    w = changed_by(test, STEP, k, n)
    for i in range(n):
        for q in range(1 + k):
            x[i, q] += w[i] * test[SUMS + 1 + q] * variance
        for j in range(n):
            p[i, j] += w[i] * w[j] * variance
    return size, variance


@njit(cache=True)
def moved_probability(lapse, channel, rate):  # type: ignore[no-untyped-def]
    """Probability that a sensor's zero has shifted since its last measurement, `lapse` (s) ago; rate: a second."""
    met = min(-np.expm1(-rate * lapse), 0.5)
    return max(met, P_MOVED) if lapse > channel[COASTING_S] else met
