"""Failed logins, counted: as many as a person needs, and no list of words."""

import time
from collections import OrderedDict, deque
from collections.abc import Callable

# Attempts that may fail, of a user and from an address, within this time, s.
WINDOW_S, MAX_OF_USER, MAX_OF_ADDRESS = 60.0, 5, 10
# Users and addresses that are remembered.
MAX_REMEMBERED = 10_000


class Attempts:
    """Failed logins by user and by address; an answer is refused while either has too many."""

    def __init__(self, now_s: Callable[[], float] = time.monotonic) -> None:
        self._now_s = now_s
        self._failed: OrderedDict[tuple[str, str], deque[float]] = OrderedDict()

    def wait_s(self, user: str, address: str) -> float:
        """How long the next attempt has to wait; 0 where it need not."""
        return max(self._wait_s(("user", user), MAX_OF_USER), self._wait_s(("address", address), MAX_OF_ADDRESS))

    def failed(self, user: str, address: str) -> None:
        """An attempt failed, or is being looked at: those at a time are as many as fail."""
        for key in (("user", user), ("address", address)):
            self._failed.setdefault(key, deque()).append(self._now_s())
            self._failed.move_to_end(key)
        while len(self._failed) > MAX_REMEMBERED:
            self._failed.popitem(last=False)

    def succeeded(self, user: str, address: str) -> None:
        """An attempt that was counted as failed did not fail."""
        for key in (("user", user), ("address", address)):
            if self._failed.get(key):
                self._failed[key].pop()

    def _wait_s(self, key: tuple[str, str], most: int) -> float:
        times = self._failed.get(key)
        while times and self._now_s() - times[0] > WINDOW_S:
            times.popleft()
        if not times:
            self._failed.pop(key, None)
            return 0.0
        return WINDOW_S - (self._now_s() - times[0]) if len(times) >= most else 0.0
