"""The camera's lens: translations of a target as an ideal pinhole camera would have shown them.

Nothing of a frame is resampled. Trackers work on the frames as they are; only the place of the target, the middle of
its region moved by the translation, goes through the lens model. The ideal camera has the same focal lengths and
principal point, so that one scale factor holds over the whole picture for targets at one distance.
"""

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from midspan import _core
from midspan.checks import ValueRange, finite, option, positive, refuse, within
from midspan.errors import UsageError
from midspan.notices import Notice
from midspan.records import Floats, Prediction, Region

# Numbers of coefficients that each model can have, as OpenCV orders them.
MODELS: dict[str, tuple[int, ...]] = {"pinhole": (4, 5, 8, 12), "fisheye": (4,)}
HALF_A_PIXEL = 0.5
COEFFICIENTS = 12
# Rays further from the axis than this are not given a place on a plane: 85°.
STEEPEST = math.tan(math.radians(85.0))
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

    def focal_px(self, axis: str) -> float:
        """The focal length along an image axis "x" or "y", px."""
        return float(self.matrix["xy".index(axis)])

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
            "Calibrate the lens in the recording mode (`midspan lens`); a lens model cannot be scaled, because modes "
            "crop and bin differently."
        )


def straight(places: Floats, lens: Lens) -> tuple[Floats, Floats]:
    """Places (n, 2) in px (x right, y down) as the frames show them, in the ideal pinhole picture.

    Returns places (n, 2) in px and derivatives (n, 2, 2) of them by the shown ones; NaN outside the frame or where the
    model is not unique (its radius no longer grows, or more than 85° from the axis).
    """
    places = np.atleast_2d(np.asarray(places, dtype=np.float64))
    inside = np.all((places >= -HALF_A_PIXEL) & (places <= np.array(lens.size) - HALF_A_PIXEL), axis=1)
    found, slopes = _model(lens).straight(np.where(inside[:, None], places, np.nan))
    return found, slopes.reshape(-1, 2, 2)


def bent(places: Floats, lens: Lens) -> tuple[Floats, Floats]:
    """Places (n, 2) in px of the ideal pinhole picture as the frames show them: the inverse of `straight`.

    Returns places (n, 2) in px and derivatives (n, 2, 2); NaN where the model is not unique.
    """
    found, slopes = _model(lens).shown(np.atleast_2d(np.asarray(places, dtype=np.float64)))
    return found, slopes.reshape(-1, 2, 2)


def check_lens(lens: Lens, region: Region, columns: int, rows: int) -> None:
    """UsageError unless the lens is for frames of `columns` by `rows` px and reaches the middle of `region` (px)."""
    check_size(lens, columns, rows)
    _middle(region, lens)


def shown_prediction(prediction: Prediction | None, region: Region, lens: Lens | None) -> Prediction | None:
    """A prediction in pixels of the ideal camera as the frames show it: the inverse of a translation in the core.

    None where the model does not reach. lens: None changes nothing.
    """
    if prediction is None or lens is None:
        return prediction
    middle, origin, _ = _middle(region, lens)
    place, slope = bent(origin + np.array([prediction.x_px, prediction.y_px]), lens)
    (x, y), ((xx, xy), (yx, yy)) = place[0] - middle, slope[0]
    if not math.isfinite(x + y):
        return None
    std_x = math.hypot(xx * prediction.std_x_px, xy * prediction.std_y_px)
    return Prediction(float(x), float(y), std_x, math.hypot(yx * prediction.std_x_px, yy * prediction.std_y_px))


def ideal_gain(gain: tuple[float, float], region: Region, lens: Lens | None) -> tuple[float, float]:
    """Translation by mean phase along x and y in px of the ideal camera by rad, at the region's middle.

    gain: the same in px of the frames, see `Tracker.phase_gain_px_per_rad`. lens: None changes nothing.
    """
    if lens is None:
        return gain
    slope = _middle(region, lens)[2]
    return float(slope[0, 0] * gain[0]), float(slope[1, 1] * gain[1])


def lens_warnings(region: Region, lens: Lens) -> list[Notice]:
    """What is worth reporting of a region under this lens: whether it lies where the board was never seen."""
    middle = _middle(region, lens)[0]
    distance = float(np.hypot(*(middle - np.array(lens.matrix[2:]))))
    if lens.covered_px is None or distance <= lens.covered_px:
        return []
    return [
        Notice(
            "lens",
            f"camera.lens: the region lies {distance:.0f} px from the principal point, but the board covered only up "
            f"to {lens.covered_px:.0f} px. The correction is extrapolated there. Calibrate the lens with pictures "
            "that show the board at the image edge.",
        )
    ]


@lru_cache(maxsize=64)
def _middle(region: Region, lens: Lens) -> tuple[Floats, Floats, Floats]:
    """The region's middle (2,) in px as shown and as ideal, and the derivatives (2, 2) there."""
    middle = np.array([region.x + 0.5 * (region.width - 1), region.y + 0.5 * (region.height - 1)])
    place, slope = straight(middle, lens)
    if not np.isfinite(place).all():
        raise UsageError(
            f"camera.roi has its centre at x={middle[0]:g}, y={middle[1]:g} px, where the lens model is not valid: "
            f"outside the frame ({lens.size[0]}x{lens.size[1]} px), or beyond the radius where it is unique. Choose a "
            "region nearer to the image centre, or calibrate the lens again with the board at the image edge."
        )
    return middle, place[0], slope[0]


def lens_of(lens: Lens | None) -> tuple[_core.LensModel, tuple[int, int]] | None:
    """A lens for the core, with the width and height in px of the frames that it is for."""
    return None if lens is None else (_model(lens), lens.size)


@lru_cache(maxsize=64)
def _model(lens: Lens) -> _core.LensModel:
    """The lens for the core: of every model twelve coefficients, filled up with zeros."""
    coefficients = np.zeros(COEFFICIENTS)
    coefficients[: len(lens.distortion)] = lens.distortion
    fisheye = lens.model == "fisheye"
    return _core.LensModel(lens.matrix, fisheye, coefficients.tolist(), radial_limit(coefficients, fisheye))


def radial_limit(k: Floats, fisheye: bool) -> float:
    """Largest distance of a ray from the axis (on the plane at 1) up to which the model's radius still grows.

    k: the twelve coefficients. Beyond it two rays fall on one place of the picture, so nothing can be said there.
    """
    if fisheye:
        # d(theta_d)/d(theta) as a polynomial in theta²
        slope = np.polynomial.Polynomial([1.0, 3.0 * k[0], 5.0 * k[1], 7.0 * k[2], 9.0 * k[3]])
        angle = math.sqrt(_first_root(slope))
        return min(math.tan(angle), STEEPEST) if angle < 0.5 * math.pi else STEEPEST
    # r N / D as functions of u = r²; its slope changes sign where (N + 2 u N') D = 2 u N D'
    above = np.polynomial.Polynomial([1.0, k[0], k[1], k[4]])
    below = np.polynomial.Polynomial([1.0, k[5], k[6], k[7]])
    twice = np.polynomial.Polynomial([0.0, 2.0])
    slope = (above + twice * above.deriv()) * below - twice * above * below.deriv()
    return min(math.sqrt(min(_first_root(slope), _first_root(below))), STEEPEST)


def _first_root(polynomial: "np.polynomial.Polynomial") -> float:
    roots = polynomial.trim().roots()
    real = roots[np.abs(roots.imag) < 1e-9 * (1.0 + np.abs(roots))].real
    positive = real[real > 0.0]
    return float(positive.min()) if positive.size else math.inf
