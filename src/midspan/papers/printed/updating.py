"""Reference frames that follow the light: a tracker whose reference is replaced when too few matches are left.

J. Choi, Z. Ma, K. Kim, H. Sohn, "Continuous Structural Displacement Monitoring Using Accelerometer, Vision, and
Infrared (IR) Cameras", Sensors 23 (2023) 5241, doi 10.3390/s23115241, section 2.2.2, equations 10 to 14.
As printed the threshold is the mean number of matches less three standard deviations. Where matches scatter by a third
of their mean or more that is zero or less, and the reference is never replaced; by default there is a floor and a
robust scale. `midspan.vision.reference.tracker` has another way that keeps its errors from adding up.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from midspan.checks import option, refuse
from midspan.errors import UsageError
from midspan.records import Event, Floats, Frame, PixelTranslation, Prediction, Region, Status
from midspan.signals.medians import SIGMA_OF_MEDIAN
from midspan.vision.reference.records import InnerTrackers, KeyFrame, place_of, relative, variance_of
from midspan.vision.region import check_size, clamp, shift
from midspan.vision.tracker import TRACKERS, Tracker, check_values

PRINTED_SIGMAS = 3.0


@dataclass(frozen=True, slots=True)
class UpdatingSettings:
    """When a reference frame is replaced.

    tracker, tracker_settings: what tracks, its own settings. literal: exactly the published rule. threshold_frames: D,
    frames after a reference that its threshold is estimated from, 2 or more. average_frames: Q + 1, frames that the
    number of matches is averaged over, 1 or more. sigmas: standard deviations below the usual number; literal: 3.
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


def updating_settings(tracker: str, tracker_settings: Any, values: Mapping[str, Any]) -> UpdatingSettings:
    """The rule for a tracker with `values` in place of its defaults; UsageError for an unknown one or another kind."""
    known = UpdatingSettings.__dataclass_fields__
    check_values("setting of the reference rule 'updating'", values, {key: known[key] for key in known if key in _OWN})
    return UpdatingSettings(tracker, tracker_settings, **values)


_OWN = ("literal", "threshold_frames", "average_frames", "sigmas", "least_matches")


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
    """A reference frame: its place (2,) in the first frame's pixels with variances (2,) (px, px²), its number among the
    frames, the matches since, and the threshold once it is known.
    """

    key: KeyFrame
    place: Floats
    variance: Floats
    number: int = 0
    matches: tuple[float, ...] = ()
    threshold: float | None = None

    def counted(self, matches: float, settings: UpdatingSettings) -> "Reference":
        """With one more number of matches; with the D-th its threshold is set (case 2)."""
        counts = (*self.matches, matches)[-max(settings.threshold_frames, settings.average_frames) :]
        threshold = self.threshold
        if threshold is None and len(counts) >= settings.threshold_frames:
            threshold = match_threshold(list(counts), settings)
        return replace(self, matches=counts, threshold=threshold)

    def too_few(self, since: int, settings: UpdatingSettings) -> bool:
        """Whether it is to be replaced; since: k, frames after it (case 3: k > D)."""
        known = self.threshold if since > settings.threshold_frames else None
        if known is not None and moving_average(list(self.matches), settings.average_frames) <= known:
            return True
        # The published rule waits for D frames whatever happens; a target that is nearly lost cannot.
        return not settings.literal and self.matches[-1] < settings.least_matches


@dataclass(frozen=True, slots=True, eq=False)
class UpdatingState:
    """What the tracker remembers: the first reference, with its threshold once known, and the one in use, the last
    frame that was tracked with its translation and number, the number of frames so far and of updates.
    """

    first: Reference
    current: Reference
    last: tuple[Frame, PixelTranslation, int] | None = None
    frames: int = 0
    updates: int = 0


class UpdatingTracker(Tracker):
    """Follows a target through changing light; see `midspan.vision.tracker.Tracker` for its interface."""

    _state: UpdatingState

    def __init__(self, reference: Frame, region: Region, settings: UpdatingSettings | None = None) -> None:
        super().__init__(reference, region)
        self.settings = settings or UpdatingSettings()
        self._inside = InnerTrackers(self.settings.tracker, self.settings.tracker_settings)
        first = Reference(self._inside.key(reference, region), np.zeros(2), np.zeros(2))
        self._state = UpdatingState(first, first)

    @property
    def region_now(self) -> Region:
        """Where the target was last seen, inside the image."""
        return self._inside.region_now(self._state.current.key)

    def restore(self, state: UpdatingState) -> None:
        """Continue from a `state` taken earlier."""
        self._state = state
        self._inside.keep((state.first.key, state.current.key))

    def push(self, frame: Frame, prediction: Prediction | None = None) -> PixelTranslation:
        """Measure the translation (px) since the first frame in `frame`; the variance grows with each new reference.

        Its events tell of new reference frames and of returns to the first.
        """
        check_size(frame, self.reference)
        state, number = self._state, self._state.frames + 1
        found, current = self._measured(state.current, frame, prediction)
        first = replace(state.first, threshold=current.threshold) if current.number == 0 else state.first
        self._state = state = replace(state, first=first, current=current, frames=number)
        if current.too_few(number - current.number, self.settings):
            found = self._renewed(frame, prediction) or found
        if found.status is Status.TRACKING:
            self._state = replace(self._state, last=(frame, found, number))
        return found

    def _measured(
        self, since: Reference, frame: Frame, prediction: Prediction | None, *, afresh: bool = False
    ) -> tuple[PixelTranslation, Reference]:
        """Translation since the first frame (equation 11; 13 where `since` is the first), and `since` after it."""
        x, y = (float(v) for v in since.place)
        found, inner = self._inside.look(since.key, frame, relative(prediction, x, y), afresh=afresh)
        since = replace(since, key=replace(since.key, inner=inner)).counted(found.strength, self.settings)
        if found.status is not Status.TRACKING:
            return found, since
        reference_x, reference_y = (float(v) for v in since.variance)
        return replace(
            found,
            x_px=found.x_px + x,
            y_px=found.y_px + y,
            reference_variance_x_px2=reference_x,
            reference_variance_y_px2=reference_y,
        ), since

    def _renewed(self, frame: Frame, prediction: Prediction | None) -> PixelTranslation | None:
        """Back to the first frame where it matches again, else on from the last frame tracked (case 3)."""
        state, here = self._state, prediction or self._guess()
        if state.current.number != 0:
            least = state.first.threshold
            found, first = self._measured(replace(state.first, matches=()), frame, here, afresh=True)
            if found.status is Status.TRACKING and least is not None and found.strength > least:
                return self._renewed_by(first, frame, found, "back to the first frame")
        if state.last is None or state.last[2] == state.current.number:
            return None
        try:
            last = self._reference_of(*state.last)
        except UsageError:  # too little texture is left for a reference
            return None
        found, current = self._measured(last, frame, here)
        if found.status is not Status.TRACKING:
            return None
        text = f"new reference frame, number {state.updates + 1}: too few matches with the one in use"
        return self._renewed_by(current, frame, found, text)

    def _renewed_by(self, current: Reference, frame: Frame, found: PixelTranslation, text: str) -> PixelTranslation:
        """Go on with another reference, and tell it with what it has `found`."""
        self._state = replace(self._state, current=current, updates=self._state.updates + 1)
        self._inside.keep((self._state.first.key, current.key))
        return replace(found, events=(Event(frame.time_ns, "reference", text),))

    def _reference_of(self, frame: Frame, found: PixelTranslation, number: int) -> Reference:
        """The frame in which the target was `found` as a reference."""
        rows, columns = frame.pixels.shape
        region = clamp(shift(self.region, found.x_px, found.y_px), columns, rows)
        return Reference(self._inside.key(frame, region), place_of(found), variance_of(found), number)

    def _guess(self) -> Prediction | None:
        """Where the target was last seen: what a tracker that is new to the frame starts from."""
        if self._state.last is None:
            return None
        found, reach = self._state.last[1], 0.1 * min(self.region.width, self.region.height)
        return Prediction(found.x_px, found.y_px, reach, reach)
