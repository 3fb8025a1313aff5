"""Which displacement measurements are believed.

A measurement whose innovation is beyond `limit` predicted standard deviations is rejected. A target that has really
moved would then be rejected for ever, so after `reacquire_s` of nothing but rejections the filter gives its position up
and takes the new one; this is declared in the result, never silent.
"""

from dataclasses import dataclass

from numba import njit


@dataclass(frozen=True, slots=True)
class GateSettings:
    """limit: predicted standard deviations at which a measurement is rejected; higher lets more outliers in.

    reacquire_s: seconds of rejections alone after which the new position is accepted; longer rides through longer
    obstructions of the target, shorter recovers sooner from a true jump.
    """

    limit: float = 4.0
    reacquire_s: float = 5.0


ACCEPTED, REJECTED, REACQUIRED = 0, 1, 2
LEAST_REJECTIONS = 5
# After a run of rejections the predicted band is wide and a wrong measurement can fall into it by chance; the target
# counts as back only when this many in a row agree within half the limit.
CONFIRMATIONS = 3


@njit(cache=True, inline="always")
def judge(innovation: float, variance: float, run: tuple[float, float, float], limits: tuple[float, float]) -> int:
    """ACCEPTED, REJECTED or REACQUIRED for an innovation of predicted `variance`.

    run: seconds since the first of the rejections in a row, their number, and how many of the last ones would agree
    (see `agrees`); limits = (limit, reacquire_s).
    """
    rejected_for_s, rejections, agreements = run
    inside = innovation * innovation <= limits[0] * limits[0] * variance
    if rejections < LEAST_REJECTIONS:
        waiting = rejections + 1 < LEAST_REJECTIONS or rejected_for_s < limits[1]
        return ACCEPTED if inside else REJECTED if waiting else REACQUIRED
    if rejected_for_s >= limits[1]:
        # Also when it lies inside: after so long the band is wide enough for a target that has moved.
        return REACQUIRED
    confirmed = agreements + 1 >= CONFIRMATIONS and agrees(innovation, variance, limits)
    return ACCEPTED if confirmed else REJECTED


@njit(cache=True, inline="always")
def agrees(innovation: float, variance: float, limits: tuple[float, float]) -> bool:
    """Whether a measurement lies so close to the prediction that it may be the target's return."""
    return innovation * innovation <= 0.25 * limits[0] * limits[0] * variance
