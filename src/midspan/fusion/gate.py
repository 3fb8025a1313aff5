"""Which displacement measurements are believed.

A measurement whose innovation is beyond `limit` predicted standard deviations is rejected. A target that has really
moved would then be rejected for ever, so after `reacquire_s` of nothing but rejections the filter gives its position up
and takes the new one; this is declared in the result, never silent.

The prediction widens meanwhile, and after some seconds its band holds where the target was and where it seems to be.
What tells the two apart is the step: over one interval the prediction is sharp however long it has coasted. Only after
a step may measurements that lie in the band be the target's return; those that drift into it, or stand where the band
comes to them, wait for `reacquire_s`.

Three things keep wrong noise levels from shutting the truth out. Five rejections in a row already count as the filter's
own error until it has settled, and later where all five lie within three times the limit: what is taken over then is so
small a step. They do not where they began with a step and keep to their level: that is no error of the filter. And
where the accepted innovations and those near to the gate step more from one to the next than predicted, the gate widens
with them.
"""

from dataclasses import dataclass

import numpy as np
from numba import njit

from midspan.fusion.state_space import (
    ACCEPTED_COUNT,
    AGREEMENTS,
    FARTHEST,
    FIRST_INNOVATION,
    FIRST_NOISE,
    FIRST_REJECTED,
    FIRST_TOTAL,
    JUDGED,
    JUDGED_AT,
    LAST_ACCEPTED,
    LEVEL,
    NEAR_ONES,
    P00,
    P11,
    P22,
    REJECTIONS,
    SOURCE,
)


@dataclass(frozen=True, slots=True)
class GateSettings:
    """limit: predicted standard deviations at which a measurement is rejected; higher lets more outliers in.

    reacquire_s: seconds of rejections alone after which the new position is accepted; longer rides through longer
    obstructions of the target, shorter recovers sooner from a true jump.
    """

    limit: float = 4.0
    reacquire_s: float = 5.0


# Wide enough to let everything in.
NO_GATE = GateSettings(limit=1e9)
ACCEPTED, REJECTED, REACQUIRED = 0, 1, 2
LEAST_REJECTIONS = 5
# After a run of rejections the predicted band is wide and a wrong measurement can fall into it by chance; the target
# counts as back only when this many in a row agree within half the limit, the first after a step and the others none.
CONFIRMATIONS = 3
# An innovation further from the one before it than the first many deviations of what can be predicted has stepped; one
# that may be the target's return does not step beyond the second from the one before it.
STEPPED, UNSTEADY = 3.0, 4.0
# A level of its own begins beyond so many limits of the gate.
CLEARLY_OFF = 1.5
# Where the second rejection lies this much farther off than the first, the prediction runs away from the truth: a level
# does not double in an interval.
RUNS_AWAY = 1.6
# Rejected ones keep to their level while the squares of their steps come to less than this, and so much more for each.
LEAST_UNSTEADY, UNSTEADY_EACH = 10.0, 3.0

# Five rejections within this many limits are an error of the filter rather than of the measurements.
NEAR = 3.0
# Of a sum of variances, the relative spacing of double precision.
RESOLVED = 2.3e-16
# Fewer accepted measurements than this are no state worth defending.
SETTLED = 20
# The median step of the innovations is followed by this factor a measurement (it scatters by a quarter then), and
# widens the gate from one and a half times the predicted one on, to a little over three times its limit.
ROUGHER, LEAST_ROUGHNESS, WIDENS_FROM, MOST_ROUGHNESS = 1.1, 0.5, 1.5, 5.0
NORMAL_MEDIAN = 0.6744897501960817


@njit(cache=True, inline="always")
def rougher(roughness: float, step: float, variance: float) -> float:
    """The innovations' median step over the predicted one, after a `step` of predicted `variance`.

    Only accepted and near measurements count (see `is_near`), so that neither an outlier nor a stuck target opens the
    gate; drift is no step.
    """
    if step * step > NORMAL_MEDIAN * NORMAL_MEDIAN * roughness * roughness * variance:
        return min(roughness * ROUGHER, MOST_ROUGHNESS)
    return max(roughness / ROUGHER, LEAST_ROUGHNESS)


@njit(cache=True, inline="always")
def limits_now(limits: tuple[float, float], accepted: float, roughness: float) -> tuple[float, float]:
    """The gate's numbers for a filter that has accepted so many measurements and whose innovations are so rough."""
    widened = limits[0] * max(1.0, roughness / WIDENS_FROM)
    return widened, limits[1] if accepted >= SETTLED else 0.0


@njit(cache=True, inline="always")
def judge(
    innovation: float,
    variance: float,
    run: tuple[float, float, float, float, float, float],
    limits: tuple[float, float],
) -> int:
    """ACCEPTED, REJECTED or REACQUIRED for an innovation of predicted `variance`.

    run: seconds since the first of the rejections in a row, their number, how many of the last ones with this one may
    be the target's return (see `returning`), the square of the farthest in predicted variances, how many of the last
    ones with this one were near (see `is_near`), and whether they keep to a level (above 0).
    limits = (limit, reacquire_s).
    """
    rejected_for_s, rejections, agreements, farthest, near_ones, level = run
    ratio, limit = innovation * innovation / variance, limits[0] * limits[0]
    if rejections < LEAST_REJECTIONS:
        near = max(ratio, farthest) <= NEAR * NEAR * limit and level == 0.0
        waiting = rejections + 1 < LEAST_REJECTIONS or (rejected_for_s < limits[1] and not near)
        still = rejections > 0.0 and level > 0.0
        return ACCEPTED if ratio <= limit and not still else REJECTED if waiting else REACQUIRED
    if agreements > 0.0:
        return ACCEPTED if agreements >= CONFIRMATIONS else REJECTED
    # Also when it lies inside: after so long the band is wide enough for a target that has moved.
    given_up = rejected_for_s >= limits[1] or (near_ones >= LEAST_REJECTIONS and level == 0.0)
    return REACQUIRED if given_up else REJECTED


@njit(cache=True, inline="always")
def is_near(innovation: float, variance_at_first: float, limits: tuple[float, float]) -> bool:
    """Whether a rejection lies within three limits of what was predicted when the run of rejections began."""
    return innovation * innovation <= NEAR * NEAR * limits[0] * limits[0] * variance_at_first


@njit(cache=True, inline="always")
def agrees(innovation: float, variance: float, limits: tuple[float, float]) -> bool:
    """Whether a measurement lies so close to the prediction that it may be the target's return."""
    return innovation * innovation <= 0.25 * limits[0] * limits[0] * variance


@njit(cache=True, inline="always")
def both_sides(s):  # type: ignore[no-untyped-def]
    """Rejections on both sides are noise: a state that is wrong is left on one side. No reason to give it up."""
    s[FARTHEST], s[NEAR_ONES] = np.inf, 0.0


@njit(cache=True, inline="always")
def returning(agreements: float, agreeing: bool, steps: tuple[float, float]) -> float:
    """How many measurements in a row may be the target's return, after one that does or does not agree.

    steps: to this innovation from the one before it, in deviations of what can be predicted of it: with the noise as it
    was before the rejections where that is less, and as it is.
    """
    if not agreeing:
        return 0.0
    if agreements > 0.0 and steps[1] <= UNSTEADY:
        return agreements + 1.0
    return 1.0 if steps[0] > STEPPED else 0.0


@njit(cache=True, inline="always")
def judged(s, stamp, innovation, total, limits, back_within):  # type: ignore[no-untyped-def]
    """Verdict on an innovation of predicted variance `total`, and seconds since the first of the rejections before it.

    The state vector `s`, whose covariance is the predicted one, remembers it; stamp = (time, source) of the
    measurement; limits as of `limits_now`; back_within: rejections after which a measurement where the first one was
    expected no longer means that the level is no level.
    """
    time, source = stamp
    rejections = s[REJECTIONS]
    rejected_for = time - s[FIRST_REJECTED] if rejections > 0 else 0.0
    # At least what a number resolves: next to an unknown position a very small noise is lost in the sum.
    noise, lapse = max(total - s[P00], RESOLVED * total), time - s[JUDGED_AT]
    if rejections == 0:
        s[FIRST_TOTAL], s[FIRST_INNOVATION], s[FIRST_NOISE] = total, innovation, noise
    squared, drifted = (innovation - s[JUDGED]) ** 2, lapse * lapse * s[P11]
    # A target that stands still while the motion goes on looks like noise: what is learnt of it then may be too large.
    step = np.sqrt(squared / (2.0 * min(noise, s[FIRST_NOISE]) + drifted))
    if rejections == 0:
        # What lies just outside the gate is chance, or the filter's own error, and no other level.
        clear = innovation * innovation > CLEARLY_OFF * CLEARLY_OFF * limits[0] * limits[0] * total
        s[LEVEL] = 1.0 if step > STEPPED and clear else 0.0
    elif s[LEVEL] > 0.0:
        s[LEVEL] += step * step
        unsteady = s[LEVEL] - 1.0 > LEAST_UNSTEADY + UNSTEADY_EACH * rejections
        # Later it may be the prediction's drift that brings the level there.
        back = rejections < back_within and innovation * innovation <= limits[0] * limits[0] * s[FIRST_TOTAL]
        away = rejections == 1 and innovation * s[FIRST_INNOVATION] > RUNS_AWAY * s[FIRST_INNOVATION] ** 2
        if unsteady or back or away:
            s[LEVEL] = 0.0
    near_ones = s[NEAR_ONES] + 1.0 if is_near(innovation, s[FIRST_TOTAL], limits) else 0.0
    steps = (step, np.sqrt(squared / (2.0 * noise + drifted)))
    agreements = returning(s[AGREEMENTS], agrees(innovation, total, limits), steps) if rejections > 0 else 0.0
    run = (rejected_for, rejections, agreements, s[FARTHEST], near_ones, s[LEVEL])
    verdict = judge(innovation, total, run, limits)
    if verdict == REJECTED:
        s[FIRST_REJECTED] = time - rejected_for
        s[REJECTIONS] = rejections + 1
        s[FARTHEST], s[NEAR_ONES] = max(s[FARTHEST], innovation * innovation / total), near_ones
        s[AGREEMENTS] = agreements
    else:
        s[ACCEPTED_COUNT] += 1.0
        s[REJECTIONS] = s[AGREEMENTS] = s[FARTHEST] = s[NEAR_ONES] = 0.0
        s[LAST_ACCEPTED], s[SOURCE] = time, source
    s[JUDGED], s[JUDGED_AT] = innovation, time
    return verdict, rejected_for


@njit(cache=True, inline="always")
def give_up(s, jump, waited):  # type: ignore[no-untyped-def]
    """Before a reacquired measurement: the old position's uncertainty becomes the size of the jump.

    waited = (seconds of rejections, seconds after which they count as a move of the target). Whether the target jumped
    or the prediction ran away is not known, so velocity and bias may be wrong by what would explain it too; where the
    rejections kept to their level, only by what would explain its drift. What came sooner may as well be noise: then
    the velocity may be wrong by the drift as well, and the bias stays what it is.
    """
    drift, lapse = jump, max(waited[0], 1e-3)
    if s[LEVEL] > 0.0 or waited[0] < waited[1]:
        drift = 2.0 * (jump - s[FIRST_INNOVATION])
    s[P00] += jump * jump
    s[P11] += (drift / lapse) ** 2
    if waited[0] >= waited[1]:
        s[P22] += (drift / lapse**2) ** 2
