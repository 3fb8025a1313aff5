"""The pass back over what the filter left of a block: what was measured later corrects what was found before.

It is the modified Bryson-Frazier smoother (G. J. Bierman, Fixed interval smoothing with discrete measurements, Int. J.
Control 18 (1973) 65-75): it carries an adjoint L and its information M, needs no inverse, and what only adds variance
to a state leaves it as it is. M is carried as a factor W, M = W W': what later measurements say of a combination of
states that was widely uncertain is a small difference of what they say of each. `adjoint` holds both,
(n, 1 + k + 2 n): L, then W; they obey the same equations.
"""

import numpy as np
from numba import njit

from midspan.fusion.filtering import INTERVAL, OF_CHANNEL, RECORD, REFERENCE_SCALED, SHIFT_SCALED, TAKEN, THETA
from midspan.fusion.forward import AXIS, BLUR, SET_DATUM, UNITS_PER_M, ZERO, ZERO_VARIANCE, quadratic

# A smoothed variance is no smaller than this share of the filtered one: beyond it rounding speaks.
MIN_VARIANCE_SHARE = 1e-12


@njit(cache=True)
def back_through_time(adjoint, axes, dt, used):  # type: ignore[no-untyped-def]
    """The first `used` columns of the adjoint `dt` earlier: Phi' times them."""
    half = 0.5 * dt * dt
    for a in range(axes):
        i = 3 * a
        for c in range(used):
            adjoint[i + 2, c] += -half * adjoint[i, c] - dt * adjoint[i + 1, c]
            adjoint[i + 1, c] += dt * adjoint[i, c]


@njit(cache=True)
def count_from(v, channels, counted):  # type: ignore[no-untyped-def]
    """A vector (n,) of covariances or gains in place, as the pass back counts the states.

    counted (axes,): zero of the channel that all of an axis count from, or -1. x becomes x + z of that channel, and the
    zeros of the others of which nothing is known become what they differ from it by. Until a known zero begins, x and
    those zeros are only known relative to each other; so they are wide in one of the new states alone.
    """
    for a in range(len(counted)):
        if counted[a] >= 0:
            own = v[counted[a]]
            v[3 * a] += own
            for c in range(len(channels)):
                z = int(channels[c, ZERO])
                if int(channels[c, AXIS]) == a and z != counted[a] and not channels[c, ZERO_VARIANCE] < np.inf:
                    v[z] -= own


@njit(cache=True)
def row_back(channel, counted):  # type: ignore[no-untyped-def]
    """States (6,) of a channel's measurement as the pass back counts them, and their entries; see `count_from`."""
    a, z, g = int(channel[AXIS]), int(channel[ZERO]), channel[UNITS_PER_M]
    common = counted[a]
    known = channel[ZERO_VARIANCE] < np.inf
    states = (3 * a, 3 * a + 2, z, z + 1, z + 2, max(common, 0))
    return states, (g, -g * channel[BLUR], 0.0 if z == common else g, g, g, -g if known and common >= 0 else 0.0)


@njit(cache=True)
def back_through_measurement(adjoint, used, states, row, gain, e, total):  # type: ignore[no-untyped-def]
    """Before an accepted measurement: (I − K h')' [L, W] with − h e'/S in L and a new column h/√S in W.

    Returns how many columns are used. 1 − K h is taken first where a state is on both sides: behind a wide prior it is
    a small difference. S is infinite where the measurement began a zero.
    """
    for c in range(used):
        apply_row(adjoint[:, c], gain, states, row)
    for q in range(len(row)):
        for c in range(len(e)):
            adjoint[states[q], c] -= row[q] * e[c] / total
        adjoint[states[q], used] += row[q] / np.sqrt(total)
    used += 1
    return used if used < adjoint.shape[1] else narrow(adjoint, len(e))


@njit(cache=True)
def narrow(adjoint, first):  # type: ignore[no-untyped-def]
    """Rotate the columns of W, from `first` on, to as many as there are states; W W' stays. Returns how many are used.

    By Householder's reflections, to a lower triangle.
    """
    n, end = len(adjoint), adjoint.shape[1]
    for j in range(n):
        begin = first + j
        v = adjoint[j, begin:].copy()
        norm = np.sqrt(np.sum(v * v))
        if norm == 0.0:
            continue
        pivot = -norm if v[0] > 0.0 else norm
        v[0] -= pivot
        square = np.sum(v * v)
        for i in range(j + 1, n):
            dot = 0.0
            for c in range(begin, end):
                dot += v[c - begin] * adjoint[i, c]
            dot *= 2.0 / square
            for c in range(begin, end):
                adjoint[i, c] -= dot * v[c - begin]
        adjoint[j, begin] = pivot
        adjoint[j, begin + 1 :] = 0.0
    adjoint[:, first + n :] = 0.0
    return first + n


@njit(cache=True)
def apply_row(v, gain, states, row):  # type: ignore[no-untyped-def]
    """(I − K h')' v in place, h having the entries `row` at `states`; a state may be twice where one entry is 0."""
    moved = np.empty(len(row))
    for q in range(len(row)):
        rest = 0.0
        for j in range(len(v)):
            if j != states[q]:
                rest += gain[j] * v[j]
        moved[q] = (1.0 - gain[states[q]] * row[q]) * v[states[q]] - row[q] * rest
    for q in range(len(row)):
        if row[q] != 0.0:
            v[states[q]] = moved[q]


@njit(cache=True)
def back_through_datum(adjoint, counted):  # type: ignore[no-untyped-def]
    """Before the datum was copied from the displacement; counted: as of `count_from`."""
    axes = len(counted)
    for a in range(axes):
        datum = adjoint[3 * axes + a]
        adjoint[3 * a] += datum
        if counted[a] >= 0:
            adjoint[counted[a]] -= datum
        datum[:] = 0.0


@njit(cache=True)
def back_to(at, until, adjoint, axes, used):  # type: ignore[no-untyped-def]
    """Carry the adjoint back from one instant to another; returns the instant it has reached."""
    if at > until:
        back_through_time(adjoint, axes, at - until, used)
        return until
    return at


@njit(cache=True)
def back_through_row(row, adjoint, used, columns, channels, counted):  # type: ignore[no-untyped-def]
    """Carry the adjoint back through a decided measurement's record; returns how many of its columns are used."""
    if row[OF_CHANNEL] < 0.0:
        if row[OF_CHANNEL] == SET_DATUM:
            back_through_datum(adjoint, counted)
        return used
    channel = channels[int(row[OF_CHANNEL])]
    if row[TAKEN] > 0.0:
        e, gain = row[RECORD : RECORD + columns], row[RECORD + columns : RECORD + columns + len(adjoint)]
        count_from(gain, channels, counted)
        states, entries = row_back(channel, counted)
        used = back_through_measurement(adjoint, used, states, entries, gain, e, row[TAKEN])
    for i, factor in ((int(channel[ZERO]) + 1, row[SHIFT_SCALED]), (int(channel[ZERO]) + 2, row[REFERENCE_SCALED])):
        if factor != 1.0:
            adjoint[i] *= factor
    return used


@njit(cache=True)
def smooth_node(node, adjoint, used, own, parameters, out):  # type: ignore[no-untyped-def]
    """Smoothed displacement, its variance and the velocity of one axis, to `out` (3,), from what `leave_node` wrote.

    own = (filtered variance, factor on what is left of it, covariances (n) with all states as the pass back counts
    them, those of the velocity); parameters = (theta (k,), covariance (k, k)).
    """
    theta, spread = parameters
    filtered, misfit, pc, pv = own
    columns = 1 + len(theta)
    met = np.zeros(used)
    for q in range(len(adjoint)):
        for c in range(used):
            met[c] += pc[q] * adjoint[q, c]
    sensitivity, velocity = np.zeros(columns - 1), 0.0
    for c in range(columns):
        faster = node[columns + c]
        for q in range(len(adjoint)):
            faster -= pv[q] * adjoint[q, c]
        velocity += faster * (1.0 if c == 0 else theta[c - 1])
    value = node[0] - met[0]
    for c in range(1, columns):
        sensitivity[c - 1] = node[c] - met[c]
        value += sensitivity[c - 1] * theta[c - 1]
    known = 0.0
    for c in range(columns, used):
        known += met[c] * met[c]
    out[0], out[2] = value, velocity
    out[1] = misfit * max(filtered - known, MIN_VARIANCE_SHARE * filtered) + quadratic(sensitivity, spread)


@njit(cache=True)
def backward_block(time_s, start_s, tables, counted, left, adjoint, parameters, rows):  # type: ignore[no-untyped-def]
    """Run the pass back over one block; `adjoint` (n, 1 + k + 2 n) is changed in place and carries on.

    time_s (s,): the samples, start_s: time of the state before them; left = (nodes, record) that `run_block` left of
    decided measurements, changed in place; tables: as of `run_block`; counted: as of `count_from`; parameters = (theta
    (k,), covariance (k, k)). rows (s, axes, 3) take displacement relative to the datum, its variance, and velocity.
    """
    nodes, record = left
    channels, datum = tables[1], tables[3]
    axes, j, n, columns = nodes.shape[1], len(record) - 1, len(adjoint), 1 + len(parameters[0])
    used = narrow(adjoint, columns)
    for k in range(len(time_s) - 1, -1, -1):
        for a in range(axes):
            node = nodes[k, a]
            pc, pv = node[2 * columns : 2 * columns + n], node[2 * columns + n :]
            filtered = pc[3 * a] - (pc[datum + a] if datum >= 0 else 0.0)
            count_from(pc, channels, counted)
            count_from(pv, channels, counted)
            smooth_node(node, adjoint, used, (filtered, tables[5][a], pc, pv), parameters, rows[k, a])
        before = time_s[k - 1] if k > 0 else start_s
        at, dt = time_s[k], time_s[k] - before
        while j >= 0 and record[j, INTERVAL] == k:
            at = back_to(at, before + record[j, THETA] * dt, adjoint, axes, used)
            used = back_through_row(record[j], adjoint, used, columns, channels, counted)
            j -= 1
        back_to(at, before, adjoint, axes, used)
