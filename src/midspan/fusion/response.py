"""Which measurements a run used, and what it takes to see what an error of them alone does: the response is linear."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from midspan.fusion.gate import ACCEPTED, NO_GATE, REACQUIRED
from midspan.fusion.kalman import KalmanSettings
from midspan.records import Acceleration, Displacement, Floats, Innovation


def places(measured: Displacement, found: Innovation) -> NDArray[np.int64]:
    """The measurement (index) that each innovation (n,) belongs to.

    measured: in time order; found: innovations of all of its usable measurements that were met, in the same order. They
    are matched by stamp and order, so that sensors which measure at one instant keep their own innovations.
    """
    usable = np.flatnonzero(np.isfinite(measured.value_m) & np.isfinite(measured.variance_m2))
    # Stamps that went through seconds agree to a nanosecond; within that the order tells.
    first = np.searchsorted(measured.time_ns[usable], found.time_ns - 1)
    order = np.arange(len(found.time_ns)) - np.searchsorted(found.time_ns, found.time_ns - 1)
    return np.asarray(usable[first + order], dtype=np.int64)


def used_variance(measured: Displacement, found: Innovation, taken: Floats | None = None) -> Floats:
    """Variance (m,) m² of the measurements that were used, infinite for the others.

    taken: the variance (n,) that each innovation's measurement was used with; None: the declared one.
    """
    met = places(measured, found)
    used = (found.verdict == ACCEPTED) | (found.verdict == REACQUIRED)
    variance = np.full(len(measured.time_ns), np.inf)
    variance[met[used]] = (measured.variance_m2[met] if taken is None else taken)[used]
    return variance


def standing_still(acceleration: Acceleration) -> Acceleration:
    """The same samples without any acceleration."""
    return replace(acceleration, value_m_s2=np.zeros(len(acceleration.time_ns)))


def linear(kalman: KalmanSettings) -> KalmanSettings:
    """The filter's settings without gate and expected bias: twice the error moves the rows twice as far."""
    return replace(kalman, bias=0.0, gate=NO_GATE)
