"""Frames in which another transmitter is received: it raises the power of all range bins at once, targets that of few.

The floor of a frame is the median power over bins spread over all ranges. It is compared with its own median over the
frames before, which a burst does not change while it lasts for less than half of them. A gain that changes for good is
the usual one soon.
"""

import numpy as np
from numpy.typing import NDArray

from midspan.records import Floats

# Over this many bins is the floor taken; with fewer nothing is said. The power of noise is distributed exponentially,
# and a Hann window leaves half as many bins independent: their median is six times its usual value once in 250 000
# frames.
PROBED_BINS = 16
MIN_RISE = 6.0
# Frames that the usual floor is taken from, at most and at least: before there are this many nothing is said. Bursts
# that fill half of them would be taken for usual, and a gain that changes for good costs half as many.
MEMORY_FRAMES, MIN_FRAMES = 512, 16


def probed_bins(bins: int) -> Floats:
    """Whole bins (k,) that the floor is taken from; none where there are too few."""
    if bins < PROBED_BINS:
        return np.empty(0)
    return np.unique(np.rint(np.linspace(0.0, bins - 1.0, PROBED_BINS)))


def floor_of(phasors: NDArray[np.complex64], valid: NDArray[np.bool_]) -> Floats:
    """Floor (n,) of the phasors (n, channels, k) of probed bins; NaN where a channel (n, channels) is not valid."""
    power = np.square(phasors.real) + np.square(phasors.imag)
    floor = np.median(power.reshape(len(power), -1), axis=1)
    return np.where(valid.all(axis=1), floor, np.nan)


class Interference:
    """Finds the frames with interference, block by block, however the frames are cut into blocks."""

    def __init__(self) -> None:
        self._before = np.empty(0)

    def found(self, floor: Floats) -> NDArray[np.bool_]:
        """Which of the next frames (n,) hold interference, by their floors; NaN: not known."""
        out, known = np.zeros(len(floor), dtype=np.bool_), np.flatnonzero(np.isfinite(floor))
        begun = min(max(MEMORY_FRAMES - len(self._before), 0), len(known))
        whole = np.concatenate((self._before, floor[known]))
        # Too few frames before, or no floor at all, say nothing.
        firsts = [whole[: len(self._before) + k] for k in range(begun)]
        usual = [float(np.median(first)) if len(first) >= MIN_FRAMES else 0.0 for first in firsts]
        usual = [floor_before or np.inf for floor_before in usual]
        if begun < len(known):
            windows = np.lib.stride_tricks.sliding_window_view(whole[:-1], MEMORY_FRAMES)
            usual += list(np.median(windows[begun - len(known) :], axis=1))
        out[known] = whole[len(self._before) :] > MIN_RISE * np.array(usual, dtype=np.float64)
        self._before = whole[-MEMORY_FRAMES:]
        return out
