"""One displacement from several targets, weighted by their variances, handed over without a step."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from midspan.checks import refuse
from midspan.records import Floats

# What the offset of a target is learnt over before it has a say, s. From one frame alone, all would inherit its noise.
LEARNING_S = 10.0


@njit(cache=True)
def _clearest(value, variance):  # type: ignore[no-untyped-def]
    """The target seen with the smallest variance, -1 when none is."""
    best = -1
    for j in range(len(value)):
        seen = np.isfinite(value[j]) and variance[j] < np.inf
        if seen and (best < 0 or variance[j] < variance[best]):
            best = j
    return best


@njit(cache=True)
def _combine(value, variance, again, need, state, last, out):  # type: ignore[no-untyped-def]
    """state (targets, 3): offset, frames learnt, 1 with a say; out (frames, 3): value, variance, 1 at a new datum."""
    targets = value.shape[0]
    for k in range(value.shape[1]):
        total, weights = 0.0, 0.0
        for j in range(targets):
            if again[j, k]:
                state[j, 0], state[j, 1], state[j, 2] = 0.0, 0.0, 0.0
            if state[j, 2] == 1.0 and np.isfinite(value[j, k]) and variance[j, k] < np.inf:
                # The offset has noise of its own: the target's and that of the others while it was learnt.
                weight = 1.0 / variance[j, k]
                total += weight * (value[j, k] - state[j, 0])
                weights += weight
        out[k, 2] = 0.0
        if weights == 0.0:
            j = _clearest(value[:, k], variance[:, k])
            out[k, 0], out[k, 1] = np.nan, np.inf
            if j < 0 or np.any(state[:, 2] == 1.0):
                continue
            # No target is left that knows the zero: a new datum, that goes on from the last value.
            state[j, 0], state[j, 1], state[j, 2] = value[j, k] - last[0], need, 1.0
            total, weights, out[k, 2] = (value[j, k] - state[j, 0]) / variance[j, k], 1.0 / variance[j, k], 1.0
        out[k, 0], out[k, 1] = total / weights, 1.0 / weights
        last[0] = out[k, 0]
        for j in range(targets):
            if state[j, 2] == 0.0 and np.isfinite(value[j, k]) and variance[j, k] < np.inf:
                state[j, 1] += 1.0
                state[j, 0] += (value[j, k] - out[k, 0] - state[j, 0]) / state[j, 1]
                if state[j, 1] >= need:
                    state[j, 2] = 1.0


class SeveralTargets:
    """Displacements of several targets in, one out; any cutting into blocks gives the same output.

    The first target gives the zero; the others join once their offset to it is known over `learning_s`. A target whose
    cycle was lost learns its offset anew. When all are blocked the output is NaN with infinite variance; when all have
    lost their cycle the output goes on from its last value, and the frame is told as a new datum.
    """

    def __init__(self, targets: int, frame_rate_hz: float, learning_s: float = LEARNING_S) -> None:
        if targets < 1:
            raise refuse("targets", "one or more", targets)
        self._need = max(1.0, learning_s * frame_rate_hz)
        self._state = np.zeros((targets, 3))
        self._state[0] = (0.0, self._need, 1.0)
        self._last = np.zeros(1)

    def push(
        self, value_m: Floats, variance_m2: Floats, lost_cycle: NDArray[np.bool_] | None = None
    ) -> tuple[Floats, Floats, NDArray[np.bool_]]:
        """Combine structural displacements (targets, n), m, with variances in m² (infinite: blocked).

        Returns displacement (n,), variance (n,) and whether a new datum begins at the frame (n,).

        lost_cycle (targets, n): frames from which on a target's cycle is a guess.
        """
        value, variance = np.ascontiguousarray(value_m, dtype=np.float64), np.ascontiguousarray(variance_m2)
        if value.shape != variance.shape or value.shape[0] != len(self._state):
            raise refuse(
                "value_m and variance_m2", f"({len(self._state)} targets, frames)", (value.shape, variance.shape)
            )
        again = np.zeros(value.shape, dtype=np.bool_) if lost_cycle is None else np.ascontiguousarray(lost_cycle)
        out = np.empty((value.shape[1], 3))
        _combine(value, variance.astype(np.float64), again, self._need, self._state, self._last, out)
        return out[:, 0], out[:, 1], out[:, 2] > 0
