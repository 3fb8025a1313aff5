"""What a measurement far from its prediction means: hypotheses, each a filter of its own, weighed by their likelihood.

While measurements agree with their predictions there is one hypothesis: that they are good. One that does not agree
splits each hypothesis by what may have happened just then:

    GOOD     it is one of the few that lie so far off by chance
    OUTLIER  it is wrong, by any amount; the next ones may be so too, and may keep its value
    SHIFT    the channel's zero has moved, and stays
    RETURN   the channel's zero is back where it was before its last shift
    WRONG    the prediction is: the acceleration errs by more than its noise, and may go on to do so
    LOST     the motion's state is wrong, its bias too: an earlier measurement led it away
    NOISE    the channel's noise has risen

Each goes on as a filter of its own; the likelihood of what is measured later, by any channel, decides. Hypotheses that
fall behind the best by `ODDS` are dropped, those that have come to agree are one again, and no more than a fixed number
is kept. The priors are rates: how often each is met in the field.
"""

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from midspan.fusion.forward import (
    AT,
    AXIS,
    CHANNEL,
    INPUT,
    LEAD,
    LIMIT,
    MOTION_COLUMNS,
    SET_DATUM,
    SLOPE,
    STEP,
    TIME,
    UNITS_PER_M,
    VALUE,
    VARIANCE,
    ZERO,
    begin_interval,
    copy_datum,
    innovations,
    leave,
    predict,
    row_variance,
    update,
)
from midspan.fusion.kalman import START_S
from midspan.fusion.state_space import GAP_STEPS
from midspan.records import Floats

GOOD, OUTLIER, SHIFT, RETURN, WRONG, LOST, NOISE = range(7)
KINDS = 7
# How many hypotheses are kept.
MOST = 16
# Two are one again where every state agrees to a fifth of its standard deviation, its variance to a tenth and the
# noise to a fifth: what is lost by that is below a hundredth of the band.
SAME_MEAN, SAME_VARIANCE, SAME_NOISE, TINY = 0.05, 0.1, 0.2, 1e-24
# Columns of what each hypothesis remembers besides its filter: logarithm of its weight; density of the error of the
# acceleration that goes on (0: none) and along which axis; of the channel in disturbance number (-1: none), last value.
WEIGHT, DENSITY, ALONG, DISTURBED, KEPT = range(5)
MEMORY_COLUMNS = 5
# Options, see `Rates`.
P_OUTLIER, P_STAYS, SHIFT_RATE, RETURN_RATE, WRONG_RATE, NOISE_RATE, LOST_RATE, ODDS = range(8)
LOG_2PI = np.log(2.0 * np.pi)
# Errors of unknown size lie within this number of decades above the noise.
DECADES = 4.0


@njit(cache=True)
def log_normal(e, total):  # type: ignore[no-untyped-def]
    """Logarithm of the normal density of an innovation."""
    return -0.5 * (LOG_2PI + np.log(total) + e * e / total)


@njit(cache=True)
def log_any_size(e, total):  # type: ignore[no-untyped-def]
    """Logarithm of the density of an error of unknown size: alike in all decades from the predicted deviation on."""
    return -np.log(2.0 * DECADES * np.log(10.0)) - 0.5 * np.log(max(e * e, total))


@njit(cache=True)
def copy_state(p, x, to, of):  # type: ignore[no-untyped-def]
    """The state `to` becomes a copy of the state `of`."""
    x[to] = x[of]
    p[to] = p[of]
    p[:, to] = p[:, of]
    p[to, to] = p[of, of]


@njit(cache=True)
def noisier(p, i, dt, density):  # type: ignore[no-untyped-def]
    """More noise of the acceleration over `dt` seconds, along the axis whose displacement is state `i`."""
    p[i, i] += density * dt * dt * dt / 3.0
    p[i, i + 1] += density * 0.5 * dt * dt
    p[i + 1, i] += density * 0.5 * dt * dt
    p[i + 1, i + 1] += density * dt


@njit(cache=True)
def alike(x, p, y, q):  # type: ignore[no-untyped-def]
    """Whether two hypotheses have come to say the same of every state but the zeros' past."""
    for i in range(len(p)):
        if (x[i, 0] - y[i, 0]) ** 2 > SAME_MEAN * (p[i, i] + q[i, i]) + TINY:
            return False
        if abs(p[i, i] - q[i, i]) > SAME_VARIANCE * max(p[i, i], q[i, i]) + TINY:
            return False
    return True


@njit(cache=True)
def weigh(b, hyps, row, motion, now, tables, options, last, scratch, chances):  # type: ignore[no-untyped-def]
    """Logarithms of the weights (6,) of what hypothesis `b` may become by a measurement; -inf: not looked at."""
    xs, ps, factors, memory, shifted = hyps
    _, channels, kinds = tables
    h, gain, e = scratch
    c, a = int(row[CHANNEL]), int(row[AXIS])
    channel = channels[c]
    innovations(xs[b], motion, a, now, row[VALUE], channel, kinds[c], h, e)
    own = row[VARIANCE] * factors[b, c]
    total = own + row_variance(ps[b], h, gain)
    disturbed = int(memory[b, DISTURBED]) == c
    p_out = options[P_STAYS] if disturbed else options[P_OUTLIER]
    prior = memory[b, WEIGHT]
    chances[:] = -np.inf
    chances[GOOD] = prior + log_normal(e[0], total) + np.log(1.0 - p_out)
    size = log_any_size(e[0], total)
    if disturbed:
        size = np.log(0.5) + max(size, log_normal(row[VALUE] - memory[b, KEPT], 2.0 * own))
    chances[OUTLIER] = prior + size + np.log(p_out)
    if e[0] * e[0] <= channel[LIMIT] ** 2 * total:
        return
    lapse = max(row[AT] - last[c], 1e-3)
    z = int(channel[ZERO])
    if z >= 0:
        chances[SHIFT] = prior + np.log(options[SHIFT_RATE] * lapse) + log_any_size(e[0], total)
        if shifted[b, c]:
            x, p, g = xs[b], ps[b], channel[UNITS_PER_M]
            back = e[0] + g * (x[z, 0] - x[z + 1, 0])
            h[z], h[z + 1] = 0.0, g
            chances[RETURN] = (
                prior + np.log(options[RETURN_RATE] * lapse) + log_normal(back, own + row_variance(p, h, gain))
            )
    chances[WRONG] = prior + np.log(options[WRONG_RATE] * lapse) + log_any_size(e[0], total)
    chances[LOST] = prior + np.log(options[LOST_RATE] * lapse) + log_any_size(e[0], total)
    chances[NOISE] = prior + np.log(options[NOISE_RATE] * lapse) + log_any_size(e[0], total)


@njit(cache=True)
def become(kind, b, hyps, row, motion, now, tables, last, scratch):  # type: ignore[no-untyped-def]
    """Turn hypothesis `b` into what a measurement makes of it, as `kind` says."""
    xs, ps, factors, memory, shifted = hyps
    _, channels, kinds = tables
    h, gain, e = scratch
    c, a = int(row[CHANNEL]), int(row[AXIS])
    channel, x, p = channels[c], xs[b], ps[b]
    z, g = int(channel[ZERO]), channel[UNITS_PER_M]
    if kind == OUTLIER:
        memory[b, DISTURBED], memory[b, KEPT] = c, row[VALUE]
        return
    if int(memory[b, DISTURBED]) == c:
        memory[b, DISTURBED] = -1.0
    innovations(x, motion, a, now, row[VALUE], channel, kinds[c], h, e)
    size, lapse = e[0] / g, max(row[AT] - last[c], 1e-3)
    if kind == SHIFT:
        copy_state(p, x, z + 1, z)
        p[z, z] += size * size
        shifted[b, c] = True
    elif kind == RETURN:
        copy_state(p, x, z, z + 1)
    elif kind == WRONG:
        memory[b, DENSITY], memory[b, ALONG] = 3.0 * size * size / lapse**3, a
        noisier(p, 3 * a, lapse, memory[b, DENSITY])
    elif kind == LOST:
        i = 3 * a
        p[i, i] += size * size
        p[i + 1, i + 1] += (size / lapse) ** 2
        p[i + 2, i + 2] += (size / lapse**2) ** 2
    elif kind == NOISE:
        factors[b, c] *= e[0] * e[0] / (row[VARIANCE] * factors[b, c] + row_variance(p, h, gain))
    innovations(x, motion, a, now, row[VALUE], channel, kinds[c], h, e)
    update(x, p, gain, e, row[VARIANCE] * factors[b, c] + row_variance(p, h, gain))


@njit(cache=True)
def copy_hypothesis(hyps, to, of):  # type: ignore[no-untyped-def]
    """Hypothesis `to` becomes a copy of `of`."""
    xs, ps, factors, memory, shifted = hyps
    xs[to], ps[to], factors[to], memory[to], shifted[to] = xs[of], ps[of], factors[of], memory[of], shifted[of]


@njit(cache=True)
def prune(hyps, count, odds):  # type: ignore[no-untyped-def]
    """Drop what fell behind or repeats a better one; the best comes first. Returns how many are left."""
    xs, ps, factors, memory, _ = hyps
    best = 0
    for b in range(1, count):
        if memory[b, WEIGHT] > memory[best, WEIGHT]:
            best = b
    if best != 0:
        copy_hypothesis(hyps, 2 * MOST, 0)
        copy_hypothesis(hyps, 0, best)
        copy_hypothesis(hyps, best, 2 * MOST)
    top, left = memory[0, WEIGHT], 0
    for b in range(count):
        keep = memory[b, WEIGHT] > top - odds
        for o in range(left):
            same = memory[o, DENSITY] == memory[b, DENSITY] and memory[o, DISTURBED] == memory[b, DISTURBED]
            same = same and np.all(np.abs(factors[o] / factors[b] - 1.0) < SAME_NOISE)
            if keep and same and alike(xs[o], ps[o], xs[b], ps[b]):
                keep = False
                high, low = max(memory[o, WEIGHT], memory[b, WEIGHT]), min(memory[o, WEIGHT], memory[b, WEIGHT])
                memory[o, WEIGHT] = high + np.log1p(np.exp(low - high))
        if keep:
            if left != b:
                copy_hypothesis(hyps, left, b)
            left += 1
    for b in range(left):
        memory[b, WEIGHT] -= top
    return left


@njit(cache=True)
def meet(hyps, count, row, motion, now, tables, options, last, scratch, chances):  # type: ignore[no-untyped-def]
    """Split, weigh and prune all hypotheses by one measurement; returns how many are left."""
    memory = hyps[3]
    for b in range(count):
        weigh(b, hyps, row, motion, now, tables, options, last, scratch, chances[b])
        if memory[b, DENSITY] > 0.0:
            # The error of the acceleration may just have ended.
            chances[b] += np.log(options[P_STAYS])
    if count == 1 and chances[0, GOOD] == np.max(chances[0]) and np.sum(chances[0] > -np.inf) == 2:
        become(GOOD, 0, hyps, row, motion, now, tables, last, scratch)
        memory[0, WEIGHT] = 0.0
        return 1
    flat = chances[:count].ravel()
    order = np.argsort(-flat)
    made = 0
    for place in order[: MOST // 2]:
        if not flat[place] > flat[order[0]] - options[ODDS]:
            break
        b, kind = place // KINDS, place % KINDS
        copy_hypothesis(hyps, MOST + made, b)
        become(kind, MOST + made, hyps, row, motion, now, tables, last, scratch)
        memory[MOST + made, WEIGHT] = flat[place]
        made += 1
    for b in range(made):
        copy_hypothesis(hyps, b, MOST + b)
    for b in range(made):
        if memory[b, DENSITY] > 0.0 and made < MOST:
            copy_hypothesis(hyps, made, b)
            memory[made, DENSITY] = 0.0
            memory[made, WEIGHT] += np.log(1.0 - options[P_STAYS]) - np.log(options[P_STAYS])
            made += 1
    return prune(hyps, made, options[ODDS])


@njit(cache=True)
def decide_block(samples, rows, state, hyps, count, last, tables, options, nodes, covariances):  # type: ignore[no-untyped-def]
    """Run all hypotheses over one block; nodes and covariances take the best one's. Returns how many are left.

    state = (motion, clock); hyps = (xs (33, n, 1 + k), ps (33, n, n), factors (33, c), memory (33, 5), shifted (33,c)).
    """
    motion, clock = state
    xs, ps, _, memory, _ = hyps
    walks = tables[0]
    n, axes, columns = xs.shape[1], len(motion), xs.shape[2]
    scratch = (np.zeros(n), np.zeros(n), np.zeros(columns))
    chances = np.zeros((MOST, KINDS))
    j = 0
    for k in range(len(samples)):
        t0, t1 = clock[TIME], samples[k, 0]
        dt = t1 - t0
        for a in range(axes):
            old_lead, old_slope = motion[a, LEAD], motion[a, SLOPE]
            for b in range(count):
                motion[a, LEAD], motion[a, SLOPE] = old_lead, old_slope
                begin_interval(xs[b], clock, motion, a, dt, samples[k, 1 + a])
        clock[STEP] = min(dt, GAP_STEPS * clock[STEP])
        reached = t0
        while True:
            due = j < len(rows) and rows[j, AT] <= t1
            if due and (rows[j, AT] < reached or not rows[j, VARIANCE] < np.inf):
                j += 1
                continue
            until = rows[j, AT] if due else t1
            was, theta = (reached - t0) / dt, (until - t0) / dt
            if until > reached:
                for b in range(count):
                    predict(xs[b], ps[b], motion, samples[k], (was, theta, dt), walks)
                    if memory[b, DENSITY] > 0.0:
                        noisier(ps[b], 3 * int(memory[b, ALONG]), until - reached, memory[b, DENSITY])
                reached = until
            if not due:
                break
            row = rows[j]
            j += 1
            if row[CHANNEL] == SET_DATUM:
                for b in range(count):
                    copy_datum(xs[b], ps[b], axes)
                continue
            a, c = int(row[AXIS]), int(row[CHANNEL])
            now = motion[a, INPUT] + theta * (samples[k, 1 + a] - motion[a, INPUT])
            count = meet(hyps, count, row, motion, now, tables, options, last, scratch, chances)
            last[c] = row[AT]
        clock[TIME] = t1
        for a in range(axes):
            motion[a, INPUT] = samples[k, 1 + a]
        leave(xs[0], motion, nodes[k])
        covariances[k] = ps[0]
    return count


@dataclass(frozen=True, slots=True)
class Rates:
    """How often each is met, and what decides.

    outlier: share of measurements that are wrong by any amount; stays: of those whose next one is wrong too, and of
    errors of the acceleration that last from one measurement to the next. shift, wrong, lost, noise: a second, see the
    module; once an hour each. back: of a shifted zero, a second. odds: logarithm by which a hypothesis falls behind the
    best before it is dropped: at 12 it is 160 000 times less likely.
    """

    outlier: float = 0.01
    stays: float = 0.6
    shift: float = 1.0 / 3600.0
    back: float = 0.1
    wrong: float = 1.0 / 3600.0
    noise: float = 1.0 / 3600.0
    lost: float = 1.0 / 3600.0
    odds: float = 12.0

    @property
    def row(self) -> Floats:
        """As the recursion takes them."""
        return np.array([self.outlier, self.stays, self.shift, self.back, self.wrong, self.noise, self.lost, self.odds])


class Hypotheses:
    """The estimator of one point along one axis as a stream of samples and measurements, cut anywhere.

    start: standard deviations of displacement (m), velocity (m/s) and bias (m/s²) before the first measurement.
    channels (c, 4), kinds (c, k): see `forward`; the zero of channel c is state 4 + 2 c, what it was before a shift the
    state after it. bias_walk: density of the bias's random walk, (m/s²)²/s. bias: expected, m/s².
    """

    def __init__(
        self,
        start: tuple[float, float, float],
        channels: Floats,
        kinds: NDArray[np.int64],
        rates: Rates,
        *,
        bias_walk: float,
        bias: float = 0.0,
    ) -> None:
        n, count = 4 + 2 * len(channels), 2 * MOST + 1
        self._hyps = (
            np.zeros((count, n, 1 + kinds.shape[1])),
            np.zeros((count, n, n)),
            np.ones((count, len(channels))),
            np.zeros((count, MEMORY_COLUMNS)),
            np.zeros((count, len(channels)), dtype=np.bool_),
        )
        self._hyps[0][0, 2, 0] = bias
        self._hyps[1][0, :3, :3] = np.diag(np.square(start))
        self._hyps[3][:, DISTURBED] = -1.0
        walks = np.zeros(n)
        walks[2] = bias_walk
        self._tables, self._options = (walks, channels, kinds), rates.row
        self._motion, self._clock = np.zeros((1, MOTION_COLUMNS)), np.array([np.nan, np.inf])
        self._last = np.full(len(channels), np.nan)
        self.count = 1

    def push(self, samples: Floats, rows: Floats) -> tuple[Floats, Floats]:
        """Take samples (s, 3) and the measurements (m, 5) up to the last of them, as of `forward`'s columns.

        Returns the best hypothesis's states and true velocity (s, n + 1, 1 + k), and covariance (s, n, n) at each.
        """
        if np.isnan(self._clock[TIME]):
            self._clock[TIME], self._motion[0, INPUT] = samples[0, 0] - START_S, samples[0, 1]
            self._last[:] = self._clock[TIME]
        n, columns = self._hyps[0].shape[1:]
        nodes, covariances = np.empty((len(samples), n + 1, columns)), np.empty((len(samples), n, n))
        state = (self._motion, self._clock)
        self.count = decide_block(
            samples, rows, state, self._hyps, self.count, self._last, self._tables, self._options, nodes, covariances
        )
        return nodes, covariances
