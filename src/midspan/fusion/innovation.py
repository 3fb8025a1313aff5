"""A measurement as a hypothesis expects it: zero and clock at that instant, the innovation and its variance."""

import numpy as np
from numba import njit

from midspan.fusion.forward import (
    APART,
    AT,
    AXIS,
    CHANNEL,
    COUNT,
    FORGETS,
    INPUT,
    LEAD,
    REFERENCE,
    SLOPE,
    SLOW_RATE,
    SLOW_VARIANCE,
    TIME,
    UNITS_PER_M,
    VALUE,
    VARIANCE,
    ZERO,
    ZERO_VARIANCE,
    find_uncertain,
    innovate,
    linearise,
    move_reference,
    predict_covariance,
    project,
    quadratic,
    scale_state,
)
from midspan.fusion.hypothesis import BEGUN, FACTOR, MET_AT, REFERENCE_NOW, STEPPED, WEIGHT
from midspan.fusion.steps import scale_changed

# A zero of which nothing is known is taken to lie within this many times (in variance) what the first measurement is
# off, where it is asked whether that is an outlier.
UNKNOWN_ZERO = 1e6


@njit(cache=True, inline="always")
def meet_zero(hyp, row, channel):  # type: ignore[no-untyped-def]
    """Before a channel's measurement: its zero begins with the first, and follows the reference, or its slow error goes
    on; returns the factor by which that state was scaled. An unknown zero is wide for the hypotheses' weights alone:
    the first measurement that is accepted begins it, see `begin_zero`.
    """
    x, p, marks, _, theta, _, tests = hyp
    mark, z = marks[int(row[CHANNEL])], int(channel[ZERO])
    if mark[BEGUN] == 0.0:
        if channel[ZERO_VARIANCE] < np.inf:
            mark[BEGUN], p[z, z] = 1.0, channel[ZERO_VARIANCE]
        else:
            g, i = channel[UNITS_PER_M], 3 * int(channel[AXIS])
            p[z, z] = UNKNOWN_ZERO * ((row[VALUE] / g - x[i, 0]) ** 2 + row[VARIANCE] / (g * g)) + p[i, i]
    if channel[SLOW_VARIANCE] > 0.0:
        factor = np.exp(-channel[SLOW_RATE] * (row[AT] - mark[MET_AT]))
        scale_state(x, p, z + 2, factor)
        scale_changed(tests, z + 2, factor, len(theta), len(p))
        p[z + 2, z + 2] += (1.0 - factor * factor) * channel[SLOW_VARIANCE]
        return factor
    was = mark[REFERENCE_NOW]
    if was == row[REFERENCE]:
        return 1.0
    mark[REFERENCE_NOW] = row[REFERENCE]
    factor = move_reference(x, p, z + 2, was, row[REFERENCE])
    scale_changed(tests, z + 2, factor, len(theta), len(p))
    return factor


@njit(cache=True, inline="always")
def follow_clock(hyp, row, channel):  # type: ignore[no-untyped-def]
    """Where a sensor's clock has stepped, let the difference between its time's displacement and this one's go on to
    change as the motion does (first-order Gauss-Markov), in the place of a shift; returns the factor on that state.
    """
    _, p, marks, _, _, _, _ = hyp
    mark, s = marks[int(row[CHANNEL])], int(channel[ZERO]) + 1
    if mark[STEPPED] == 0.0:
        return 1.0
    # The correlation of a smooth motion over so short a time.
    factor = np.exp(-0.5 * (channel[FORGETS] * (row[AT] - mark[MET_AT])) ** 2)
    scale_state(hyp[0], p, s, factor)
    p[s, s] += (1.0 - factor * factor) * channel[APART]
    return factor


@njit(cache=True, inline="always")
def look(hyp, row, scene, tables, scratch):  # type: ignore[no-untyped-def]
    """Innovation of a measurement in one hypothesis, variance of its prediction, and of its own noise.

    scene = (motion, acceleration at the instant, density of its noise); the sensitivities go to `scratch`, and P h with
    them. The variance of the prediction is (without, with) the parameters' part.
    """
    x, p, marks, _, theta, spread, _ = hyp
    channels, kinds = tables[1], tables[2]
    gain, e = scratch
    c = int(row[CHANNEL])
    innovate(x, scene[0], channels, kinds, c, scene[1], row[VALUE], e)
    linearise(x[3 * int(channels[c, AXIS])], theta, kinds[c], channels[c, UNITS_PER_M], e)
    error, known = e[0], project(p, channels, c, gain)
    wider = known
    for q in range(len(theta)):
        error += e[1 + q] * theta[q]
        for r in range(len(theta)):
            wider += e[1 + q] * spread[q, r] * e[1 + r]
    return error, known, wider, row[VARIANCE] * marks[c, FACTOR]


@njit(cache=True)
def predict_value(time_s, c, motion, clock, hyps, tables):  # type: ignore[no-untyped-def]
    """Expected measurement of channel `c` at a time after the last sample and its variance, over all hypotheses.

    Before its first measurement a channel's zero is as uncertain as the table says. Hypotheses in which a zero of which
    nothing is known has not begun say nothing; in the first it has.
    """
    xs, ps, marks, memory, thetas, spreads, _ = hyps
    walks, channels, kinds = tables[:3]
    axes, n, columns = len(motion), xs.shape[1], xs.shape[2]
    x, p, ph, e = np.empty((n, columns)), np.empty((n, n)), np.empty(n), np.empty(columns)
    still, uncertain = np.zeros((axes, 3)), np.empty(n, dtype=np.int64)
    dt = max(time_s - clock[TIME], 0.0)
    a = int(channels[c, AXIS])
    whole = mean = square = 0.0
    first = 0.0
    for b in range(int(clock[COUNT])):
        zero_variance = channels[c, ZERO_VARIANCE] if marks[b, c, BEGUN] == 0.0 else 0.0
        if not zero_variance < np.inf:
            continue
        x[:], p[:] = xs[b], ps[b]
        for i in range(axes):
            x[3 * i + 1, 0] -= motion[i, LEAD] * motion[i, SLOPE]
            for q in range(columns):
                held = motion[i, INPUT] if q == 0 else 0.0
                x[3 * i, q] += dt * x[3 * i + 1, q] + 0.5 * dt * dt * (held - x[3 * i + 2, q])
                x[3 * i + 1, q] += dt * (held - x[3 * i + 2, q])
        count = find_uncertain(p, 3 * axes, walks, uncertain)
        predict_covariance(p, axes, dt, walks, uncertain, count)
        innovate(x, still, channels, kinds, c, motion[a, INPUT], 0.0, e)
        value = -e[0]
        for q in range(columns - 1):
            value -= e[1 + q] * thetas[b, q]
        variance = project(p, channels, c, ph) + quadratic(e[1:], spreads[b])
        variance += channels[c, UNITS_PER_M] ** 2 * zero_variance
        if b == 0:
            first = value
        weight = np.exp(memory[b, WEIGHT])
        whole += weight
        mean += weight * (value - first)
        square += weight * (variance + (value - first) ** 2)
    return first + mean / whole, square / whole - (mean / whole) ** 2
