"""The feature trackers as printed: rejection I and then II alone, and the technique of Yu and Zhang that they replaced.

Ma, Choi and Sohn, "Real-time structural displacement estimation by fusing asynchronous acceleration and computer
vision measurements", 2022, doi 10.1111/mice.12767, equations 15 to 17 and 27 to 30. Neither looks for the target
elsewhere, tells it from places that look like it, or refuses matches that scatter. Yu and Zhang, 2019, keep the region
where it is; pre-purification, a ratio test and RANSAC select the matches.
"""

import math

import numpy as np
from numpy.typing import NDArray

from midspan.records import Floats, Frame, Prediction, Region
from midspan.vision.features import FeatureSettings, FeatureTracker, Matched
from midspan.vision.region import shift
from midspan.vision.rejection import Mask, rejection_one, rejection_two


def printed_matches(
    first: Floats, now: Floats, settings: FeatureSettings, *, prediction: Prediction | None, rng: np.random.Generator
) -> NDArray[np.int64]:
    """Indices of the matches (n, 2), px, that rejection I and then, with a prediction, II keep."""
    epsilon_px = settings.epsilon_px
    kept = np.flatnonzero(rejection_one(first, now, epsilon_px, rng=rng, literal=True))
    return kept if prediction is None else kept[rejection_two((now - first)[kept], prediction, epsilon_px)]


def earlier_rules(first: Floats, now: Floats, settings: FeatureSettings, **_: object) -> NDArray[np.int64]:
    """Indices of the matches (n, 2), px, that pre-purification and RANSAC keep."""
    translation = now - first
    kept = np.flatnonzero(within_largest(translation, settings.max_displacement_px))
    return kept[consensus(translation[kept], settings.ransac_px)]


def within_largest(translation: Floats, largest_px: float) -> Mask:
    """Pre-purification: matches (n,) that moved at most `largest_px`, which must be known beforehand."""
    return np.asarray(np.hypot(*translation.T) <= largest_px)


def consensus(translation: Floats, tolerance_px: float) -> Mask:
    """The largest set of matches (n,) within `tolerance_px` of one match's translation.

    RANSAC for a translation: one match is a whole hypothesis, so every one is tried and nothing is drawn.
    """
    if len(translation) == 0:
        return np.zeros(0, dtype=bool)
    apart = np.hypot(*(translation[:, None] - translation[None]).transpose(2, 0, 1))
    votes = apart <= tolerance_px
    return np.asarray(votes[np.argmax(votes.sum(axis=1))])


class PrintedFeatureTracker(FeatureTracker):
    """The paper's own technique; see `midspan.vision.tracker.Tracker` for its interface."""

    _max_spread_px = math.inf
    _good = staticmethod(printed_matches)

    def _find(self, frame: Frame, prediction: Prediction | None) -> Matched | None:
        return self._match(frame, shift(self.region, *self._state.expected(frame.time_ns, prediction)), prediction)

    def _identified(self, frame: Frame, found: Matched, prediction: Prediction | None) -> Matched | None:
        return found


class EarlierFeatureTracker(PrintedFeatureTracker):
    """The technique "existing", whose region stays; see `midspan.vision.tracker.Tracker` for its interface."""

    _good = staticmethod(earlier_rules)

    @property
    def region_now(self) -> Region:
        """The region itself."""
        return self.region

    def _find(self, frame: Frame, prediction: Prediction | None) -> Matched | None:
        return self._match(frame, self.region, None)


def printed_features(reference: Frame, region: Region, settings: FeatureSettings) -> FeatureTracker:
    """The tracker of the technique that the settings name."""
    kind = EarlierFeatureTracker if settings.technique == "existing" else PrintedFeatureTracker
    return kind(reference, region, settings)
