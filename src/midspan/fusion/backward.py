"""The pass back over what the filter left of a block: what was measured later corrects what was found before.

It is the modified Bryson-Frazier smoother (G. J. Bierman, Fixed interval smoothing with discrete measurements, Int. J.
Control 18 (1973) 65-75): it carries an adjoint L and its information M, needs no inverse, and what only adds variance
to a state leaves it as it is. M is carried as a factor W, M = W W': what later measurements say of a combination of
states that was widely uncertain is a small difference of what they say of each. `adjoint` holds the columns of both as
its rows, (1 + k + 2 n, n): L, then W; they obey the same equations.
"""

import numpy as np
from numba import njit

from midspan.fusion.borrowing import borrowed
from midspan.fusion.filtering import (
    FOUND_VARIANCE,
    FOUND_VELOCITY,
    FOUND_X,
    INTERVAL,
    OF_CHANNEL,
    RECORD,
    REFERENCE_SCALED,
    SHIFT_SCALED,
    TAKEN,
    THETA,
)
from midspan.fusion.forward import AXIS, BLUR, SET_DATUM, UNITS_PER_M, ZERO, ZERO_VARIANCE

# A smoothed variance is no smaller than this share of the filtered one: beyond it rounding speaks.
MIN_VARIANCE_SHARE = 1e-12
# Entries that a measurement's row may have: displacement, bias, three of its zero and the zero that all count from.
ENTRIES = 6


@njit(cache=True, inline="always")
def back_through_time(adjoint, axes, dt, used):  # type: ignore[no-untyped-def]
    """The first `used` rows of the adjoint `dt` earlier: Phi' times each."""
    half = 0.5 * dt * dt
    for c in range(used):
        for i in range(0, 3 * axes, 3):
            x, v = adjoint[c, i], adjoint[c, i + 1]
            adjoint[c, i + 2] += -half * x - dt * v
            adjoint[c, i + 1] = v + dt * x


@njit(cache=True, inline="always")
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
def find_live(unknown, channels, counted, live):  # type: ignore[no-untyped-def]
    """Write to `live` the states that are uncertain as the pass back counts them; returns how many.

    unknown (n,): 1 for those that are in some part of the block, see `filtering.run_block`. A state that is certain in
    all of the block is so before it too, until a measurement whose record scales it by 0: its adjoint is of no weight.
    """
    for c in range(len(channels)):
        if counted[int(channels[c, AXIS])] >= 0 and not channels[c, ZERO_VARIANCE] < np.inf:
            unknown[int(channels[c, ZERO])] = 1
    count = 0
    for i in range(len(unknown)):
        if unknown[i] > 0:
            live[count] = i
            count += 1
    return count


@njit(cache=True, inline="always")
def find_row(channel, counted, unknown, states, entries):  # type: ignore[no-untyped-def]
    """Write the row of a channel's measurement as the pass back counts the states, see `count_from`: its entries for
    live states that are not 0. Returns how many there are.
    """
    a, z, g, count = int(channel[AXIS]), int(channel[ZERO]), channel[UNITS_PER_M], 0
    common = counted[a]
    known = channel[ZERO_VARIANCE] < np.inf
    states[0], states[1], states[2], states[3], states[4], states[5] = 3 * a, 3 * a + 2, z, z + 1, z + 2, max(common, 0)
    entries[0], entries[1], entries[2], entries[3], entries[4] = g, -g * channel[BLUR], 0.0 if z == common else g, g, g
    entries[5] = -g if known and common >= 0 else 0.0
    for q in range(ENTRIES):
        if entries[q] != 0.0 and unknown[states[q]] > 0:
            states[count], entries[count] = states[q], entries[q]
            count += 1
    return count


@njit(cache=True, inline="always")
def apply_row(v, gain, live, row, moved):  # type: ignore[no-untyped-def]
    """(I − K h')' v in place, for the `live` states; row = (states, entries) of h. 1 − K h is taken first where a state
    is on both sides: behind a wide prior it is a small difference.
    """
    states, entries = row
    for q in range(len(states)):
        rest = 0.0
        for j in live:
            if j != states[q]:
                rest += gain[j] * v[j]
        moved[q] = (1.0 - gain[states[q]] * entries[q]) * v[states[q]] - entries[q] * rest
    for q in range(len(states)):
        v[states[q]] = moved[q]


@njit(cache=True, inline="always")
def back_through_measurement(adjoint, used, live, row, record, moved):  # type: ignore[no-untyped-def]
    """Before an accepted measurement: (I − K h')' [L, W] with − h e'/S in L and a new column h/√S in W.

    row: as of `apply_row`; record = (K (n,), e (1 + k), S), S infinite where the measurement began a zero. Returns how
    many rows of the adjoint are used.
    """
    (states, entries), (gain, e, total) = row, record
    for c in range(used):
        apply_row(adjoint[c], gain, live, row, moved)
    adjoint[used] = 0.0
    for q in range(len(states)):
        for c in range(len(e)):
            adjoint[c, states[q]] -= entries[q] * e[c] / total
        adjoint[used, states[q]] = entries[q] / np.sqrt(total)
    used += 1
    return used if used < len(e) + 2 * len(live) else narrow(adjoint, len(e), used, live)


@njit(cache=True)
def narrow(adjoint, first, used, live):  # type: ignore[no-untyped-def]
    """Rotate the columns of W, from row `first` of the adjoint on, to as many as there are `live` states; W W' stays.
    Returns how many rows are used. By Householder's reflections, to a lower triangle.
    """
    for begin in range(first, min(first + len(live), used)):
        j, square = live[begin - first], 0.0
        for c in range(begin, used):
            square += adjoint[c, j] * adjoint[c, j]
        if square == 0.0:
            continue
        pivot = -np.sqrt(square) if adjoint[begin, j] > 0.0 else np.sqrt(square)
        adjoint[begin, j] -= pivot
        square = 0.0
        for c in range(begin, used):
            square += adjoint[c, j] * adjoint[c, j]
        for i in live[begin - first + 1 :]:
            dot = 0.0
            for c in range(begin, used):
                dot += adjoint[c, j] * adjoint[c, i]
            dot *= 2.0 / square
            for c in range(begin, used):
                adjoint[c, i] -= dot * adjoint[c, j]
        adjoint[begin, j] = pivot
        for c in range(begin + 1, used):
            adjoint[c, j] = 0.0
    return min(first + len(live), used)


@njit(cache=True)
def back_through_datum(adjoint, counted):  # type: ignore[no-untyped-def]
    """Before the datum was copied from the displacement; counted: as of `count_from`."""
    axes = len(counted)
    for a in range(axes):
        for c in range(len(adjoint)):
            datum = adjoint[c, 3 * axes + a]
            adjoint[c, 3 * a] += datum
            if counted[a] >= 0:
                adjoint[c, counted[a]] -= datum
            adjoint[c, 3 * axes + a] = 0.0


@njit(cache=True, inline="always")
def back_through_row(row, adjoint, used, columns, channels, counted, live, unknown, scratch):  # type: ignore[no-untyped-def]
    """Carry the adjoint back through a decided measurement's record; returns how many of its rows are used."""
    if row[OF_CHANNEL] < 0.0:
        if row[OF_CHANNEL] == SET_DATUM:
            back_through_datum(adjoint, counted)
        return used
    channel = channels[int(row[OF_CHANNEL])]
    states, entries, moved = scratch
    if row[TAKEN] > 0.0:
        e, gain = row[RECORD : RECORD + columns], row[RECORD + columns : RECORD + columns + adjoint.shape[1]]
        count_from(gain, channels, counted)
        count = find_row(channel, counted, unknown, states, entries)
        own = states[:count], entries[:count]
        used = back_through_measurement(adjoint, used, live, own, (gain, e, row[TAKEN]), moved)
    for i, factor in ((int(channel[ZERO]) + 1, row[SHIFT_SCALED]), (int(channel[ZERO]) + 2, row[REFERENCE_SCALED])):
        if factor != 1.0:
            for c in range(used):
                adjoint[c, i] *= factor
    return used


@njit(cache=True, inline="always")
def smooth_node(node, adjoint, used, live, own, parameters, out):  # type: ignore[no-untyped-def]
    """Smoothed displacement, its variance and the velocity of one axis, to `out` (5,), from what `leave_node` wrote.

    own = (filtered variance, factor on what is left of it, covariances (n) with all states as the pass back counts
    them, those of the velocity); parameters = (theta (k,), covariance (k, k)).
    """
    theta, spread = parameters
    filtered, misfit, pc, pv = own
    columns, value, velocity, known, uncertain = 1 + len(theta), 0.0, 0.0, 0.0, 0.0
    for c in range(columns):
        met, faster = 0.0, 0.0
        for j in live:
            met += pc[j] * adjoint[c, j]
            faster += pv[j] * adjoint[c, j]
        # The sensitivity stays in the place of what the filter left.
        node[c] -= met
        value += node[c] * (1.0 if c == 0 else theta[c - 1])
        velocity += (node[columns + c] - faster) * (1.0 if c == 0 else theta[c - 1])
    for c in range(columns, used):
        met = 0.0
        for j in live:
            met += pc[j] * adjoint[c, j]
        known += met * met
    for q in range(len(theta)):
        for r in range(len(theta)):
            uncertain += node[1 + q] * spread[q, r] * node[1 + r]
    out[FOUND_X], out[FOUND_VELOCITY] = value, velocity
    out[FOUND_VARIANCE] = misfit * max(filtered - known, MIN_VARIANCE_SHARE * filtered) + uncertain


@njit(cache=True)
def backward_block(time_s, start_s, tables, counted, left, adjoint, parameters, scratch, rows):  # type: ignore[no-untyped-def]
    """Run the pass back over one block; see `pass_back`. scratch = (live states (n,), states and entries of a row, and
    what becomes of them (ENTRIES,)).
    """
    time_s, tables, counted, left = borrowed((time_s, tables, counted, left))
    adjoint, parameters, scratch, rows = borrowed((adjoint, parameters, scratch, rows))
    nodes, record, unknown = left
    channels, datum, misfit = tables[1], tables[3], tables[5]
    axes, j, n, columns = nodes.shape[1], len(record) - 1, adjoint.shape[1], 1 + len(parameters[0])
    live = scratch[0][: find_live(unknown, channels, counted, scratch[0])]
    used = narrow(adjoint, columns, len(adjoint), live)
    for k in range(len(time_s) - 1, -1, -1):
        for a in range(axes):
            node = nodes[k, a]
            pc, pv = node[2 * columns : 2 * columns + n], node[2 * columns + n :]
            filtered = pc[3 * a] - (pc[datum + a] if datum >= 0 else 0.0)
            count_from(pc, channels, counted)
            count_from(pv, channels, counted)
            smooth_node(node, adjoint, used, live, (filtered, misfit[a], pc, pv), parameters, rows[k, a])
        before = time_s[k - 1] if k > 0 else start_s
        at, dt = time_s[k], time_s[k] - before
        while j >= 0 and record[j, INTERVAL] == k:
            until = before + record[j, THETA] * dt
            if at > until:
                back_through_time(adjoint, axes, at - until, used)
                at = until
            used = back_through_row(record[j], adjoint, used, columns, channels, counted, live, unknown, scratch[1:])
            j -= 1
        if at > before:
            back_through_time(adjoint, axes, at - before, used)
    adjoint[used:] = 0.0


def pass_back(  # type: ignore[no-untyped-def]
    time_s, start_s, tables, counted, left, adjoint, parameters, found
) -> None:
    """Smooth what the filter found of a block (s, axes, 5): displacement relative to the datum, its variance, velocity;
    `adjoint` (1 + k + 2 n, n) is changed in place and carries on.

    time_s (s,): the samples, start_s: time of the state before them; left = (nodes, record, uncertain) that `run_block`
    left of decided measurements, changed in place; tables: as of `run_block`; counted: as of `count_from`; parameters =
    (theta (k,), covariance (k, k)).
    """
    states = np.zeros(adjoint.shape[1], dtype=np.int64), np.zeros(ENTRIES, dtype=np.int64)
    scratch = (*states, np.zeros(ENTRIES), np.zeros(ENTRIES))
    backward_block(time_s, start_s, tables, counted, left, adjoint, parameters, scratch, found)
