"""What a hypothesis becomes by a measurement: rejected, accepted, or first changed in its zero, motion or clock."""

import numpy as np
from numba import njit

from midspan.fusion.acceptance import ANEW, accept, find_step
from midspan.fusion.forward import APART, AT, AXIS, CHANNEL, FORGETS, UNITS_PER_M, VALUE, ZERO, add_noise, scale_state
from midspan.fusion.forward import SENSOR as SENSOR_OF
from midspan.fusion.hypothesis import (
    ACCEPTED_AT,
    AGE,
    ALONG,
    BEGAN_AT,
    CLOCK,
    CODE,
    DENSITY,
    DISTURBED,
    DOUBTED,
    ENDED,
    ERROR,
    FACTOR,
    GOOD,
    KEPT,
    KINDS,
    LASTING,
    LOST,
    MET_AT,
    NOISE,
    ONCE,
    OUTLIER,
    OUTLIER_AT,
    OUTLIER_OF,
    RECENT,
    RESTS_ON,
    RETURN,
    RETURN_RATE,
    SHARE,
    SHIFT,
    SHIFT_AT,
    SHIFT_BY,
    SHIFT_OF,
    SHIFTED,
    SINCE_THEN,
    SPREAD,
    STEPPED,
    STEPPED_BEFORE,
    TOTAL,
    WRONG,
)
from midspan.fusion.innovation import look
from midspan.fusion.steps import group_of
from midspan.fusion.weighing import GATE, OUTLIER_MEMORY, SHORTEST_S, VAGUE, led_away, tells_step


@njit(cache=True)
def reject(mark, memory, row, sensor):  # type: ignore[no-untyped-def]
    """Leave out a measurement of a sensor as an outlier."""
    if mark[DISTURBED] == 0.0:
        # From value to value a fast sensor always keeps its own; stuck is one that keeps the first.
        mark[KEPT] = row[VALUE]
    mark[DISTURBED] += 1.0
    mark[SHARE] += (1.0 - mark[SHARE]) / OUTLIER_MEMORY
    memory[OUTLIER_AT], memory[OUTLIER_OF] = row[AT], sensor


@njit(cache=True)
def go_back(hyp, row, scene, tables, options, scratch):  # type: ignore[no-untyped-def]
    """Let a channel's zero be where it was before its shift, or its clock; as well as one measurement tells, where that
    comes later than returns do on the mean: what does not go back soon has moved for good, and a second shift has
    nearly undone the first.
    """
    x, p, marks, memory, _, _, _ = hyp
    channel, mark = tables[1][int(row[CHANNEL])], marks[int(row[CHANNEL])]
    s = int(channel[ZERO]) + 1
    scale_state(x, p, s, 0.0)
    if mark[STEPPED] == 0.0:
        seen = look(hyp, row, scene, tables, scratch)
        own_shift = memory[SHIFT_OF] == channel[SENSOR_OF]
        if not own_shift or (row[AT] - memory[SHIFT_AT]) * options[RETURN_RATE] > 1.0:
            p[s, s] += (seen[2] + seen[3]) / channel[UNITS_PER_M] ** 2
    mark[SHIFTED] = mark[STEPPED] = 0.0


@njit(cache=True)
def let_go(p, i, missed, spread):  # type: ignore[no-untyped-def]
    """Let an axis' state from place `i` on be what it may: missed = (by how much, m; in which time, s).

    spread: displacement and velocity have their noise already.
    """
    size, lapse = missed
    bias = size / lapse**2
    p[i + 2, i + 2] += bias * bias
    if not spread:
        p[i, i] += size * size
        p[i + 1, i + 1] += (size / lapse) ** 2


@njit(cache=True)
def settle_doubt(mark, kind, at, forgets, is_sharp):  # type: ignore[no-untyped-def]
    """After a gap of measurements the clock is in doubt until the motion has gone through one period, of the angular
    frequency `forgets`: before that a motion that is seen late looks like one that began otherwise, or as if the
    acceleration were wrong. After stamps that went back the next measurement tells where the prediction is sharp.
    """
    if kind == OUTLIER and mark[DOUBTED] > ONCE:
        return
    if mark[DOUBTED] == LASTING and forgets > 0.0:
        mark[DOUBTED] = ONCE + at + 2.0 * np.pi / forgets
    over = is_sharp if mark[DOUBTED] == ONCE else mark[DOUBTED] == LASTING or at >= mark[DOUBTED] - ONCE
    if over or kind in (SHIFT, RETURN, CLOCK):
        mark[DOUBTED] = 0.0


@njit(cache=True)
def step_clock(p, mark, channel, doubted):  # type: ignore[no-untyped-def]
    """A sensor's clock stepped: it measures another instant's displacement from here on."""
    s, x = int(channel[ZERO]) + 1, 3 * int(channel[AXIS])
    p[s, s], mark[STEPPED] = p[s, s] + channel[APART], 1.0
    if ONCE < doubted < LASTING:
        # It stepped while nothing was measured: what came since led the motion's state as far away.
        p[x, x] += channel[APART]
        p[x + 1, x + 1] += channel[APART] * channel[FORGETS] ** 2


@njit(cache=True)
def forget_steps(tests, kind, channel, axes):  # type: ignore[no-untyped-def]
    """No step before a change of a sensor's zero is asked for any more."""
    if kind in (SHIFT, RETURN, CLOCK):
        tests[group_of(channel, axes)] = 0.0


@njit(cache=True)
def shift_zero(hyp, row, channel, seen, since_then):  # type: ignore[no-untyped-def]
    """Let a channel's zero have shifted; seen = (innovation, its variance). Where only later measurements tell the
    size, nothing is known of it here: the prior takes a fiftieth of its deviation.
    """
    _, p, marks, memory, _, _, _ = hyp
    s, (error, total), unit = int(channel[ZERO]) + 1, seen, channel[UNITS_PER_M]
    p[s, s] += (VAGUE * total if since_then else error * error) / (unit * unit)
    marks[int(row[CHANNEL]), SHIFTED] = 1.0
    memory[SHIFT_AT], memory[SHIFT_OF], memory[SHIFT_BY] = row[AT], channel[SENSOR_OF], error / unit


@njit(cache=True)
def become(code, hyp, row, scene, tables, options, scratch):  # type: ignore[no-untyped-def]
    """Turn a hypothesis into what a measurement makes of it, as `code` says; returns the innovation's variance that
    it was taken with (0: not at all) and the factor by which the shift's state was scaled.
    """
    _, p, marks, memory, _, _, tests = hyp
    c = int(row[CHANNEL])
    channel, mark = tables[1][c], marks[c]
    a, s, scaled = int(channel[AXIS]), int(channel[ZERO]) + 1, 1.0
    kind, lapse, spread = code % KINDS, max(row[AT] - mark[MET_AT], SHORTEST_S), (code // SPREAD) % 2 == 1
    since_then, code = code >= SINCE_THEN, code % SPREAD
    memory[CODE] = code
    memory[AGE] = memory[AGE] + 1.0 if code == GOOD else 0.0
    mark[MET_AT], doubted = row[AT], mark[DOUBTED]
    seen = look(hyp, row, scene, tables, scratch)
    settle_doubt(mark, kind, row[AT], channel[FORGETS], tells_step(channel, seen[2] + seen[3]))
    # Whether the samples' noise since then explains it: then it was the prediction that was wrong.
    spread = spread and seen[0] ** 2 <= GATE * GATE * (seen[2] + seen[3])
    kind = GOOD if spread and kind == OUTLIER else kind
    if kind == OUTLIER:
        reject(mark, memory, row, channel[SENSOR_OF])
        memory[ERROR], memory[TOTAL] = seen[0], seen[2] + seen[3]
        if code >= ENDED:
            memory[DENSITY] = 0.0
        return 0.0, scaled
    error, total = seen[0], seen[2] + seen[3]
    size = error / channel[UNITS_PER_M]
    forget_steps(tests, kind, channel, len(tables[5]))
    if kind == SHIFT:
        shift_zero(hyp, row, channel, (error, total), since_then)
    elif kind == RETURN:
        scaled = 0.0
        go_back(hyp, row, scene, tables, options, scratch)
    elif kind == CLOCK:
        step_clock(p, mark, channel, doubted)
    elif kind == WRONG:
        memory[DENSITY], memory[ALONG] = led_away(size, lapse), a
        if not spread:
            add_noise(p, 3 * a, lapse, memory[DENSITY])
    elif kind == LOST:
        lapse = max(row[AT] - max(mark[ACCEPTED_AT], memory[BEGAN_AT]), SHORTEST_S)
        size = max(abs(size), np.sqrt(total) / abs(channel[UNITS_PER_M]))
        let_go(p, 3 * a, (size, lapse), spread)
        memory[DENSITY] = 0.0
    elif kind == NOISE:
        mark[RECENT] = 1.0
        mark[FACTOR], mark[RESTS_ON] = mark[FACTOR] * error * error / total, min(mark[RESTS_ON], ANEW)
    if kind != GOOD:
        seen = look(hyp, row, scene, tables, scratch)
    if mark[STEPPED] > 0.0 and seen[0] ** 2 > GATE * GATE * (seen[2] + seen[3]):
        # The two instants are farther apart than usual, as in a passage: rejected, or taken for an error of the
        # motion's state, it would leave the acceleration alone or begin a velocity that nothing moves with.
        p[s, s] += seen[0] ** 2 / channel[UNITS_PER_M] ** 2
        seen = look(hyp, row, scene, tables, scratch)
    taken = accept(hyp, row, seen, tables, options, scratch)
    memory[ERROR], memory[TOTAL] = error, total
    if code == STEPPED_BEFORE:
        find_step(hyp, row, tables, -np.inf)
    elif code >= ENDED:
        memory[DENSITY] = 0.0
    return taken, scaled
