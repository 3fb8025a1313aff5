"""Feature tracker: the mean translation of matched features, mismatches rejected.

Ma, Choi and Sohn, "Real-time structural displacement estimation by fusing asynchronous acceleration and computer
vision measurements", 2022, doi 10.1111/mice.12767: the region follows the prediction in whole pixels (equations 27 and
28), features of both regions are matched, rejection I and II (15 to 17 and 29) keep the good ones, their mean counts
(30). With `literal`, and with the technique "existing" that the paper compares with, the tracker is that of
`midspan.papers.printed.features`.
"""

import math
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from midspan import _core
from midspan.checks import option, refuse
from midspan.errors import DataError, MidspanError, UsageError
from midspan.records import Floats, Floats32, Frame, PixelTranslation, Prediction, Region, Status
from midspan.vision.keypoints import DETECTORS, GRID_STD_PX, Detector, Keypoints, SurfSettings
from midspan.vision.region import check_size, shift
from midspan.vision.rejection import near_median, rejection_two, repeated_rejection_one
from midspan.vision.search import Span, coarse_factor, coarse_positions, coarse_span
from midspan.vision.target import MAX_DISTANCE_PX, Motion, lost
from midspan.vision.template import TemplateSettings, TemplateTracker
from midspan.vision.texture import check_texture, full_scale, noise_std, values
from midspan.vision.tracker import Tracker

TECHNIQUES = {
    "proposed": "region shifted by the prediction, rejection I and II",
    "existing": "fixed region, pre-purification, ratio test and RANSAC",
}
MARGIN_PX = 12  # image around the region that the features at its edge are described by
MIN_MATCHES = 3
MIN_FEATURES = 2 * MIN_MATCHES
MAX_SPREAD_PX = 2.0  # good matches of a rigid target that rolls less than 1 degree agree within this
AGREEMENT_PX = 1.0
# Ratio of the nearest to the second nearest descriptor: MATLAB's default, and that of Yu and Zhang.
LITERAL_RATIO, EXISTING_RATIO = 0.6, 0.65
WIDE_SHARE = 0.25  # a prediction no better than this share of the region's side needs a search


@dataclass(frozen=True, slots=True)
class FeatureSettings:
    """Settings of the feature tracker.

    technique: one of TECHNIQUES. detector: one of DETECTORS. literal: exactly the published steps; else the target is
    looked for elsewhere where few match, rejection II comes before I, I is paired anew while few matches pass, and what
    is far from the median translation is left out. Not the paper's in either: without a prediction, in a calibration,
    the region follows the last place, where a fixed one of the paper is as large as the motion asks; the features of
    a frame may lie `MARGIN_PX` outside it; they match mutually; and fewer than three matches count as lost, since they
    do not tell the variance of their mean.
    max_features: the strongest this many in the region, 10 to 5000; more is slower and a little quieter.
    threshold, threshold_dn2, octaves, upright: of SURF, see `midspan.vision.keypoints.SurfSettings`.
    ratio: the nearest descriptor's distance over the second nearest's that a match may have, above 0, up to 1; None:
    0.6 with `literal`, what MATLAB's matching has by default (the paper does not print its own), 0.65 with the
    technique "existing", any otherwise.
    epsilon_px: discretisation error of a coordinate in rejection I and II, above 0 to 5 px; more rejects less.
    search_px: how far the target is looked for when it is not near its last place and there is no prediction.
    seed: of the random pairing in rejection I; one seed gives the same result in every run.
    max_displacement_px, ransac_px: largest translation known beforehand, tolerance of RANSAC; only with the technique
    "existing".
    bias_floor_px: standard deviation added for what the scatter of the matches does not show, 0 px or more.
    """

    technique: str = "proposed"
    detector: str = "surf"
    literal: bool = False
    max_features: int = 300
    threshold: float = 0.002
    threshold_dn2: float = 0.0
    octaves: int = 3
    upright: bool = True
    epsilon_px: float = 0.5
    search_px: float = 48.0
    seed: int = 0
    max_displacement_px: float = 32.0
    ratio: float | None = None
    ransac_px: float = 5.0
    bias_floor_px: float = 0.001

    def __post_init__(self) -> None:
        option("technique", self.technique, TECHNIQUES)
        option("detector", self.detector, DETECTORS)
        for name, low, high, rule in _RANGES:
            value = getattr(self, name)
            if value is not None and not low <= value <= high:
                raise refuse(name, rule, value)

    @property
    def max_ratio(self) -> float | None:
        """Which ratio a match may have; None: any."""
        printed = EXISTING_RATIO if self.technique == "existing" else LITERAL_RATIO if self.literal else None
        return printed if self.ratio is None else self.ratio

    @property
    def as_printed(self) -> bool:
        """Whether the tracker is one of the paper's."""
        return self.literal or self.technique == "existing"


_RANGES = (
    ("max_features", 10, 5000, "from 10 to 5000"),
    ("threshold", 0.0, 1.0, "from 0 to 1"),
    ("threshold_dn2", 0.0, 1e9, "0 or more (squared grey levels)"),
    ("octaves", 1, 4, "from 1 to 4"),
    ("epsilon_px", 1e-3, 5.0, "from 0.001 to 5 px"),
    ("search_px", 3.0, MAX_DISTANCE_PX, "3 px or more"),
    ("seed", 0, 2**63, "0 or more"),
    ("max_displacement_px", 1e-3, MAX_DISTANCE_PX, "above 0 px"),
    ("ratio", 1e-3, 1.0, "above 0, up to 1"),
    ("ransac_px", 1e-3, 100.0, "above 0, up to 100 px"),
    ("bias_floor_px", 0.0, 10.0, "from 0 to 10 px"),
)


@dataclass(frozen=True, slots=True)
class Matched:
    """What the good matches of a frame say: mean translation and its variance (2,) in px and px², counts."""

    translation: Floats
    variance: Floats
    good: int
    all: int


def good_matches(
    first: Floats, now: Floats, settings: FeatureSettings, *, prediction: Prediction | None, rng: np.random.Generator
) -> NDArray[np.int64]:
    """Indices of the matches (n, 2), px, that rejection II, with a prediction, and I keep."""
    kept, epsilon = np.arange(len(first)), settings.epsilon_px
    if prediction is not None:
        kept = kept[rejection_two(now - first, prediction, epsilon)]
    kept = kept[repeated_rejection_one(first[kept], now[kept], epsilon, rng=rng)]
    return kept[near_median((now - first)[kept], AGREEMENT_PX)]


class FeatureTracker(Tracker):
    """Follows a target by its features; see `midspan.vision.tracker.Tracker` for its interface."""

    _state: Motion
    _max_spread_px = MAX_SPREAD_PX
    # Indices of the good ones among matches (n, 2), px.
    _good = staticmethod(good_matches)

    def __init__(self, reference: Frame, region: Region, settings: FeatureSettings) -> None:
        self.settings = settings
        super().__init__(reference, region)
        raw, self._offset = _target(reference.pixels, region)
        self._template = np.asarray(raw - raw.mean(), dtype=np.float32)
        self._factor = coarse_factor(self._template)
        self._detector = _detector(reference.pixels, region, settings, self._offset)
        self._features = self._reference_features()
        xy, descriptor, kind = self._features.xy, self._features.descriptor, self._features.kind
        self._matcher = _core.FeatureMatcher(xy, descriptor, kind, settings.max_ratio)
        self._state = Motion()

    @property
    def features(self) -> Keypoints:
        """The features of the region in the reference frame."""
        return self._features

    def push(self, frame: Frame, prediction: Prediction | None = None) -> PixelTranslation:
        """Measure the translation (px) of the target in `frame`; LOST with NaN when fewer than three matches agree."""
        check_size(frame, self.reference)
        if prediction is not None and not math.isfinite(prediction.x_px + prediction.y_px):
            prediction = None
        found = self._find(frame, prediction)
        if found is None:
            self._state = self._state.missed()
            return lost(frame.time_ns)
        found = self._identified(frame, found, prediction)
        if found is None:
            self._state = self._state.missed(confused=True)
            return lost(frame.time_ns)
        (x, y), (var_x, var_y) = found.translation.tolist(), found.variance.tolist()
        self._state = self._state.seen(frame.time_ns, (x, y))
        quality = found.good / found.all
        return PixelTranslation(frame.time_ns, x, y, var_x, var_y, quality, Status.TRACKING, strength=float(found.good))

    def _find(self, frame: Frame, prediction: Prediction | None) -> Matched | None:
        """Match where the target is expected; without success and a sharp prediction, where the picture looks alike."""
        expected = shift(self.region, *self._state.expected(frame.time_ns, prediction))
        found = self._match(frame, expected, prediction)
        if found is not None:
            return found
        reach = self._reach(prediction)
        if reach == 0.0:
            return None
        places = [self._match(frame, place, prediction) for place in self._alike(frame.pixels, expected, reach)]
        return max((p for p in places if p is not None), key=lambda p: p.good, default=None)

    @cached_property
    def _template_tracker(self) -> TemplateTracker | None:
        """What tells the target from places that look like it; None without room for it."""
        with suppress(MidspanError):
            return TemplateTracker(self.reference, self.region, TemplateSettings())
        return None

    def _identified(self, frame: Frame, found: Matched, prediction: Prediction | None) -> Matched | None:
        """The matches, those at the alternative that is the target, or None where that is not known."""
        if self._template_tracker is None:
            return found
        place = self._template_tracker.identified(frame, found.translation, prediction, self._state)
        if place is None or place is found.translation:
            return None if place is None else found
        return self._match(frame, shift(self.region, float(place[0]), float(place[1])), None)

    def _reach(self, prediction: Prediction | None) -> float:
        """How far (px) from the expected place to search; 0 when the prediction is sharp."""
        if prediction is None:
            return self.settings.search_px if self._state.lost_frames == 0 else MAX_DISTANCE_PX
        reach = 3.0 * max(prediction.std_x_px, prediction.std_y_px)
        wide = WIDE_SHARE * min(self.region.width, self.region.height)
        return min(reach, MAX_DISTANCE_PX) if reach > wide else 0.0

    def _alike(self, image: NDArray[np.generic], expected: Region, reach: float) -> list[Region]:
        """Up to three regions within `reach` px of the expected one whose decimated picture correlates best."""
        rows, columns = image.shape
        width, height = expected.width, expected.height
        place = (expected.x, expected.y)
        span = Span(0, columns - width, 0, rows - height).around(*place, math.ceil(reach), math.ceil(reach))
        if span.empty:
            return []
        span = coarse_span(span, *place, self._template.size, self._factor)
        found = coarse_positions(image, self._template, span, factor=self._factor, offset=self._offset)
        return [Region(x, y, width, height) for x, y in found]

    def _reference_features(self) -> Keypoints:
        """The strongest features inside the region; UsageError when there are too few to match."""
        region = self.region
        found = self._detect(self.reference.pixels, region)
        low, high = np.array([region.x, region.y]), np.array([region.x + region.width, region.y + region.height])
        inside = found.part(np.flatnonzero(np.all((found.xy >= low) & (found.xy < high), axis=1)))
        if len(inside) < MIN_FEATURES:
            raise UsageError(
                f"camera.roi must hold at least {MIN_FEATURES} features of the detector "
                f"{self.settings.detector!r}; {region} has {len(inside)}. Choose a larger or richer place, or the "
                "tracker 'template'."
            )
        return inside.part(np.arange(min(len(inside), self.settings.max_features)))

    def _detect(self, image: NDArray[np.generic], region: Region) -> Keypoints:
        """Features of the region and its margin, as far as they lie inside the image."""
        place = _with_margin(region, image.shape)
        if place is None:
            return Keypoints(np.empty((0, 2)), np.empty((0, 1), dtype=np.float32), np.empty(0, dtype=np.int8))
        return self._detector.detect(image, place, self._offset, self._most(place))

    def _most(self, place: tuple[int, int, int, int]) -> int:
        """How many features to keep of a part of the image."""
        share = place[2] * place[3] / (self.region.width * self.region.height)
        return math.ceil(self.settings.max_features * max(share, 1.0))

    def _matches(self, image: NDArray[np.generic], region: Region) -> tuple[Floats, Floats] | None:
        """Positions (n, 2) then and now of the features of the reference that match some of the region."""
        if self.settings.detector != "surf":
            now = self._detect(image, region)
            return self._matcher.among(now.xy, now.descriptor, now.kind)
        place = _with_margin(region, image.shape)
        if place is None:
            return None
        surf = replace(self._detector.settings, most=self._most(place))
        return self._matcher.in_image(image, place, self._offset, surf)

    def _match(self, frame: Frame, region: Region, prediction: Prediction | None) -> Matched | None:
        """The good matches between the reference and `region` of the frame; None when they are too few or disagree."""
        matches = self._matches(frame.pixels, region)
        if matches is None or len(matches[0]) < MIN_MATCHES:
            return None
        then, here = matches
        rng = np.random.default_rng((self.settings.seed, frame.time_ns % 2**63))
        good = self._good(then, here, self.settings, prediction=prediction, rng=rng)
        return average((here - then)[good], len(then), self.settings, self._max_spread_px)


def _with_margin(region: Region, shape: tuple[int, ...]) -> tuple[int, int, int, int] | None:
    """The part (x, y, width, height) of an image of this shape that is a region and its margin; None without room."""
    rows, columns = shape
    left, top = max(region.x - MARGIN_PX, 0), max(region.y - MARGIN_PX, 0)
    right = min(region.x + region.width + MARGIN_PX, columns)
    bottom = min(region.y + region.height + MARGIN_PX, rows)
    # A part this small has no room for three matches.
    return (left, top, right - left, bottom - top) if min(right - left, bottom - top) >= 12 else None


def average(
    good: Floats, matches: int, settings: FeatureSettings, max_spread_px: float = MAX_SPREAD_PX
) -> Matched | None:
    """Mean (equation 30) of the good translations (n, 2), px, out of this many matches, with the variance of the mean.

    None when fewer than three are good, or when they scatter by more than `max_spread_px`.
    """
    count = len(good)
    if count < MIN_MATCHES:
        return None
    scatter = np.sum((good - good.mean(axis=0)) ** 2, axis=0)
    spread = float(np.sqrt(np.max(scatter) / (count - 1)))
    if spread > max_spread_px:
        return None
    # Few matches tell their own scatter badly; Student's variance allows for it.
    floor = settings.bias_floor_px**2 + GRID_STD_PX.get(settings.detector, 0.0) ** 2
    variance = scatter / (count * max(count - 3, 1)) + floor
    return Matched(good.mean(axis=0), variance, count, matches)


def _target(image: NDArray[np.generic], region: Region) -> tuple[Floats32, float]:
    """The region's pixels less their mean, and that mean; UsageError when there is no texture to follow."""
    part = np.asarray(image[region.slices], dtype=np.float64)
    offset = float(np.mean(part[np.isfinite(part)])) if np.isfinite(part).any() else 0.0
    raw = values(part, offset)
    if raw is None:
        raise DataError(f"camera.roi: {region} holds pixels without a value in the first frame. Choose another region.")
    check_texture(raw, noise_std(raw.astype(np.float64)), full_scale(image), str(region))
    return raw, offset


def _detector(image: NDArray[np.generic], region: Region, settings: FeatureSettings, offset: float) -> Detector:
    """The detector, its grey scale that of 8 bit images, else twice the region's range in the reference frame."""
    part = np.asarray(image[region.slices], dtype=np.float64)
    # An occluder or a shadow raises the contrast of a frame, but must not raise the threshold for what is left.
    contrast = float(np.nanvar(part))
    surf = SurfSettings(
        settings.octaves,
        settings.threshold,
        settings.max_features,
        upright=settings.upright,
        contrast=contrast,
        least=settings.threshold_dn2,
    )
    if image.dtype == np.uint8:
        return Detector(settings.detector, surf, level=-offset)
    low, high = float(np.nanmin(part)) - offset, float(np.nanmax(part)) - offset
    return Detector(settings.detector, surf, level=low - 0.5 * (high - low), span=2.0 * (high - low))
