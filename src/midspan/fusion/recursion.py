"""The compiled forward recursion that `kalman` and `smoother` share, and the layout of what it leaves behind."""

import numpy as np
from numba import njit

from midspan.fusion.gate import ACCEPTED, REACQUIRED, REJECTED, agrees, is_near, judge, limits_now, rougher
from midspan.fusion.state_space import (
    ACCEPTED_COUNT,
    AGREEMENTS,
    FARTHEST,
    FIRST_REJECTED,
    FIRST_TOTAL,
    INPUT,
    LAST_ACCEPTED,
    LAST_INNOVATION,
    LAST_TOTAL,
    NEAR_ONES,
    P00,
    P01,
    P02,
    P11,
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

# What the recursion leaves for each sample: the state vector up to P22, the true velocity, the time, the time of the
# last accepted measurement and its source.
VELOCITY, TIME_OF_NODE, ACCEPTED_AT, ACCEPTED_SOURCE = range(P22 + 1, P22 + 5)
NODE_COLUMNS = P22 + 5
# And for each measurement.
INTERVAL, THETA, INNOVATION, INNOVATION_VARIANCE, GAIN_X, GAIN_V, GAIN_B, VERDICT = range(8)
RECORD_COLUMNS = 8
UNUSED = -1.0


@njit(cache=True, inline="always")
def meet_measurement(s, row, measured, limits):  # type: ignore[no-untyped-def]
    """Judge one measurement (time, value, variance, source) against the state at its instant and use it if believed."""
    time, value, variance, source = measured
    innovation, total = value - s[X], s[P00] + variance
    limits = limits_now(limits, s[ACCEPTED_COUNT], s[ROUGHNESS])
    rejections = s[REJECTIONS]
    rejected_for = time - s[FIRST_REJECTED] if rejections > 0 else 0.0
    if rejections == 0:
        s[FIRST_TOTAL] = total
    near_ones = s[NEAR_ONES] + 1.0 if is_near(innovation, s[FIRST_TOTAL], limits) else 0.0
    run = (rejected_for, rejections, s[AGREEMENTS], s[FARTHEST], near_ones)
    verdict = judge(innovation, total, run, limits)
    if verdict == REJECTED:
        s[FIRST_REJECTED] = time - rejected_for
        s[REJECTIONS] = rejections + 1
        s[FARTHEST], s[NEAR_ONES] = max(s[FARTHEST], innovation * innovation / total), near_ones
        s[AGREEMENTS] = s[AGREEMENTS] + 1.0 if agrees(innovation, total, limits) else 0.0
        row[GAIN_X] = row[GAIN_V] = row[GAIN_B] = 0.0
    if verdict == ACCEPTED or (verdict == REJECTED and is_near(innovation, total, limits)):
        if np.isfinite(s[LAST_INNOVATION]):
            s[ROUGHNESS] = rougher(s[ROUGHNESS], innovation - s[LAST_INNOVATION], total + s[LAST_TOTAL])
        s[LAST_INNOVATION], s[LAST_TOTAL] = innovation, total
    if verdict != REJECTED:
        if verdict == REACQUIRED:
            # The old position is given up: its uncertainty becomes the size of the jump. Whether the target jumped or
            # the prediction ran away is not known, so velocity and bias may be wrong by what would explain it too.
            s[P00] += innovation * innovation
            s[P11] += (innovation / max(rejected_for, 1e-3)) ** 2
            s[P22] += (innovation / max(rejected_for, 1e-3) ** 2) ** 2
            total = s[P00] + variance
        gain = (s[P00] / total, s[P01] / total, s[P02] / total)
        s[X] += gain[0] * innovation
        s[V] += gain[1] * innovation
        s[B] += gain[2] * innovation
        update_covariance(s, gain, variance)
        s[ACCEPTED_COUNT] += 1.0
        s[REJECTIONS] = s[AGREEMENTS] = s[FARTHEST] = s[NEAR_ONES] = 0.0
        s[LAST_ACCEPTED], s[SOURCE] = time, source
        row[GAIN_X], row[GAIN_V], row[GAIN_B] = gain
    row[INNOVATION], row[INNOVATION_VARIANCE], row[VERDICT] = innovation, total, verdict


@njit(cache=True)
def filter_block(samples, measurements, s, bias_walk, limits, nodes, record):  # type: ignore[no-untyped-def]
    """Run the filter over one block; the state vector `s` is changed in place and carries over to the next block.

    samples: (n, 3) time in s, acceleration, its noise density, all after the state's time. measurements: (m, 4) time in
    s, displacement, variance (infinite: ignored) and source, in time order; those after the last sample are left.
    nodes (n, 13) and record (m, 8) take what the module's column names say. Returns how many measurements were
    consumed.
    """
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
            meet_measurement(s, row, (time, measurements[j, 1], measurements[j, 2], measurements[j, 3]), limits)
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
