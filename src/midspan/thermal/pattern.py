"""The fixed pattern of a thermal camera: what stays on its pixels while the scene moves over them.

A pattern in the reference frame and in the present one draws every translation towards zero, and it is the larger the
weaker the scene. Where the scene has moved by some tenths of a pixel or more, both can be distinguished: the mean of
the frames moved back is the scene, the mean of what is left on each pixel is the pattern; the two are improved in turn.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from midspan.checks import finite, positive, refuse
from midspan.records import Floats

MIN_TRAVEL_PX = 0.4  # standard deviation of the motion below which scene and pattern are one
MIN_FRAMES = 8
TURNS = 10
_ORDER = 5  # of the spline that moves the scene
_EDGE_PX = 2  # from the edge inwards the spline is disturbed by what it takes to lie beyond


@dataclass(frozen=True, slots=True, eq=False)
class FixedPattern:
    """A fixed pattern (rows, columns) in K, mean 0."""

    values_k: Floats

    def removed(self, celsius: NDArray[np.generic]) -> NDArray[np.float32]:
        """The picture (rows, columns) without the pattern."""
        return np.asarray(celsius, dtype=np.float32) - self.values_k.astype(np.float32)


def estimate_pattern(frames: Floats, translation_px: Floats, expected_k: float = 0.03) -> FixedPattern | None:
    """The fixed pattern of pictures in °C whose scene has moved by known translations.

    frames (n, rows, columns), 8 or more, of one place on the sensor; translation_px (n, 2): x to the right and y down;
    expected_k: standard deviation of the pattern to be expected, K, by which noise is told from it.
    None where the scene has moved so little that the two cannot be distinguished. Raises UsageError for arrays of
    other shapes.
    """
    stack = finite("frames", frames)
    moved = finite("translation_px", translation_px)
    positive("expected_k", expected_k, "K")
    if stack.ndim != 3 or len(stack) < MIN_FRAMES or moved.shape != (len(stack), 2):
        raise refuse(
            f"frames and translation_px of shapes (n, rows, columns) and (n, 2), n from {MIN_FRAMES} on",
            "given",
            (stack.shape, moved.shape),
        )
    if float(np.sqrt(np.sum(np.var(moved, axis=0)))) < MIN_TRAVEL_PX:
        return None
    # A frame's level is what it has in common with the others after the scene was moved back; its median will do.
    return _told_apart(stack - np.median(stack, axis=(1, 2), keepdims=True), moved, expected_k)


def _told_apart(stack: Floats, moved: Floats, expected_k: float) -> FixedPattern:
    """Scene and pattern improved in turn; pixels that the scene's known part does not reach have the pattern 0.

    A scene that warms or cools has another contrast in each frame; what its mean leaves of it would pass for pattern.
    """
    back = [_shifted(f, -x, -y) for f, (x, y) in zip(stack, moved, strict=True)]
    inside = [_covered(stack.shape[1:], -x, -y) for x, y in moved]
    count = np.sum(inside, axis=0)
    known = count > 0
    seen = [_covered(known.shape, x, y) & (_shifted(known.astype(np.float64), x, y) > 0.999) for x, y in moved]
    number = np.sum(seen, axis=0)
    pattern, noise, contrast = np.zeros(stack.shape[1:]), expected_k, np.ones(len(stack))
    for _ in range(TURNS):
        scene, weight = np.zeros_like(pattern), np.zeros_like(pattern)
        for image, mask, (x, y), share in zip(back, inside, moved, contrast, strict=True):
            scene += np.where(mask, share * (image - _shifted(pattern, -x, -y)), 0.0)
            weight += share**2 * mask
        scene /= np.maximum(weight, 1e-3)
        there = [np.where(mask, _shifted(scene, x, y), 0.0) for mask, (x, y) in zip(seen, moved, strict=True)]
        contrast = _straight(
            [_amount(f - pattern, expected, mask) for f, expected, mask in zip(stack, there, seen, strict=True)]
        )
        total, square = np.zeros_like(pattern), np.zeros_like(pattern)
        for frame, mask, expected, share in zip(stack, seen, there, contrast, strict=True):
            rest = np.where(mask, frame - share * expected, 0.0)
            total += rest
            square += rest**2
        mean = total / np.maximum(number, 1)
        full = number >= MIN_FRAMES
        variance = square / np.maximum(number, 1) - mean**2
        noise = float(np.sqrt(max(np.median(variance[full]), 0.0))) if full.any() else noise
        # The mean of n noisy values, drawn to zero as far as it may be noise.
        pattern = total / (number + (noise / expected_k) ** 2)
        pattern -= np.mean(pattern[full]) if full.any() else 0.0
        pattern[~full] = 0.0
    return FixedPattern(pattern)


def _amount(seen: Floats, expected: Floats, mask: NDArray[np.bool_]) -> float:
    """How much of what is expected (rows, columns; 0 beyond the mask) is seen over the mask, apart from levels."""
    count = max(np.count_nonzero(mask), 1)
    free = np.where(mask, expected - expected.sum() / count, 0.0)
    return float(np.sum(free * seen) / max(float(np.sum(free**2)), 1e-12))


def _straight(shares: list[float]) -> Floats:
    """The straight line (n,) of mean 1 through shares: contrast fades slowly; what differs from frame to frame is what
    the spline makes of another fraction of a pixel, and would come to stand in the pattern.
    """
    place = np.arange(len(shares)) - 0.5 * (len(shares) - 1)
    mean = max(float(np.mean(shares)), 1e-3)
    slope = float(place @ np.array(shares)) / float(place @ place) / mean
    return np.maximum(np.asarray(1.0 + slope * place, dtype=np.float64), 0.05)


def _shifted(image: Floats, x_px: float, y_px: float) -> Floats:
    """The picture moved by x (right) and y (down) px with a quintic spline; its edge is repeated beyond it."""
    from scipy.ndimage import correlate1d, spline_filter

    grid = spline_filter(image, order=_ORDER, mode="nearest")
    whole_x, whole_y = round(x_px), round(y_px)
    for axis, (whole, exact) in enumerate(((whole_y, y_px), (whole_x, x_px))):
        grid = correlate1d(grid, _spline_weights(exact - whole), axis=axis, mode="nearest")
        places = np.clip(np.arange(grid.shape[axis]) - whole, 0, grid.shape[axis] - 1)
        grid = np.take(grid, places, axis=axis)
    return np.asarray(grid, dtype=np.float64)


def _spline_weights(fraction: float) -> Floats:
    """Weights (7,) of the coefficients around a pixel for the value `fraction` px before it."""
    distance = np.abs(np.arange(-3, 4) + fraction)
    powers = sum(
        sign * math.comb(6, k) * np.maximum(3.0 - k - distance, 0.0) ** 5
        for k, sign in enumerate((1, -1, 1, -1, 1, -1, 1))
    )
    return np.asarray(powers / math.factorial(_ORDER), dtype=np.float64)


def _covered(shape: tuple[int, ...], x_px: float, y_px: float) -> NDArray[np.bool_]:
    """Pixels (rows, columns) of a picture moved by x and y px that come from inside it, not from its repeated edge."""
    masks = []
    for size, moved in zip(shape, (y_px, x_px), strict=True):
        place = np.arange(size) - moved
        masks.append((place >= _EDGE_PX) & (place <= size - 1 - _EDGE_PX))
    return np.asarray(masks[0][:, None] & masks[1][None, :])
