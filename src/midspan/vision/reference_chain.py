"""Where several reference frames lie, from translations between pairs of them: one Gaussian estimate of all.

Each link of a chain of references adds its error. A frame that is linked to several earlier ones, and a return to an
early one, give more links than frames; the least-squares solution of all links is kept up to date link by link.
"""

import math
from dataclasses import dataclass

import numpy as np

from midspan.records import Floats

UNKNOWN_PX2 = 1e8  # variance of a place before its first link
# A link that contradicts the others by more standard deviations than this is widened until it agrees.
CONSISTENT = 2.0


@dataclass(frozen=True, slots=True, eq=False)
class Link:
    """Translation (2,) in px from one frame to another, x and y, with variances (2,) in px²."""

    start: int
    end: int
    value: Floats
    variance: Floats


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

    def extended(self) -> "Chain":
        """With one more frame at an unknown place."""
        count = len(self)
        covariance = np.zeros((2, count + 1, count + 1))
        covariance[:, :count, :count] = self.covariance
        covariance[:, count, count] = UNKNOWN_PX2
        return Chain(np.vstack([self.place, np.zeros(2)]), covariance)

    def without(self, frame: int) -> "Chain":
        """Without a frame; what it told about the others stays."""
        covariance = np.delete(np.delete(self.covariance, frame, axis=1), frame, axis=2)
        return Chain(np.delete(self.place, frame, axis=0), covariance)

    def linked(self, link: Link) -> "Chain":
        """With one more link: the Kalman update of both places and of all that hang on them."""
        place, covariance = self.place.copy(), self.covariance.copy()
        for axis in range(2):
            p = covariance[axis]
            column = p[:, link.end] - p[:, link.start]
            innovation = link.value[axis] - (place[link.end, axis] - place[link.start, axis])
            predicted = float(column[link.end] - column[link.start])
            r = max(float(link.variance[axis]), (innovation / CONSISTENT) ** 2 - predicted)
            gain = column / (predicted + r)
            place[:, axis] += gain * innovation
            covariance[axis] = p - np.outer(gain, column)
        return Chain(place, covariance)


def first_chain() -> Chain:
    """The chain of the first frame alone."""
    return Chain(np.zeros((1, 2)), np.zeros((2, 1, 1)))


def mean_link(pairs: Floats, variances: Floats, floor_px: float) -> tuple[Floats, Floats]:
    """Mean (2,) and its variance (2,) of differences `pairs` (n, 2), px, of two trackers in n frames of both.

    variances (n, 2), px²: of each difference; floor_px: standard deviation that more frames do not take away.
    """
    weight = 1.0 / np.maximum(variances, 1e-12)
    mean = (weight * pairs).sum(axis=0) / weight.sum(axis=0)
    stated = 1.0 / weight.sum(axis=0)
    count = len(pairs)
    # Neighbouring frames err alike: their scatter counts as that of a third of them.
    scatter = ((pairs - mean) ** 2).sum(axis=0) / max(count - 1, 1) / max(count / 3.0, 1.0) if count > 1 else 0.0
    return mean, np.maximum(stated, scatter) + floor_px**2


def share_lost(strength: float, usual: float) -> float:
    """Share (0 to 1) of its usual strength that a reference has lost."""
    return min(max(1.0 - strength / max(usual, 1e-9), 0.0), 1.0) if math.isfinite(strength) else 1.0
