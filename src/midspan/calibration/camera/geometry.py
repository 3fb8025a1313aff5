"""Where a camera's targets are: declared distances and focal length, and what the accelerometer says of them.

Errors of the distances 1/ρ and of the focal length f make the motion along an axis too large or too small, by a first
order that the pixels tell. The accelerometer tells by how much it is, to a tenth of a per cent: one equation that
sharpens f and all ρ together, or shows that what is declared cannot be.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from midspan.calibration.camera.disagreement import SAME_DISTANCE
from midspan.notices import Notice
from midspan.records import Floats
from midspan.vision.lens import Lens, straight
from midspan.vision.pose import Geometry, inflation

# Relative standard deviations of a focal length, and of a distance of which none is given.
FOCAL_STD = 0.005
DISTANCE_STD = 0.01
# What a camera turns (rad/m) and moves (m/m) besides with its displacement, which the scale factors of targets apart
# from each other in the picture hold as well.
TURNS, MOVES = 0.1, 0.3
# A degree of freedom is seen where not knowing the other five makes it this many times as uncertain at most.
MAX_INFLATION = 20.0
# Distances differ for certain by this many standard deviations; what is farther off than the second contradicts.
CERTAIN, CONTRADICTS = 2.0, 4.0
DEGREES = ("translation x", "translation y", "translation z", "rotation x", "rotation y", "rotation z")


@dataclass(frozen=True, slots=True)
class Placed:
    """A target as declared and calibrated: the middle of its region in the frames, px; inverse_distance with its
    standard deviation, 1/m, None: unknown; px_per_m: by which it moves with the displacement, None: unknown.
    """

    name: str
    middle_px: tuple[float, float]
    inverse_distance: tuple[float, float] | None
    px_per_m: float | None


@dataclass(frozen=True, slots=True, eq=False)
class Surroundings:
    """What a camera sees: the targets' names and geometry, with the covariance (1 + k, 1 + k) of the logarithm of the
    focal length and the inverse distances.
    """

    names: tuple[str, ...]
    geometry: Geometry
    covariance: Floats

    def unseen(self, variance_px2: Floats) -> str:
        """Why not all six degrees are seen, and which target would show them; empty where they are.

        variance_px2 (k, 2): of each target in a frame.
        """
        count = len(self.names)
        if count < 3:
            there = " and ".join(self.names)
            return (
                f"{count} targets give {2 * count} equations for the six degrees. Add a camera.target away from the "
                f"line through {there}, and at another distance than theirs."
            )
        grown = inflation(self.geometry, variance_px2)
        hidden = [name for name, one in zip(DEGREES, grown, strict=True) if one > MAX_INFLATION]
        if not self._differ():
            return (
                "translation and rotation about x and y look alike in targets at one distance. Add a camera.target at "
                "a clearly different distance, best less than half or more than twice as far."
            )
        if hidden:
            return (
                f"{', '.join(hidden)} cannot be distinguished from the others with these targets, which lie on a line "
                "in space or nearly so. Add a camera.target away from that line."
            )
        return ""

    def _differ(self) -> bool:
        """Whether two distances differ for certain."""
        near, far = int(np.argmax(self.geometry.inverse_distance)), int(np.argmin(self.geometry.inverse_distance))
        by = self.geometry.inverse_distance[near] - self.geometry.inverse_distance[far]
        along = np.zeros(len(self.covariance))
        along[1 + near], along[1 + far] = 1.0, -1.0
        std = float(np.sqrt(along @ self.covariance @ along))
        return bool(by > max(CERTAIN * std, SAME_DISTANCE * self.geometry.inverse_distance[near]))

    def with_gain(self, gain: float, variance: float, slopes: Floats) -> "Surroundings | None":
        """The same after the accelerometer has shown the motion to be `gain` times as large as by this geometry; None
        where that cannot be.

        slopes (1 + k,): by how much the parameters change the motion, relative.
        """
        off, cross = gain - 1.0, self.covariance @ slopes
        total = float(slopes @ cross) + variance
        if off**2 > CONTRADICTS**2 * total:
            return None
        change = cross * off / total
        geometry = replace(
            self.geometry,
            focal_px=self.geometry.focal_px * np.exp(change[0]),
            inverse_distance=self.geometry.inverse_distance + change[1:],
        )
        return replace(self, geometry=geometry, covariance=self.covariance - np.outer(cross, cross) / total)


def surroundings(placed: Sequence[Placed], lens: Lens) -> Surroundings | None:
    """What is known before the camera's motion is looked at; None where no distance is declared.

    A distance that is not declared follows from how far its target moves compared with one that is.
    """
    focal_px, axis_px = np.array(lens.matrix[:2]), np.array(lens.matrix[2:])
    place_px = straight(np.array([one.middle_px for one in placed]), lens)[0] - axis_px
    declared = [k for k, one in enumerate(placed) if one.inverse_distance is not None]
    if not declared or any(one.inverse_distance is None and one.px_per_m is None for one in placed):
        return None
    inverse, anchors, own_std = _inverse_distances(placed, declared, place_px / focal_px, float(np.mean(focal_px)))
    if not np.all(inverse >= 0.0):
        return None
    # What an anchor errs by, those that follow from it err by.
    spread = np.zeros((len(placed), len(placed)))
    spread[np.arange(len(placed)), anchors] = own_std[anchors]
    covariance = np.zeros((1 + len(placed), 1 + len(placed)))
    covariance[0, 0] = FOCAL_STD**2
    more = np.where(anchors == np.arange(len(placed)), 0.0, own_std)
    covariance[1:, 1:] = spread @ spread.T + np.diag(more**2)
    geometry = Geometry(focal_px, place_px, inverse)
    return Surroundings(tuple(one.name for one in placed), geometry, covariance)


def _inverse_distances(
    placed: Sequence[Placed], declared: Sequence[int], place: Floats, focal_px: float
) -> tuple[Floats, np.ndarray[tuple[int], np.dtype[np.int64]], Floats]:
    """Inverse distances, the target that each rests on, and the standard deviation of its own or of the difference."""
    inverse, std, anchors = np.zeros(len(placed)), np.zeros(len(placed)), np.arange(len(placed))
    for k in declared:
        known = placed[k].inverse_distance
        assert known is not None
        inverse[k], std[k] = known[0], known[1] or DISTANCE_STD * known[0]
    moved = np.array([np.nan if one.px_per_m is None else one.px_per_m for one in placed]) / focal_px
    others = sorted(set(range(len(placed))) - set(declared))
    sign = _sign(inverse, moved, declared) if others else 1.0
    for k in others:
        anchor = min(
            (one for one in declared if np.isfinite(moved[one])), key=lambda one: std[one], default=declared[0]
        )
        inverse[k] = inverse[anchor] + sign * (moved[k] - moved[anchor])
        apart = float(np.linalg.norm(place[k] - place[anchor]))
        std[k] = np.hypot(TURNS * apart + MOVES * apart * abs(inverse[k]), DISTANCE_STD * abs(inverse[k]))
        anchors[k] = anchor
    return inverse, anchors, std


def _sign(inverse: Floats, moved: Floats, declared: Sequence[int]) -> float:
    """1 where a target moves the more towards positive pixels the nearer it is, else -1."""
    known = [k for k in declared if np.isfinite(moved[k])]
    if len(known) > 1 and np.ptp(inverse[known]) > SAME_DISTANCE * np.max(inverse[known]):
        near, far = max(known, key=lambda k: inverse[k]), min(known, key=lambda k: inverse[k])
        return 1.0 if moved[near] > moved[far] else -1.0
    # The nearest moves most, but for a tilt.
    return 1.0 if moved[int(np.nanargmax(np.abs(moved)))] > 0.0 else -1.0


def contradicted(names: Sequence[str], axis: str, gain: float) -> Notice:
    """That declared distances and focal length cannot be."""
    return Notice(
        "geometry-wrong",
        f"camera: by the declared distances and camera.lens it moves along {axis} by {gain**-1:.3g} times what the "
        f"accelerometer shows; they are wrong by more than their standard deviations, and the result has no columns "
        f"of its translation and rotation. Measure the distance of {', '.join(names)} again, or set distance_std_m.",
    )
