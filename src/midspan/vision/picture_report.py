"""What the frames of a run say of themselves: compression, blur, saturation; see `core/src/track/picture_watch.rs`."""

import math
from dataclasses import dataclass, field

from midspan import _core

SCALE_LOSS = 0.6  # of the scale, for a codec's standard deviation as large as the motion's


@dataclass(frozen=True, slots=True)
class Compression:
    """What a codec did to the frames: the share a picture inherits from the one before, the share of texture that
    stood still, and the standard deviation (px) of what that does to a translation; zeros for raw frames.
    """

    inherited_share: float = 0.0
    frozen_share: float = 0.0
    std_px: float = 0.0

    def relative_scale_std(self, moved_px: float) -> float:
        """Relative standard deviation that it adds to a scale factor estimated on a motion of `moved_px` rms."""
        return min(SCALE_LOSS * self.std_px / moved_px, 1.0) if moved_px > 0.0 and self.std_px > 0.0 else 0.0


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


@dataclass(frozen=True, slots=True)
class PictureCounts:
    """Frames so far, and how many of them are blurred or sharper compared with the reference, or saturated.

    most_saturated: the largest share of saturated pixels over the others.
    """

    frames: int = 0
    blurred: int = 0
    sharper: int = 0
    saturated: int = 0
    most_saturated: float = 0.0
    x: AxisCounts = field(default_factory=AxisCounts)
    y: AxisCounts = field(default_factory=AxisCounts)


@dataclass(frozen=True, slots=True)
class PictureReport:
    """Of the frames so far; saturated_share: of the region's pixels at the end of the scale, 0 to 1, the usual frame's
    or the reference's.
    """

    compression: Compression
    counts: PictureCounts
    saturated_share: float

    def relative_scale_std(self, axis: str) -> float:
        """Relative standard deviation that compression adds to a scale factor estimated on the frames so far."""
        moved = self.counts.x if axis == "x" else self.counts.y
        return self.compression.relative_scale_std(moved.moved_px)


def picture_report(chain: _core.TargetChain) -> PictureReport | None:
    """What a target's chain has to report of the pictures so far; None where it does not look at them."""
    compression, counts, saturated_share = chain.compression, chain.counts, chain.saturated_share
    if compression is None or counts is None or saturated_share is None:
        return None
    x, y = (AxisCounts(*axis) for axis in counts[5:])
    return PictureReport(Compression(*compression), PictureCounts(*counts[:5], x, y), saturated_share)
