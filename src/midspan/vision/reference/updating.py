"""Reference frames that follow the light: a tracker whose reference is replaced when too few matches are left.

J. Choi, Z. Ma, K. Kim, H. Sohn, "Continuous Structural Displacement Monitoring Using Accelerometer, Vision, and
Infrared (IR) Cameras", Sensors 23 (2023) 5241, doi 10.3390/s23115241, section 2.2.2, equations 10 to 14.
As printed the threshold is the mean number of matches less three standard deviations. Where matches scatter by a third
of their mean or more that is zero or less, and the reference is never replaced; by default there is a floor and a
robust scale. `midspan.vision.reference.tracker` has another way that keeps its errors from adding up.
"""

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from midspan.checks import option, refuse
from midspan.errors import UsageError
from midspan.records import Event, Floats, Frame, PixelTranslation, Prediction, Region, Status
from midspan.vision.reference.records import relative
from midspan.vision.region import check_size, clamp, shift
from midspan.vision.tracker import TRACKERS, Tracker, open_tracker

SIGMA_OF_MEDIAN = 1.4826  # standard deviation over median deviation of a normal variable
PRINTED_SIGMAS = 3.0


@dataclass(frozen=True, slots=True)
class UpdatingSettings:
    """When a reference frame is replaced.

    tracker, tracker_settings: what tracks, its own settings. literal: exactly the published rule. threshold_frames: D,
    frames after a reference that its threshold is learnt from, 2 or more. average_frames: Q + 1, frames that the number
    of matches is averaged over, 1 or more. sigmas: standard deviations below the usual number; literal: 3.
    least_matches: floor of the threshold (of trackers without matches: quality in percent); ignored when literal.
    """

    tracker: str = "features"
    tracker_settings: Any = None
    literal: bool = False
    threshold_frames: int = 30
    average_frames: int = 10
    sigmas: float = 2.0
    least_matches: float = 10.0

    def __post_init__(self) -> None:
        option("tracker", self.tracker, TRACKERS)
        if self.threshold_frames < 2 or self.average_frames < 1:
            raise refuse(
                "threshold_frames, average_frames", "2 and 1 or more", (self.threshold_frames, self.average_frames)
            )
        if not (0.0 <= self.sigmas < math.inf and 0.0 <= self.least_matches < math.inf):
            raise refuse("sigmas, least_matches", "0 or more", (self.sigmas, self.least_matches))


def moving_average(matches: list[float], frames: int) -> float:
    """Mean number of matches of the last `frames` frames: equation 10 with Q = frames - 1."""
    return float(np.mean(matches[-frames:]))


def match_threshold(matches: list[float], settings: UpdatingSettings) -> float:
    """Number of matches (equations 12 and 14) below which a reference is replaced, from the first D after it."""
    values: Floats = np.asarray(matches[: settings.threshold_frames], dtype=np.float64)
    if settings.literal:
        return float(np.mean(values) - PRINTED_SIGMAS * np.std(values))
    middle = float(np.median(values))
    scale = SIGMA_OF_MEDIAN * float(np.median(np.abs(values - middle)))
    return max(middle - settings.sigmas * scale, settings.least_matches)


@dataclass(frozen=True, slots=True, eq=False)
class Reference:
    """A reference frame: its place in the first frame's pixels with variances (px, px²), its number among the frames,
    the matches since, and the threshold once it is known.
    """

    frame: Frame
    x_px: float = 0.0
    y_px: float = 0.0
    variance_x_px2: float = 0.0
    variance_y_px2: float = 0.0
    number: int = 0
    matches: tuple[float, ...] = ()
    threshold: float | None = None


@dataclass(frozen=True, slots=True, eq=False)
class UpdatingState:
    """What the tracker remembers: the reference in use, the first frame's threshold, the last frame that was tracked
    with its place, the number of frames so far and of updates, and the inner tracker's state.
    """

    current: Reference
    first_threshold: float | None = None
    last: Reference | None = None
    frames: int = 0
    updates: int = 0
    inner: Any = None


class UpdatingTracker(Tracker):
    """Follows a target through changing light; see `midspan.vision.tracker.Tracker` for its interface."""

    def __init__(self, reference: Frame, region: Region, settings: UpdatingSettings | None = None) -> None:
        self.settings = settings or UpdatingSettings()
        super().__init__(reference, region)
        self._first = open_tracker(self.settings.tracker, reference, region, self.settings.tracker_settings)
        self._tracker: Tracker = self._first
        self._at_rest = self._first.state
        self._state = UpdatingState(Reference(reference))
        self._events: list[Event] = []

    @property
    def region_now(self) -> Region:
        """Where the target was last seen, inside the image."""
        return self._tracker.region_now

    @property
    def state(self) -> UpdatingState:
        """Everything that changes from frame to frame."""
        state: UpdatingState = self._state
        return replace(state, inner=self._tracker.state)

    def restore(self, state: UpdatingState) -> None:
        """Continue from a `state` taken earlier."""
        self._state = state
        self._use(state.current)
        self._tracker.restore(state.inner if state.inner is not None else self._at_rest)

    def push(self, frame: Frame, prediction: Prediction | None = None) -> PixelTranslation:
        """Measure the translation (px) since the first frame in `frame`; the variance grows with each new reference."""
        check_size(frame, self.reference)
        state = self._state
        number = state.frames + 1
        found, matches = self._measure(self._tracker, frame, prediction, state.current)
        current = self._counted(state.current, matches)
        state = replace(state, current=current, frames=number)
        if current.number == 0 and current.threshold is not None:
            state = replace(state, first_threshold=current.threshold)
        self._state = state
        if self._too_few(current, number - current.number, matches):
            found = self._renewed(frame, prediction, found)
        if found.status is Status.TRACKING:
            variance = (
                found.variance_x_px2 + found.reference_variance_x_px2,
                found.variance_y_px2 + found.reference_variance_y_px2,
            )
            self._state = replace(self._state, last=Reference(frame, found.x_px, found.y_px, *variance, number=number))
        told, self._events = tuple(self._events), []
        return replace(found, events=told)

    def _measure(
        self, tracker: Tracker, frame: Frame, prediction: Prediction | None, since: Reference
    ) -> tuple[PixelTranslation, float]:
        """Translation since the first frame (equation 11; 13 where `since` is the first) and the number of matches."""
        found = tracker.push(frame, relative(prediction, since.x_px, since.y_px))
        matches = found.strength
        if found.status is not Status.TRACKING:
            return found, matches
        return replace(
            found,
            x_px=found.x_px + since.x_px,
            y_px=found.y_px + since.y_px,
            reference_variance_x_px2=since.variance_x_px2,
            reference_variance_y_px2=since.variance_y_px2,
        ), matches

    def _counted(self, current: Reference, matches: float) -> Reference:
        """The reference with one more number of matches; with the D-th its threshold is set (case 2)."""
        settings = self.settings
        kept = max(settings.threshold_frames, settings.average_frames)
        counts = (*current.matches, matches)[-kept:]
        threshold = current.threshold
        if threshold is None and len(counts) >= settings.threshold_frames:
            threshold = match_threshold(list(counts), settings)
        return replace(current, matches=counts, threshold=threshold)

    def _too_few(self, current: Reference, since: int, matches: float) -> bool:
        """Whether the reference is to be replaced; since: k, frames after the reference (case 3: k > D)."""
        settings = self.settings
        known = current.threshold if since > settings.threshold_frames else None
        if known is not None and moving_average(list(current.matches), settings.average_frames) <= known:
            return True
        # The published rule waits for D frames whatever happens; a target that is nearly lost cannot.
        return not settings.literal and matches < settings.least_matches

    def _renewed(self, frame: Frame, prediction: Prediction | None, found: PixelTranslation) -> PixelTranslation:
        """Back to the first frame where it matches again, else on from the last frame tracked (case 3)."""
        state = self._state
        if state.current.number != 0:
            self._first.restore(self._at_rest)
            here = prediction or self._guess()
            again, matches = self._measure(self._first, frame, here, Reference(self.reference))
            least = state.first_threshold
            if again.status is Status.TRACKING and least is not None and matches > least:
                self._tracker = self._first
                current = Reference(self.reference, matches=(matches,), threshold=least)
                self._state = replace(state, current=current, updates=state.updates + 1)
                self._events.append(Event(frame.time_ns, "reference", "back to the first frame"))
                return again
        last = state.last
        if last is None or last.number == state.current.number:
            return found
        before = self._tracker
        try:
            self._use(last)
        except UsageError:  # too little texture is left for a reference
            self._tracker = before
            return found
        renewed, matches = self._measure(self._tracker, frame, prediction or self._guess(), last)
        if renewed.status is not Status.TRACKING:
            self._tracker = before
            return found
        self._state = replace(state, current=self._counted(last, matches), updates=state.updates + 1)
        text = f"new reference frame, number {self._state.updates}: too few matches with the one in use"
        self._events.append(Event(frame.time_ns, "reference", text))
        return renewed

    def _guess(self) -> Prediction | None:
        """Where the target was last seen: what a tracker that is new to the frame starts from."""
        last = self._state.last
        reach = 0.1 * min(self.region.width, self.region.height)
        return None if last is None else Prediction(last.x_px, last.y_px, reach, reach)

    def _use(self, current: Reference) -> None:
        """Track from `current` on."""
        if current.number == 0:
            self._tracker = self._first
            return
        rows, columns = current.frame.pixels.shape
        region = clamp(shift(self.region, current.x_px, current.y_px), columns, rows)
        self._tracker = open_tracker(self.settings.tracker, current.frame, region, self.settings.tracker_settings)
