"""The compiled recursion of `adaptive-kalman` in its guarded form; as printed: `adaptive_printed`.

Ma, Choi and Sohn, doi 10.1111/mice.12767. Letters as there: G the covariance before a frame, K the gain, R the noise
variance of a frame, beta the forgetting factor.
"""

import numpy as np
from numba import njit

from midspan.fusion.gate import ACCEPTED, NORMAL_MEDIAN, REACQUIRED, REJECTED, both_sides, give_up, judged, limits_now
from midspan.fusion.state_space import (
    ACCEPTED_COUNT,
    GAP_STEPS,
    INPUT,
    JUDGED,
    LAST_ACCEPTED,
    LEAD,
    P00,
    P01,
    P02,
    P11,
    P12,
    P22,
    REJECTIONS,
    SLOPE,
    SOURCE,
    STATE_SIZE,
    STEP,
    TIME,
    B,
    V,
    X,
    begin_interval,
    update_covariance,
)

# The state vector of the filter, and behind it what is learnt: the noise variance of a frame (literal: m²; guarded:
# over the declared one), the median step of successive innovations and the last one, in declared deviations; running
# means of the squared and of the lagged product of the normalised innovations; the factor on the acceleration's noise;
# the running mean of the innovation's square beyond the declared noise (m²); how many steps in a row were above their
# median.
NOISE, MEDIAN_STEP, LAST, SQUARED, LAGGED, LAST_NORMAL, SPREAD, BEYOND, ABOVE = range(STATE_SIZE, STATE_SIZE + 9)
ADAPTIVE_SIZE = STATE_SIZE + 9

# What is left for each measurement.
MET_INNOVATION, MET_TOTAL, MET_NOISE, MET_VERDICT = range(4)
MET_COLUMNS = 4
UNUSED = -1.0

# The median step moves by this factor a frame: standing still it scatters by a quarter. From the third step in a row
# above it on it rises faster: five times the noise is followed in some ten frames. Steps much larger than that are
# outliers or a target that stands still, and do not count.
STEP_UP = 1.1
IN_A_ROW, FAST_UP, FARTHEST_STEP = 3.0, 1.3, 6.0
LEAST_STEP = 0.05
# The noise variance may leave what the successive differences say by this factor.
SLACK = 8.0
# The frame at hand is taken for at least this part of what the steps show beyond the prediction's error.
QUICK_PART = 0.25
# While the prediction is wide the steps tell little of the noise; but it is not below this part of what they show.
LEAST_PART = 1.0 / 16.0
# The declared noise weighs as much as this many frames.
PRIOR_FRAMES = 10.0
# Memory of the consistency watch, and of the error beyond the noise: 20 frames.
MEMORY = 0.95
INCONSISTENT, CORRELATED, CONSISTENT = 1.5, 0.4, 1.2
SPREAD_UP, SPREAD_DOWN, MOST_SPREAD = 1.2, 0.98, 1e6
# Divisions are what the inner loop would wait for.
THIRD, SIXTH = 1.0 / 3.0, 1.0 / 6.0
# Stamps beyond any: longer than 64-bit nanoseconds reach.
FOREVER_S, NEVER_NS = 9e9, np.int64(2**63 - 1)


@njit(cache=True, inline="always")
def keep_row(rows, k, x, variance, velocity):  # type: ignore[no-untyped-def]
    """Write row k of the result: rows = (displacement, variance, velocity), each (n,)."""
    displacements, variances, velocities = rows
    displacements[k], variances[k], velocities[k] = x, variance, velocity


@njit(cache=True, inline="always")
def label_row(labels, k, now, accepted_at, source):  # type: ignore[no-untyped-def]
    """Write source and status of row k: labels = (sources, statuses, coasting_s, lost_s), the first two (n,)."""
    sources, statuses, coasting_s, lost_s = labels
    age = now - accepted_at
    tracking = age <= coasting_s
    sources[k] = np.uint8(source) if tracking else np.uint8(0)
    statuses[k] = np.uint8(0) if tracking else np.uint8(1) if age <= lost_s else np.uint8(2)


@njit(cache=True, inline="always")
def _watch_steps(s, innovation, deviation):  # type: ignore[no-untyped-def]
    """Follow the median of |step| between successive innovations; returns the variance of one of them by it.

    Drift, bias, a jump and a stuck target hardly touch the steps, and one outlier in ten does not move their median: so
    it tells the noise of the frames whatever else goes wrong. In units of the declared deviation.
    """
    if np.isfinite(s[LAST]):
        step, median = abs(innovation - s[LAST]), s[MEDIAN_STEP] * deviation
        above = step > median
        if step < FARTHEST_STEP * median:
            s[ABOVE] = s[ABOVE] + 1.0 if above else 0.0
        up = FAST_UP if s[ABOVE] >= IN_A_ROW and step < FARTHEST_STEP * median else STEP_UP
        s[MEDIAN_STEP] = max(s[MEDIAN_STEP] * up if above else s[MEDIAN_STEP] / STEP_UP, LEAST_STEP)
    s[LAST] = innovation
    return 0.5 * (s[MEDIAN_STEP] / NORMAL_MEDIAN) ** 2


@njit(cache=True, inline="always")
def _watch_consistency(s, normal):  # type: ignore[no-untyped-def]
    """Raise the acceleration's noise where innovations are too large and alike: then it is not the frames that err."""
    normal = min(max(normal, -4.0), 4.0)
    s[SQUARED] = MEMORY * s[SQUARED] + (1.0 - MEMORY) * normal * normal
    s[LAGGED] = MEMORY * s[LAGGED] + (1.0 - MEMORY) * normal * s[LAST_NORMAL]
    s[LAST_NORMAL] = normal
    if s[SQUARED] > INCONSISTENT and s[LAGGED] > CORRELATED * s[SQUARED]:
        s[SPREAD] = min(s[SPREAD] * SPREAD_UP, MOST_SPREAD)
    elif s[SQUARED] < CONSISTENT:
        s[SPREAD] = max(s[SPREAD] * SPREAD_DOWN, 1.0)


@njit(cache=True, inline="always")
def _take(s, innovation, verdict, waited, noise):  # type: ignore[no-untyped-def]
    """Update state and covariance; returns the share of the innovation that is left, and the new displacement's
    variance."""
    if verdict == REACQUIRED:
        give_up(s, innovation, waited)
    share = 1.0 / (s[P00] + noise)
    gain = (share * s[P00], share * s[P01], share * s[P02])
    s[X] += gain[0] * innovation
    s[V] += gain[1] * innovation
    s[B] += gain[2] * innovation
    update_covariance(s, gain, noise)
    return (1.0 - gain[0]) * innovation


@njit(cache=True, inline="always")
def meet(s, met, j, measured, limits, rule):  # type: ignore[no-untyped-def]
    """Judge one frame (time, value, declared variance, source), use it if believed, and learn the noise from it.

    rule = (beta, floor, ceiling): forgetting factor, and the limits of the noise variance over the declared one.
    """
    time, value, declared, source = measured
    beta, floor, ceiling = rule
    innovation, g = value - s[X], s[P00]
    seen = _watch_steps(s, innovation, np.sqrt(declared)) * declared
    # Never less than the steps show beyond the prediction's own error, never much more than all of them.
    learnt = max(min(s[NOISE] * declared, SLACK * seen), seen / SLACK - g)
    learnt = max(min(learnt, ceiling * declared), floor * declared)
    noise = max(learnt, min(max(LEAST_PART * seen, QUICK_PART * seen - g), ceiling * declared))
    total, count = g + noise, s[ACCEPTED_COUNT]
    limits = limits_now(limits, count, 1.0)
    if s[REJECTIONS] > 0.0 and innovation * s[JUDGED] < 0.0:
        both_sides(s)
    verdict, rejected_for = judged(s, (time, source), innovation, total, limits, np.inf)
    if verdict != REJECTED:
        left = _take(s, innovation, verdict, (rejected_for, limits[1]), noise)
        if verdict == ACCEPTED:
            # Residual form: positive whatever happens (equation 20 is not). In proportion to what the sensor declares.
            beta = min(beta, 1.0 - 1.0 / (PRIOR_FRAMES + count))
            s[NOISE] = beta * learnt / declared + (1.0 - beta) * (left * left + s[P00]) / declared
            _watch_consistency(s, innovation / np.sqrt(total))
    row = met[j]
    row[MET_INNOVATION], row[MET_TOTAL], row[MET_NOISE], row[MET_VERDICT] = innovation, total, noise, verdict


@njit(cache=True, inline="always")
def _glide(s, dt, force, noise, walk):  # type: ignore[no-untyped-def]
    """Move state and covariance by `dt` within an interval; force = (acceleration now, its slope, lead), see `_coast`.

    The same model as `state_space`, without a division.
    """
    a, slope, lead = force
    half = 0.5 * dt * dt
    v, b = s[V], s[B]
    p01, p02, p11, p12, p22 = s[P01], s[P02], s[P11], s[P12], s[P22]
    s[X] += dt * (v - lead * slope) + half * (a + THIRD * dt * slope - b)
    s[V] = v + dt * (a - b) + half * slope
    m01, m02 = p01 + dt * p11 - half * p12, p02 + dt * p12 - half * p22
    m11, m12 = p11 - dt * p12, p12 - dt * p22
    s[P00] += dt * (p01 + m01) - half * (p02 + m02) + noise * dt * dt * dt * THIRD
    s[P01], s[P02] = m01 - dt * m02 + noise * half, m02
    s[P11], s[P12] = m11 - dt * m12 + noise * dt, m12
    s[P22] = p22 + walk * dt


@njit(cache=True, inline="always")
def stamp_before(until, origin_ns):  # type: ignore[no-untyped-def]
    """A stamp (ns) just before the time `until` (s): one that went through seconds may be off after some weeks."""
    return origin_ns + np.int64(np.rint(until * 1e9)) - 2 if until < FOREVER_S else NEVER_NS


@njit(cache=True, inline="always")
def _coast(samples, k, until, s, walk, rows, labels):  # type: ignore[no-untyped-def]
    """Samples k up to the first at or just before the time `until`, without frames; returns where it stopped.

    The same model as `state_space`, with everything in local numbers: this is where the time goes. Steps are counted in
    whole nanoseconds, so that even ones are equal to the last digit and what follows from them is kept.
    """
    time_ns, origin_ns, values, densities = samples
    x, v, b = s[X], s[V], s[B]
    p00, p01, p02, p11, p12, p22 = s[P00], s[P01], s[P02], s[P11], s[P12], s[P22]
    a0, step, last_lead, last_slope = s[INPUT], s[STEP], s[LEAD], s[SLOPE]
    spread, accepted_at, source = s[SPREAD], s[LAST_ACCEPTED], s[SOURCE]
    t1, rise = s[TIME], 0.0
    last_ns, stop_ns = origin_ns + np.int64(np.rint(t1 * 1e9)), stamp_before(until, origin_ns)
    step_ns, dt, inverse, half, cube, twelfth = np.int64(-1), 0.0, 0.0, 0.0, 0.0, 0.0
    while k < len(time_ns) and time_ns[k] < stop_ns:
        if time_ns[k] - last_ns != step_ns or step < dt:
            # The velocity state's lead follows the length of the interval, see `begin_interval`.
            step_ns = time_ns[k] - last_ns
            dt = step_ns / 1e9
            inverse, half, cube = 1.0 / dt, 0.5 * dt * dt, dt * dt * dt * THIRD
            twelfth = half * SIXTH * inverse if dt <= GAP_STEPS * step else 0.0
            slope = (values[k] - a0) * inverse
            v += (twelfth * dt - last_lead) * 0.5 * (last_slope + slope)
            step, last_lead = min(dt, GAP_STEPS * step), twelfth * dt
        last_ns = time_ns[k]
        rise = values[k] - a0
        x += dt * (v - twelfth * rise) + half * (a0 + THIRD * rise - b)
        v += dt * (a0 + 0.5 * rise - b)
        noise = densities[k] * spread
        m01, m02 = p01 + dt * p11 - half * p12, p02 + dt * p12 - half * p22
        m11, m12 = p11 - dt * p12, p12 - dt * p22
        p00 += dt * (p01 + m01) - half * (p02 + m02) + noise * cube
        p01, p02 = m01 - dt * m02 + noise * half, m02
        p11, p12 = m11 - dt * m12 + noise * dt, m12
        p22 += walk * dt
        a0, t1, last_slope = values[k], (time_ns[k] - origin_ns) / 1e9, rise * inverse
        keep_row(rows, k, x, p00, v - twelfth * rise)
        label_row(labels, k, t1, accepted_at, source)
        k += 1
    s[X], s[V], s[B] = x, v, b
    s[P00], s[P01], s[P02], s[P11], s[P12], s[P22] = p00, p01, p02, p11, p12, p22
    s[TIME], s[INPUT], s[STEP], s[LEAD], s[SLOPE] = t1, a0, step, last_lead, last_slope
    return k


@njit(cache=True, error_model="numpy")
def guarded_block(samples, frames, s, options, rows, labels, met):  # type: ignore[no-untyped-def]
    """The guarded filter over one block; arguments as in `printed_block`.

    options = (walk, limits, rule): density of the bias's walk, the gate's numbers, and what `meet` takes.
    """
    time_ns, origin_ns, values, densities = samples
    walk, limits, rule = options
    j = k = 0
    while k < len(time_ns):
        k = _coast(samples, k, frames[j, 0] if j < len(frames) else np.inf, s, walk, rows, labels)
        if k == len(time_ns):
            return j
        t0, a0 = s[TIME], s[INPUT]
        t1, density = (time_ns[k] - origin_ns) / 1e9, densities[k]
        lead = begin_interval(s, t1 - t0, a0, values[k])
        reached, slope, spread = t0, s[SLOPE], s[SPREAD]
        while j < len(frames) and frames[j, 0] <= t1:
            time = frames[j, 0]
            if time < reached or not frames[j, 2] < np.inf:
                met[j, MET_VERDICT] = UNUSED
            else:
                _glide(s, time - reached, (a0 + (reached - t0) * slope, slope, lead), density * spread, walk)
                reached = time
                meet(s, met, j, (time, frames[j, 1], frames[j, 2], frames[j, 3]), limits, rule)
            j += 1
        if reached < t1:
            _glide(s, t1 - reached, (a0 + (reached - t0) * slope, slope, lead), density * spread, walk)
        s[TIME], s[INPUT] = t1, values[k]
        keep_row(rows, k, s[X], s[P00], s[V] - lead * slope)
        label_row(labels, k, t1, s[LAST_ACCEPTED], s[SOURCE])
        k += 1
    return j
