"""Measurements that are missing: frames without a value, and those that an even series left out."""

import numpy as np

from midspan.records import NANOSECONDS, Displacement, Floats, Nanoseconds

# Intervals between measurements within this share of a whole number of the usual one make an even series.
EVEN_SHARE = 0.1
# At most so many instants in a row are asked for: no acceleration carries a displacement that far.
MOST_IN_A_ROW = 200


def is_even(time_ns: Nanoseconds, frame_s: float) -> bool:
    """Whether the stamps (m,) lie on an even raster of `frame_s` seconds, single ones left out or not."""
    steps = np.diff(time_ns) / (frame_s * NANOSECONDS)
    whole = np.maximum(np.rint(steps), 1.0)
    return len(steps) > 1 and bool(np.all(np.abs(steps - whole) <= EVEN_SHARE))


class MissingFrames:
    """Finds the instants at which a measurement was due and none came, from block to block.

    That a frame is only late is not known yet when its instant passes: an instant beside a measurement does not count,
    which is left to whoever takes it.
    """

    def __init__(self) -> None:
        self._every_ns, self._most = np.inf, 0
        self._last: tuple[int, int, int] | None = None

    def begin(self, every_s: float, longest_s: float) -> None:
        """Nothing is known of what came before; every_s: interval of an even series, s, infinite for others.

        longest_s: how long after a measurement instants are asked for.
        """
        self._every_ns, self._last = every_s * NANOSECONDS, None
        self._most = int(min(longest_s / every_s, MOST_IN_A_ROW)) + 1 if every_s < np.inf else 0

    def until(self, measured: Displacement, end_ns: int) -> Displacement:
        """What is missing up to `end_ns` (q,), without values, in time order.

        measured: the measurements (m,) since the last call, infinite the variance of those without a value. Infinite is
        the variance of what has none of its own.
        """
        gone = ~np.isfinite(measured.variance_m2)
        stamps, sources = measured.time_ns[gone], measured.source[gone]
        if self._most:
            left_out, beside = self._left_out(measured, end_ns)
            stamps, sources = np.concatenate((stamps, left_out)), np.concatenate((sources, beside))
        order = np.argsort(stamps, kind="stable")
        empty: Floats = np.full(len(stamps), np.nan)
        return Displacement(stamps[order], empty, np.full(len(stamps), np.inf), sources[order])

    def _left_out(
        self, measured: Displacement, end_ns: int
    ) -> tuple[Nanoseconds, "np.ndarray[tuple[int], np.dtype[np.uint8]]"]:
        """Stamps on the raster after each measurement up to the next one, and the source of the one before."""
        before = [] if self._last is None else [self._last]
        start = np.array([item[0] for item in before] + measured.time_ns.tolist(), dtype=np.int64)
        if not len(start):
            return np.empty(0, dtype=np.int64), np.empty(0, dtype=np.uint8)
        source = np.concatenate(([item[1] for item in before], measured.source)).astype(np.uint8)
        gap_ns = np.diff(start, append=end_ns + 1)
        count = np.clip(np.ceil(gap_ns / self._every_ns).astype(np.int64) - 1, 0, self._most)
        told = np.zeros(len(start), dtype=np.int64)
        told[: len(before)] = [item[2] for item in before]
        told = np.minimum(told, count)
        fresh = count - told
        number = np.arange(int(fresh.sum())) - np.repeat(np.cumsum(fresh) - fresh, fresh) + np.repeat(told, fresh) + 1
        self._last = (int(start[-1]), int(source[-1]), int(max(count[-1], told[-1])))
        stamps = np.repeat(start, fresh) + np.rint(number * self._every_ns).astype(np.int64)
        return stamps, np.repeat(source, fresh)
