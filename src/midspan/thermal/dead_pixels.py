"""Pixels of a thermal camera that measure nothing: found by what they do over many frames, filled from around them.

Cameras write such pixels as missing, or leave them at the temperature that they are stuck at. One that is static in
a scene that moves draws every translation towards zero.
"""

import numpy as np
from numpy.typing import NDArray

from midspan.records import Floats32
from midspan.signals.medians import SIGMA_OF_MEDIAN

Mask = NDArray[np.bool_]

MIN_LOOKED_AT = 12  # frames; fewer may agree by chance
# Where more than this share of the picture seems stuck it is an overlay or a scene at rest, not a damaged sensor.
MAX_STUCK = 0.02
# Among this many frames the noise of a pixel, if it were one step of its numbers, would show in four steps.
_MIN_STEPS = 4.0
_LIVELY_SHARE = 0.75  # of a stuck pixel's neighbours, or the picture is static there
# A pixel that stands out from its neighbours by more than this, by the median over time, is no part of a scene: lenses
# spread every point over several pixels.
_STANDS_OUT_K = 5.0
_STANDS_OUT_STDS = 8.0
_EDGE = 2
_CUBIC = np.array([-1.0, 4.0, 4.0, -1.0]) / 6.0
_AROUND = tuple((y, x) for y in (-1, 0, 1) for x in (-1, 0, 1) if (y, x) != (0, 0))


def filled(image: NDArray[np.generic], dead: Mask) -> Floats32:
    """The picture (rows, columns) with the pixels of `dead` (rows, columns) replaced by what lies around them.

    Where two pixels are known on either side, along rows or columns, by cubics through them; else by the mean of the
    neighbours, larger holes from their edge inwards. Where all pixels are dead they stay NaN.
    """
    held = np.full((image.shape[0] + 2 * _EDGE, image.shape[1] + 2 * _EDGE), np.nan, dtype=np.float32)
    held[_EDGE:-_EDGE, _EDGE:-_EDGE] = np.where(dead, np.nan, image)
    places = np.argwhere(dead) + _EDGE
    # By cubics along rows and columns, their mean where both are known.
    down, along = (
        _CUBIC @ np.stack([held[places[:, 0] + k * y, places[:, 1] + k * x] for k in (-2, -1, 1, 2)])
        for y, x in ((1, 0), (0, 1))
    )
    both = np.where(np.isfinite(down) & np.isfinite(along), 0.5 * (down + along), down)
    found = np.where(np.isfinite(both), both, along).astype(np.float32)
    held[places[:, 0], places[:, 1]] = found
    _fill_by_means(held, places[~np.isfinite(found)])
    return np.ascontiguousarray(held[_EDGE:-_EDGE, _EDGE:-_EDGE])


def _fill_by_means(held: Floats32, left: NDArray[np.int64]) -> None:
    """Fill the places (n, 2) in `held` by the mean of their neighbours, from the edge of each hole inwards."""
    steps = np.array(_AROUND)
    weights = np.where(np.abs(steps).sum(axis=1) == 1, 1.0, 0.5)
    while len(left):
        values = held[left[:, :1] + steps[:, 0], left[:, 1:] + steps[:, 1]]
        known = np.isfinite(values)
        weight = known @ weights
        ready = weight >= min(2.0, float(weight.max()))
        if not weight.any():
            break
        mean = (np.where(known, values, 0.0) @ weights)[ready] / weight[ready]
        held[left[ready, 0], left[ready, 1]] = mean
        left = left[~ready]


def stuck_pixels(stack: Floats32) -> Mask:
    """Pixels (rows, columns) of frames (n, rows, columns) in °C, spread over time, that are stuck.

    They keep one value to the last digit while those around them change, or stand out by 5 K and more from all
    neighbours. None where there are fewer than 12 frames, or where too many pixels would be stuck.
    """
    shape = stack.shape[1:]
    nothing = np.zeros(shape, dtype=bool)
    if len(stack) < MIN_LOOKED_AT:
        return nothing
    low, high = stack.min(axis=0), stack.max(axis=0)
    known = np.isfinite(low) & np.isfinite(high)
    # The usual distance between neighbouring numbers, K: their digits, or a camera's counts.
    sample = stack[:, :: max(stack.shape[1] // 32, 1), :: max(stack.shape[2] // 32, 1)]
    numbers = np.unique(sample[np.isfinite(sample)])
    step = float(np.median(np.diff(numbers))) if len(numbers) > 1 else 0.0
    lively = known & (high - low > 0.0) & (high - low >= _MIN_STEPS * step)
    neighbours = np.sum([_moved(known, y, x) for y, x in _AROUND], axis=0)
    moving = np.sum([_moved(lively, y, x) for y, x in _AROUND], axis=0)
    still = known & (high == low) & (neighbours > 0) & (moving >= _LIVELY_SHARE * neighbours)
    if lively.any():
        # The least and the most that other pixels reach may be where the numbers end: a scene may stay beyond.
        still &= (low != low[lively].min()) & (high != high[lively].max())
    stuck = still | _standing_out(np.median(np.where(known, stack, np.float32(0.0)), axis=0), known)
    return stuck if np.mean(stuck) <= MAX_STUCK else nothing


def _standing_out(picture: Floats32, known: Mask) -> Mask:
    """Pixels of a picture (rows, columns) that are far from the middle of their neighbours."""
    values = np.where(known, picture, np.nan)
    edged = np.pad(values, 1, mode="reflect")
    around = np.stack([edged[1 + y : 1 + y + values.shape[0], 1 + x : 1 + x + values.shape[1]] for y, x in _AROUND])
    around = np.where(np.isfinite(around), around, values)
    apart = np.abs(values - np.median(around, axis=0))
    if not known.any():
        return known
    usual = SIGMA_OF_MEDIAN * float(np.median(apart[known]))
    return np.asarray(known & (apart > max(_STANDS_OUT_K, _STANDS_OUT_STDS * usual)))


def _moved(mask: Mask, y: int, x: int) -> NDArray[np.int64]:
    """The mask (rows, columns) shifted by one pixel, nothing beyond the edge."""
    edged = np.pad(mask.astype(np.int64), 1)
    return edged[1 + y : 1 + y + mask.shape[0], 1 + x : 1 + x + mask.shape[1]]
