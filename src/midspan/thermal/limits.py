"""Which temperatures belong to the target, and how those that do not are kept from pulling a tracker.

A person or a vehicle in front of the target differs from it by ten times its contrast. Clipped at the edge of a range
it would still be the strongest object in the picture. So temperatures far outside the target's own are reflected back
to its middle, the way a redescending influence function treats an outlier (Hampel's three parts): what covers a quarter
of the target then weighs no more than a patch without texture.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from midspan.errors import DataError
from midspan.records import NANOSECONDS, Floats, Floats32

_SHARES = (1.0, 25.0, 50.0, 75.0, 99.0)  # percent; the quartiles are moved by what covers less than a quarter only
_MIN_K = 1e-3
MARGIN = 0.25  # share of the width by which temperatures may lie outside and still count in full
FOLLOW_S = 10.0  # in this many s the limits move by half their width at most, and the width by a quarter
# The width follows this many times slower than the middle: what passes in front widens it, and contrast changes slowly.
_SLOWER = 4.0


@dataclass(frozen=True, slots=True)
class Limits:
    """The target's own temperatures, from low to high in °C."""

    low_c: float
    high_c: float

    @property
    def middle_c(self) -> float:
        """Half way between the limits, °C."""
        return 0.5 * (self.low_c + self.high_c)

    @property
    def half_k(self) -> float:
        """Half the width, K."""
        return max(0.5 * (self.high_c - self.low_c), _MIN_K)


def reflected(celsius: NDArray[np.generic], limits: Limits, margin: float = MARGIN) -> Floats32:
    """The picture (any shape) in °C with what lies far outside `limits` reflected back to their middle.

    margin: share of the width, 0 or more, by which temperatures may lie outside and still count in full; over another
    quarter of the width they go down to the middle.
    """
    values = np.asarray(celsius, dtype=np.float32)
    place = (values - np.float32(limits.middle_c)) / np.float32(limits.half_k)
    full = np.float32(1.0 + 2.0 * margin)
    distance = np.abs(place)
    excess = np.maximum(distance - full, np.float32(0.0))
    weight = np.maximum(np.float32(1.0) - excess / np.float32(0.5), np.float32(0.0))
    kept = np.minimum(distance, full) * weight
    return np.asarray(np.float32(limits.middle_c) + np.float32(limits.half_k) * np.copysign(kept, place))


def is_foreign(celsius: NDArray[np.generic], limits: Limits) -> NDArray[np.bool_]:
    """Which pixels of a picture (any shape) in °C are warmer or colder than all of the target."""
    place = np.abs(np.asarray(celsius, dtype=np.float32) - np.float32(limits.middle_c))
    return np.asarray(place > np.float32((1.0 + 2.0 * MARGIN) * limits.half_k))


@dataclass(frozen=True, slots=True)
class LimitState:
    """What is remembered of the target's temperatures: the quartiles in °C and when they were last looked at."""

    quartiles_c: tuple[float, float, float]
    time_ns: int


class LimitFollower:
    """The target's limits as it warms and cools: its quartiles, followed at a limited pace, times the shape of the
    first frame.

    A pace and not a time constant: what passes in front is far from the target and soon gone, while a wall that cools
    all evening must not be lagged behind, or its own temperatures would be reflected.
    """

    def __init__(self, region: NDArray[np.generic], time_ns: int) -> None:
        """`region` (rows, columns) in °C of the reference frame."""
        low, first, middle, third, high = _shares(region)
        self._below = (middle - low) / max(middle - first, _MIN_K)
        self._above = (high - middle) / max(third - middle, _MIN_K)
        # Everything that changes from frame to frame.
        self.state = LimitState((first, middle, third), time_ns)

    def restore(self, state: LimitState) -> None:
        """Continue from a `state` taken earlier."""
        self.state = state

    @property
    def limits(self) -> Limits:
        """The limits of the moment."""
        first, middle, third = self.state.quartiles_c
        low = middle - self._below * max(middle - first, _MIN_K)
        return Limits(low, middle + self._above * max(third - middle, _MIN_K))

    def push(self, region: NDArray[np.generic], time_ns: int) -> Limits:
        """Follow the temperatures (rows, columns), °C, of where the target is at `time_ns`; return the limits."""
        share = max(time_ns - self.state.time_ns, 0) / NANOSECONDS / FOLLOW_S
        first, middle, third = self.state.quartiles_c
        low, now, high = _shares(region)[1:4]
        moved = middle + _within(now - middle, share * self.limits.half_k)
        widths = ((middle - first, now - low), (third - middle, high - now))
        below, above = (
            before * float(np.exp(_within(float(np.log(width / before)), share / _SLOWER)))
            for before, width in ((max(a, _MIN_K), max(b, _MIN_K)) for a, b in widths)
        )
        self.state = LimitState((moved - below, moved, moved + above), time_ns)
        return self.limits

    def jump(self, step_k: float) -> None:
        """Move the limits by a step of the camera's level, in K."""
        first, middle, third = (q + step_k for q in self.state.quartiles_c)
        self.state = LimitState((first, middle, third), self.state.time_ns)


def _within(value: float, most: float) -> float:
    return min(max(value, -most), most)


def _shares(region: NDArray[np.generic]) -> list[float]:
    values: Floats = np.asarray(region, dtype=np.float64).ravel()
    values = values[np.isfinite(values)]
    if values.size == 0:
        raise DataError("The region must hold temperatures in °C; all are missing. Choose another region.")
    return [float(v) for v in np.percentile(values, _SHARES)]
