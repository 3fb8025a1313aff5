"""The mean of registered frames: a template with less noise and less aliasing than any one frame has."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from midspan.records import Floats
from midspan.vision.spline import REACH, coefficients, combine, weights
from midspan.vision.texture import values

_MARGIN = 6  # the spline through a cut is exact from here on to about 1e-3 of the step at its mirrored edge
_SMOOTHED_PX = 5


@dataclass(frozen=True, slots=True, eq=False)
class Average:
    """Sums over `count` registered frames on the template's pixels: of the values (h, w) and of their squares."""

    count: int
    total: Floats
    square: Floats

    @property
    def mean(self) -> Floats:
        """Mean frame (h, w)."""
        return self.total / self.count

    def weight(self) -> NDArray[np.float32]:
        """One over the variance (h, w) of a pixel from frame to frame, smoothed, about 1 in the middle.

        It holds shot noise, aliasing at edges and what moves in front, each where it is.
        """
        from scipy.ndimage import uniform_filter

        variance = np.maximum(self.square / self.count - self.mean**2, 0.0)
        smooth = uniform_filter(variance, _SMOOTHED_PX, mode="mirror")
        middle = max(float(np.median(smooth)), 1e-30)
        return np.asarray(1.0 / np.clip(smooth / middle, 0.2, 10.0), dtype=np.float32)

    def plus(self, moved: Floats) -> "Average":
        """With one more registered frame (h, w), whose level and contrast are made those of the mean."""
        mean = self.mean
        moved = (moved - moved.mean()) * (mean.std() / max(float(moved.std()), 1e-30)) + mean.mean()
        return Average(self.count + 1, self.total + moved, self.square + moved**2)


def start(plane: Floats) -> Average:
    """An average of one frame (h, w)."""
    return Average(1, plane.copy(), plane**2)


def registered(
    pixels: NDArray[np.generic], box: tuple[int, int, int, int], translation: tuple[float, float], offset: float
) -> Floats | None:
    """The frame `pixels` less `offset`, read at `translation` (x, y in px) from the pixels of `box`.

    `box`: first row, row after the last, first column, column after the last. None where that leaves the image.
    """
    x, y = round(translation[0]), round(translation[1])
    reach = _MARGIN + REACH
    top, bottom, left, right = box[0] + y - reach, box[1] + y + reach, box[2] + x - reach, box[3] + x + reach
    if top < 0 or left < 0 or bottom > pixels.shape[0] or right > pixels.shape[1]:
        return None
    cut = values(pixels[top:bottom, left:right], offset)
    if cut is None:
        return None
    grid = coefficients(cut.astype(np.float64))[_MARGIN:-_MARGIN, _MARGIN:-_MARGIN].astype(np.float32)
    moved = combine(np.ascontiguousarray(grid), weights(translation[1] - y, 0), weights(translation[0] - x, 0))
    return np.asarray(moved, dtype=np.float64)
