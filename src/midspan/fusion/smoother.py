"""`smoother`: the Kalman filter followed by a backward pass over the whole record (offline default).

The backward pass is the modified Bryson-Frazier form of the Rauch-Tung-Striebel smoother: it carries the adjoint of the
state and its information matrix back in time and needs no inverse of a covariance. Memory stays bounded: the forward
pass keeps a state vector only at every block's start, and the backward pass runs each block forward again.

Reference: G. J. Bierman, Fixed interval smoothing with discrete measurements, Int. J. Control 18 (1973) 65-75.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit

from midspan.fusion.events import gate_events
from midspan.fusion.gate import REACQUIRED, REJECTED
from midspan.fusion.kalman import (
    BLOCK,
    KalmanSettings,
    Output,
    estimate_rows,
    innovation_rows,
    measurement_rows,
    sample_rows,
)
from midspan.fusion.recursion import (
    GAIN_B,
    GAIN_V,
    GAIN_X,
    INNOVATION,
    INNOVATION_VARIANCE,
    INTERVAL,
    NODE_COLUMNS,
    RECORD_COLUMNS,
    THETA,
    UNUSED,
    VELOCITY,
    VERDICT,
    filter_block,
)
from midspan.fusion.state_space import P00, P01, P02, P11, P12, TIME, X
from midspan.records import Acceleration, Displacement, Estimate, Event, Floats, Innovation, Nanoseconds, joined, part

# The adjoint vector: gradient l and information matrix L of the state given everything later.
ADJOINT_SIZE = 9
SMOOTHED_X, SMOOTHED_VELOCITY, SMOOTHED_VARIANCE = range(3)
SMOOTHED_COLUMNS = 3
# A second new level is the old one when the two jumps cancel but for this part.
SAME_LEVEL = 0.3


@dataclass(frozen=True, slots=True)
class Smoothed:
    """What a method returns for a whole record: the estimate, the innovations of its forward pass, and events.

    variance_m2 (m,): what each innovation's measurement was taken to vary by, where the method learns it by itself.
    zero_variance_m2: the part of every row's variance that is the zero's, common to the whole record.
    """

    estimate: Estimate
    innovation: Innovation
    events: tuple[Event, ...]
    variance_m2: Floats | None = None
    zero_variance_m2: float = 0.0


def collected(outputs: Sequence[Output]) -> Smoothed:
    """All that a stream gave for a whole record, up to and with its `finish`."""
    nothing = Innovation(np.empty(0, dtype=np.int64), np.empty(0), np.empty(0), np.empty(0, dtype=np.int8))
    innovations = [item for item in outputs if isinstance(item, Innovation)]
    return Smoothed(
        joined([item for item in outputs if isinstance(item, Estimate)]),
        joined(innovations) if innovations else nothing,
        tuple(item for item in outputs if isinstance(item, Event)),
    )


def smooth(acceleration: Acceleration, displacement: Displacement, settings: KalmanSettings | None = None) -> Smoothed:
    """Smooth a whole record.

    acceleration: block of n samples; displacement: block of m measurements on the same clock, in time order, outside
    ones ignored. The estimate has one row a sample; its standard deviation is that of the smoother.
    """
    settings = settings or KalmanSettings()
    origin_ns = int(acceleration.time_ns[0])
    rows = measurement_rows(displacement, origin_ns)
    blocks = [part(acceleration, slice(i, i + BLOCK)) for i in range(0, len(acceleration.time_ns), BLOCK)]
    state = settings.state_before(sample_rows(part(acceleration, slice(2)), origin_ns))
    checkpoints, outcomes, used = [], [], [0]
    for block in blocks:
        checkpoints.append(state.copy())
        samples = sample_rows(block, origin_ns)
        due = int(np.searchsorted(rows[:, 0], samples[-1, 0], side="right"))
        _, outcome = _forward(samples, rows[used[-1] : due], state, settings)
        outcomes.append(outcome)
        used.append(due)
    estimate = empty_estimate(acceleration.time_ns)
    adjoint = np.zeros(ADJOINT_SIZE)
    for i in reversed(range(len(blocks))):
        samples = sample_rows(blocks[i], origin_ns)
        nodes, _ = _forward(samples, rows[used[i] : used[i + 1]], checkpoints[i].copy(), settings)
        smoothed = np.empty((len(samples), SMOOTHED_COLUMNS))
        smooth_block(samples[:, 0], float(checkpoints[i][TIME]), nodes, outcomes[i], adjoint, smoothed)
        _fill(part(estimate, slice(i * BLOCK, (i + 1) * BLOCK)), nodes, smoothed, settings)
    outcome = np.concatenate(outcomes)
    met = outcome[:, VERDICT] != UNUSED
    innovation = innovation_rows(rows[: used[-1]][met], outcome[met], origin_ns)
    return Smoothed(estimate, innovation, tuple(gate_events(innovation)))


def doubt_levels(estimate: Estimate, innovation: Innovation) -> None:
    """Widen, in place, a smoother's band where a new level was taken over: from the last one believed it holds both.

    Where the old level came back later, which of the two was true is not known in between either. The first rejection
    tells how far apart they are; the last one holds seconds of drift.
    """
    taken = np.flatnonzero(innovation.verdict == REACQUIRED)
    believed = np.flatnonzero(innovation.verdict != REJECTED)
    before = believed[np.maximum(np.searchsorted(believed, taken) - 1, 0)]
    jumps = innovation.value_m[np.minimum(before + 1, taken)]
    for i, place in enumerate(taken):
        back = i + 1 < len(taken) and abs(jumps[i] + jumps[i + 1]) < SAME_LEVEL * abs(jumps[i])
        until_ns = innovation.time_ns[taken[i + 1] if back else place]
        rows = slice(*np.searchsorted(estimate.time_ns, (innovation.time_ns[before[i]], until_ns)))
        estimate.variance_m2[rows] += max(abs(jumps[i]), abs(innovation.value_m[place])) ** 2


def _forward(samples: Floats, rows: Floats, state: Floats, settings: KalmanSettings) -> tuple[Floats, Floats]:
    """Nodes (n, 13) of a block and the outcome (m, 9) of its measurements; moves `state` on."""
    nodes, outcome = np.empty((len(samples), NODE_COLUMNS)), np.zeros((len(rows), RECORD_COLUMNS))
    used = filter_block(samples, rows, state, settings.bias_walk, settings.limits, nodes, outcome)
    outcome[used:, VERDICT] = UNUSED
    return nodes, outcome


def empty_estimate(time_ns: Nanoseconds) -> Estimate:
    """An estimate of n rows to be filled; a day of rows must not exist twice."""
    n = len(time_ns)
    return Estimate(
        time_ns=time_ns,
        displacement_m=np.empty(n),
        variance_m2=np.empty(n),
        velocity_m_s=np.empty(n),
        source=np.empty(n, dtype=np.uint8),
        status=np.empty(n, dtype=np.uint8),
    )


def _fill(rows: Estimate, nodes: Floats, smoothed: Floats, settings: KalmanSettings) -> None:
    """Write a block's result into `rows`, views of the whole."""
    forward = estimate_rows(rows.time_ns, nodes, settings)
    rows.displacement_m[:] = smoothed[:, SMOOTHED_X]
    rows.variance_m2[:] = smoothed[:, SMOOTHED_VARIANCE]
    rows.velocity_m_s[:] = smoothed[:, SMOOTHED_VELOCITY]
    rows.source[:] = forward.source
    rows.status[:] = forward.status


@njit(cache=True, inline="always")
def back_through_time(adjoint: Floats, dt: float) -> None:
    """Adjoint and information `dt` earlier: Phi' l and Phi' L Phi with the transition Phi of the model."""
    l0, l1, l2, i00, i01, i02, i11, i12, i22 = adjoint
    half = 0.5 * dt * dt
    adjoint[1] = l1 + dt * l0
    adjoint[2] = l2 - half * l0 - dt * l1
    m01, m11 = i01 + dt * i00, i11 + dt * i01
    m02, m12, m22 = i02 - half * i00 - dt * i01, i12 - half * i01 - dt * i11, i22 - half * i02 - dt * i12
    adjoint[4] = m01
    adjoint[5] = m02
    adjoint[6] = m11 + dt * m01
    adjoint[7] = m12 + dt * m02
    adjoint[8] = m22 - half * m02 - dt * m12


@njit(cache=True, inline="always")
def back_through_measurement(adjoint: Floats, row: Floats) -> None:
    """Before an accepted measurement: (I − K H)' l − H' e/S and (I − K H)' L (I − K H) + H'H/S."""
    l0, l1, l2, i00, i01, i02, i11, i12, i22 = adjoint
    k0, k1, k2 = 1.0 - row[GAIN_X], row[GAIN_V], row[GAIN_B]
    variance = row[INNOVATION_VARIANCE]
    adjoint[0] = k0 * l0 - k1 * l1 - k2 * l2 - row[INNOVATION] / variance
    m0, m1, m2 = k0 * i00 - k1 * i01 - k2 * i02, k0 * i01 - k1 * i11 - k2 * i12, k0 * i02 - k1 * i12 - k2 * i22
    adjoint[3] = k0 * m0 - k1 * m1 - k2 * m2 + 1.0 / variance
    adjoint[4] = m1
    adjoint[5] = m2


@njit(cache=True)
def smooth_block(time_s, start_s, nodes, outcome, adjoint, smoothed):  # type: ignore[no-untyped-def]
    """Run the backward pass over one block; `adjoint` (9,) is changed in place and carries over to the block before.

    time_s (n,): the samples; start_s: the time of the block's first state; nodes (n, 13), outcome (m, 9): what the
    forward recursion left; smoothed (n, 3) takes displacement, velocity and the displacement's variance.
    """
    j = len(outcome) - 1
    for k in range(len(time_s) - 1, -1, -1):
        node = nodes[k]
        l0, l1, l2, i00, i01, i02, i11, i12, i22 = adjoint
        p0, p1, p2 = node[P00], node[P01], node[P02]
        smoothed[k, SMOOTHED_X] = node[X] - (p0 * l0 + p1 * l1 + p2 * l2)
        smoothed[k, SMOOTHED_VELOCITY] = node[VELOCITY] - (p1 * l0 + node[P11] * l1 + node[P12] * l2)
        known = p0 * (i00 * p0 + 2.0 * i01 * p1 + 2.0 * i02 * p2) + p1 * (i11 * p1 + 2.0 * i12 * p2) + i22 * p2 * p2
        smoothed[k, SMOOTHED_VARIANCE] = max(p0 - known, 1e-12 * p0)
        before = time_s[k - 1] if k > 0 else start_s
        at, dt = time_s[k], time_s[k] - before
        while j >= 0 and (outcome[j, VERDICT] == UNUSED or outcome[j, INTERVAL] == k):
            row = outcome[j]
            j -= 1
            if row[VERDICT] == UNUSED or row[VERDICT] == REJECTED:
                continue
            instant = before + row[THETA] * dt
            back_through_time(adjoint, at - instant)
            back_through_measurement(adjoint, row)
            at = instant
        back_through_time(adjoint, at - before)
