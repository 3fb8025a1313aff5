"""What the frames of a run say of themselves: compression, blur, saturation; see `core/src/track/picture_watch.rs`."""

import math
from dataclasses import dataclass, field

from midspan import _core
from midspan._core import SATURATED_SHARE
from midspan.notices import Notice

TELLING_STD_PX = 0.003  # below this, compression does less than the noise of a usual frame
SWALLOWED = 3.0  # motion below this many standard deviations of the codec loses half of its size, or all
REPORTED_SHARE, REPORTED_FRAMES = 0.02, 3  # of the frames; and not less than this many
MAX_FRAMES = 0.5
SCALE_LOSS = 0.6  # of the scale, for a codec's standard deviation as large as the motion's


@dataclass(frozen=True, slots=True)
class Compression:
    """What a codec did to the frames: the share a picture inherits from the one before, the share of texture that
    was static, and the standard deviation (px) of what that does to a translation; zeros for raw frames.
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


@dataclass(frozen=True, slots=True)
class LightReport:
    """How far changed light may have moved a target with a fixed reference: the largest variance so far (px²), and the
    stamp of the first that is worth reporting; see `core/src/track/light_watch.rs`.
    """

    largest_px2: float = 0.0
    notable_ns: int | None = None


def picture_warnings(report: PictureReport, axes: str) -> list[Notice]:
    """What `report` says in the frames so far, measured along the image axes "x", "y" or "xy"."""
    along = [report.counts.x if axis == "x" else report.counts.y for axis in axes]
    found = {
        "video-compressed": _compression(report, along),
        "frames-blurred": _blur(report),
        "region-exposure": _saturation(report),
        "region-texture": _texture(along),
    }
    return [Notice(code, text) for code, text in found.items() if text]


def _compression(report: PictureReport, along: list[AxisCounts]) -> str:
    found = report.compression
    if found.std_px < TELLING_STD_PX:
        return ""
    moved, limit = max(one.moved_px for one in along), SWALLOWED * found.std_px
    scale = 100.0 * found.relative_scale_std(moved)
    small = (
        f"The measured motion, {moved:.2g} px rms, is not larger: much of it may be missing."
        if moved < limit
        else f"The scale factor can be off by {scale:.2g} %."
    )
    shares = [f"a frame copies {100.0 * found.inherited_share:.0f} % of the previous one"]
    if found.frozen_share > 0.005:
        shares.append(f"{100.0 * found.frozen_share:.0f} % of the texture is static")
    return (
        f"camera: the frames are compressed ({', '.join(shares)}). A standard deviation of {found.std_px:.2g} px is "
        f"added to each; motion below about {limit:.2g} px may be lost. {small} Record raw or lossless, or at the "
        "best quality of the camera."
    )


def _blur(report: PictureReport) -> str:
    count, blurred, sharper = report.counts.frames, report.counts.blurred, report.counts.sharper
    least = max(REPORTED_SHARE * count, REPORTED_FRAMES)
    # One frame out of focus at the start leaves all others sharper; a few sharper ones are brighter, or covered.
    if sharper > MAX_FRAMES * count:
        return (
            f"camera: {sharper} of {count} frames show more than twice the detail of the first one, which is blurred. "
            "Start at a sharp frame."
        )
    if blurred > least:
        return (
            f"camera: {blurred} of {count} frames show less than half the detail of the first one (motion blur or "
            "focus); their standard deviations are increased. Shorten the exposure or fix the focus."
        )
    return ""


def _saturation(report: PictureReport) -> str:
    share, count, some = report.saturated_share, report.counts.frames, report.counts.saturated
    if share <= SATURATED_SHARE and some > max(REPORTED_SHARE * count, REPORTED_FRAMES):
        most = 100.0 * report.counts.most_saturated / (1.0 + report.counts.most_saturated)
        return (
            f"camera: {some} of {count} frames have saturated or black pixels in the region, up to {most:.0f} %; "
            "their standard deviations are increased. Fix the exposure and avoid glare."
        )
    if share <= SATURATED_SHARE:
        return ""
    return (
        f"camera: {100.0 * share:.0f} % of the region's pixels are saturated or black. They show no motion and bias "
        "the edges next to them. Change the exposure, or choose another region."
    )


def _texture(along: list[AxisCounts]) -> str:
    coarse = [one.variance_px2 for one in along if one.coarse > MAX_FRAMES * one.seen]
    if not coarse:
        return ""
    return (
        f"camera: the region has little texture for its noise: σ of a frame is {math.sqrt(max(coarse)):.2g} px. "
        "Choose a larger region, one with more edges, or more light."
    )
