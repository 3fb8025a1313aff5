"""What the key-frame tracker keeps: key frames, where they lie, a hand-over, what one of them says of a frame."""

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from midspan.records import Floats, Frame, PixelTranslation, Region, Status
from midspan.vision.spline import Floats32
from midspan.vision.tracker import Tracker


@dataclass(slots=True)
class KeyFrame:
    """A key frame, the tracker that follows from it, and how strong it usually is; `picture`: the mean of the first
    frames after it, laid over each other, and how much farther on (2,) px it is to be read.
    """

    frame: Frame
    region: Region
    tracker: Tracker
    at_rest: Any
    strengths: list[float] = field(default_factory=list)
    picture: Floats32 | None = None
    offset: Floats = field(default_factory=lambda: np.zeros(2))

    @property
    def usual(self) -> float:
        """Median strength in the first frames after it, 0 while there are none."""
        return float(np.median(self.strengths)) if self.strengths else 0.0


@dataclass(slots=True)
class Overlap:
    """Frames that make the picture of the key frame `to`: how many so far, their windows; `new`: it is tracked beside
    the one in use, to take over from it, and `places` (2,) px are where each frame says that it lies.
    """

    to: int
    new: bool
    frames: int = 0
    windows: list[Floats32] = field(default_factory=list)
    places: list[Floats] = field(default_factory=list)


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
        """With one frame at another place (2,) px, known to a variance (2,) in px² by itself."""
        moved, covariance = self.place.copy(), self.covariance.copy()
        moved[frame] = place
        covariance[:, frame, :] = covariance[:, :, frame] = 0.0
        covariance[:, frame, frame] = variance
        return Chain(moved, covariance)


def first_chain() -> Chain:
    """The chain of the first frame alone."""
    return Chain(np.zeros((1, 2)), np.zeros((2, 1, 1)))


@dataclass(frozen=True, slots=True)
class Seen:
    """What one key frame says of a frame: its tracker's translation and strength."""

    found: PixelTranslation
    strength: float

    @property
    def place(self) -> Floats:
        """Translation (2,) from the key frame, px."""
        return np.array([self.found.x_px, self.found.y_px])

    @property
    def variance(self) -> Floats:
        """Variances (2,), px²."""
        return np.array([self.found.variance_x_px2, self.found.variance_y_px2])


def unmoved(frame: Frame) -> Seen:
    """What a key frame says of itself: no translation, without error."""
    return Seen(PixelTranslation(frame.time_ns, 0.0, 0.0, 0.0, 0.0, 1.0, Status.TRACKING), math.nan)
