"""The one loop of the estimator over a block of samples and measurements, and what it leaves.

Measurements are either judged as they come, by hypotheses (see `hypotheses`), or taken as was decided before: then one
hypothesis is enough, and what the pass back (`backward`) needs is left behind.
"""

import numpy as np
from numba import njit

from midspan.fusion.acceptance import accept, find_step
from midspan.fusion.borrowing import borrowed
from midspan.fusion.forward import (
    APART,
    AT,
    AXIS,
    CHANNEL,
    COASTING_S,
    COUNT,
    GAIN_OF,
    INPUT,
    JUDGED,
    LEAD,
    LOST_S,
    SET_DATUM,
    SLOPE,
    SOURCE,
    STEP,
    TIME,
    ZERO,
    add_noise,
    begin_interval,
    copy_datum,
    find_uncertain,
    predict,
)
from midspan.fusion.hypotheses import split
from midspan.fusion.hypothesis import (
    ACCEPTED_AT,
    ACCEPTED_VARIANCE,
    ALONG,
    CODE,
    DATUM,
    DENSITY,
    DISTURBED,
    DOUBTED,
    ERROR,
    GOOD,
    LASTING,
    MET_AT,
    ONCE,
    PARENT,
    SHIFT_RATE,
    STEP_AGO,
    STEP_BY,
    STEP_VARIANCE,
    STEPPED,
    STEPPED_BEFORE,
    TOTAL,
    WEIGHT,
    one_of,
)
from midspan.fusion.innovation import follow_clock, look, meet_zero
from midspan.fusion.outcomes import become
from midspan.fusion.state_space import GAP_STEPS
from midspan.fusion.steps import SURE
from midspan.fusion.weighing import GATE, VAGUE
from midspan.records import Status

# What is left of each sample and axis: displacement relative to the datum, its variance, the true velocity, codes of
# source and status.
FOUND_X, FOUND_VARIANCE, FOUND_VELOCITY, FOUND_SOURCE, FOUND_STATUS = range(5)
FOUND_COLUMNS = 5
# Of each measurement as the best hypothesis saw it then: innovation, its predicted variance, code of what it was.
MET_ERROR, MET_TOTAL, MET_CODE = range(3)
MET_COLUMNS = 3
# Of each decided measurement, for the pass back: number of its sample in the block, fraction of the interval, variance
# it was taken with (0: not at all), channel, factors that scaled the states of shift and reference; then its
# sensitivities (1 + k) and gain (n).
INTERVAL, THETA, TAKEN, OF_CHANNEL, SHIFT_SCALED, REFERENCE_SCALED, RECORD = range(7)
TRACKING, COASTING, LOST_STATUS = float(Status.TRACKING), float(Status.COASTING), float(Status.LOST)
# Standard deviation (s) of the clock of a sensor that is just back: one that starts anew is set to within some frames.
# What is farther off is a clock that has stepped, see `hypotheses`.
BACK_STD_S = 0.02
# In `decided`: not decided, the hypotheses judge.
OPEN = -1
PARENT_STEP = 32


@njit(cache=True, inline="always")
def leave_status(axis, time, marks, channels, found, k):  # type: ignore[no-untyped-def]
    """Write source and status of an axis's row: of the channels that are not too old, the most informative one."""
    source, status, best = 0.0, LOST_STATUS, np.inf
    for c in range(len(channels)):
        if int(channels[c, AXIS]) != axis:
            continue
        age = time - marks[c, ACCEPTED_AT]
        if age <= channels[c, COASTING_S]:
            status = TRACKING
            if marks[c, ACCEPTED_VARIANCE] < best:
                best, source = marks[c, ACCEPTED_VARIANCE], channels[c, SOURCE]
        elif age <= channels[c, LOST_S]:
            status = min(status, COASTING)
    found[k, axis, FOUND_SOURCE], found[k, axis, FOUND_STATUS] = source, status


@njit(cache=True, inline="always")
def clock_variance(axis, time, marks, channels):  # type: ignore[no-untyped-def]
    """Variance (s²) of the clock that an axis's row rests on, where all sensors that measure it are just back."""
    doubted = False
    for c in range(len(channels)):
        if int(channels[c, AXIS]) == axis and time - marks[c, ACCEPTED_AT] <= channels[c, COASTING_S]:
            if marks[c, DOUBTED] <= ONCE or channels[c, APART] == 0.0:
                return 0.0
            doubted = True
    return BACK_STD_S * BACK_STD_S if doubted else 0.0


@njit(cache=True, inline="always")
def zero_variance(p, channels, a, datum, misfit):  # type: ignore[no-untyped-def]
    """Variance (m²) that all rows of an axis have in common: of the datum as the first channel's values count it."""
    d = datum + a
    for c in range(len(channels)):
        if int(channels[c, AXIS]) == a:
            z = int(channels[c, ZERO])
            if datum < 0:
                return misfit[a] * p[z, z]
            return misfit[a] * max(p[d, d] + 2.0 * p[d, z] + p[z, z], 0.0) if p[d, d] > 0.0 else 0.0
    return misfit[a] * p[d, d] if datum >= 0 else 0.0


@njit(cache=True, inline="always")
def row_of(x, p, theta, spread, a, datum, misfit):  # type: ignore[no-untyped-def]
    """Displacement of axis `a` relative to its datum, its variance, and the velocity state, in one hypothesis.

    misfit (axes,): factor on the variance of the states.
    """
    i, d = 3 * a, datum + a
    value, variance, velocity = x[i, 0], p[i, i], x[i + 1, 0]
    if datum >= 0:
        value -= x[d, 0]
        variance += p[d, d] - 2.0 * p[i, d]
    variance = misfit[a] * max(variance, 0.0)
    for q in range(len(theta)):
        one = x[i, 1 + q] - (x[d, 1 + q] if datum >= 0 else 0.0)
        value += one * theta[q]
        velocity += x[i + 1, 1 + q] * theta[q]
        for r in range(len(theta)):
            variance += one * spread[q, r] * (x[i, 1 + r] - (x[d, 1 + r] if datum >= 0 else 0.0))
    return value, variance, velocity


@njit(cache=True)
def mixed_row(hyps, count, a, datum, misfit):  # type: ignore[no-untyped-def]
    """The same over all hypotheses: mean and variance, by their weights."""
    whole = mean = square = velocity = first = 0.0
    for b in range(count):
        weight = np.exp(hyps[3][b, WEIGHT])
        x, p, _, _, theta, spread, _ = one_of(hyps, b)
        value, variance, speed = row_of(x, p, theta, spread, a, datum, misfit)
        first = value if b == 0 else first
        off = value - first
        whole += weight
        mean += weight * off
        square += weight * (variance + off * off)
        velocity += weight * speed
    return first + mean / whole, square / whole - (mean / whole) ** 2, velocity / whole


@njit(cache=True, inline="always")
def leave_row(hyps, best, a, motion, clock, channels, datum, misfit, found, k):  # type: ignore[no-untyped-def]
    """Write what is found of axis `a` at sample `k`, where the clock is."""
    x, p, marks, _, theta, spread, _ = best
    if clock[COUNT] > 1.0:
        value, variance, velocity = mixed_row(hyps, int(clock[COUNT]), a, datum, misfit)
    else:
        value, variance, velocity = row_of(x, p, theta, spread, a, datum, misfit)
    found[k, a, FOUND_X] = value
    velocity -= motion[a, LEAD] * motion[a, SLOPE]
    variance += clock_variance(a, clock[TIME], marks, channels) * velocity * velocity
    found[k, a, FOUND_VARIANCE] = max(variance, zero_variance(p, channels, a, datum, misfit))
    found[k, a, FOUND_VELOCITY] = velocity
    leave_status(a, clock[TIME], marks, channels, found, k)


@njit(cache=True, inline="always")
def leave_node(x, p, motion, datum, nodes, k):  # type: ignore[no-untyped-def]
    """Write what the pass back needs of sample `k`, for each axis: displacement relative to the datum (1 + k), true
    velocity (1 + k), and the covariances (n) of both with all states.
    """
    n, columns = x.shape
    for a in range(len(motion)):
        i, d = 3 * a, datum + a
        for c in range(columns):
            nodes[k, a, c], nodes[k, a, columns + c] = x[i, c], x[i + 1, c]
        nodes[k, a, columns] -= motion[a, LEAD] * motion[a, SLOPE]
        for q in range(n):
            nodes[k, a, 2 * columns + q] = p[i, q]
        for q in range(n):
            nodes[k, a, 2 * columns + n + q] = p[i + 1, q]
        if datum >= 0:
            for c in range(columns):
                nodes[k, a, c] -= x[d, c]
            for q in range(n):
                nodes[k, a, 2 * columns + q] -= p[d, q]


@njit(cache=True)
def order_frame(rows, j, best, motion, now, tables, scratch):  # type: ignore[no-untyped-def]
    """Put the measurements of the same instant as `rows[j]` in the order of how well they agree with the best
    hypothesis, so that what is found does not depend on the order of targets. Returns where they end.
    """
    end = j + 1
    while end < len(rows) and rows[end, AT] == rows[j, AT] and rows[end, CHANNEL] >= 0.0:
        end += 1
    off = np.empty(end - j)
    for i in range(j, end):
        scene = (motion, now[int(tables[1][int(rows[i, CHANNEL]), AXIS])], 0.0)
        error, _, wider, own = look(best, rows[i], scene, tables, scratch)
        off[i - j] = error * error / (wider + own)
    rows[j:end] = rows[j:end][np.argsort(off)]
    return end


@njit(cache=True)
def meet_others(hyps, clock, row, channel):  # type: ignore[no-untyped-def]
    """Bring all hypotheses but the best to a channel's measurement."""
    for b in range(1, int(clock[COUNT])):
        meet_zero(one_of(hyps, b), row, channel)
        follow_clock(one_of(hyps, b), row, channel)


@njit(cache=True, inline="always")
def take_good(hyp, row, seen, tables, options, scratch):  # type: ignore[no-untyped-def]
    """Take a measurement of a sound channel as a good one; seen: of `look`. Returns as `accept`."""
    _, _, marks, memory, _, _, _ = hyp
    marks[int(row[CHANNEL]), MET_AT] = row[AT]
    memory[PARENT], memory[CODE] = 0.0, GOOD
    return accept(hyp, row, seen, tables, options, scratch)


@njit(cache=True, inline="always")
def judge(hyps, best, clock, row, scene, tables, options, scratch, chances):  # type: ignore[no-untyped-def]
    """Let all hypotheses meet a measurement; the number of them in `clock` follows."""
    _, _, marks, memory, _, _, _ = best
    count, c = int(clock[COUNT]), int(row[CHANNEL])
    if row[AT] - marks[c, MET_AT] > tables[1][c, COASTING_S]:
        hyps[2][:count, c, DOUBTED] = LASTING
    meet_zero(best, row, tables[1][c])
    follow_clock(best, row, tables[1][c])
    usual = memory[DENSITY] == 0.0 and marks[c, DISTURBED] == 0.0 and marks[c, STEPPED] + marks[c, DOUBTED] == 0.0
    if count == 1 and clock[JUDGED] <= 0.0 and usual:
        seen = look(best, row, scene, tables, scratch)
        if seen[0] * seen[0] <= GATE * GATE * (seen[2] + seen[3]) and seen[2] <= VAGUE * seen[3]:
            take_good(best, row, seen, tables, options, scratch)
            if options[SHIFT_RATE] > 0.0:
                find_step(best, row, tables, SURE)
            return
    meet_others(hyps, clock, row, tables[1][c])
    doubted = clock[JUDGED] > 0.0
    clock[COUNT] = split(hyps, count, row, scene, tables, options, scratch, doubted, chances)
    if doubted:
        pass_first(hyps[6], clock)


@njit(cache=True)
def pass_first(tests, clock):  # type: ignore[no-untyped-def]
    """Count one of the first measurements: no step is asked for among them, as little is known of the start."""
    tests[: int(clock[COUNT])] = 0.0
    clock[JUDGED] -= 1.0


@njit(cache=True, inline="always")
def keep_survivors(hyps, count, j, survivors, errors, met):  # type: ignore[no-untyped-def]
    """Write what each hypothesis took the measurement `j`, the last one, for, of which hypothesis it came, and its
    innovation with the variance of that, or of a step that it told size (m), variance (m²) and how long ago (s) it was.
    """
    memory = hyps[3]
    for b in range(count):
        survivors[b, j] = int(memory[b, PARENT]) * PARENT_STEP + int(memory[b, CODE])
        if memory[b, CODE] == STEPPED_BEFORE:
            errors[b, j, 0], errors[b, j, 1] = memory[b, STEP_BY], memory[b, STEP_VARIANCE]
            errors[b, j, 2] = memory[b, STEP_AGO]
        else:
            errors[b, j, 0], errors[b, j, 1], errors[b, j, 2] = memory[b, ERROR], memory[b, TOTAL], 0.0
    met[j, MET_ERROR], met[j, MET_TOTAL], met[j, MET_CODE] = memory[0, ERROR], memory[0, TOTAL], memory[0, CODE]


@njit(cache=True, inline="always")
def take_decided(code, best, row, scene, tables, options, scratch, out):  # type: ignore[no-untyped-def]
    """Take a measurement as was decided, and leave its record for the pass back."""
    gain, e = scratch
    c, scaled = int(row[CHANNEL]), 1.0
    out[OF_CHANNEL] = c
    out[REFERENCE_SCALED] = meet_zero(best, row, tables[1][c])
    followed = follow_clock(best, row, tables[1][c])
    if code == GOOD and best[2][c, STEPPED] == 0.0:
        best[2][c, DOUBTED] = 0.0
        out[TAKEN] = take_good(best, row, look(best, row, scene, tables, scratch), tables, options, scratch)
    else:
        out[TAKEN], scaled = become(code, best, row, scene, tables, options, scratch)
    out[SHIFT_SCALED] = followed * scaled
    for q in range(len(e)):
        out[RECORD + q] = e[q]
    for j in range(len(gain)):
        out[RECORD + len(e) + j] = gain[j]


@njit(cache=True, inline="always")
def move(x, p, memory, motion, samples, k, way, walks, gain_of, uncertain, count):  # type: ignore[no-untyped-def]
    """Move one hypothesis within the interval that ends at sample `k`; way and what follows: as of `predict`."""
    predict(x, p, motion, samples, k, way, walks, gain_of, uncertain, count)
    if memory[DENSITY] > 0.0:
        add_noise(p, 3 * int(memory[ALONG]), (way[1] - way[0]) * way[2], memory[DENSITY])


@njit(cache=True, inline="always")
def note_uncertain(p, moving, walks, uncertain, once):  # type: ignore[no-untyped-def]
    """As `find_uncertain`, and mark them as having been so `once` (n,) in the block."""
    count = find_uncertain(p, moving, walks, uncertain)
    for q in range(count):
        once[uncertain[q]] = 1
    return count


@njit(cache=True)
def move_others(hyps, motion, clock, samples, k, way, tables, uncertain):  # type: ignore[no-untyped-def]
    """Move all hypotheses but the best."""
    walks, gain_of = tables[0], tables[4][:, GAIN_OF]
    for b in range(1, int(clock[COUNT])):
        x, p, _, memory, _, _, _ = one_of(hyps, b)
        count = find_uncertain(p, 3 * len(motion), walks, uncertain)
        move(x, p, memory, motion, samples, k, way, walks, gain_of, uncertain, count)


@njit(cache=True)
def pass_mark(hyps, axes, clock, mark, j, out):  # type: ignore[no-untyped-def]
    """The rows count from here, or clocks are in doubt; each hypothesis goes on as it is."""
    _, met, survivors, errors, _, record, _ = out
    for b in range(int(clock[COUNT])):
        if mark == SET_DATUM:
            copy_datum(hyps[0][b], hyps[1][b], axes)
            hyps[6][b] = 0.0
        else:
            hyps[2][b, :, DOUBTED] = ONCE
        survivors[b, j] = b * PARENT_STEP + DATUM
        errors[b, j] = 0.0
    met[j, MET_CODE] = DATUM
    record[j, OF_CHANNEL] = mark


@njit(cache=True, inline="always")
def meet_row(j, ordered, place, block, state, hyps, best, tables, options, scratch, out):  # type: ignore[no-untyped-def]
    """Take the measurement `j` of a block, judged or as decided; returns up to where rows are in their order.

    place = (number of the sample that ends the interval, fraction of it); block = (samples, rows, decided).
    """
    motion, clock = state
    samples, rows, decided = block
    _, met, survivors, errors, _, record, _ = out
    k, theta = place
    record[j, INTERVAL], record[j, THETA] = k, theta
    if rows[j, CHANNEL] < 0.0:
        pass_mark(hyps, len(motion), clock, rows[j, CHANNEL], j, out)
        return ordered
    now, own = scratch[2], (scratch[0], scratch[1])
    for a in range(len(motion)):
        now[a] = motion[a, INPUT] + theta * (samples[k, 1 + a] - motion[a, INPUT])
    if decided[j] == OPEN and j >= ordered and j + 1 < len(rows) and rows[j + 1, AT] == rows[j, AT]:
        ordered = order_frame(rows, j, best, motion, now, tables, own)
    a = int(tables[1][int(rows[j, CHANNEL]), AXIS])
    scene = (motion, now[a], samples[k, 1 + len(motion) + a])
    if decided[j] == OPEN:
        judge(hyps, best, clock, rows[j], scene, tables, options, own, scratch[3])
        keep_survivors(hyps, int(clock[COUNT]), j, survivors, errors, met)
    else:
        take_decided(decided[j], best, rows[j], scene, tables, options, own, record[j])
        if clock[JUDGED] > 0.0:
            pass_first(hyps[6], clock)
    return ordered


@njit(cache=True)
def run_block(samples, rows, decided, state, hyps, tables, options, scratch, numbers, out):  # type: ignore[no-untyped-def]
    """Run over one block; `state` = (motion (axes, 3), clock (4,)) and `hyps` are changed in place and carry on.

    samples (s, 1 + 2 axes): time in s, acceleration of each axis, to which what leaning takes is added in place, its
    noise density, all after the state's time. rows (m, 5): usable measurements, all within the samples, in time order;
    those of one instant are put in the order they are taken in. decided (m,): OPEN, or the code that was decided. hyps:
    see `model.hypotheses_at`. tables = (walks (n,), channels (c, 13), kinds (c, k), first state of the datums or -1,
    parameters (k, 4), misfit (axes,), lean (axes,)). To work with: scratch = (gain (n,), sensitivities (1 + k),
    accelerations (axes,), chances (MOST, KINDS)), numbers = (uncertain states of the best hypothesis (n,), of another).
    out = (found (s, axes, 5), met (m, 3), of each hypothesis that judges survivors (MOST, m) and errors (MOST, m, 3),
    nodes (s or 0, axes, 2 (1 + k) + 2 n), record (m, 8 + k + n), 1 for states that are uncertain in some part of the
    block (n,)). Returns how many hypotheses there were at most.
    """
    samples, rows, decided, options = borrowed((samples, rows, decided, options))
    state, hyps, tables, out = borrowed((state, hyps, tables, out))
    scratch, (uncertain, others) = borrowed((scratch, numbers))
    motion, clock = state
    walks, channels, _, datum, learning, misfit, lean = tables
    gain_of, found, nodes, once = learning[:, GAIN_OF], out[0], out[4], out[6]
    best = one_of(hyps, 0)
    x, p, _, memory, _, _, _ = best
    once[: 3 * len(motion)] = 1
    count = note_uncertain(p, 3 * len(motion), walks, uncertain, once)
    # Not the literal 0: Numba would compile all that takes them a second time, for that constant.
    j = ordered = np.int64(0)
    widest = int(clock[COUNT])
    for k in range(len(samples)):
        begun, end = clock[TIME], samples[k, 0]
        gap, reached = end - begun > GAP_STEPS * clock[STEP], begun
        for a in range(len(motion)):
            # An error of the displacement makes lean times it of the acceleration, far below its noise.
            samples[k, 1 + a] += lean[a] * (x[3 * a, 0] + (end - begun) * x[3 * a + 1, 0])
        dt = begin_interval(hyps[0], clock, motion, samples, k, gain_of)
        while True:
            due = j < len(rows) and rows[j, AT] <= end
            until = rows[j, AT] if due else end
            if until > reached:
                way = ((reached - begun) / dt, (until - begun) / dt, dt)
                move(x, p, memory, motion, samples, k, way, walks, gain_of, uncertain, count)
                if clock[COUNT] > 1.0:
                    move_others(hyps, motion, clock, samples, k, way, tables, others)
                reached = until
            if not due:
                break
            place = (k, (until - begun) / dt)
            ordered = meet_row(
                j, ordered, place, (samples, rows, decided), state, hyps, best, tables, options, scratch, out
            )
            count = note_uncertain(p, 3 * len(motion), walks, uncertain, once)
            widest = max(widest, int(clock[COUNT]))
            j += 1
        clock[TIME] = end
        if gap:
            hyps[2][: int(clock[COUNT]), :, DOUBTED] = ONCE
        for a in range(len(motion)):
            motion[a, INPUT] = samples[k, 1 + a]
            leave_row(hyps, best, a, motion, clock, channels, datum, misfit, found, k)
        if len(nodes) > 0:
            leave_node(x, p, motion, datum, nodes, k)
    return widest


@njit(cache=True)
def trace(survivors, count, codes, errors, kept):  # type: ignore[no-untyped-def]
    """Follow the hypotheses back: what the best one took each measurement for, to `codes` (m,), and its errors, from
    `errors` to `kept` (m, 3). Returns up to which measurement all hypotheses have one past.
    """
    at = np.arange(count)
    final = len(survivors) if count == 1 else 0
    for j in range(len(survivors) - 1, -1, -1):
        codes[j] = survivors[j, at[0]] % PARENT_STEP
        kept[j] = errors[j, at[0]]
        one = True
        for b in range(count):
            at[b] = survivors[j, at[b]] // PARENT_STEP
            one = one and at[b] == at[0]
        if one and final == 0:
            final = j
    return final
