"""Knowing when not to trust the picture: compression, blur and saturation, from the frames alone.

What a frame's variance becomes rests on the frames up to it: on medians over the last checks (see `compression`) and
frames, and on the frame itself.
"""

import math
from copy import deepcopy
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from midspan import _core
from midspan.records import Frame, PixelTranslation, Region, Status
from midspan.signals.running_median import RunningMedian
from midspan.vision.compression import CodecState, CodecWatch, Compression
from midspan.vision.fair_variance import USUAL_FRAMES
from midspan.vision.picture_counts import PictureCounts
from midspan.vision.region import clamp, shift

FROZEN_MEAN_FRAMES = 96  # the usual share of texture that stood still is a mean over about so many
FROZEN_FRAMES = 9  # the steps of so many frames are taken for the target's speed
MOST_FROZEN = 0.9
BLURRED = 0.6  # of the reference's detail (square)
SATURATED_SHARE = 0.015
SATURATED_STD_PX = 0.025  # times the square root of the saturated over the other pixels


@dataclass(frozen=True, slots=True)
class Widening:
    """What a frame's picture makes of its variances along x and y: times a factor, and so many px² more."""

    factor_x: float = 1.0
    factor_y: float = 1.0
    added_x_px2: float = 0.0
    added_y_px2: float = 0.0

    def of(self, found: PixelTranslation) -> PixelTranslation:
        """The translation with its variances widened."""
        if self is NOTHING:
            return found
        x = self.factor_x * found.variance_x_px2 + self.added_x_px2
        y = self.factor_y * found.variance_y_px2 + self.added_y_px2
        return replace(found, variance_x_px2=x, variance_y_px2=y)


NOTHING, LOSSLESS = Widening(), Compression()


@dataclass(frozen=True, slots=True)
class Lag:
    """By how much (px) a picture of which a part stands still lags along one axis: the last translation, the squares of
    the last steps, and the lag.
    """

    value_px: float = math.nan
    squares_px2: tuple[float, ...] = ()
    lag_px: float = 0.0

    def after(self, value_px: float, share: float) -> "Lag":
        """In the next frame, in which a `share` (0 to 1) of the texture stands still.

        What stands still lags by its share of the step, and of the lag that it had: e = share · (e + step), with the
        rms of the last steps.
        """
        step = 0.0 if math.isnan(self.value_px) else value_px - self.value_px
        squares = (*self.squares_px2[-FROZEN_FRAMES + 1 :], step * step)
        usual = math.sqrt(sum(squares) / len(squares))
        return Lag(value_px, squares, min(share, MOST_FROZEN) * (self.lag_px + usual))


@dataclass(frozen=True, slots=True, eq=False)
class PictureState:
    """What a `PictureWatch` remembers: of the codec, the target in the frame before and where that was, the last
    frames' sharpness along x and y, lags along x and y, the usual share that stood still, and what is counted.
    """

    codec: CodecState
    before: tuple[Region, NDArray[np.generic]] | None = None
    sharp: tuple[tuple[float, ...], tuple[float, ...]] = ((), ())
    lags: tuple[Lag, Lag] = (Lag(), Lag())
    frozen_share: float = 0.0
    counts: PictureCounts = field(default_factory=PictureCounts)

    def at_the_start(self) -> "PictureState":
        """With what is known of the codec and the usual frame, before the frames that taught it are taken again."""
        return PictureState(replace(self.codec, last=None), None, self.sharp, frozen_share=self.frozen_share)


class PictureWatch:
    """Looks at every frame that a tracker has measured, and tells how far to widen its variances.

    `reference` and `region`: those of the tracker. `lossless`: that the frames come from a file which leaves nothing
    out; what they share with each other is then the scene's, not a codec's.
    """

    def __init__(self, reference: Frame, region: Region, *, lossless: bool = False) -> None:
        self._region, self._lossless = region, lossless
        self._picture = _core.TargetPicture(reference.pixels, (region.x, region.y, region.width, region.height))
        self._codec = CodecWatch(reference, region)
        self.restore(PictureState(self._codec.state))

    @property
    def state(self) -> PictureState:
        """Everything that changes from frame to frame."""
        sharp = (self._sharp[0].state, self._sharp[1].state)
        return PictureState(
            self._codec.state, self._before, sharp, self._lags, self._frozen_share, deepcopy(self.counts)
        )

    def restore(self, state: PictureState) -> None:
        """Continue from a `state` taken earlier."""
        self._codec.restore(state.codec)
        self._before, self._lags, self.counts = state.before, state.lags, deepcopy(state.counts)
        self._frozen_share = state.frozen_share
        self._sharp = tuple(RunningMedian(USUAL_FRAMES, values) for values in state.sharp)

    def push(self, frame: Frame, found: PixelTranslation) -> Widening:
        """Look at `frame` with the target at `found`; the first frame pushed is the reference."""
        if found.status is Status.LOST:
            self._codec.lost()
            self.counts.frames += 1
            self._before, self._lags = None, (Lag(), Lag())
            return NOTHING
        place = self._place(frame.pixels.shape, found)
        self._codec.push(frame.pixels, found, place)
        before = None if self._before is None else (self._before[1], self._before[0].x, self._before[0].y)
        noise = self._codec.usual.noise**2
        x, y, ends, frozen = self._picture.look(frame.pixels, place.x, place.y, noise, before)
        if not self._lossless:
            self._before = place, _cut(frame.pixels, place).copy()
            self._follow_frozen(frozen, found)
            self._keep_sharpness(x, y)
        sharp, share = (x, y), max(ends, self._picture.ends)
        saturated = share / max(1.0 - share, 0.02) if share > SATURATED_SHARE else 0.0
        self.counts.add(found, sharp, saturated)
        added = self.compression.std_px**2 + SATURATED_STD_PX**2 * saturated
        x, y = _blur_factor(sharp[0]), _blur_factor(sharp[1])
        more_x, more_y = self._lags[0].lag_px, self._lags[1].lag_px
        if x == y == 1.0 and added == more_x == more_y == 0.0:
            return NOTHING
        return Widening(x, y, x * more_x**2 + added, y * more_y**2 + added)

    @property
    def compression(self) -> Compression:
        """What a codec did to the frames so far."""
        if self._lossless:
            return LOSSLESS
        return self._codec.compression(self._frozen_share, refocused=self._refocused)

    @property
    def saturated_share(self) -> float:
        """Share of the region's pixels at the end of the scale, 0 to 1: the usual frame's or the reference's."""
        return max(self._codec.usual.ends, self._picture.ends)

    def relative_scale_std(self, axis: str) -> float:
        """Relative standard deviation that compression adds to a scale factor estimated on the frames so far."""
        moved = self.counts.x if axis == "x" else self.counts.y
        return self.compression.relative_scale_std(moved.moved_px)

    @property
    def _refocused(self) -> bool:
        """Whether the usual frame has another sharpness than the reference."""
        return any(_change(median.value) <= BLURRED for median in self._sharp)

    def _follow_frozen(self, frozen: float, found: PixelTranslation) -> None:
        """Follow what a codec left standing still: a share of the texture, in a frame with the target at `found`."""
        self._frozen_share += (frozen - self._frozen_share) / min(self._codec.frames, FROZEN_MEAN_FRAMES)
        self._lags = self._lags[0].after(found.x_px, frozen), self._lags[1].after(found.y_px, frozen)

    def _keep_sharpness(self, x: float, y: float) -> None:
        """Count the detail of a frame's target over the reference's, square and without noise, for the usual one.

        They tell of what a codec did, see `compression`.
        """
        if math.isfinite(x + y):
            for median, value in zip(self._sharp, (x, y), strict=True):
                median.push(value)

    def _place(self, shape: tuple[int, ...], found: PixelTranslation) -> Region:
        """The region moved by whole pixels, inside the image."""
        return clamp(shift(self._region, found.x_px, found.y_px), shape[1], shape[0])


def _cut(pixels: NDArray[np.generic], region: Region) -> NDArray[np.generic]:
    return pixels[region.y : region.y + region.height, region.x : region.x + region.width]


def _change(sharp: float) -> float:
    """A ratio of sharpness as a number up to 1, whichever of the two is the sharper; NaN where it is not known."""
    return min(sharp, 1.0 / max(sharp, 1e-3))


def _blur_factor(sharp: float) -> float:
    """Factor of the variance for detail of `sharp` times the reference's; 1 where that is not known."""
    change = _change(sharp)
    return BLURRED / max(change, 1e-3) if change < BLURRED else 1.0
