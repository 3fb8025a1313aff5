"""What of a run's pictures is worth reporting, counted frame by frame: blur, saturation, texture, motion."""

import math
from dataclasses import dataclass, replace

from midspan.records import PixelTranslation

BLURRED = 0.5  # of the first frame's detail (square) a frame is counted as blurred; over it, as sharper
COARSE_STD_PX = 0.06  # a frame known no better is counted


@dataclass(frozen=True, slots=True)
class AxisCounts:
    """Along one image axis: frames in which the target was seen, in how many its own standard deviation is coarse, the
    mean of their variances (px²), and mean (px) and sum of the squared distances from it (px²) of the translation.
    """

    seen: int = 0
    coarse: int = 0
    variance_px2: float = 0.0
    mean_px: float = 0.0
    square_px2: float = 0.0

    @property
    def moved_px(self) -> float:
        """Standard deviation of the translation, px."""
        return math.sqrt(self.square_px2 / self.seen) if self.seen else 0.0

    def plus(self, value_px: float, variance_px2: float) -> "AxisCounts":
        """With one more frame (Welford's recursion)."""
        seen = self.seen + 1
        mean = self.mean_px + (value_px - self.mean_px) / seen
        return AxisCounts(
            seen,
            self.coarse + (variance_px2 > COARSE_STD_PX**2),
            self.variance_px2 + (variance_px2 - self.variance_px2) / seen,
            mean,
            self.square_px2 + (value_px - self.mean_px) * (value_px - mean),
        )


@dataclass(frozen=True, slots=True)
class PictureCounts:
    """Frames so far, and how many of them are blurred or sharper beside the reference, or saturated.

    most_saturated: the largest share of saturated pixels over the others.
    """

    frames: int = 0
    blurred: int = 0
    sharper: int = 0
    saturated: int = 0
    most_saturated: float = 0.0
    x: AxisCounts = AxisCounts()
    y: AxisCounts = AxisCounts()

    def lost(self) -> "PictureCounts":
        """With a frame that does not show the target."""
        return replace(self, frames=self.frames + 1)

    def plus(self, found: PixelTranslation, sharp: tuple[float, float], saturated: float) -> "PictureCounts":
        """With a frame of such detail (square) along x and y over the reference's, and of so many saturated pixels over
        the others.
        """
        return PictureCounts(
            self.frames + 1,
            self.blurred + (min(sharp) < BLURRED),
            self.sharper + (max(sharp) > 1.0 / BLURRED),
            self.saturated + (saturated > 0.0),
            max(self.most_saturated, saturated),
            self.x.plus(found.x_px, found.variance_x_px2),
            self.y.plus(found.y_px, found.variance_y_px2),
        )
