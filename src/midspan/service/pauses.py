"""How long to wait before a source that failed is opened again."""

import time
from collections.abc import Callable

# The shortest and the longest pause, s.
SHORTEST_S, LONGEST_S = 1.0, 30.0
# A pause is this part of the time that the source has been away: one that is back is opened soon after a short
# absence, and seldom asked for in a long one.
PART = 0.25


class Pauses:
    """`worked` whenever the source gave something, `next_s` after each failure; clock_s: a monotonic clock, s."""

    def __init__(self, clock_s: Callable[[], float] = time.monotonic) -> None:
        self._clock_s = clock_s
        self._away_s: float | None = None

    def worked(self) -> None:
        """The source gave something."""
        self._away_s = None

    def next_s(self) -> float:
        """How long to wait now, s."""
        now_s = self._clock_s()
        if self._away_s is None:
            self._away_s = now_s
        return min(max(PART * (now_s - self._away_s), SHORTEST_S), LONGEST_S)
