"""One displacement from several targets, weighted by their variances, handed over without a step."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from midspan.checks import refuse
from midspan.records import Floats

# What the offset of a target is learnt over before it has a say, s. From one frame alone, all would inherit its noise.
LEARNING_S = 10.0
# A target leaves the others, or does not keep its distance from them while it is learnt, from so many standard
# deviations on; the distance is known well enough to say so after this many frames.
LIMIT = 8.0
_LEARNT_FRAMES = 5.0
# Where no other is left, a target has a say from this share of the learning on.
_STANDS_IN = 0.2
# A target that leaves the others slowly began to so long before it is noticed, s; a record is gone through again to
# leave that out, at most so often.
BEFORE_S, _PASSES = 3.0, 4
# Columns of a target's state: offset, frames learnt, 1 with a say, 1 while left out.
OFFSET, LEARNT, SAY, LEFT = 0, 1, 2, 3


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
def _worst(value, variance, doubt, use):  # type: ignore[no-untyped-def]
    """The target that lies farthest from the mean of the others, and by how many standard deviations."""
    worst, most = -1, 0.0
    for j in range(len(value)):
        if not use[j]:
            continue
        total, weights, common = 0.0, 0.0, 0.0
        for i in range(len(value)):
            if i != j and use[i]:
                total += value[i] / variance[i]
                weights += 1.0 / variance[i]
                common += doubt[i] / variance[i]
        if weights > 0.0:
            spread = variance[j] + doubt[j] + (1.0 + common) / weights
            ratio = abs(value[j] - total / weights) / np.sqrt(spread)
            if ratio > most:
                worst, most = j, ratio
    return worst, most


@njit(cache=True)
def _contradiction(value, variance, doubt, use):  # type: ignore[no-untyped-def]
    """Which target to leave out (-1: none), and whether those that stay contradict each other all the same."""
    worst, most = _worst(value, variance, doubt, use)
    if most <= LIMIT:
        return -1, False
    if np.sum(use) < 3:
        return -1, True
    use[worst] = False
    _, rest = _worst(value, variance, doubt, use)
    if rest <= LIMIT:
        return worst, False
    use[worst] = True
    return -1, True


@njit(cache=True)
def _mean(value, variance, use):  # type: ignore[no-untyped-def]
    """Weighted mean, its variance, and the variance about it."""
    total, weights = 0.0, 0.0
    for j in range(len(value)):
        if use[j]:
            total += value[j] / variance[j]
            weights += 1.0 / variance[j]
    if weights == 0.0:
        return np.nan, np.inf, 0.0
    middle, apart = total / weights, 0.0
    for j in range(len(value)):
        if use[j]:
            apart = max(apart, (value[j] - middle) ** 2)
    return middle, 1.0 / weights, apart


@njit(cache=True)
def _learn(state, value, variance, need):  # type: ignore[no-untyped-def]
    """Learn the offset of a target from its distance to the others; anew when the distance changes."""
    apart = value - state[OFFSET]
    if state[LEARNT] >= _LEARNT_FRAMES and apart * apart > LIMIT * LIMIT * variance:
        state[OFFSET], state[LEARNT], apart = 0.0, 0.0, value
    state[LEARNT] += 1.0
    state[OFFSET] += apart / state[LEARNT]
    if state[LEARNT] >= need:
        state[SAY], state[LEFT] = 1.0, 0.0


@njit(cache=True)
def _combine(value, variance, doubt, told, need, state, last, out, left):  # type: ignore[no-untyped-def]
    """told (2, targets, frames): cycle lost, not to be used; out (frames, 4): value, variance, 1 at a new datum, the
    distance (m) of those that contradict each other; left (targets, frames): seen but left out."""
    targets, again, moved = value.shape[0], told[0], told[1]
    own, use = np.empty(targets), np.zeros(targets, dtype=np.bool_)
    seen = np.zeros(targets, dtype=np.bool_)
    for k in range(value.shape[1]):
        for j in range(targets):
            seen[j] = np.isfinite(value[j, k]) and variance[j, k] < np.inf
            left[j, k] = seen[j] and (moved[j, k] or state[j, LEFT] == 1.0)
            if again[j, k] or moved[j, k]:
                state[j, :3] = 0.0
            if moved[j, k]:
                state[j, LEFT], seen[j] = 1.0, False
            use[j] = seen[j] and state[j, SAY] == 1.0
            own[j] = value[j, k] - state[j, OFFSET]
        if not np.any(use):
            # Those that know the zero are hidden: one whose offset is nearly learnt stands in.
            for j in range(targets):
                if seen[j] and state[j, LEFT] == 0.0 and state[j, LEARNT] >= _STANDS_IN * need:
                    state[j, SAY], use[j] = 1.0, True
        # The offset has noise of its own: the target's and that of the others while it was learnt.
        worst, widened = _contradiction(own, variance[:, k], doubt[:, k], use)
        if worst >= 0:
            state[worst, :3], state[worst, LEFT], left[worst, k] = 0.0, 1.0, True
        out[k, 0], out[k, 1], apart = _mean(own, variance[:, k], use)
        out[k, 2], out[k, 3] = 0.0, np.sqrt(apart) if widened else 0.0
        if widened:
            # Nothing tells which of them is right.
            out[k, 1] += apart
        if not np.any(use):
            j = _clearest(np.where(seen, value[:, k], np.nan), variance[:, k])
            if j < 0 or np.any(state[:, SAY] == 1.0):
                continue
            # No target is left that knows the zero: a new datum, that goes on from the last value.
            state[j, OFFSET], state[j, LEARNT], state[j, SAY], state[j, LEFT] = value[j, k] - last[0], need, 1.0, 0.0
            out[k, 0], out[k, 1], out[k, 2] = last[0], variance[j, k], 1.0
        last[0] = out[k, 0]
        for j in range(targets):
            if state[j, SAY] == 0.0 and seen[j] and not widened and j != worst:
                spread = variance[j, k] + doubt[j, k] + out[k, 1]
                _learn(state[j], value[j, k] - out[k, 0], spread, need)


class SeveralTargets:
    """Displacements of several targets in, one out; any cutting into blocks gives the same output.

    The first target gives the zero; the others join once their offset to it is known over `learning_s`. A target whose
    cycle was lost learns its offset anew, and so does one that leaves the others where these agree; it has no say
    before it has kept its distance. Where two contradict each other, the variance holds their distance. When all are
    blocked the output is NaN with infinite variance; when all have lost their cycle the output goes on from its last
    value, and the frame is told as a new datum.

    relative_std (targets,): of the conversion factors, by which they may differ. After `push`, `left_out` (targets, n)
    tells which targets were seen but left out, and `apart_m` (n,) the distance by which the variance was widened.
    """

    def __init__(
        self, targets: int, frame_rate_hz: float, learning_s: float = LEARNING_S, *, relative_std: Floats | None = None
    ) -> None:
        if targets < 1:
            raise refuse("targets", "one or more", targets)
        self._need = max(1.0, learning_s * frame_rate_hz)
        self._state = np.zeros((targets, 4))
        self._state[0, :3] = (0.0, self._need, 1.0)
        self._last = np.zeros(1)
        self._relative = np.zeros(targets) if relative_std is None else np.asarray(relative_std, dtype=np.float64)
        self.left_out = np.zeros((targets, 0), dtype=np.bool_)
        self.apart_m = np.zeros(0)

    def push(
        self,
        value_m: Floats,
        variance_m2: Floats,
        lost_cycle: NDArray[np.bool_] | None = None,
        moved: NDArray[np.bool_] | None = None,
    ) -> tuple[Floats, Floats, NDArray[np.bool_]]:
        """Combine structural displacements (targets, n), m, with variances in m² (infinite: blocked).

        Returns displacement (n,), variance (n,) and whether a new datum begins at the frame (n,).

        lost_cycle (targets, n): frames from which on a target's cycle is a guess; moved (targets, n): frames at which
        it moved by itself (see `departures`).
        """
        value, variance = np.ascontiguousarray(value_m, dtype=np.float64), np.ascontiguousarray(variance_m2)
        if value.shape != variance.shape or value.shape[0] != len(self._state):
            raise refuse(
                "value_m and variance_m2", f"({len(self._state)} targets, frames)", (value.shape, variance.shape)
            )
        told = np.zeros((2, *value.shape), dtype=np.bool_)
        for row, mask in enumerate((lost_cycle, moved)):
            told[row] = False if mask is None else mask
        doubt = np.nan_to_num(self._relative[:, None] * value) ** 2
        out, self.left_out = np.empty((value.shape[1], 4)), np.zeros(value.shape, dtype=np.bool_)
        variance = variance.astype(np.float64)
        _combine(value, variance, doubt, told, self._need, self._state, self._last, out, self.left_out)
        self.apart_m = out[:, 3]
        return out[:, 0], out[:, 1], out[:, 2] > 0


def record_combined(
    value_m: Floats,
    variance_m2: Floats,
    frame_rate_hz: float,
    *,
    told: tuple[NDArray[np.bool_], NDArray[np.bool_]],
    relative_std: Floats,
) -> tuple[SeveralTargets, tuple[Floats, Floats, NDArray[np.bool_]]]:
    """The targets of a whole record combined, and what `SeveralTargets.push` returns.

    told: frames (targets, n) at which a cycle was lost, and at which a target moved by itself. One that was found to
    leave the others is also left out of the time before, in which it had begun to; where two contradict each other,
    that time is widened too.
    """
    lost_cycle, moved = told[0], told[1].copy()
    back = max(1, round(BEFORE_S * frame_rate_hz))
    for _ in range(_PASSES):
        targets = SeveralTargets(len(value_m), frame_rate_hz, relative_std=relative_std)
        found = targets.push(value_m, variance_m2, lost_cycle, moved)
        fresh = targets.left_out & ~moved
        begins = fresh & ~np.concatenate((np.zeros((len(fresh), 1), dtype=np.bool_), targets.left_out[:, :-1]), axis=1)
        if not begins.any():
            break
        for j, k in zip(*np.nonzero(begins), strict=True):
            moved[j, max(0, k - back) : k + 1] = True
    apart = targets.apart_m
    for k in np.flatnonzero((apart[1:] > 0.0) & (apart[:-1] == 0.0)) + 1:
        before = slice(max(0, k - back), k)
        found[1][before] += np.maximum(apart[k] ** 2 - apart[before] ** 2, 0.0)
        apart[before] = np.maximum(apart[before], apart[k])
    return targets, found
