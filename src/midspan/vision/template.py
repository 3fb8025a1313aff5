"""Template tracker: zero-mean normalised cross-correlation with a spline peak.

After Ma, Liu, Choi and Sohn, "High-sampled structural displacement estimation through the FIR filter-based two-stage
fusion of high-sampled acceleration and temporally aliased low-sampled displacement measurements", equation 2.

Frame and template are filtered alike by a low-pass that keeps noise and aliasing near the Nyquist frequency from
pulling the peak to whole or half pixels. The whole-pixel peak is found on the ZNCC of every position in the search
window. Around it the template's quintic spline is moved over the frame's window: the numerator of ZNCC is then itself
a quintic spline of the shift, the template's energy a known function of it, and Newton's method climbs the surface.
"""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from midspan._core import Fix
from midspan.checks import refuse
from midspan.records import Floats, Frame, PixelTranslation, Prediction, Region, Status
from midspan.vision.alternatives import MIN_LIKENESS, Alternatives, find_alternatives, identified
from midspan.vision.matching import Matching, make_template
from midspan.vision.region import check_size
from midspan.vision.search import Span, coarse_positions, coarse_span
from midspan.vision.target import FULL_QUALITY, MAX_DISTANCE_PX, Motion, lost
from midspan.vision.tracker import Tracker

DIRECT_RADIUS_PX = 8  # up to here every position is tried, beyond it the search is decimated first
PATIENCE_FRAMES = 5  # lost frames after which a sharp prediction is no longer believed
NEXT_PX = 1.0  # a target that is found within this of its expected place is not taken for another
CLEARLY_BETTER = 0.02  # difference of correlation


@dataclass(frozen=True, slots=True)
class TemplateSettings:
    """Settings of the template tracker.

    literal: exactly the published steps, see `midspan.papers.printed.template`; smoothing_px and min_correlation are
    then not used, and search_px counts from the target's place in the first frame.
    smoothing_px: Gaussian smoothing of frame and template on top of the low-pass at the Nyquist frequency, 0 to 3 px;
    more suits aliased texture, less keeps fine texture.
    search_px: how far from its last place the target is looked for without a prediction, 3 px or more.
    min_correlation: share of the correlation that noise allows below which the target counts as lost, 0 to 1.
    bias_floor_px: standard deviation added for what the interpolation gets wrong, 0 px or more.
    """

    literal: bool = False
    smoothing_px: float = 0.0
    search_px: float = 48.0
    min_correlation: float = 0.6
    bias_floor_px: float = 0.0005

    def __post_init__(self) -> None:
        if not 0.0 <= self.smoothing_px <= 3.0:
            raise refuse("smoothing_px", "from 0 to 3 px", self.smoothing_px)
        if not 3.0 <= self.search_px <= MAX_DISTANCE_PX:
            raise refuse("search_px", "3 px or more", self.search_px)
        if not 0.0 < self.min_correlation < 1.0:
            raise refuse("min_correlation", "above 0 and below 1", self.min_correlation)
        if not 0.0 <= self.bias_floor_px < math.inf:
            raise refuse("bias_floor_px", "0 px or more", self.bias_floor_px)

    @property
    def as_printed(self) -> bool:
        """Whether the tracker is the paper's."""
        return self.literal


@dataclass(frozen=True, slots=True)
class TemplateState(Motion):
    """What the template tracker remembers besides: the usual correlation."""

    correlation: float = 1.0


class TemplateTracker(Tracker):
    """Follows a template through frames; see `midspan.vision.tracker.Tracker` for its interface."""

    _state: TemplateState

    def __init__(self, reference: Frame, region: Region, settings: TemplateSettings) -> None:
        self.settings = settings
        super().__init__(reference, region)
        self.template = make_template(
            reference.pixels, region, Matching(settings.smoothing_px, settings.min_correlation)
        )
        self._state = TemplateState(correlation=self.template.expected_correlation)

    @property
    def expected_correlation(self) -> float:
        """The correlation of a frame with the template that the noise of both allows, 0 to 1."""
        return self.template.expected_correlation

    def push(self, frame: Frame, prediction: Prediction | None = None) -> PixelTranslation:
        """Measure the translation (px) of the target in `frame`; LOST with NaN where it cannot be found."""
        check_size(frame, self.reference)
        fix = self._find(frame, prediction)
        if fix is None:
            return self._seen(frame, None)
        found = np.array([fix.x_px, fix.y_px])
        place = self.identified(frame, found, prediction, self._state)
        if place is not found:
            fix = None if place is None else self._around(frame.pixels, place)
        if fix is None:
            self._state = self._state.missed(confused=True)
            return lost(frame.time_ns)
        return self._seen(frame, fix)

    def _seen(self, frame: Frame, fix: Fix | None) -> PixelTranslation:
        """What the frame gives, with the state after it."""
        if fix is None:
            self._state = self._state.missed()
            return lost(frame.time_ns)
        floor_px2 = self.settings.bias_floor_px**2
        correlation = 0.9 * self._state.correlation + 0.1 * fix.quality
        self._state = self._state.seen(frame.time_ns, (fix.x_px, fix.y_px), correlation=correlation)
        return PixelTranslation(
            time_ns=frame.time_ns,
            x_px=fix.x_px,
            y_px=fix.y_px,
            variance_x_px2=fix.variance_x_px2 + floor_px2,
            variance_y_px2=fix.variance_y_px2 + floor_px2,
            quality=fix.quality,
            status=Status.TRACKING,
            strength=FULL_QUALITY * fix.quality,
        )

    def _find(self, frame: Frame, prediction: Prediction | None) -> Fix | None:
        """Look near the expected place, then farther away, and take the best acceptable peak."""
        place, radius = self._expected(frame.time_ns, prediction)
        image, near = frame.pixels, None
        if max(radius) <= DIRECT_RADIUS_PX:
            near = self.template.near(image, place, radius)
            if near is not None and (prediction is not None or self._as_good_as_before(near)):
                return near
        return self._far(image, place, self._reach(radius, prediction is not None), near)

    @cached_property
    def alternatives(self) -> Alternatives:
        """The places that look like the target in the reference frame."""
        template = self.template
        least = max(MIN_LIKENESS * template.expected_correlation, template.threshold)
        return find_alternatives(
            self.reference.pixels, template.window, template.pixels, offset=template.offset, least=least
        )

    def identified(self, frame: Frame, found: Floats, prediction: Prediction | None, state: Motion) -> Floats | None:
        """`found` (2,) px if it is the target, the place of the target if it is an alternative, None: not known.

        `state`: of the motion up to this frame. A target next to its expected place is not looked at; after a loss
        without a prediction, the last place says nothing of others than that.
        """
        expected = None if state.confused else state.extrapolated(frame.time_ns)
        if prediction is not None and math.isfinite(prediction.x_px + prediction.y_px):
            expected = prediction
        if expected is not None and math.hypot(found[0] - expected.x_px, found[1] - expected.y_px) <= NEXT_PX:
            return found
        if expected is not prediction and state.lost_frames > 0:
            expected = None

        def correlation(place: Floats) -> float:
            fix = self._around(frame.pixels, place)
            return 0.0 if fix is None else fix.quality

        return identified(self.alternatives, frame.pixels, found, expected, correlation)

    def _around(self, image: NDArray[np.generic], place: Floats) -> Fix | None:
        """The peak next to the target's `place` (2,) px, which is known to a decimated pixel."""
        window, step = self.template.window, self.template.factor + 2
        middle = window.x + round(float(place[0])), window.y + round(float(place[1]))
        return self.template.near(image, middle, (step, step))

    def _reach(self, radius: tuple[int, int], predicted: bool) -> float:
        """How far (px) the target is looked for when it is not near its expected place.

        A sharp prediction is believed for a few frames: behind an occluder a repeating pattern fits elsewhere too.
        """
        missed = self._state.lost_frames
        if predicted and max(radius) <= DIRECT_RADIUS_PX and missed < PATIENCE_FRAMES:
            return 2.0 * DIRECT_RADIUS_PX
        return max(self.settings.search_px, *radius) if missed == 0 else MAX_DISTANCE_PX

    def _expected(self, time_ns: int, prediction: Prediction | None) -> tuple[tuple[int, int], tuple[int, int]]:
        """Whole-pixel position of the window and the search radii: prediction ± (3 sigma + 2 px), at least 3 px."""
        window = self.template.window
        radii = [0, 0]
        if prediction is not None and math.isfinite(prediction.x_px + prediction.y_px):
            sigmas = (prediction.std_x_px, prediction.std_y_px)
            radii = [math.ceil(3.0 * s) + 2 if s < MAX_DISTANCE_PX else MAX_DISTANCE_PX for s in sigmas]
        x, y = self._state.expected(time_ns, prediction)
        return (window.x + round(x), window.y + round(y)), (max(radii[0], 3), max(radii[1], 3))

    def _as_good_as_before(self, fix: Fix) -> bool:
        return 1.0 - fix.quality <= 3.0 * (1.0 - self._state.correlation) + 0.01

    def _span(self) -> Span:
        """All positions where the window and the margin for smoothing lie inside the image."""
        rows, columns = self.reference.pixels.shape
        window, margin = self.template.window, len(self.template.taps) // 2
        return Span(margin, columns - window.width - margin, margin, rows - window.height - margin)

    def _far(self, image: NDArray[np.generic], place: tuple[int, int], reach: float, near: Fix | None) -> Fix | None:
        """The best of `near` and of the peaks of a decimated search up to `reach` px away."""
        template = self.template
        span = self._span().around(*place, math.ceil(reach), math.ceil(reach))
        if span.empty:
            return near
        span = coarse_span(span, *place, template.pixels.size, template.factor)
        step = template.factor // 2 + 2
        found = [near] if near is not None else []
        for position in coarse_positions(image, template.pixels, span, factor=template.factor, offset=template.offset):
            fix = template.near(image, position, (step, step))
            if fix is not None:
                found.append(fix)
        best = max(found, key=lambda f: f.quality, default=None)
        # Repeating texture gives nearly equal peaks: the one at the expected place is kept unless another is better.
        return near if near is not None and best is not None and best.quality - near.quality < CLEARLY_BETTER else best
