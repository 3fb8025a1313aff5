"""Knowing when not to trust the picture: compression, blur and saturation, from the frames alone.

Most lossy codecs predict a picture from the one before, moved by quarters of a pixel, and leave out what differs
little. So a picture inherits a part of the one before: its noise, which in a raw recording is new in each frame, and
the rounding of its motion. The noise of the difference to the frame before, over the noise of the difference to a frame
long ago, is 1 in raw frames; what is missing from 1 is the inherited share. Codecs that take each picture by itself
show blocks that stand still while the target moves, and steps at the edges of blocks.

The constants that turn these into pixels were set on simulated frames through x264 and MJPEG (see docs/methods.md).
"""

import math
from dataclasses import dataclass, fields, replace
from operator import attrgetter

import numpy as np
from numba import njit
from numpy.typing import NDArray

from midspan.records import Floats, Frame, PixelTrack, PixelTranslation, Region, Status
from midspan.signals.growing import Columns
from midspan.vision.picture_difference import (
    REACH_PX,
    Difference,
    Sample,
    blockiness,
    detail,
    difference,
    frozen_texture,
    share_at_ends,
    stair_share,
)
from midspan.vision.region import clamp, shift

CHECK_FRAMES = 96  # one in so many frames is compared with earlier ones
FIRST_CHECKS = range(8, 48, 8)  # and these, so that short recordings are known too
LEAST_CHECKS = 2
SAMPLE_PX = 64  # side of the square that is compared
LEAST_SAMPLE_PX = 16
ROWS_LOOKED_AT = 32  # for the detail of each frame

# What chance makes of the inherited share in raw frames: over many checks, and more in a single one of a full square.
CHANCE_SHARE, CHANCE_SHARE_ONCE = 0.03, 0.045
# Motion rounded to quarters of a pixel errs by 0.072 px where nothing is added to the prediction. Of two predictions
# averaged, and of blocks predicted each on its own, this much is left for a picture whose noise is all inherited.
INHERITED_STD_PX = 0.032
MOST_COLOUR = 3.5
CLEAR_SHARE, CLEAR_COLOUR = 0.25, 1.4
CODED_ALONE = 0.1  # blockiness from which on pictures may be coded each by itself
STAIR_STD_PX = 0.4  # where nothing but flat blocks is left
ONLY_STAIRS = 3.0  # blockiness
STANDSTILL, STANDSTILL_STD_PX = 0.3, 0.06  # share of the texture that stands still, and what the encoder then withholds
MOST_FROZEN = 0.9
FROZEN_FRAMES_AROUND = 9
SCALE_LOSS = 0.6  # of the scale, for a codec's standard deviation as large as the motion's
BLURRED = 0.6  # of the reference's detail (square)
SATURATED_SHARE = 0.015
SATURATED_STD_PX = 0.025  # times the square root of the saturated over the other pixels


@dataclass(frozen=True, slots=True)
class PictureQuality:
    """One frame's picture of the target.

    frozen_share: share of the texture in blocks that are bit for bit those of the frame before, 0 to 1.
    detail_x, detail_y: mean square difference of pixels two apart; contrast: variance; both in grey levels squared,
    NaN where the target is lost. ends: share of the pixels at an end of the scale, 0 to 1.
    """

    frozen_share: float = 0.0
    detail_x: float = math.nan
    detail_y: float = math.nan
    contrast: float = math.nan
    ends: float = 0.0


# The columns of a watch's rows.
FROZEN, DETAIL_X, DETAIL_Y, CONTRAST, ENDS = range(5)
_numbers = attrgetter(*(field.name for field in fields(PictureQuality)))


@dataclass(frozen=True, slots=True)
class Check:
    """Noise of one frame in its difference to the frame before, to one at least eight frames ago, to the reference;
    its steps at the edges of blocks; the shares of it that are flat blocks and at the ends of the scale.

    soon: whether all of these are from the first seconds, in which light has hardly changed.
    """

    before: Difference
    earlier: Difference
    reference: Difference
    blockiness: float
    stairs: float
    ends: float
    soon: bool = False

    @property
    def inherited(self) -> tuple[float, float]:
        """Share of the picture inherited from the frame before, by the frame long ago and by the reference."""
        return _inherited(self.before, self.earlier), _inherited(self.before, self.reference)

    @property
    def colour(self) -> float:
        """Noise over all detail over that of the finest: 1 if it is white, more where a codec left the finest out."""
        return self.reference.broad / self.reference.fine if self.reference.fine > 0.0 else MOST_COLOUR


@dataclass(frozen=True, slots=True)
class Compression:
    """What a codec did to the frames so far: the share a picture inherits from the one before, the share of texture
    that stood still, and the standard deviation (px) of what that does to a translation; zeros for raw frames.
    """

    inherited_share: float = 0.0
    frozen_share: float = 0.0
    std_px: float = 0.0


class PictureWatch:
    """Looks at every frame that a tracker has measured, and widens its variances as far as the pictures ask for.

    `reference` and `region`: those of the tracker. `lossless`: that the frames come from a file which leaves nothing
    out; what they share with each other is then the scene's, not a codec's.
    """

    def __init__(self, reference: Frame, region: Region, *, lossless: bool = False) -> None:
        self.region = region
        self._lossless = lossless
        self._size = _sample_size(reference.pixels.shape, region)
        self._every = max(region.height // ROWS_LOOKED_AT, 1)
        cut = _cut(reference.pixels, region)
        self._zero = PictureQuality(0.0, *detail(cut, self._every))
        self._ends = share_at_ends(cut)
        # The fields of `PictureQuality`, a row a frame.
        self._rows = Columns("ddddd")
        self._checks: list[Check] = []
        self._before: tuple[Region, NDArray[np.generic]] | None = None
        self._moved, self._region_now = (0, 0), region
        self._reference = self._sample(reference.pixels, 0.0, 0.0)
        self._last, self._earlier = self._reference, self._reference

    def push(self, frame: Frame, translation: PixelTranslation) -> PictureQuality:
        """Look at `frame` with the target at `translation`; the first frame pushed is the reference."""
        index = len(self._rows)
        if translation.status == Status.LOST:
            quality, self._before, self._last = PictureQuality(), None, None
        else:
            quality = self._look(frame.pixels, translation)
            if _checked(index + 1):
                self._last = self._sample(frame.pixels, translation.x_px, translation.y_px)
            elif _checked(index):
                self._check(frame.pixels, self._sample(frame.pixels, translation.x_px, translation.y_px))
        self._rows.append(*_numbers(quality))
        return quality

    @property
    def compression(self) -> Compression:
        """What a codec did to the frames so far."""
        if self._lossless:
            return Compression()
        frozen = float(np.mean(self._rows.column(FROZEN))) if len(self._rows) else 0.0
        share, variance, blocky = 0.0, 0.0, 0.0
        if len(self._checks) >= LEAST_CHECKS:
            shares = np.median([check.inherited for check in self._checks], axis=0)
            blocky = float(np.median([check.blockiness for check in self._checks]))
            stairs = float(np.median([check.stairs for check in self._checks]))
            variance = (STAIR_STD_PX * stairs * min(max(blocky / ONLY_STAIRS, 0.0), 1.0)) ** 2
            colour = float(np.median([check.colour for check in self._checks]))
            # Against the reference alone: a change of light parts frames from it too, but leaves their noise white;
            # blur does not.
            clear = shares[1] > CLEAR_SHARE and colour > CLEAR_COLOUR and not self._changed_focus
            if (shares[0] > self._chance(self._checks) or clear) and self._soon_too:
                share = float(max(shares))
                variance += _inherited_std_px(share, colour, blocky) ** 2
        if share == 0.0 and frozen > STANDSTILL and blocky < CODED_ALONE:
            variance += STANDSTILL_STD_PX**2
        return Compression(share, frozen, math.sqrt(variance))

    def _chance(self, checks: list[Check]) -> float:
        """The share that chance makes of raw frames in as many checks."""
        return CHANCE_SHARE + CHANCE_SHARE_ONCE * SAMPLE_PX / self._size / math.sqrt(len(checks))

    @property
    def _soon_too(self) -> bool:
        """Whether frames inherit in the first checks as well: light that turns parts only those long after each other,
        whatever a codec does.
        """
        soon = [check for check in self._checks if check.soon]
        if len(soon) < LEAST_CHECKS:
            return True
        return float(np.max(np.median([check.inherited for check in soon], axis=0))) > self._chance(soon)

    @property
    def _changed_focus(self) -> bool:
        """Whether the usual frame has another sharpness than the reference."""
        sharp = self.sharpness
        known = sharp[np.isfinite(sharp).all(axis=1)]
        return len(known) > 0 and not np.all(_change(np.median(known, axis=0)) > BLURRED)

    @property
    def saturated_share(self) -> float:
        """Share of the region's pixels at the end of the scale, 0 to 1: the usual frame's or the reference's."""
        usual = float(np.median([check.ends for check in self._checks])) if self._checks else 0.0
        return max(usual, self._ends)

    @property
    def saturated(self) -> Floats:
        """For each frame (n,) the share of its or the reference's pixels at an end of the scale over the share of the
        others; 0 where there are next to none.
        """
        share = np.maximum(self._rows.column(ENDS), self._ends)
        return np.where(share > SATURATED_SHARE, share / np.maximum(1.0 - share, 0.02), 0.0)

    @property
    def sharpness(self) -> Floats:
        """Detail along x and y (n, 2) of each frame over the reference's, square and without noise; NaN where lost."""
        noise = float(np.median([check.reference.fine for check in self._checks])) ** 2 if self._checks else 0.0
        zero, rows = self._zero, self._rows
        found = np.full((len(rows), 2), np.nan)
        contrast = rows.column(CONTRAST)
        for axis, (column, zero_detail) in enumerate(((DETAIL_X, zero.detail_x), (DETAIL_Y, zero.detail_y))):
            # At most half is taken off: where nearly all is noise, what is left of it says nothing.
            now, then = (np.maximum(value - 2.0 * noise, 0.5 * value) for value in (rows.column(column), zero_detail))
            light, dark = (np.maximum(value - noise, 0.5 * value) for value in (contrast, zero.contrast))
            with np.errstate(divide="ignore", invalid="ignore"):
                found[:, axis] = (now / light) / (then / dark)
        return found

    def widened(self, track: PixelTrack) -> PixelTrack:
        """`track`, a row for each frame pushed, with its variances as large as these pictures allow."""
        added = self.compression.std_px**2 + SATURATED_STD_PX**2 * self.saturated
        frozen = self._rows.column(FROZEN)
        sharp = self.sharpness
        wide = []
        for axis, name in enumerate("xy"):
            value, variance = track.along(name)
            if frozen.any():
                variance = variance + _frozen_std_px(frozen, value) ** 2
            wide.append(variance * _blur_factor(sharp[:, axis]) + added)
        return replace(track, variance_x_px2=wide[0], variance_y_px2=wide[1])

    def relative_scale_std(self, value_px: Floats) -> float:
        """Relative standard deviation that compression adds to a scale factor learnt on the translation (n,) in px."""
        known = value_px[np.isfinite(value_px)]
        moved = float(np.std(known)) if len(known) else 0.0
        std_px = self.compression.std_px
        return min(SCALE_LOSS * std_px / moved, 1.0) if moved > 0.0 and std_px > 0.0 else 0.0

    def _look(self, pixels: NDArray[np.generic], translation: PixelTranslation) -> PictureQuality:
        """Frozen blocks where the target was in the frame before, and detail where it is now."""
        share = 0.0
        if self._before is not None and not self._lossless:
            then, cut = self._before
            frozen, whole = frozen_texture(_cut(pixels, then), cut, then.x, then.y)
            share = frozen / whole if whole > 0.0 else 0.0
        place = self._place(pixels.shape, round(translation.x_px), round(translation.y_px))
        now = _cut(pixels, place).copy()
        self._before = place, now
        return PictureQuality(share, *detail(now, self._every), share_at_ends(now))

    def _place(self, shape: tuple[int, ...], x_px: int, y_px: int) -> Region:
        """The region moved by whole pixels, inside the image; most frames need no other than the one before."""
        if (x_px, y_px) != self._moved:
            self._moved = x_px, y_px
            self._region_now = clamp(shift(self.region, x_px, y_px), shape[1], shape[0])
        return self._region_now

    def _check(self, pixels: NDArray[np.generic], sample: Sample | None) -> None:
        """Compare the square of a frame with those of the frame before, of the last check and of the reference."""
        last, earlier, reference = self._last, self._earlier, self._reference
        if sample is not None and last is not None and earlier is not None and reference is not None and self._before:
            place, cut = self._before
            # A frozen picture tells nothing of the codec; it is told of as such.
            if np.array_equal(sample.pixels, last.pixels):
                return
            check = Check(
                before=difference(sample, last),
                earlier=difference(sample, earlier),
                reference=difference(sample, reference),
                blockiness=blockiness(cut, place.x, place.y),
                stairs=stair_share(cut, place.x, place.y),
                ends=share_at_ends(cut),
                soon=len(self._rows) in FIRST_CHECKS,
            )
            self._checks.append(check)
        self._earlier = sample or self._earlier

    def _sample(self, pixels: NDArray[np.generic], x_px: float, y_px: float) -> Sample | None:
        """The square about the target's middle; None where it leaves the image or a pixel has no value."""
        if self._size < LEAST_SAMPLE_PX:
            return None
        n = self._size + 2 * REACH_PX
        dx, dy = round(x_px), round(y_px)
        left = self.region.x + dx + (self.region.width - n) // 2
        top = self.region.y + dy + (self.region.height - n) // 2
        if left < 0 or top < 0 or left + n > pixels.shape[1] or top + n > pixels.shape[0]:
            return None
        square = np.ascontiguousarray(pixels[top : top + n, left : left + n], dtype=np.float32)
        return Sample(square, (x_px - dx, y_px - dy)) if np.isfinite(square).all() else None


def _checked(index: int) -> bool:
    return index in FIRST_CHECKS or (index > 0 and index % CHECK_FRAMES == 0)


def _cut(pixels: NDArray[np.generic], region: Region) -> NDArray[np.generic]:
    return pixels[region.y : region.y + region.height, region.x : region.x + region.width]


def _sample_size(shape: tuple[int, ...], region: Region) -> int:
    """Side (px) of the square that is compared: with what the spline reaches for it lies inside the image."""
    x, y = region.x + region.width // 2, region.y + region.height // 2
    room = min(x, y, shape[1] - x, shape[0] - y)
    return min(SAMPLE_PX, region.width, region.height, 2 * (room - REACH_PX - 2))


def _inherited(before: Difference, then: Difference) -> float:
    """What is missing from 1 in the ratio of the noise, in the finest or in all detail, whichever is less."""
    fine = before.fine / then.fine if then.fine > 0.0 else 1.0
    broad = before.broad / then.broad if then.broad > 0.0 else 1.0
    return 1.0 - min(max(fine, broad), 1.0)


def _inherited_std_px(share: float, colour: float, blocky: float) -> float:
    """Standard deviation (px) for an inherited share, 0 to 1, of noise of such a colour in such blocks."""
    # Where little is inherited, the codec left out the finest detail, but not because it predicted.
    coarse = min(max(colour, 1.0), 1.0 + 5.0 * share, MOST_COLOUR)
    # Steps at the edges of blocks show pictures coded each by itself: what seems inherited there is only at rest.
    alone = min(max(2.0 * blocky / share - 0.5, 0.0), 1.0)
    return INHERITED_STD_PX * share * coarse / (1.0 + 3.0 * alone)


def _change(sharp: Floats) -> Floats:
    """A ratio of sharpness as a number up to 1, whichever of the two is the sharper."""
    return np.asarray(np.fmin(sharp, 1.0 / np.maximum(sharp, 1e-3)), dtype=np.float64)


def _blur_factor(sharp: Floats) -> Floats:
    """Factor (n,) of the variance for detail of `sharp` (n,) times the reference's; 1 where that is not known."""
    change = _change(sharp)
    return np.asarray(np.where(change < BLURRED, BLURRED / np.maximum(change, 1e-3), 1.0), dtype=np.float64)


def _frozen_std_px(frozen: Floats, value_px: Floats) -> Floats:
    """Standard deviation (n,) for shares `frozen` (n,) of texture that stood still while the target moved.

    What stands still lags by its share of the step, and of the lag that it had: e = share · (e + step), with the rms
    of the steps around the frame.
    """
    step = np.nan_to_num(np.diff(value_px, prepend=value_px[:1]))
    window = np.ones(FROZEN_FRAMES_AROUND)
    counted = np.convolve(np.ones(len(step)), window, "same")
    return _lag(np.minimum(frozen, MOST_FROZEN), np.sqrt(np.convolve(step**2, window, "same") / counted))


@njit(cache=True)
def _lag(share: Floats, step: Floats) -> Floats:
    out = np.zeros(len(share))
    lag = 0.0
    for k in range(len(share)):
        lag = share[k] * (lag + step[k])
        out[k] = lag
    return out
