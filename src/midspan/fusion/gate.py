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


@njit(cache=True, inline="always")
def judge(
    innovation: float, variance: float, rejected_for_s: float, rejections: float, limits: tuple[float, float]
) -> int:
    """ACCEPTED, REJECTED or REACQUIRED for an innovation of predicted `variance`; limits = (limit, reacquire_s)."""
    if innovation * innovation <= limits[0] * limits[0] * variance:
        return ACCEPTED
    if rejections + 1 >= LEAST_REJECTIONS and rejected_for_s >= limits[1]:
        return REACQUIRED
    return REJECTED
