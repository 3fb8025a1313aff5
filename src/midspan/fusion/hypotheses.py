"""What a measurement far from its prediction means: hypotheses, each a filter of its own, weighed by their likelihood.

While measurements agree with their predictions there is one hypothesis: that they are good. One that does not agree
splits each hypothesis by what may have happened just then:

    GOOD     it is one of the few that lie so far off by chance
    OUTLIER  it is wrong, by any amount; the next ones may be so too, and may keep its value
    SHIFT    the channel's zero has moved, and stays
    RETURN   the channel's zero is back where it was before its shift, or the sensor's clock is
    WRONG    the prediction is: the acceleration errs by more than its noise, and may go on to do so
    LOST     the motion's state is wrong, its bias too: an earlier measurement led it away
    NOISE    the channel's noise has risen
    CLOCK    the sensor's clock has stepped against the accelerometer's: it measures the motion of another time

Each goes on as a filter of its own; the likelihood of what is measured later, by any channel, decides. Hypotheses that
fall behind the best by `ODDS` are dropped, those that have come to agree are one again, and no more than a fixed number
is kept. The priors are rates: how often each is met in the field.

One hypothesis is laid out in `hypothesis`; `innovation` compares a measurement with it, `weighing` says how likely each
kind is, `outcomes` what the hypothesis becomes by it, and `acceptance` updates it.
"""

import numpy as np
from numba import njit

from midspan.fusion.hypothesis import (
    AGE,
    CODE,
    DENSITY,
    DISTURBED,
    ENDED,
    FACTOR,
    KINDS,
    LATER,
    MOST,
    ODDS,
    OUTLIER,
    P_STAYS,
    PARENT,
    STEPPED,
    WEIGHT,
    copy_hypothesis,
    one_of,
)
from midspan.fusion.innovation import look
from midspan.fusion.outcomes import become
from midspan.fusion.weighing import weigh

# Then one may fall behind by so many times the odds: three outliers in a row may look like motion until the fifth.
FIRST_ODDS = 2.0
# Two are one again where every state agrees to a fifth of its standard deviation, its variance to a tenth and the
# noise to a fifth: what is lost by that is below a hundredth of the band.
SAME_MEAN, SAME_VARIANCE, SAME_NOISE, TINY = 0.05, 0.1, 0.2, 1e-24
# After so many good measurements half the odds are enough to drop a hypothesis, after twice as many a third: what they
# have not distinguished they will not.
SETTLES = 20.0


@njit(cache=True)
def alike(hyps, b, o):  # type: ignore[no-untyped-def]
    """Whether two hypotheses have come to say the same of every state, of the noise and of what goes on."""
    xs, ps, marks, memory, _, _, _ = hyps
    if memory[o, DENSITY] != memory[b, DENSITY]:
        return False
    for c in range(marks.shape[1]):
        if (marks[o, c, DISTURBED] > 0.0) != (marks[b, c, DISTURBED] > 0.0) or marks[o, c, STEPPED] != marks[
            b, c, STEPPED
        ]:
            return False
        if abs(marks[o, c, FACTOR] / marks[b, c, FACTOR] - 1.0) > SAME_NOISE:
            return False
    for i in range(ps.shape[1]):
        mine, other = ps[b, i, i], ps[o, i, i]
        if (xs[b, i, 0] - xs[o, i, 0]) ** 2 > SAME_MEAN * (mine + other) + TINY:
            return False
        if abs(mine - other) > SAME_VARIANCE * max(mine, other) + TINY:
            return False
    return True


@njit(cache=True)
def prune(hyps, count, odds):  # type: ignore[no-untyped-def]
    """Drop what fell behind or repeats a better one; the best comes first. Returns how many are left."""
    memory = hyps[3]
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
        age = min(memory[b, AGE], memory[0, AGE])
        keep = b == 0 or memory[b, WEIGHT] > top - odds / (1.0 + age / SETTLES)
        for o in range(left):
            if keep and alike(hyps, b, o):
                keep = False
                high, low = max(memory[o, WEIGHT], memory[b, WEIGHT]), min(memory[o, WEIGHT], memory[b, WEIGHT])
                memory[o, WEIGHT] = high + np.log1p(np.exp(low - high))
        if keep:
            if left != b:
                copy_hypothesis(hyps, left, b)
            left += 1
    top = memory[0, WEIGHT]
    for b in range(left):
        memory[b, WEIGHT] -= top
    return left


@njit(cache=True)
def split(hyps, count, row, scene, tables, options, scratch, doubted, chances):  # type: ignore[no-untyped-def]
    """Split, weigh and prune all hypotheses by one measurement; returns how many are left. doubted: as of `weigh`."""
    memory, sharpest = hyps[3], np.inf
    for b in range(count):
        seen = look(one_of(hyps, b), row, scene, tables, scratch)
        sharpest = min(sharpest, seen[2] + seen[3])
    for b in range(count):
        weigh(one_of(hyps, b), row, scene, tables, options, scratch, (doubted, sharpest), chances[b])
        if memory[b, DENSITY] > 0.0:
            # The error of the acceleration may just have ended.
            chances[b] += np.log(options[P_STAYS])
    flat = chances[:count].ravel()
    order = np.argsort(-flat)
    most, odds = (MOST, FIRST_ODDS * options[ODDS]) if doubted else (LATER, options[ODDS])
    made = rejecting = 0
    for place in order:
        if made == most // 2 or not flat[place] > flat[order[0]] - odds:
            break
        b, kind = place // KINDS, place % KINDS
        if kind == OUTLIER:
            # Those that reject learn nothing: all of them together would keep out for ever what could take it.
            if rejecting == most // 4:
                continue
            rejecting += 1
        copy_hypothesis(hyps, MOST + made, b)
        become(kind, one_of(hyps, MOST + made), row, scene, tables, options, scratch)
        memory[MOST + made, WEIGHT], memory[MOST + made, PARENT] = flat[place], b
        made += 1
    for b in range(made):
        copy_hypothesis(hyps, b, MOST + b)
    for b in range(made):
        if memory[b, DENSITY] > 0.0 and made < most:
            copy_hypothesis(hyps, made, b)
            memory[made, DENSITY], memory[made, CODE] = 0.0, memory[b, CODE] + ENDED
            memory[made, WEIGHT] += np.log(1.0 - options[P_STAYS]) - np.log(options[P_STAYS])
            made += 1
    return prune(hyps, made, odds)
