"""How well a target still resembles its reference frame: the number of good matches, or a tracker's quality."""

import math
from typing import Any

from midspan.records import Frame, PixelTranslation, Prediction, Region, Status
from midspan.vision.features import FeatureSettings, FeatureTracker, Matched
from midspan.vision.region import check_region
from midspan.vision.tracker import Tracker, open_tracker

FULL_QUALITY = 100.0  # what a quality of 1 counts, so that a least number of matches is a least percentage too


class CountingFeatures(FeatureTracker):
    """The feature tracker, which also says how many matches were good in the last frame."""

    matches: int = 0

    @property
    def strength(self) -> float:
        """Good matches in the last frame."""
        return float(self.matches)

    def _find(self, frame: Frame, prediction: Prediction | None) -> Matched | None:
        found = super()._find(frame, prediction)
        self.matches = 0 if found is None else found.good
        return found


def open_counting(name: str, reference: Frame, region: Region, settings: Any = None) -> Tracker:
    """The tracker `name` for the target in `region` of `reference`, as `open_tracker`; one of features counts."""
    if name == "features" and isinstance(settings, FeatureSettings | None) and reference.pixels.ndim == 2:
        rows, columns = reference.pixels.shape
        check_region(region, columns, rows)
        return CountingFeatures(reference, region, settings or FeatureSettings())
    return open_tracker(name, reference, region, settings)


def strength(tracker: Tracker, found: PixelTranslation) -> float:
    """Good matches of the last frame, or its quality in percent for trackers without matches; 0 where it is lost."""
    if found.status is not Status.TRACKING:
        return 0.0
    # As `isinstance(tracker, Counting)`, which takes as long as a small picture's sums.
    counted = getattr(tracker, "strength", None)
    return FULL_QUALITY * found.quality if counted is None else float(counted)


def relative(prediction: Prediction | None, x_px: float, y_px: float) -> Prediction | None:
    """A prediction counted from a frame that lies x, y px from the one it counts from now."""
    if prediction is None:
        return None
    return Prediction(prediction.x_px - x_px, prediction.y_px - y_px, prediction.std_x_px, prediction.std_y_px)


def share_lost(strength: float, usual: float) -> float:
    """Share (0 to 1) of its usual strength that a reference has lost."""
    return min(max(1.0 - strength / max(usual, 1e-9), 0.0), 1.0) if math.isfinite(strength) else 1.0
