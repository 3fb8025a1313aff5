"""What the key-frame tracker keeps: a key frame, a running comparison of several, what one of them says of a frame."""

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from midspan.records import Floats, Frame, PixelTranslation, Region, Status
from midspan.vision.tracker import Tracker


@dataclass(slots=True)
class KeyFrame:
    """A key frame, the tracker that follows from it, and how strong it usually is."""

    frame: Frame
    region: Region
    tracker: Tracker
    at_rest: Any
    strengths: list[float] = field(default_factory=list)

    @property
    def usual(self) -> float:
        """Median strength in the first frames after it, 0 while there are none."""
        return float(np.median(self.strengths)) if self.strengths else 0.0


@dataclass(slots=True)
class Overlap:
    """Frames that several key frames are tracked in: `to` (`new`: just made) is compared with the one in use
    and with `others`; `pairs` are differences (2,) in px with variances (2,) and the share of the
    strength that is lost, by the key frame compared with."""

    to: int
    others: tuple[int, ...]
    new: bool
    frames: int = 0
    pairs: dict[int, list[tuple[Floats, Floats, float]]] = field(default_factory=dict)


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
