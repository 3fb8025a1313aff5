"""What a codec did to the frames: how much of each picture is inherited from the one before.

Most lossy codecs predict a picture from the one before, moved by quarters of a pixel, and leave out what differs
little. So a picture inherits a part of the one before: its noise, which in a raw recording is new in each frame, and
the rounding of its motion. The noise of the difference to the frame before, over the noise of the difference to a frame
long ago, is 1 in raw frames; what is missing from 1 is the inherited share. Codecs that take each picture by itself
show steps at the edges of blocks.

The constants that turn these into pixels were set on simulated frames through x264 and MJPEG (see docs/validation.md).
"""

import math
from dataclasses import dataclass, fields, replace
from operator import attrgetter

import numpy as np
from numpy.typing import NDArray

from midspan import _core
from midspan._core import CARDINAL_REACH_PX
from midspan.records import Frame, PixelTranslation, Region
from midspan.signals.running_median import RunningMedian
from midspan.vision.spline import Floats32

CHECK_FRAMES = 96  # one in so many frames is compared with earlier ones
FIRST_CHECKS, FIRST_FRAMES = 5, 8  # and one in so many until so many checks have told something
# Rounding to whole grey levels alone makes so much noise, 1/√12; a difference with less is of one picture with itself.
ROUNDING_NOISE = 0.29
LEAST_CHECKS = 2
CHECKS_KEPT = 64  # medians are taken over so many: a median of 64 is known to a sixth of one check's scatter
SAMPLE_PX = 64  # side of the square that is compared
LEAST_SAMPLE_PX = 16

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
SCALE_LOSS = 0.6  # of the scale, for a codec's standard deviation as large as the motion's


@dataclass(frozen=True, slots=True)
class Square:
    """A square of a picture about the target: `pixels` (n, n) and where the target lies in it beyond whole pixels.

    shift: (x, y) of -0.5 to 0.5 px.
    """

    pixels: Floats32
    shift: tuple[float, float]


@dataclass(frozen=True, slots=True)
class Difference:
    """Noise of one picture as the difference of two registered ones shows it, in grey levels.

    fine: in the finest detail, where cameras have most of their noise and codecs leave least of it; broad: over all
    detail. Without a codec the two are the same.
    """

    fine: float
    broad: float


def difference(now: Square, then: Square) -> Difference:
    """The noise (grey levels) of `now` against `then`, moved to the same place and brought to the same contrast."""
    return Difference(*_core.picture_noise_of(now.pixels, now.shift, then.pixels, then.shift))


@dataclass(frozen=True, slots=True)
class Check:
    """One frame compared with earlier ones, or the medians of several such comparisons.

    by_earlier, by_reference: share inherited from the frame before, 0 to 1, by a frame at least eight frames ago and by
    the reference. colour: noise over all detail over that of the finest: 1 if it is white, more where a codec left the
    finest out. noise: of the finest detail, grey levels. blockiness: steps at the edges of blocks; stairs, ends: shares
    of the picture that are flat blocks, and at the ends of the scale.
    """

    by_earlier: float = 0.0
    by_reference: float = 0.0
    colour: float = 1.0
    noise: float = 0.0
    blockiness: float = 0.0
    stairs: float = 0.0
    ends: float = 0.0

    @property
    def inherited(self) -> float:
        """The larger of the two shares."""
        return max(self.by_earlier, self.by_reference)


_numbers = attrgetter(*(field.name for field in fields(Check)))


@dataclass(frozen=True, slots=True, eq=False)
class Comparison:
    """A check under way; one difference is taken in each of the next frames, so that none bears the cost of all three.

    partners: what `sample` is still to be compared with; found: the differences so far, to the frame before, an earlier
    one and the reference.
    """

    sample: Square
    partners: tuple[Square, ...]
    found: tuple[Difference, ...]
    blockiness: float
    stairs: float
    ends: float

    def advanced(self) -> "Comparison":
        """With the next difference."""
        now = difference(self.sample, self.partners[0])
        return replace(self, partners=self.partners[1:], found=(*self.found, now))

    def check(self) -> Check | None:
        """What it shows once all differences are taken; None where the picture is hardly another than it was."""
        before, earlier, reference = self.found
        if min(earlier.broad, reference.broad) < ROUNDING_NOISE:
            return None
        colour = reference.broad / reference.fine if reference.fine > 0.0 else MOST_COLOUR
        shares = _inherited(before, earlier), _inherited(before, reference)
        return Check(*shares, colour, reference.fine, self.blockiness, self.stairs, self.ends)


@dataclass(frozen=True, slots=True, eq=False)
class CodecState:
    """What a `CodecWatch` remembers: samples of the frame before a check and of the last check, the check under way,
    and the numbers of the last and of the first checks, one tuple each.
    """

    frames: int
    last: Square | None
    earlier: Square | None
    under_way: Comparison | None
    checks: tuple[tuple[float, ...], ...]
    first_checks: tuple[tuple[float, ...], ...]


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


class CodecWatch:
    """Compares single frames of a target with earlier ones; medians over the last checks tell what a codec does.

    `reference` and `region`: those of the tracker.
    """

    def __init__(self, reference: Frame, region: Region) -> None:
        self._region = region
        self._size = _sample_size(reference.pixels.shape, region)
        self._reference = self._sample(reference.pixels, 0.0, 0.0)
        self.restore(CodecState(0, self._reference, self._reference, None, (), ()))

    @property
    def state(self) -> CodecState:
        """Everything that changes from frame to frame."""
        checks, first = (tuple(m.state for m in medians) for medians in (self._medians, self._first))
        return CodecState(self.frames, self._last, self._earlier, self._under_way, checks, first)

    def restore(self, state: CodecState) -> None:
        """Continue from a `state` taken earlier."""
        self.frames, self._last, self._earlier = state.frames, state.last, state.earlier
        self._under_way = state.under_way
        none: tuple[tuple[float, ...], ...] = ((),) * len(fields(Check))
        self._medians = [RunningMedian(CHECKS_KEPT, values) for values in state.checks or none]
        self._first = [RunningMedian(FIRST_CHECKS, values) for values in state.first_checks or none]
        self._take_medians()

    def push(self, pixels: NDArray[np.generic], translation: PixelTranslation, seen: Region) -> None:
        """Look at a frame with the target, which lies at `translation`, in the region `seen`."""
        index, self.frames = self.frames, self.frames + 1
        if self._due(index + 1):
            self._last = self._sample(pixels, translation.x_px, translation.y_px)
        elif self._due(index):
            self._begin(pixels, self._sample(pixels, translation.x_px, translation.y_px), seen)
        elif self._under_way is not None:
            self._go_on(self._under_way)

    def lost(self) -> None:
        """Take note of a frame that does not show the target."""
        self.frames, self._last = self.frames + 1, None

    def compression(self, frozen_share: float, *, refocused: bool) -> Compression:
        """What a codec did to the frames so far.

        frozen_share: of the texture that stood still, 0 to 1; refocused: whether the usual frame has another sharpness
        than the reference.
        """
        usual, share, variance = self.usual, 0.0, 0.0
        if self.checks >= LEAST_CHECKS:
            variance = (STAIR_STD_PX * usual.stairs * min(max(usual.blockiness / ONLY_STAIRS, 0.0), 1.0)) ** 2
            # Against the reference alone: a change of light parts frames from it too, but leaves their noise white;
            # blur does not.
            clear = usual.by_reference > CLEAR_SHARE and usual.colour > CLEAR_COLOUR and not refocused
            if (usual.by_earlier > self._chance(self.checks) or clear) and self._soon_too:
                share = usual.inherited
                variance += _inherited_std_px(share, usual.colour, usual.blockiness) ** 2
        if share == 0.0 and frozen_share > STANDSTILL and usual.blockiness < CODED_ALONE:
            variance += STANDSTILL_STD_PX**2
        return Compression(share, frozen_share, math.sqrt(variance))

    @property
    def checks(self) -> int:
        """How many checks the medians are taken over."""
        return len(self._medians[0].state)

    def _due(self, index: int) -> bool:
        """Whether the frame of this number is to be compared with earlier ones."""
        return index > 0 and index % self._every == 0

    def _chance(self, checks: int) -> float:
        """The share that chance makes of raw frames in as many checks."""
        return CHANCE_SHARE + CHANCE_SHARE_ONCE * SAMPLE_PX / self._size / math.sqrt(checks)

    def _begin(self, pixels: NDArray[np.generic], sample: Square | None, seen: Region) -> None:
        """Begin to compare the square of a frame with those of the frame before, the last check and the reference."""
        last, earlier, reference = self._last, self._earlier, self._reference
        if sample is not None and last is not None and earlier is not None and reference is not None:
            # A frozen picture tells nothing of the codec; it is told of as such.
            if np.array_equal(sample.pixels, last.pixels):
                return
            traces = _core.codec_traces(pixels, (seen.x, seen.y, seen.width, seen.height))
            self._under_way = Comparison(sample, (last, earlier, reference), (), *traces)
        self._earlier = sample or self._earlier

    def _go_on(self, under_way: Comparison) -> None:
        """Take the next difference of a check, and count it where it is the last one."""
        under_way = under_way.advanced()
        if under_way.partners:
            self._under_way = under_way
            return
        self._under_way, check = None, under_way.check()
        if check is None:
            return
        first = len(self._first[0].state) < FIRST_CHECKS
        for medians in (self._medians, self._first) if first else (self._medians,):
            for median, value in zip(medians, _numbers(check), strict=True):
                median.push(value)
        self._take_medians()

    def _take_medians(self) -> None:
        """Renew what only changes with a check: the usual one, and whether frames inherit in the first ones as well.

        Light that turns parts only those long after each other, whatever a codec does.
        """
        self.usual, first = (
            Check(*(m.value for m in medians)) if medians[0].state else Check()
            for medians in (self._medians, self._first)
        )
        soon = len(self._first[0].state)
        self._every = FIRST_FRAMES if soon < FIRST_CHECKS else CHECK_FRAMES
        self._soon_too = soon < LEAST_CHECKS or first.inherited > self._chance(soon)

    def _sample(self, pixels: NDArray[np.generic], x_px: float, y_px: float) -> Square | None:
        """The square about the target's middle; None where it leaves the image or a pixel has no value."""
        if self._size < LEAST_SAMPLE_PX:
            return None
        n = self._size + 2 * CARDINAL_REACH_PX
        dx, dy = round(x_px), round(y_px)
        left = self._region.x + dx + (self._region.width - n) // 2
        top = self._region.y + dy + (self._region.height - n) // 2
        if left < 0 or top < 0 or left + n > pixels.shape[1] or top + n > pixels.shape[0]:
            return None
        square = np.array(pixels[top : top + n, left : left + n], dtype=np.float32, order="C")
        return Square(square, (x_px - dx, y_px - dy)) if np.isfinite(square).all() else None


def _sample_size(shape: tuple[int, ...], region: Region) -> int:
    """Side (px) of the square that is compared: with what the spline reaches for it lies inside the image."""
    x, y = region.x + region.width // 2, region.y + region.height // 2
    room = min(x, y, shape[1] - x, shape[0] - y)
    return min(SAMPLE_PX, region.width, region.height, 2 * (room - CARDINAL_REACH_PX - 2))


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
