"""The median of the last n values, one value at a time."""

from bisect import bisect_left, insort
from collections import deque
from collections.abc import Sequence


class RunningMedian:
    """The median of the last `size` values; a push costs the logarithm of `size`, and its `state` is the values."""

    def __init__(self, size: int, values: Sequence[float] = ()) -> None:
        self._last = deque(values, maxlen=size)
        self._sorted = sorted(self._last)

    @property
    def state(self) -> tuple[float, ...]:
        """The values in their order; a median of the same size made from them goes on as this one."""
        return tuple(self._last)

    @property
    def value(self) -> float:
        """The median, NaN before the first value."""
        n = len(self._sorted)
        if not n:
            return float("nan")
        return 0.5 * (self._sorted[(n - 1) // 2] + self._sorted[n // 2])

    def push(self, value: float) -> None:
        """Take one finite value; the oldest one goes where there are more than `size`."""
        if len(self._last) == self._last.maxlen:
            self._sorted.pop(bisect_left(self._sorted, self._last[0]))
        self._last.append(value)
        insort(self._sorted, value)
