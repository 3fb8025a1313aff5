"""What light takes of a picture whose reference stays the first frame, and how far its shading may move the result.

A bump or a ledge is shaded anew when the light turns: part of that looks as if the target had moved. A tracker with one
reference frame does not see it; the picture does, as it is less and less the reference's. Under light from another
side a picture is a · reference + b · something else, and the shift that is taken for motion goes with b: its variance
with the share of the picture's contrast, squared, that is not the reference's.
"""

import math
from dataclasses import dataclass, replace
from statistics import median
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from midspan.records import NANOSECONDS, Floats, Frame, PixelTranslation, Region, Status

# A frame whose mean is above black by less than this share of full scale is dark; black is 0, or in video of limited
# range 16 of 255 (ITU-R BT.601): then its darkest pixels are near that.
DARK_SHARE, VIDEO_BLACK, NEAR_BLACK = 0.02, 16.0 / 255.0, 0.75
# The picture is looked at so often; the middle one of the last so many looks counts: what passes by is no light.
LOOK_S, LOOKS = 1.0, 5
# The best of the first looks after the reference tells what noise takes, as light may turn already; it scatters by
# this share, and pictures without noise by this much.
USUAL_LOOKS, SCATTER, LEAST_SCATTER = 6, 0.5, 1e-3
# Means of so many pixels a side are compared, in so many blocks a side: what hides less than half of them is no light.
THINNED, BLOCKS, LEAST_BLOCK = 3, 4, 5
# Pixels near the top of 8 bits are cut off: more light changes them without any shading.
CLIPPED = 250.0
# Standard deviation (px) that a picture of which nothing is the reference's any more stands for.
LIGHT_PX = 0.12
# A standard deviation beyond which changed light is reported, px.
NOTABLE_PX = 0.05


def is_dark(pixels: NDArray[Any]) -> bool:
    """Whether an integer frame (rows, columns) is black: neither its mean nor its brightest pixels leave the bottom.

    Cameras put 10 or 12 bits into files of 16, so full scale is not known; a dark frame also has no contrast.
    """
    if pixels.dtype.kind == "f":
        return False
    scale = 255.0 if pixels.dtype.itemsize == 1 else 1023.0
    if _adds_up(pixels, (VIDEO_BLACK + DARK_SHARE) * scale * pixels.size):
        return False
    darkest, brightest = np.percentile(pixels[::4, ::4], (1, 99))
    black = VIDEO_BLACK * scale if darkest > NEAR_BLACK * VIDEO_BLACK * scale else 0.0
    return float(brightest) < black + 2.0 * DARK_SHARE * scale and float(pixels.mean()) < black + DARK_SHARE * scale


@njit(cache=True)
def _adds_up(pixels: NDArray[np.generic], total: float) -> bool:
    """Whether whole numbers (rows, columns), none below 0, add up to a total; rows after that are not looked at."""
    found = 0
    for r in range(pixels.shape[0]):
        for value in pixels[r]:
            found += value
        if found >= total:
            return True
    return False


@dataclass(frozen=True, slots=True)
class LightState:
    """What a `LightWatch` remembers: the shares of the first and of the last looks, when the next one is due, the
    variance (px²); the largest one so far, and the stamp of the first that is worth reporting.
    """

    first: tuple[float, ...] = ()
    last: tuple[float, ...] = ()
    due_ns: int | None = None
    variance_px2: float = 0.0
    largest_px2: float = 0.0
    notable_ns: int | None = None

    def looked(self, share: float, time_ns: int) -> "LightState":
        """After a look that found this `share` of the picture not the reference's."""
        last = (*self.last[-LOOKS + 1 :], share)
        if len(self.first) < USUAL_LOOKS:
            return replace(self, first=(*self.first, share), last=last)
        usual = (1.0 + SCATTER) * min(self.first) + LEAST_SCATTER
        variance = LIGHT_PX**2 * max(median(last) - usual, 0.0)
        notable = self.notable_ns
        if notable is None and variance > NOTABLE_PX**2:
            notable = time_ns
        return replace(
            self,
            last=last,
            variance_px2=variance,
            largest_px2=max(self.largest_px2, variance),
            notable_ns=notable,
        )


class LightWatch:
    """Takes a target's frames and tells the variance (px²) that light adds to where it was found."""

    def __init__(self, reference: Frame, region: Region) -> None:
        """`region` of the frame `reference` is what light is compared with."""
        self._region = region
        self._reference = _small(reference, region, 0.0, 0.0)
        self._full = CLIPPED if reference.pixels.dtype == np.uint8 else math.inf
        self.state = LightState()

    def restore(self, state: LightState) -> None:
        """Continue from a `state` taken earlier."""
        self.state = state

    def push(self, frame: Frame, found: PixelTranslation) -> float:
        """The variance (px²) along either axis beside what was `found` in `frame`, as the picture shows it."""
        due_ns = self.state.due_ns
        due = due_ns is None or frame.time_ns >= due_ns
        if due and found.status is Status.TRACKING and self._reference is not None:
            seen = _small(frame, self._region, found.x_px, found.y_px)
            if seen is not None:
                if due_ns is not None:
                    self.state = self.state.looked(unlike(self._reference, seen, self._full), frame.time_ns)
                self.state = replace(self.state, due_ns=frame.time_ns + round(LOOK_S * NANOSECONDS))
        return self.state.variance_px2


def unlike(reference: Floats, seen: Floats, full: float = math.inf) -> float:
    """Share (0 to 1) of the contrast, squared, of a picture (rows, columns) that is not the reference's.

    The middle one of the picture's blocks counts, each by its contrast in the reference. Values from `full` on are cut
    off and left out.
    """
    side = min(max(min(reference.shape) // LEAST_BLOCK, 1), BLOCKS)
    sums = _block_sums(reference, seen, full, side)
    shares, weights = [], []
    for count, own, its, energy, product, power in sums[sums[:, 0] > 0.0].tolist():
        a, b, both = energy - own * own / count, power - its * its / count, product - own * its / count
        shares.append(1.0 - min(max(both, 0.0) ** 2 / max(a * b, 1e-12), 1.0))
        weights.append(a)
    if not shares:
        return 0.0
    order = np.argsort(shares)
    reached = np.cumsum(np.array(weights)[order])
    return float(np.array(shares)[order][np.searchsorted(reached, 0.5 * reached[-1])])


@njit(cache=True)
def _block_sums(reference: Floats, seen: Floats, full: float, side: int) -> Floats:
    """For each of side² blocks (blocks, 6) of two pictures without their middle levels: how many pixels count, sums of
    both, of the first one's squares, of products, and of the second one's squares.
    """
    rows, columns = reference.shape
    sums = np.zeros((side * side, 6))
    level, other = reference[rows // 2, columns // 2], seen[rows // 2, columns // 2]
    for r in range(rows):
        # The first blocks are larger by one pixel where the sides do not divide evenly.
        down = _block(r, rows, side)
        for c in range(columns):
            if not (reference[r, c] < full and seen[r, c] < full):
                continue
            own, its = reference[r, c] - level, seen[r, c] - other
            block = sums[down * side + _block(c, columns, side)]
            block[0] += 1.0
            block[1] += own
            block[2] += its
            block[3] += own * own
            block[4] += own * its
            block[5] += its * its
    return sums


@njit(cache=True)
def _block(place: int, length: int, side: int) -> int:
    """Number of the block that a pixel lies in, of `side` blocks over a `length`."""
    size, more = length // side, length % side
    if place < more * (size + 1):
        return place // (size + 1)
    return (place - more) // size


def _small(frame: Frame, region: Region, x_px: float, y_px: float) -> Floats | None:
    """The target that lies x, y px from its region as means of pixels; None where it leaves the frame."""
    left, top = math.floor(x_px), math.floor(y_px)
    rows, columns = region.height // THINNED * THINNED, region.width // THINNED * THINNED
    y, x = region.y + top, region.x + left
    if y < 0 or x < 0 or y + rows + 1 > frame.pixels.shape[0] or x + columns + 1 > frame.pixels.shape[1]:
        return None
    return _means(frame.pixels[y : y + rows + 1, x : x + columns + 1], x_px - left, y_px - top)


@njit(cache=True)
def _means(cut: NDArray[np.generic], across: float, down: float) -> Floats:
    """Means of squares of pixels of a picture moved by parts of a pixel (0 to 1), linearly interpolated."""
    rows, columns = (cut.shape[0] - 1) // THINNED, (cut.shape[1] - 1) // THINNED
    out = np.zeros((rows, columns))
    for r in range(rows * THINNED):
        for c in range(columns * THINNED):
            upper = (1.0 - across) * cut[r, c] + across * cut[r, c + 1]
            lower = (1.0 - across) * cut[r + 1, c] + across * cut[r + 1, c + 1]
            out[r // THINNED, c // THINNED] += (1.0 - down) * upper + down * lower
    return out / (THINNED * THINNED)
