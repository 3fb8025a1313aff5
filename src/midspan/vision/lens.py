"""The camera's lens: translations of a target as an ideal pinhole camera would have shown them.

Nothing of a frame is resampled. Trackers work on the frames as they are; only the place of the target, the middle of
its region moved by the translation, goes through the lens model. The ideal camera has the same focal lengths and
principal point, so that one scale factor holds over the whole picture for targets at one distance.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np

from midspan.checks import ValueRange, finite, option, positive, refuse, within
from midspan.errors import UsageError
from midspan.records import Floats, Frame, PixelTrack, PixelTranslation, Prediction, Region, Status
from midspan.vision.tracker import Learner, PhaseGain, Tracker

# Numbers of coefficients that each model can have, as OpenCV orders them.
MODELS: dict[str, tuple[int, ...]] = {"pinhole": (4, 5, 8, 12), "fisheye": (4,)}
HALF_A_PIXEL = 0.5
# Beyond these a lens is no camera's: a thousand times the focal lengths and sizes of real ones.
MATRIX_PX, DISTORTION, MAX_SIZE_PX = ValueRange(-1e7, 1e7, "px"), ValueRange(-1e6, 1e6), 1_000_000


@dataclass(frozen=True, slots=True)
class Lens:
    """A camera's lens in OpenCV's models.

    model: "pinhole" or "fisheye". matrix: fx, fy, cx, cy in px (focal lengths above zero; the principal point counts
    from the middle of the first pixel). distortion: k1, k2, p1, p2[, k3[, k4, k5, k6[, s1, s2, s3, s4]]] of a pinhole,
    k1, k2, k3, k4 of a fisheye. size: width and height in px of the frames that it holds for. covered_px: distance from
    the principal point up to which the calibration saw its board; None: not known. Raises UsageError.
    """

    model: str
    matrix: tuple[float, float, float, float]
    distortion: tuple[float, ...]
    size: tuple[int, int]
    covered_px: float | None = None

    def __post_init__(self) -> None:
        option("lens model", self.model, MODELS)
        if len(self.matrix) != 4:
            raise refuse("lens matrix", "the four numbers fx, fy, cx, cy (px)", list(self.matrix))
        for value in finite("lens matrix", self.matrix):
            within("lens matrix", float(value), MATRIX_PX)
        positive("lens focal length", min(self.matrix[:2]), "px")
        counts = MODELS[self.model]
        if len(self.distortion) not in counts:
            rule = f"a list of {' or '.join(str(count) for count in counts)} numbers for the model {self.model!r}"
            raise refuse("lens distortion", rule, list(self.distortion), "Fill up with zeros where terms are missing.")
        for value in finite("lens distortion", self.distortion):
            within("lens distortion", float(value), DISTORTION)
        if self.covered_px is not None:
            positive("lens covered_px", self.covered_px, "px")
        if len(self.size) != 2 or min(self.size) < 1 or max(self.size) > MAX_SIZE_PX:
            raise refuse(
                "lens size", f"the width and height of the frames, from 1 to {MAX_SIZE_PX} px", list(self.size)
            )

    def to_dict(self) -> dict[str, Any]:
        """The lens as a tree of plain values."""
        return {
            "model": self.model,
            "matrix": list(self.matrix),
            "distortion": list(self.distortion),
            "size": list(self.size),
            "covered_px": self.covered_px,
        }

    @classmethod
    def from_dict(cls, tree: dict[str, Any]) -> "Lens":
        """The lens of such a tree. Raises KeyError, TypeError, ValueError or UsageError for anything else."""
        fx, fy, cx, cy = (float(value) for value in tree["matrix"])
        width, height = (int(value) for value in tree["size"])
        distortion, covered = tuple(float(value) for value in tree["distortion"]), tree.get("covered_px")
        known = None if covered is None else float(covered)
        return cls(str(tree["model"]), (fx, fy, cx, cy), distortion, (width, height), known)


def check_size(lens: Lens, columns: int, rows: int) -> None:
    """UsageError naming both sizes unless the lens belongs to frames of `columns` by `rows` px."""
    if lens.size != (columns, rows):
        raise UsageError(
            f"camera.lens is for frames of {lens.size[0]}x{lens.size[1]} px, but these have {columns}x{rows} px. "
            "Calibrate the lens in the mode that the recording was made in (`midspan lens`); a lens is never scaled, "
            "because cameras crop and bin differently from mode to mode."
        )


def straight(places: Floats, lens: Lens) -> tuple[Floats, Floats]:
    """Places (n, 2) in px (x right, y down) as the frames show them, in the ideal pinhole picture.

    Returns places (n, 2) in px and derivatives (n, 2, 2) of them by the shown ones; NaN outside the frame or where the
    model is not unique (its radius no longer grows, or more than 85° from the axis).
    """
    from midspan.vision.distortion import straightened

    places = np.atleast_2d(np.asarray(places, dtype=np.float64))
    inside = np.all((places >= -HALF_A_PIXEL) & (places <= np.array(lens.size) - HALF_A_PIXEL), axis=1)
    found = straightened(np.where(inside[:, None], places, np.nan), *_prepared(lens))
    return found[:, :2], found[:, 2:].reshape(-1, 2, 2)


def bent(places: Floats, lens: Lens) -> tuple[Floats, Floats]:
    """Places (n, 2) in px of the ideal pinhole picture as the frames show them: the inverse of `straight`.

    Returns places (n, 2) in px and derivatives (n, 2, 2); NaN where the model is not unique.
    """
    from midspan.vision.distortion import shown

    found = shown(np.atleast_2d(np.asarray(places, dtype=np.float64)), *_prepared(lens))
    return found[:, :2], found[:, 2:].reshape(-1, 2, 2)


def corrected(track: PixelTrack, region: Region, lens: Lens) -> PixelTrack:
    """The track (n rows) of the target in `region` (px of the reference frame) in pixels of the ideal pinhole camera.

    Translation = ideal place of the region's middle now − its ideal place in the reference frame. Variances pass
    through the derivatives, the errors along x and y taken as independent. Frames whose place the model does not reach
    are LOST. Raises UsageError where it does not even reach the region.
    """
    middle, origin, _ = _middle(region, lens)
    seen = np.column_stack((track.x_px, track.y_px))
    place, slope = straight(middle + seen, lens)
    found = place - origin
    with np.errstate(invalid="ignore"):
        variance = np.einsum("nij,nj->ni", slope**2, np.column_stack((track.variance_x_px2, track.variance_y_px2)))
    missed = ~np.isfinite(found).all(axis=1)
    variance[missed], found[missed] = np.nan, np.nan
    return replace(
        track,
        x_px=found[:, 0],
        y_px=found[:, 1],
        variance_x_px2=variance[:, 0],
        variance_y_px2=variance[:, 1],
        quality=np.where(missed, 0.0, track.quality),
        status=np.where(missed, np.uint8(Status.LOST), track.status),
    )


def seen_translation(track: PixelTrack, region: Region, lens: Lens) -> tuple[Floats, Floats]:
    """Translations x, y (n,) in px of the frames themselves, from a corrected track: the inverse of `corrected`."""
    middle, origin, _ = _middle(region, lens)
    place, _ = bent(origin + np.column_stack((track.x_px, track.y_px)), lens)
    return place[:, 0] - middle[0], place[:, 1] - middle[1]


def lens_warnings(region: Region, lens: Lens) -> list[str]:
    """What is worth telling of a region under this lens: whether it lies where the board was never seen."""
    middle = _middle(region, lens)[0]
    distance = float(np.hypot(*(middle - np.array(lens.matrix[2:]))))
    if lens.covered_px is None or distance <= lens.covered_px:
        return []
    return [
        f"camera.lens: the region lies {distance:.0f} px from the principal point, but the board was only seen up to "
        f"{lens.covered_px:.0f} px. The correction is extrapolated there. Calibrate the lens with pictures that show "
        "the board at the rim."
    ]


def through(tracker: Tracker, lens: Lens | None) -> Tracker:
    """The tracker as if the camera had no distortion: predictions and translations in pixels of the ideal camera.

    None leaves it as it is. Raises UsageError where the lens is for frames of another size, or does not reach the
    tracker's region.
    """
    if lens is None:
        return tracker
    if isinstance(tracker, PhaseGain):
        return LensPhaseTracker(tracker, lens)
    return LensLearner(tracker, lens) if isinstance(tracker, Learner) else LensTracker(tracker, lens)


def bare(tracker: Tracker) -> Tracker:
    """The tracker itself where it stands behind a lens, else what was given."""
    return tracker.tracker if isinstance(tracker, LensTracker) else tracker


def as_shown(tracker: Tracker, found: PixelTranslation) -> PixelTranslation:
    """What a tracker has just `found`, in pixels of the frame itself, whether or not it stands behind a lens."""
    return tracker.shown if isinstance(tracker, LensTracker) and tracker.shown is not None else found


class LensTracker:
    """A tracker behind a lens; `reference`, `region` and `region_now` stay those of the frames as they are.

    `shown` is what the tracker itself found last, in pixels of the frame.
    """

    def __init__(self, tracker: Tracker, lens: Lens) -> None:
        rows, columns = tracker.reference.pixels.shape
        check_size(lens, columns, rows)
        self.tracker, self.lens = tracker, lens
        self.shown: PixelTranslation | None = None
        self._middle, self._origin, self._slope = _middle(tracker.region, lens)

    @property
    def reference(self) -> Frame:
        """The frame that the translation counts from."""
        return self.tracker.reference

    @property
    def region(self) -> Region:
        """The target's region in the reference frame."""
        return self.tracker.region

    @property
    def region_now(self) -> Region:
        """Where the target was last seen in the frames."""
        return self.tracker.region_now

    @property
    def state(self) -> Any:
        """The state of the tracker itself."""
        return self.tracker.state

    def restore(self, state: Any) -> None:
        """Continue from a `state` taken earlier."""
        self.tracker.restore(state)

    def push(self, frame: Frame, prediction: Prediction | None = None) -> PixelTranslation:
        """Measure the translation in pixels of the ideal camera; LOST where the model does not reach the target."""
        self.shown = found = self.tracker.push(frame, None if prediction is None else self._expected(prediction))
        track = corrected(PixelTrack.stack([found]), self.region, self.lens)
        return PixelTranslation(
            time_ns=found.time_ns,
            x_px=float(track.x_px[0]),
            y_px=float(track.y_px[0]),
            variance_x_px2=float(track.variance_x_px2[0]),
            variance_y_px2=float(track.variance_y_px2[0]),
            quality=float(track.quality[0]),
            status=Status(int(track.status[0])),
        )

    def _expected(self, prediction: Prediction) -> Prediction | None:
        """A prediction of the ideal camera as the frames show it; None where the model does not reach."""
        place, slope = bent(self._origin + np.array([prediction.x_px, prediction.y_px]), self.lens)
        (x, y), ((xx, xy), (yx, yy)) = place[0] - self._middle, slope[0]
        if not math.isfinite(x + y):
            return None
        std_x = math.hypot(xx * prediction.std_x_px, xy * prediction.std_y_px)
        return Prediction(float(x), float(y), std_x, math.hypot(yx * prediction.std_x_px, yy * prediction.std_y_px))


class LensLearner(LensTracker):
    """A tracker behind a lens that knows its target better from frames in which it moves."""

    tracker: Any

    @property
    def frames_to_learn(self) -> int:
        """How many frames are worth learning from."""
        return int(self.tracker.frames_to_learn)

    def learn(self, frames: Sequence[Frame]) -> Any:
        """Let the tracker itself learn from frames, in the order of their times."""
        return self.tracker.learn(frames)


class LensPhaseTracker(LensLearner):
    """A tracker of phase behind a lens."""

    @property
    def phase_gain_px_per_rad(self) -> tuple[float, float]:
        """Translation by mean phase along x and y, px of the ideal camera by rad, at the region's middle."""
        x, y = self.tracker.phase_gain_px_per_rad
        return float(self._slope[0, 0] * x), float(self._slope[1, 1] * y)


def _middle(region: Region, lens: Lens) -> tuple[Floats, Floats, Floats]:
    """The region's middle (2,) in px as shown and as ideal, and the derivatives (2, 2) there."""
    middle = np.array([region.x + 0.5 * (region.width - 1), region.y + 0.5 * (region.height - 1)])
    place, slope = straight(middle, lens)
    if not np.isfinite(place).all():
        raise UsageError(
            f"camera.roi has its middle at x={middle[0]:g}, y={middle[1]:g} px, where the lens model does not hold: "
            f"outside the frame ({lens.size[0]}x{lens.size[1]} px), or beyond the radius up to which the model is "
            "unique. Choose a region nearer to the middle of the picture, or calibrate the lens again with the board "
            "at the rim."
        )
    return middle, place[0], slope[0]


@lru_cache(maxsize=64)
def _prepared(lens: Lens) -> tuple[Floats, bool, Floats, float]:
    """What the compiled functions take: matrix, whether it is a fisheye, twelve coefficients, the radial limit."""
    from midspan.vision.distortion import COEFFICIENTS, radial_limit

    coefficients = np.zeros(COEFFICIENTS)
    coefficients[: len(lens.distortion)] = lens.distortion
    fisheye = lens.model == "fisheye"
    return np.array(lens.matrix, dtype=np.float64), fisheye, coefficients, radial_limit(coefficients, fisheye)
