"""The compiled forward recursion over a declared list of states, and the pass back over what it left.

The motion of each axis is three states: displacement x, velocity v and bias b of the accelerometer, driven by the
measured acceleration as in `state_space`. Every other state is constant or walks at random: the datum of each axis (its
displacement at the instant that rows count from), and the zeros of channels. A channel is one target of one sensor
along one axis; its measurement y, in the sensor's own unit, is

    y = units_per_m · ((1 − e) x + z + v d + blur (a − b)) + noise

with zero z, relative scale error e and clock offset d. The two last are parameters: constants of mean 0 whose effect on
every estimate and innovation is carried along as a sensitivity. The columns of the state matrix X (n, 1 + parameters)
are the estimate, and what one unit of each parameter moves it by; they obey the same equations and share the gains, so
that covariance and gains are those of the filter without parameters (separate bias estimation: B. Friedland, Treatment
of bias in recursive filtering, IEEE Trans. Automat. Contr. 14 (1969) 359-367, doi 10.1109/TAC.1969.1099223). The
innovations' sensitivities give the score and the information that the record holds about the parameters; whether they
are estimated from it or only widen the band is decided afterwards.
"""

import numpy as np
from numba import njit

from midspan.fusion.state_space import GAP_STEPS, input_response

# Columns of `motion` (axes, 3): acceleration at the last sample, its slope, the velocity state's lead.
INPUT, SLOPE, LEAD = range(3)
MOTION_COLUMNS = 3
# `clock` (2,): time of the last sample and length of the last interval, s.
TIME, STEP = range(2)
# Columns of the measurements.
AT, AXIS, CHANNEL, VALUE, VARIANCE = range(5)
MEASUREMENT_COLUMNS = 5
# In the place of a channel: the datum of all axes is set at this instant.
SET_DATUM = -1.0
# Columns of the channels: units per metre, blur (exposure²/24, s²), the gate's limit in standard deviations, and which
# state is its zero (-1: none).
UNITS_PER_M, BLUR, LIMIT, ZERO = range(4)
CHANNEL_COLUMNS = 4
# What a parameter is to a channel: entries of the table (channels, parameters).
NOTHING, SCALE, CLOCK = range(3)
# Columns of the record of each measurement; gain (n), row (n) and the innovation's sensitivities follow.
INTERVAL, THETA, TOTAL, VERDICT, INNOVATION = range(5)
RECORD_COLUMNS = 4
UNUSED, ACCEPTED, REJECTED, DATUM = -1.0, 0.0, 1.0, 2.0


@njit(cache=True)
def predict_covariance(p, axes, dt, densities, walks):  # type: ignore[no-untyped-def]
    """Phi P Phi' + Q over `dt` seconds; densities (axes,) of the acceleration's noise, walks (n,) of all states."""
    n = len(p)
    half = 0.5 * dt * dt
    for a in range(axes):
        i = 3 * a
        for j in range(n):
            p[i, j] += dt * p[i + 1, j] - half * p[i + 2, j]
            p[i + 1, j] -= dt * p[i + 2, j]
    for a in range(axes):
        i = 3 * a
        for j in range(n):
            p[j, i] += dt * p[j, i + 1] - half * p[j, i + 2]
            p[j, i + 1] -= dt * p[j, i + 2]
        q = densities[a]
        p[i, i] += q * dt * dt * dt / 3.0
        p[i, i + 1] += q * half
        p[i + 1, i] += q * half
        p[i + 1, i + 1] += q * dt
    for j in range(n):
        p[j, j] += walks[j] * dt


@njit(cache=True)
def predict_mean(x, i, dt, before, after):  # type: ignore[no-untyped-def]
    """Move the motion whose first state is `i` by `dt`; the input's response moves the estimate alone."""
    for c in range(x.shape[1]):
        v, b = x[i + 1, c], x[i + 2, c]
        x[i, c] += dt * v - 0.5 * dt * dt * b
        x[i + 1, c] = v - dt * b
    x[i, 0] += after[0] - before[0] - dt * before[1]
    x[i + 1, 0] += after[1] - before[1]


@njit(cache=True)
def begin_interval(x, clock, motion, a, dt, a1):  # type: ignore[no-untyped-def]
    """Bring the velocity state of axis `a` to the interval of length `dt` that begins; see `state_space`."""
    slope = (a1 - motion[a, INPUT]) / dt
    lead = dt * dt / 12.0 if dt <= GAP_STEPS * clock[STEP] else 0.0
    if lead != motion[a, LEAD]:
        x[3 * a + 1, 0] += (lead - motion[a, LEAD]) * 0.5 * (motion[a, SLOPE] + slope)
    motion[a, LEAD], motion[a, SLOPE] = lead, slope


@njit(cache=True)
def innovations(x, motion, a, acceleration, value, channel, kinds, h, e):  # type: ignore[no-untyped-def]
    """Innovation of a `value` of a channel and its sensitivities, to `e` (1 + k); its row by the states, to `h`."""
    i, g, blur, zero = 3 * a, channel[UNITS_PER_M], channel[BLUR], int(channel[ZERO])
    for j in range(len(h)):
        h[j] = 0.0
    h[i], h[i + 2] = g, -g * blur
    if zero >= 0:
        h[zero] = g
    for c in range(len(e)):
        e[c] = -(g * x[i, c] - g * blur * x[i + 2, c])
        if zero >= 0:
            e[c] -= g * x[zero, c]
    e[0] += value - g * blur * acceleration
    for k in range(len(kinds)):
        if kinds[k] == SCALE:
            e[1 + k] -= g * x[i, 0]
        elif kinds[k] == CLOCK:
            e[1 + k] += g * (x[i + 1, 0] - motion[a, LEAD] * motion[a, SLOPE])


@njit(cache=True)
def row_variance(p, h, ph):  # type: ignore[no-untyped-def]
    """h' P h; P h goes to `ph` (n,)."""
    n = len(h)
    total = 0.0
    for i in range(n):
        ph[i] = 0.0
        for j in range(n):
            ph[i] += p[i, j] * h[j]
        total += h[i] * ph[i]
    return total


@njit(cache=True)
def update(x, p, gain, e, total):  # type: ignore[no-untyped-def]
    """Take a measurement: X += K e', P − K S K'; `gain` (n,) holds P h before, K after."""
    n = len(p)
    for i in range(n):
        gain[i] /= total
        for c in range(len(e)):
            x[i, c] += gain[i] * e[c]
    for i in range(n):
        for j in range(i, n):
            p[i, j] -= gain[i] * gain[j] * total
            p[j, i] = p[i, j]


@njit(cache=True)
def copy_datum(x, p, axes):  # type: ignore[no-untyped-def]
    """The datum of each axis becomes a copy of its displacement."""
    for a in range(axes):
        i, d = 3 * a, 3 * axes + a
        x[d] = x[i]
        p[d] = p[i]
        p[:, d] = p[:, i]
        p[d, d] = p[i, i]


@njit(cache=True)
def predict(x, p, motion, sample, way, walks):  # type: ignore[no-untyped-def]
    """Move mean and covariance from one fraction of the interval that ends at `sample` to another.

    way = (fraction reached, fraction wanted, length of the interval in s); sample, walks: as of `forward_block`.
    """
    was, theta, dt = way
    axes, step = len(motion), (theta - was) * dt
    for a in range(axes):
        a0, a1, lead = motion[a, INPUT], sample[1 + a], motion[a, LEAD]
        before, after = input_response(was, dt, a0, a1, lead), input_response(theta, dt, a0, a1, lead)
        predict_mean(x, 3 * a, step, before, after)
    predict_covariance(p, axes, step, sample[1 + axes :], walks)


@njit(cache=True)
def leave(x, motion, node):  # type: ignore[no-untyped-def]
    """Write the states and, after them, the true velocity of each axis to `node` (n + axes, 1 + k)."""
    n = len(x)
    node[:n] = x
    for a in range(len(motion)):
        node[n + a] = x[3 * a + 1]
        node[n + a, 0] -= motion[a, LEAD] * motion[a, SLOPE]


@njit(cache=True)
def forward_block(samples, rows, state, tables, nodes, covariances, record):  # type: ignore[no-untyped-def]
    """Run over one block; `state` = (X (n, 1 + k), P (n, n), motion (axes, 3), clock (2,)) is changed in place.

    samples (s, 1 + 2 axes): time in s, acceleration of each axis, its noise density, all after the state's time. rows
    (m, 5): measurements in time order, as of the column names; those after the last sample are left. tables = (walks
    (n,), channels (c, 4), kinds (c, k)). nodes (s, n + axes, 1 + k): states and true velocities; covariances (s, n, n).
    record (m, 4 + 1 + k + 2 n). Returns how many measurements were consumed.
    """
    x, p, motion, clock = state
    walks, channels, kinds = tables
    n, axes, columns = len(x), len(motion), x.shape[1]
    h, gain, e = np.zeros(n), np.zeros(n), np.zeros(columns)
    j = 0
    for k in range(len(samples)):
        t0, t1 = clock[TIME], samples[k, 0]
        dt = t1 - t0
        for a in range(axes):
            begin_interval(x, clock, motion, a, dt, samples[k, 1 + a])
        clock[STEP] = min(dt, GAP_STEPS * clock[STEP])
        reached = t0
        while True:
            due = j < len(rows) and rows[j, AT] <= t1
            if due and (rows[j, AT] < reached or not rows[j, VARIANCE] < np.inf):
                record[j, VERDICT] = UNUSED
                j += 1
                continue
            until = rows[j, AT] if due else t1
            was, theta = (reached - t0) / dt, (until - t0) / dt
            if until > reached:
                predict(x, p, motion, samples[k], (was, theta, dt), walks)
                reached = until
            if not due:
                break
            row, out = rows[j], record[j]
            j += 1
            out[INTERVAL], out[THETA] = k, theta
            if row[CHANNEL] == SET_DATUM:
                copy_datum(x, p, axes)
                out[VERDICT] = DATUM
                continue
            a, c = int(row[AXIS]), int(row[CHANNEL])
            now = motion[a, INPUT] + theta * (samples[k, 1 + a] - motion[a, INPUT])
            innovations(x, motion, a, now, row[VALUE], channels[c], kinds[c], h, e)
            total = row[VARIANCE] + row_variance(p, h, gain)
            out[TOTAL] = total
            out[INNOVATION : INNOVATION + columns] = e
            if e[0] * e[0] > channels[c, LIMIT] ** 2 * total:
                out[VERDICT] = REJECTED
                continue
            update(x, p, gain, e, total)
            out[VERDICT] = ACCEPTED
            out[INNOVATION + columns : INNOVATION + columns + n] = gain
            out[INNOVATION + columns + n :] = h
        clock[TIME] = t1
        for a in range(axes):
            motion[a, INPUT] = samples[k, 1 + a]
        leave(x, motion, nodes[k])
        covariances[k] = p
    return j


@njit(cache=True)
def back_through_time(adj, m, axes, dt):  # type: ignore[no-untyped-def]
    """Adjoints (n, 1 + k) and information (n, n) `dt` earlier: Phi' L and Phi' M Phi."""
    half, n = 0.5 * dt * dt, len(m)
    for a in range(axes):
        i = 3 * a
        for c in range(adj.shape[1]):
            adj[i + 2, c] += -half * adj[i, c] - dt * adj[i + 1, c]
            adj[i + 1, c] += dt * adj[i, c]
        for j in range(n):
            m[i + 2, j] += -half * m[i, j] - dt * m[i + 1, j]
            m[i + 1, j] += dt * m[i, j]
    for a in range(axes):
        i = 3 * a
        for j in range(n):
            m[j, i + 2] += -half * m[j, i] - dt * m[j, i + 1]
            m[j, i + 1] += dt * m[j, i]


@njit(cache=True)
def back_through_measurement(adj, m, gain, h, e, total):  # type: ignore[no-untyped-def]
    """Before an accepted measurement: (I − K h')' L − h e'/S and (I − K h')' M (I − K h') + h h'/S."""
    n = len(m)
    km = np.zeros(n)
    kmk = 1.0 / total
    for j in range(n):
        for i in range(n):
            km[j] += gain[i] * m[i, j]
        kmk += km[j] * gain[j]
    for c in range(adj.shape[1]):
        kl = e[c] / total
        for i in range(n):
            kl += gain[i] * adj[i, c]
        for i in range(n):
            adj[i, c] -= h[i] * kl
    for i in range(n):
        for j in range(n):
            m[i, j] += h[i] * h[j] * kmk - h[i] * km[j] - km[i] * h[j]


@njit(cache=True)
def back_through_datum(adj, m, axes):  # type: ignore[no-untyped-def]
    """Before the datum was copied from the displacement."""
    for a in range(axes):
        i, d = 3 * a, 3 * axes + a
        adj[i] += adj[d]
        adj[d] = 0.0
        m[i] += m[d]
        m[d] = 0.0
        m[:, i] += m[:, d]
        m[:, d] = 0.0


@njit(cache=True)
def backward_block(time_s, start_s, axes, nodes, covariances, record, adjoint, rows, variance):  # type: ignore[no-untyped-def]
    """Run the pass back over one block; `adjoint` = (L (n, 1 + k), M (n, n)) is changed in place and carries on.

    rows (s, 2 axes, 1 + k): displacement relative to the datum and velocity of each axis; variance (s, axes): of the
    displacement, without the parameters' part.
    """
    adj, m = adjoint
    n, columns = adj.shape
    j = len(record) - 1
    pc = np.zeros(n)
    for k in range(len(time_s) - 1, -1, -1):
        x, p = nodes[k], covariances[k]
        for a in range(axes):
            i, d = 3 * a, 3 * axes + a
            for q in range(n):
                pc[q] = p[q, i] - p[q, d]
            for c in range(columns):
                value, velocity = x[i, c] - x[d, c], x[n + a, c]
                for q in range(n):
                    value -= pc[q] * adj[q, c]
                    velocity -= p[q, i + 1] * adj[q, c]
                rows[k, 2 * a, c], rows[k, 2 * a + 1, c] = value, velocity
            known = 0.0
            for q in range(n):
                for r in range(n):
                    known += pc[q] * m[q, r] * pc[r]
            variance[k, a] = max(pc[i] - pc[d] - known, 0.0)
        before = time_s[k - 1] if k > 0 else start_s
        at, dt = time_s[k], time_s[k] - before
        while j >= 0 and (record[j, VERDICT] == UNUSED or record[j, INTERVAL] == k):
            row = record[j]
            j -= 1
            if row[VERDICT] == UNUSED or row[VERDICT] == REJECTED:
                continue
            instant = before + row[THETA] * dt
            if at > instant:
                back_through_time(adj, m, axes, at - instant)
                at = instant
            if row[VERDICT] == DATUM:
                back_through_datum(adj, m, axes)
            else:
                e, gain = row[INNOVATION : INNOVATION + columns], row[INNOVATION + columns : INNOVATION + columns + n]
                back_through_measurement(adj, m, gain, row[INNOVATION + columns + n :], e, row[TOTAL])
        if at > before:
            back_through_time(adj, m, axes, at - before)
