"""Many points at once: filters of displacement, velocity and bias alone, in one compiled loop, without hypotheses.

For points whose sensors are known to be sound, or for comparisons over thousands of points; a measurement that is not
finite is left out, and no other: a gate without a way back would lose one filter of some thousand by chance.
"""

from dataclasses import dataclass

import numpy as np
from numba import njit

from midspan.fusion.model import START_S
from midspan.fusion.state_space import (
    INPUT,
    LEAD,
    P00,
    P01,
    P02,
    SLOPE,
    STATE_SIZE,
    TIME,
    B,
    V,
    X,
    advance_covariance,
    advance_mean,
    begin_interval,
    initial_state,
    input_response,
    update_covariance,
)
from midspan.records import Floats, Nanoseconds

# Columns of the measurements: number of the point, time (s), displacement (m), variance (m²).
POINT, MET_AT, VALUE, VARIANCE = range(4)
# What is left of each sample.
ROW_X, ROW_VARIANCE, ROW_VELOCITY = range(3)


@dataclass(frozen=True, slots=True)
class BankState:
    """All that a `Bank` knows: filters (p, n), whether they have begun, late (p,): measurements that came too late."""

    filters: Floats
    begun: bool
    late: Nanoseconds


class Bank:
    """Filters of p points whose accelerometers are sampled together.

    std: standard deviations of displacement (m), velocity (m/s) and bias (m/s²) before the first measurement.
    bias_walk: density of the bias's random walk, (m/s²)²/s.
    """

    def __init__(self, points: int, std: tuple[float, float, float] = (1.0, 1.0, 0.3), bias_walk: float = 1e-8) -> None:
        self._std, self._bias_walk = std, bias_walk
        self._state = BankState(np.zeros((points, STATE_SIZE)), False, np.zeros(points, dtype=np.int64))

    @property
    def state(self) -> BankState:
        """All that has an effect on what comes later, and how many measurements of each point came too late."""
        own = self._state
        return BankState(own.filters.copy(), own.begun, own.late.copy())

    def push(self, time_s: Floats, acceleration: Floats, density: Floats, measured: Floats) -> Floats:
        """Take samples at times (s,): acceleration (p, s) in m/s², its noise density (p,), measurements (m, 4) up to
        the last sample as of the column names, each point's in time order. Returns rows (p, s, 3): displacement, its
        variance, velocity. A measurement earlier than what the point's filter has reached is counted and left out.
        """
        points, count = acceleration.shape
        filters, late = self._state.filters, self._state.late
        if not self._state.begun:
            variance = (self._std[0] ** 2, self._std[1] ** 2, self._std[2] ** 2)
            filters[:] = initial_state(time_s[0] - START_S, (0.0, 0.0, 0.0), variance)
            filters[:, INPUT] = acceleration[:, 0]
            self._state = BankState(filters, True, late)
        ordered = measured[np.argsort(measured[:, POINT], kind="stable")]
        first = np.searchsorted(ordered[:, POINT], np.arange(points + 1))
        rows = np.empty((points, count, 3))
        run_bank(time_s, acceleration, density, ordered, first, filters, self._bias_walk, rows, late)
        return rows

    def restore(self, state: BankState) -> None:
        """Go on from the state of a bank of as many points."""
        self._state = BankState(state.filters.copy(), state.begun, state.late.copy())


@njit(cache=True)
def take(s, value, variance):  # type: ignore[no-untyped-def]
    """Update a state vector with a displacement, unless it is not finite."""
    e, total = value - s[X], s[P00] + variance
    # NaN fails every comparison; of a variance without end nothing is learnt.
    if not (np.abs(e) < np.inf and total < np.inf):
        return
    k = (s[P00] / total, s[P01] / total, s[P02] / total)
    s[X] += k[0] * e
    s[V] += k[1] * e
    s[B] += k[2] * e
    update_covariance(s, k, variance)


@njit(cache=True)
def run_bank(time_s, acceleration, density, measured, first, state, bias_walk, rows, late):  # type: ignore[no-untyped-def]
    """Run all points over a block; see `Bank.push`. first (p + 1,): where each point's measurements begin."""
    for p in range(len(state)):
        s, j = state[p], first[p]
        for k in range(len(time_s)):
            t0, a0 = s[TIME], s[INPUT]
            t1, a1 = time_s[k], acceleration[p, k]
            dt = t1 - t0
            lead = begin_interval(s, dt, a0, a1)
            reached, response = t0, (0.0, 0.0)
            while j < first[p + 1] and measured[j, MET_AT] <= t1:
                time = measured[j, MET_AT]
                if time >= reached:
                    ahead = input_response((time - t0) / dt, dt, a0, a1, lead)
                    advance_mean(s, time - reached, response, ahead)
                    advance_covariance(s, time - reached, density[p], bias_walk)
                    reached, response = time, ahead
                    take(s, measured[j, VALUE], measured[j, VARIANCE])
                else:
                    late[p] += 1
                j += 1
            advance_mean(s, t1 - reached, response, input_response(1.0, dt, a0, a1, lead))
            advance_covariance(s, t1 - reached, density[p], bias_walk)
            s[TIME], s[INPUT] = t1, a1
            rows[p, k, ROW_X], rows[p, k, ROW_VARIANCE] = s[X], s[P00]
            rows[p, k, ROW_VELOCITY] = s[V] - s[LEAD] * s[SLOPE]
