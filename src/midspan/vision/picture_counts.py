"""What of a run's pictures is worth reporting, counted frame by frame: blur, saturation, texture, motion."""

import math
from dataclasses import dataclass, field

from midspan.records import PixelTranslation

BLURRED = 0.5  # of the first frame's detail (square) a frame is counted as blurred; over it, as sharper
COARSE_STD_PX = 0.06  # a frame known no better is counted


@dataclass(slots=True)
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

    def add(self, value_px: float, variance_px2: float) -> None:
        """Count one more frame (Welford's recursion)."""
        off = value_px - self.mean_px
        self.seen += 1
        self.coarse += variance_px2 > COARSE_STD_PX**2
        self.variance_px2 += (variance_px2 - self.variance_px2) / self.seen
        self.mean_px += off / self.seen
        self.square_px2 += off * (value_px - self.mean_px)


@dataclass(slots=True)
class PictureCounts:
    """Frames so far, and how many of them are blurred or sharper beside the reference, or saturated.

    most_saturated: the largest share of saturated pixels over the others.
    """

    frames: int = 0
    blurred: int = 0
    sharper: int = 0
    saturated: int = 0
    most_saturated: float = 0.0
    x: AxisCounts = field(default_factory=AxisCounts)
    y: AxisCounts = field(default_factory=AxisCounts)

    def add(self, found: PixelTranslation, sharp: tuple[float, float], saturated: float) -> None:
        """Count a frame of such detail (square) along x and y over the reference's, and of so many saturated pixels
        over the others.
        """
        self.frames += 1
        self.blurred += min(sharp) < BLURRED
        self.sharper += max(sharp) > 1.0 / BLURRED
        self.saturated += saturated > 0.0
        self.most_saturated = max(self.most_saturated, saturated)
        self.x.add(found.x_px, found.variance_x_px2)
        self.y.add(found.y_px, found.variance_y_px2)
