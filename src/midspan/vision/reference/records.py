"""A key frame, the places of all of them, and short functions of frames and translations."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from statistics import median
from typing import Any

import numpy as np

from midspan.records import Floats, Floats32, Frame, PixelTranslation, Prediction, Region, Status
from midspan.vision.reference.cover import ALL_SEEN, Cells
from midspan.vision.tracker import Tracker, open_tracker


@dataclass(frozen=True, slots=True, eq=False)
class KeyFrame:
    """A key frame with the target's region in it; `inner`: state of the tracker that follows from it; `contrast`: the
    target's standard deviation; `strengths`: the first ones after it; `picture`: the mean of the first frames after
    it, laid over each other, and how much farther on (2,) px it is to be read (`offset`); `hidden` (cells,): where
    something stood in front; `clear`: whether little of the contrast is noise.
    """

    frame: Frame
    region: Region
    inner: Any
    contrast: float
    strengths: tuple[float, ...] = ()
    picture: Floats32 | None = None
    offset: Floats = field(default_factory=lambda: np.zeros(2))
    hidden: Cells = field(default_factory=lambda: ALL_SEEN)
    clear: bool = True

    @property
    def usual(self) -> float:
        """Median strength in the first frames after it, 0 while there are none."""
        return median(self.strengths) if self.strengths else 0.0


@dataclass(frozen=True, slots=True, eq=False)
class Chain:
    """Places (frames, 2) in px from the first frame, which is exact; covariances (2, frames, frames) in px²."""

    place: Floats
    covariance: Floats

    def __len__(self) -> int:
        return len(self.place)

    def variance(self, frame: int) -> Floats:
        """Variances (2,) of a frame's place, px²."""
        return self.covariance[:, frame, frame].copy()

    def extended(self, place: Floats, variance: Floats) -> "Chain":
        """With one more frame at `place` (2,) px with its variance (2,) in px²."""
        count = len(self)
        covariance = np.zeros((2, count + 1, count + 1))
        covariance[:, :count, :count] = self.covariance
        covariance[:, count, count] = variance
        return Chain(np.vstack([self.place, place]), covariance)

    def without(self, frame: int) -> "Chain":
        """Without a frame."""
        covariance = np.delete(np.delete(self.covariance, frame, axis=1), frame, axis=2)
        return Chain(np.delete(self.place, frame, axis=0), covariance)

    def changed(self, frame: int, place: Floats, variance: Floats) -> "Chain":
        """With one frame at another place (2,) px, known to a variance (2,) in px² on its own."""
        moved, covariance = self.place.copy(), self.covariance.copy()
        moved[frame] = place
        covariance[:, frame, :] = covariance[:, :, frame] = 0.0
        covariance[:, frame, frame] = variance
        return Chain(moved, covariance)


def first_chain() -> Chain:
    """The chain of the first frame alone."""
    return Chain(np.zeros((1, 2)), np.zeros((2, 1, 1)))


def place_of(found: PixelTranslation) -> Floats:
    """Translation (2,), px."""
    return np.array([found.x_px, found.y_px])


def variance_of(found: PixelTranslation) -> Floats:
    """Variances (2,) with those of the reference's place, px²."""
    x, y = found.variance_x_px2 + found.reference_variance_x_px2, found.variance_y_px2 + found.reference_variance_y_px2
    return np.array([x, y])


def unmoved(frame: Frame) -> PixelTranslation:
    """What a key frame says of itself: no translation, without error, of no known strength."""
    return PixelTranslation(frame.time_ns, 0.0, 0.0, 0.0, 0.0, 1.0, Status.TRACKING, strength=math.nan)


def relative(prediction: Prediction | None, x_px: float, y_px: float) -> Prediction | None:
    """A prediction counted from a frame that lies x, y px from the one it counts from now."""
    if prediction is None:
        return None
    return Prediction(prediction.x_px - x_px, prediction.y_px - y_px, prediction.std_x_px, prediction.std_y_px)


def crowded(keys: Sequence[KeyFrame], used: int) -> int:
    """The key frame, not the first nor the one in use, whose neighbours in time are nearest to each other."""
    times = [key.frame.time_ns for key in keys]
    inner = [k for k in range(1, len(times)) if k != used]
    return min(inner, key=lambda k: times[min(k + 1, len(times) - 1)] - times[k - 1])


def nearest(number: int, keys: Sequence[KeyFrame], most: int) -> list[int]:
    """Up to `most` key frames besides one that show all of the target: those made next to it, and the first."""
    whole = [k for k, key in enumerate(keys) if k != number and not key.hidden.any()]
    others = sorted(whole, key=lambda k: (abs(k - number), -k))
    chosen = others[:most]
    return chosen if 0 in chosen or number == 0 else [*chosen[:-1], 0]


def clear_share(windows: Sequence[Floats32]) -> float:
    """Share of the windows' contrast, squared, that they have in common, 0 to 1; 1 where there are too few to tell."""
    if len(windows) < 2:
        return 1.0
    stack = np.stack(windows).astype(np.float64)
    stack -= stack.mean(axis=(1, 2), keepdims=True)
    own = float(np.mean(np.var(stack, axis=0, ddof=1)))
    whole = float(np.mean(stack**2))
    return 1.0 - own / whole if whole > 0.0 else 0.0


def contrast(frame: Frame, region: Region) -> float:
    """Standard deviation of the pixels of a region; 0 where there are none."""
    part = frame.pixels[region.slices]
    return float(np.nanstd(part.astype(np.float64))) if part.size else 0.0


def exchanged(frame: Frame) -> Frame:
    """A frame with bright and dark exchanged."""
    return Frame(frame.time_ns, -np.asarray(frame.pixels, dtype=np.float32), frame.index)


class InnerTrackers:
    """Trackers of one kind, one for each key frame."""

    def __init__(self, name: str, settings: Any) -> None:
        self._name, self._settings = name, settings
        self._open: list[tuple[Tracker, Any]] = []

    def key(self, frame: Frame, region: Region) -> KeyFrame:
        """A new key frame. Raises UsageError where too little texture is left for a reference."""
        tracker = open_tracker(self._name, frame, region, self._settings)
        self._open.append((tracker, tracker.state))
        return KeyFrame(frame, region, tracker.state, contrast(frame, region))

    def keep(self, keys: tuple[KeyFrame, ...]) -> None:
        """Close the trackers of all other key frames."""
        known = {id(key.frame) for key in keys}
        self._open = [one for one in self._open if id(one[0].reference) in known]

    def region_now(self, key: KeyFrame) -> Region:
        """Where the tracker of a key frame has last seen the target."""
        tracker = self._of(key)[0]
        tracker.restore(key.inner)
        return tracker.region_now

    def look(
        self, key: KeyFrame, frame: Frame, prediction: Prediction | None, *, afresh: bool
    ) -> tuple[PixelTranslation, Any]:
        """The translation since a key frame, and what its tracker then remembers.

        prediction: counts from the key frame. afresh: the tracker forgets what it had seen.
        """
        tracker, at_rest = self._of(key)
        tracker.restore(at_rest if afresh else key.inner)
        return tracker.push(frame, prediction), tracker.state

    def _of(self, key: KeyFrame) -> tuple[Tracker, Any]:
        """The tracker of a key frame, and its state at rest."""
        for tracker, at_rest in self._open:
            if tracker.reference is key.frame and tracker.region == key.region:
                return tracker, at_rest
        self.key(key.frame, key.region)
        return self._open[-1]
