"""The compiled forward recursion that `kalman`, `lag` and `smoother` share, and the layout of what it leaves behind."""

import numpy as np
from numba import njit

from midspan.fusion.gate import (
    ACCEPTED,
    LEAST_REJECTIONS,
    REACQUIRED,
    REJECTED,
    both_sides,
    give_up,
    is_near,
    judged,
    limits_now,
    rougher,
)
from midspan.fusion.noise_online import FACTOR, doubt, forget_steps, learn, learning_off
from midspan.fusion.state_space import (
    ACCEPTED_COUNT,
    AGREEMENTS,
    FARTHEST,
    FIRST_TOTAL,
    INPUT,
    LAST_ACCEPTED,
    LAST_INNOVATION,
    LAST_TOTAL,
    NEAR_ONES,
    P00,
    P01,
    P02,
    P22,
    REJECTIONS,
    ROUGHNESS,
    SLOPE,
    SOURCE,
    TIME,
    B,
    V,
    X,
    advance_covariance,
    advance_mean,
    begin_interval,
    input_response,
    update_covariance,
)
from midspan.records import Floats

# What the recursion leaves for each sample: the state vector up to P22, the true velocity, the time, the time of the
# last accepted measurement and its source.
VELOCITY, TIME_OF_NODE, ACCEPTED_AT, ACCEPTED_SOURCE = range(P22 + 1, P22 + 5)
NODE_COLUMNS = P22 + 5
# And for each measurement.
INTERVAL, THETA, INNOVATION, INNOVATION_VARIANCE, GAIN_X, GAIN_V, GAIN_B, VERDICT, NOISE = range(9)
RECORD_COLUMNS = 9
UNUSED = -1.0


@njit(cache=True, inline="always")
def _settle_gate(s):  # type: ignore[no-untyped-def]
    """The noise rose: what was rejected was rejected for the wrong reason, and the gate needs no widening."""
    s[REJECTIONS] = s[AGREEMENTS] = s[FARTHEST] = s[NEAR_ONES] = 0.0
    s[ROUGHNESS] = 1.0


@njit(cache=True, inline="always")
def _reacquire(s, learnt, source, jump, waited):  # type: ignore[no-untyped-def]
    """Give the position up, see `give_up`; near rejections that came sooner may as well be noise."""
    give_up(s, jump, waited)
    if len(learnt) > 0:
        forget_steps(learnt)
        if waited[0] < waited[1]:
            doubt(learnt[source])


@njit(cache=True, inline="always")
def _take(s, row, innovation, variance):  # type: ignore[no-untyped-def]
    """Update state and covariance with a measurement of this variance."""
    total = s[P00] + variance
    gain = (s[P00] / total, s[P01] / total, s[P02] / total)
    s[X] += gain[0] * innovation
    s[V] += gain[1] * innovation
    s[B] += gain[2] * innovation
    update_covariance(s, gain, variance)
    row[GAIN_X], row[GAIN_V], row[GAIN_B] = gain
    row[INNOVATION_VARIANCE], row[NOISE] = total, variance


@njit(cache=True, inline="always")
def meet_measurement(s, row, measured, limits, learnt):  # type: ignore[no-untyped-def]
    """Judge one measurement (time, value, variance, source) against the state at its instant and use it if believed."""
    time, value, declared, code = measured
    learning, source = len(learnt) > 0, int(code)
    variance = declared * learnt[source, FACTOR] if learning else declared
    innovation, total = value - s[X], s[P00] + variance
    limits = limits_now(limits, s[ACCEPTED_COUNT], s[ROUGHNESS])
    if learning and s[REJECTIONS] > 0.0 and innovation * s[LAST_INNOVATION] < 0.0:
        both_sides(s)
    verdict, rejected_for = judged(s, (time, code), innovation, total, limits, LEAST_REJECTIONS)
    row[GAIN_X] = row[GAIN_V] = row[GAIN_B] = 0.0
    row[INNOVATION], row[INNOVATION_VARIANCE], row[VERDICT], row[NOISE] = innovation, total, verdict, variance
    if verdict == ACCEPTED or (verdict == REJECTED and is_near(innovation, s[FIRST_TOTAL], limits)):
        if np.isfinite(s[LAST_INNOVATION]):
            s[ROUGHNESS] = rougher(s[ROUGHNESS], innovation - s[LAST_INNOVATION], total + s[LAST_TOTAL])
        s[LAST_INNOVATION], s[LAST_TOTAL] = innovation, total
        if learning and learn(learnt[source], innovation, (total, variance), verdict == ACCEPTED):
            _settle_gate(s)
    if verdict == REACQUIRED:
        _reacquire(s, learnt, source, innovation, (rejected_for, limits[1]))
        variance = declared * learnt[source, FACTOR] if learning else declared
    if verdict != REJECTED:
        _take(s, row, innovation, variance)


def filter_block(
    samples: Floats,
    measurements: Floats,
    s: Floats,
    bias_walk: float,
    limits: tuple[float, float],
    nodes: Floats,
    record: Floats,
) -> int:
    """`learning_block` with every measurement's noise as declared."""
    return int(learning_block(samples, measurements, s, (bias_walk, limits), learning_off(), nodes, record))


@njit(cache=True)
def learning_block(samples, measurements, s, options, learnt, nodes, record):  # type: ignore[no-untyped-def]
    """Run the filter over one block; the state vector `s` is changed in place and carries over to the next block.

    samples: (n, 3) time in s, acceleration, its noise density, all after the state's time. measurements: (m, 4) time in
    s, displacement, variance (infinite: ignored) and source, in time order; those after the last sample are left.
    options = (density of the bias's walk, the gate's numbers). learnt: what is known of each source's noise, as of
    `noise_online`; changed in place too. nodes (n, 13) and record (m, 9) take what the module's column names say.
    Returns how many measurements were consumed.
    """
    bias_walk, limits = options
    j = 0
    for k in range(len(samples)):
        t0, a0 = s[TIME], s[INPUT]
        t1, a1, density = samples[k, 0], samples[k, 1], samples[k, 2]
        dt = t1 - t0
        lead = begin_interval(s, dt, a0, a1)
        reached, response = t0, (0.0, 0.0)
        while j < len(measurements) and measurements[j, 0] <= t1:
            row, time = record[j], measurements[j, 0]
            if time < reached or not measurements[j, 2] < np.inf:
                row[VERDICT] = UNUSED
                j += 1
                continue
            theta = (time - t0) / dt
            ahead = input_response(theta, dt, a0, a1, lead)
            advance_mean(s, time - reached, response, ahead)
            advance_covariance(s, time - reached, density, bias_walk)
            reached, response = time, ahead
            row[INTERVAL], row[THETA] = k, theta
            meet_measurement(s, row, (time, measurements[j, 1], measurements[j, 2], measurements[j, 3]), limits, learnt)
            j += 1
        advance_mean(s, t1 - reached, response, input_response(1.0, dt, a0, a1, lead))
        advance_covariance(s, t1 - reached, density, bias_walk)
        s[TIME], s[INPUT] = t1, a1
        node = nodes[k]
        for i in range(P22 + 1):
            node[i] = s[i]
        # The Numerov velocity state leads the true velocity by a multiple of the slope of the acceleration.
        node[VELOCITY] = s[V] - lead * s[SLOPE]
        node[TIME_OF_NODE], node[ACCEPTED_AT], node[ACCEPTED_SOURCE] = t1, s[LAST_ACCEPTED], s[SOURCE]
    return j
