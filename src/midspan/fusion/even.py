"""Acceleration on an even clock: what linear filters need, from truly stamped samples that jitter."""

import numpy as np
from numba import njit

from midspan.records import Floats
from midspan.signals.resample import REACH_STEPS, SIDE, spline_rows

# Jitter below this share of the step is left: its error is far below the noise of any accelerometer.
LEAST_JITTER = 1e-4
# How fast the even clock follows the stamps, per sample: it averages the jitter of some thousand of them.
FOLLOWING = 2e-3
# Samples behind one that its even value looks at.
BEHIND = SIDE + 3


@njit(cache=True)
def follow(time_s, step_s, state, even_s):  # type: ignore[no-untyped-def]
    """Even instants (n,) that follow the stamps (n,) as a critically damped loop of second order.

    state: (last even instant, step), changed in place; before the first sample (first stamp − step_s, step_s).
    """
    for k in range(len(time_s)):
        expected = state[0] + state[1]
        late = time_s[k] - expected
        # Never by more than a fifth of a step: the instants must go on.
        moved = min(max(FOLLOWING * late, -0.2 * step_s), 0.2 * step_s)
        state[1] += 0.25 * FOLLOWING * moved
        state[0] = expected + moved
        even_s[k] = state[0]


class EvenClock:
    """Takes stamps and values of one stretch, gives the values at even instants, one for each sample.

    Without jitter both pass as they are. With it, values come `BEHIND` samples late, by a cubic spline.
    """

    def __init__(self, step_s: float, *, jittered: bool) -> None:
        self._step_s, self._jittered = step_s, jittered
        self._time_s, self._value, self._even_s = np.empty(0), np.empty(0), np.empty(0)
        self._state = np.empty(0)
        self._given = 0

    @property
    def behind(self) -> int:
        """Samples that the values come late."""
        return BEHIND if self._jittered else 0

    def push(self, time_s: Floats, value: Floats) -> tuple[Floats, Floats]:
        """Take stamps and values (n,); returns even instants and the values there (k,)."""
        if not self._jittered:
            return time_s, value
        if not len(self._state):
            self._state = np.array([time_s[0] - self._step_s, self._step_s])
        even_s = np.empty(len(time_s))
        follow(time_s, self._step_s, self._state, even_s)
        self._time_s = np.concatenate((self._time_s, time_s))
        self._value = np.concatenate((self._value, value))
        self._even_s = np.concatenate((self._even_s, even_s))
        return self._due(max(len(self._time_s) - BEHIND, self._given))

    def finish(self) -> tuple[Floats, Floats]:
        """The rest; at the end the last value is held where an even instant lies beyond the last stamp."""
        return self._due(len(self._time_s))

    def _due(self, stop: int) -> tuple[Floats, Floats]:
        at_s = self._even_s[self._given : stop]
        if not len(at_s):
            return np.empty(0), np.empty(0)
        rows, sound = np.empty((2, len(at_s))), np.empty(len(at_s), dtype=np.bool_)
        limits = (3.0 * self._step_s, REACH_STEPS * self._step_s)
        spline_rows(at_s, self._time_s, np.column_stack((self._value, self._value)), limits, rows, sound)
        value = np.where(sound, rows[0], np.interp(at_s, self._time_s, self._value))
        keep = max(stop - 2 * BEHIND, 0)
        self._time_s, self._value, self._even_s = self._time_s[keep:], self._value[keep:], self._even_s[keep:]
        self._given = stop - keep
        return at_s, value
