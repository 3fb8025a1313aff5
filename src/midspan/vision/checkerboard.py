"""A camera's lens from pictures of a checkerboard: corners, fit, and whether the result can be trusted."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from midspan.checks import option, positive, refuse
from midspan.errors import UntrustedError
from midspan.notices import Notice
from midspan.records import Floats
from midspan.vision.lens import MODELS, Lens, bent, straight

MIN_BOARDS = 8
MANY_BOARDS = 15
# Root mean square distance between found and fitted corners, px.
REFUSED_RMS_PX = 1.0
WARNED_RMS_PX = 0.5
# Standard deviation of the focal length over the focal length: large when no board is tilted.
REFUSED_FOCAL = 0.02
WARNED_FOCAL = 0.005
# A view whose corners lie within this share of the picture's diagonal of another view's says nothing new.
SAME_VIEW = 0.02
# A view is left out when it fits this many times worse than the usual one and worse than half the refused rms.
WORSE = 3.0
# Half the side of the window that places a corner: this share of the distance to its neighbour, within limits in px.
WINDOW = 0.4
WINDOWS_PX = (2, 10)
# Coverage: cells of the picture along each side, the share of them with corners that is enough, and how far towards
# each corner of the picture (as a share of its distance from the middle) the boards should reach.
CELLS = 5
ENOUGH_CELLS = 0.6
ENOUGH_REACH = 0.7
QUADRANTS = ("upper left", "upper right", "lower left", "lower right")


@dataclass(frozen=True, slots=True)
class Board:
    """A checkerboard: inner corners along its width and height (one fewer than squares), side of a square in mm."""

    columns: int = 9
    rows: int = 6
    square_mm: float = 25.0

    def __post_init__(self) -> None:
        if min(self.columns, self.rows) < 3:
            remedy = "Count the corners where four squares meet, not the squares."
            raise refuse("board columns and rows", "3 or more inner corners", (self.columns, self.rows), remedy)
        positive("board square", self.square_mm, "mm")

    @property
    def points(self) -> Floats:
        """Corners (n, 3) in mm in the board's plane, row by row."""
        x, y = np.meshgrid(np.arange(self.columns), np.arange(self.rows))
        return np.asarray(self.square_mm * np.column_stack((x.ravel(), y.ravel(), np.zeros(x.size))), dtype=np.float64)


@dataclass(frozen=True, slots=True)
class LensFit:
    """A calibrated lens, and how well it is known.

    rms_px: root mean square distance between found and fitted corners; focal_std: relative standard deviation of the
    focal length; rim_std: relative standard deviation of the correction's local scale at the picture's corners (NaN
    where the model does not reach them); coverage: share of the picture's 5 × 5 cells with corners; reach: the share of
    the way to each corner of the picture (upper left, upper right, lower left, lower right) that the boards cover;
    corners, residuals: (views, n, 2) px; warnings: sentences.
    """

    lens: Lens
    rms_px: float
    focal_std: float
    rim_std: float
    coverage: float
    reach: tuple[float, ...]
    corners: Floats
    residuals: Floats
    warnings: tuple[Notice, ...]

    @property
    def boards(self) -> int:
        """How many views of the board were used."""
        return len(self.corners)


@dataclass(frozen=True, slots=True)
class _Views:
    """What is fitted: corners (views, n, 2) px of a board in pictures of one size, and the model."""

    corners: Floats
    board: Board
    size: tuple[int, int]
    model: str


@dataclass(frozen=True, slots=True)
class _Solution:
    """What the fit gives: matrix (4,), distortion, and for each view rotation and shift (6,)."""

    matrix: Floats
    distortion: Floats
    poses: Floats

    def lens(self, seen: _Views, covered_px: float | None = None) -> Lens:
        fx, fy, cx, cy = (float(value) for value in self.matrix)
        return Lens(seen.model, (fx, fy, cx, cy), tuple(float(k) for k in self.distortion), seen.size, covered_px)


def find_board(pixels: NDArray[Any], board: Board) -> Floats | None:
    """Inner corners (columns · rows, 2) in px of the board in a picture (rows, columns), None where it is not found.

    All corners must be seen. Found by OpenCV's sector-based detector, then placed by the gradients around each corner,
    in a window that does not reach its neighbours: 0.03 to 0.07 px rms on simulated pictures.
    """
    import cv2

    picture = _eight_bits(pixels)
    flags = cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_ACCURACY
    found, corners = cv2.findChessboardCornersSB(picture, (board.columns, board.rows), flags=flags)
    if not found:
        return None
    places = np.array(corners, dtype=np.float32).reshape(-1, 2)
    windows = np.clip((WINDOW * _spacing(places, board)).astype(int), *WINDOWS_PX)
    stop = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 50, 1e-4)
    for window in np.unique(windows):
        chosen = windows == window
        sides = (int(window), int(window))
        placed = np.asarray(cv2.cornerSubPix(picture, places[chosen][:, None].copy(), sides, (-1, -1), stop))[:, 0]
        # A corner that leaves its window has been drawn to another edge.
        stayed = np.hypot(*(placed - places[chosen]).T) < window
        places[chosen] = np.where(stayed[:, None], placed, places[chosen])
    return places.astype(np.float64)


def _spacing(places: NDArray[Any], board: Board) -> Floats:
    """Distance (n,) in px of each corner to its nearest neighbour along a row or column of the board."""
    grid = places.reshape(board.rows, board.columns, 2)
    across, down = (np.hypot(*np.moveaxis(np.diff(grid, axis=axis), -1, 0)) for axis in (1, 0))
    nearest = np.full(grid.shape[:2], np.inf)
    for part, steps in (
        (nearest[:, :-1], across),
        (nearest[:, 1:], across),
        (nearest[:-1], down),
        (nearest[1:], down),
    ):
        np.minimum(part, steps, out=part)
    return nearest.ravel()


def _eight_bits(pixels: NDArray[Any]) -> NDArray[np.uint8]:
    if pixels.dtype == np.uint8:
        return np.ascontiguousarray(pixels)
    low, high = np.percentile(pixels, (0.5, 99.5))
    scaled = (pixels.astype(np.float64) - low) * (255.0 / max(float(high - low), 1e-9))
    return np.ascontiguousarray(np.clip(np.rint(scaled), 0, 255).astype(np.uint8))


def is_new(corners: Floats, known: Sequence[Floats], size: tuple[int, int]) -> bool:
    """Whether a view (n, 2) differs from all those known by more than 2 % of the picture's diagonal on average."""
    least = SAME_VIEW * math.hypot(*size)
    # A board turned by half a turn has the same corners in the opposite order.
    return all(
        min(float(np.mean(np.hypot(*(corners - other).T))), float(np.mean(np.hypot(*(corners[::-1] - other).T))))
        > least
        for other in known
    )


def calibrate_lens(views: Sequence[Floats], board: Board, size: tuple[int, int], model: str = "pinhole") -> LensFit:
    """The lens from views (each (n, 2) px) of a board in pictures of `size` (width, height) px.

    Raises UntrustedError, with the reason, for fewer than 8 views, for views that do not fix the focal length, and for
    corners that do not fit by more than 1 px rms.
    """
    option("lens model", model, MODELS)
    seen = _Views(np.array(views, dtype=np.float64), board, size, model)
    _refuse_few(len(seen.corners), "")
    solution = _solve(seen)
    rms = np.sqrt(np.mean(np.sum(_residuals(solution, seen) ** 2, axis=2), axis=1))
    kept = rms <= max(WORSE * float(np.median(rms)), 0.5 * REFUSED_RMS_PX)
    if kept.all():
        return _judged(solution, seen, ())
    dropped = int(np.count_nonzero(~kept))
    left_out = f"{dropped} of {len(kept)} views of the board do not fit the others and are left out."
    seen = replace(seen, corners=seen.corners[kept])
    _refuse_few(len(seen.corners), f" that fit one another ({dropped} do not)")
    return _judged(_solve(seen), seen, (Notice("lens", left_out),))


def _judged(solution: _Solution, seen: _Views, warnings: tuple[Notice, ...]) -> LensFit:
    residuals = _residuals(solution, seen)
    rms = float(np.sqrt(np.mean(np.sum(residuals**2, axis=2))))
    _refuse_poor_fit(rms, seen.model)
    focal_std, rim_std = _deviations(solution, seen, residuals)
    _refuse_degenerate(focal_std)
    cells, reach, covered = _coverage(seen.corners.reshape(-1, 2), seen.size, solution.matrix[2:])
    fit = LensFit(
        lens=solution.lens(seen, covered),
        rms_px=rms,
        focal_std=focal_std,
        rim_std=rim_std,
        coverage=cells,
        reach=reach,
        corners=seen.corners,
        residuals=residuals,
        warnings=(),
    )
    return replace(fit, warnings=(*warnings, *_doubts(fit)))


def _refuse_few(count: int, why: str) -> None:
    if count < MIN_BOARDS:
        raise UntrustedError(
            f"Only {count} different views of the board were found{why}; at least {MIN_BOARDS} are needed, better "
            f"{MANY_BOARDS} to 30. Take more pictures with the whole board in them, tilted and moved between them. If "
            "it is in the pictures already, check --columns and --rows: they count inner corners, one fewer than "
            "squares."
        )


def _refuse_poor_fit(rms: float, model: str) -> None:
    if not rms <= REFUSED_RMS_PX:
        other = "fisheye" if model == "pinhole" else "pinhole"
        raise UntrustedError(
            f"The board's corners deviate from the model {model!r} by {rms:.2f} px rms; at most {REFUSED_RMS_PX:g} px "
            "is accepted. Use a flat board, sharp pictures with the stabiliser off, and one focus; or try --model "
            f"{other}."
        )


def _refuse_degenerate(focal_std: float) -> None:
    if not focal_std <= REFUSED_FOCAL:
        raise UntrustedError(
            f"The views do not determine the focal length (± {100 * focal_std:.2g} %; at most {100 * REFUSED_FOCAL:g} "
            "%): the board faces the camera in nearly all of them. Tilt it by 20 to 45° about both axes, also at the "
            "image edge."
        )


def _solve(seen: _Views) -> _Solution:
    """OpenCV's bundle adjustment; its failures are those of the views."""
    import cv2

    refused = f"No lens of the model {seen.model!r} fits these views. Tilt the board, and move it between them"
    try:
        if seen.model == "fisheye":
            points = [seen.board.points[None]] * len(seen.corners)
            stop = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 200, 1e-9)
            flags = _fisheye_flags()
            start = np.eye(3), np.zeros((4, 1))
            found = cv2.fisheye.calibrate(
                points, list(seen.corners[:, None]), seen.size, *start, flags=flags, criteria=stop
            )
        else:
            points = [seen.board.points.astype(np.float32)] * len(seen.corners)
            found = cv2.calibrateCamera(points, list(seen.corners.astype(np.float32)), seen.size, None, None)
    except cv2.error as error:
        raise UntrustedError(f"{refused} ({error.err}).") from None
    _, matrix, distortion, turns, shifts = found
    poses = np.array([np.concatenate((np.ravel(t), np.ravel(s))) for t, s in zip(turns, shifts, strict=True)])
    values = np.array([matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2]])
    if not (np.isfinite(values).all() and np.isfinite(poses).all() and values[:2].min() > 0.0):
        raise UntrustedError(f"{refused}.")
    return _Solution(values, np.asarray(distortion, dtype=np.float64).ravel(), poses)


def _fisheye_flags() -> int:
    """New poses in each round, no skew; the names moved between OpenCV 4 and 5."""
    import cv2

    names = ("CALIB_RECOMPUTE_EXTRINSIC", "CALIB_FIX_SKEW")
    return sum(int(getattr(cv2.fisheye, name, None) or getattr(cv2, name)) for name in names)


def _seen(lens: Lens, pose: Floats, points: Floats) -> Floats:
    """Where a board's points (n, 3) in mm appear (n, 2), px."""
    import cv2

    there = points @ cv2.Rodrigues(pose[:3])[0].T + pose[3:]
    fx, fy, cx, cy = lens.matrix
    with np.errstate(divide="ignore", invalid="ignore"):
        rays = np.where(there[:, 2:] > 0.0, there[:, :2] / there[:, 2:], np.nan)
    return bent(rays * (fx, fy) + (cx, cy), lens)[0]


def _residuals(solution: _Solution, seen: _Views) -> Floats:
    """Found minus fitted corners (views, n, 2), px; infinite where the model does not reach them."""
    lens, points = solution.lens(seen), seen.board.points
    off = seen.corners - np.array([_seen(lens, pose, points) for pose in solution.poses])
    return np.where(np.isfinite(off), off, np.inf)


def _deviations(solution: _Solution, seen: _Views, residuals: Floats) -> tuple[float, float]:
    """Relative standard deviations of the focal length and of the local scale at the picture's corners.

    From the curvature of the sum of squares, the poses of the boards eliminated view by view (Schur complement).
    """
    inner = np.concatenate((solution.matrix, solution.distortion))
    count, points = len(inner), seen.board.points

    def lens_of(values: Floats) -> Lens:
        return _Solution(values[:4], values[4:], solution.poses).lens(seen)

    information = np.zeros((count, count))
    for pose in solution.poses:
        both = np.concatenate((inner, pose))
        slope = _slope(lambda v: _seen(lens_of(v[:count]), v[count:], points).ravel(), both)
        of_lens, of_pose = slope[:, :count], slope[:, count:]
        share, *_ = np.linalg.lstsq(of_pose, of_lens, rcond=None)
        left = of_lens - of_pose @ share
        information += left.T @ left
    free = max(residuals.size - count - solution.poses.size, 1)
    variance = float(np.sum(residuals**2)) / free
    # Scaled to ones on the diagonal, since focal lengths and coefficients differ by many powers of ten.
    scale = 1.0 / np.sqrt(np.maximum(np.diag(information), 1e-300))
    covariance = variance * np.linalg.pinv(information * np.outer(scale, scale), rcond=1e-15) * np.outer(scale, scale)
    focal = float(np.sqrt(np.max(np.diag(covariance)[:2] / inner[:2] ** 2)))
    rim = _slope(lambda v: _rim_scale(lens_of(v)), inner) / _rim_scale(lens_of(inner))[:, None]
    variances = np.einsum("ri,ij,rj->r", rim, covariance, rim)
    return focal, float(np.sqrt(np.max(variances)))


def _rim_scale(lens: Lens) -> Floats:
    """Ideal pixels a pixel (4,) at the picture's corners: the root of the area that the correction spreads it over."""
    width, height = lens.size
    places = np.array([(0.0, 0.0), (width - 1.0, 0.0), (0.0, height - 1.0), (width - 1.0, height - 1.0)])
    slope = straight(places, lens)[1]
    scale: Floats = np.sqrt(slope[:, 0, 0] * slope[:, 1, 1] - slope[:, 0, 1] * slope[:, 1, 0])
    return scale


def _slope(function: Callable[[Floats], Floats], at: Floats) -> Floats:
    """Derivatives (m, n) of a function (n,) → (m,) by central differences."""
    columns = []
    for k in range(len(at)):
        step = 1e-6 * max(abs(float(at[k])), 0.1)
        up, down = at.copy(), at.copy()
        up[k] += step
        down[k] -= step
        columns.append((function(up) - function(down)) / (2.0 * step))
    return np.column_stack(columns)


def _coverage(places: Floats, size: tuple[int, int], centre: Floats) -> tuple[float, tuple[float, ...], float]:
    """Share of cells with corners, reach towards the picture's four corners, and the covered distance in px."""
    cell = np.clip((places + 0.5) / size * CELLS, 0, CELLS - 1e-9).astype(int)
    filled = len({(int(x), int(y)) for x, y in cell}) / CELLS**2
    middle = 0.5 * (np.array(size) - 1.0)
    away, left, above = places - middle, places[:, 0] < middle[0], places[:, 1] < middle[1]
    reach, covered = [], []
    for in_quadrant in (left & above, ~left & above, left & ~above, ~left & ~above):
        reach.append(float(np.max(np.hypot(*away[in_quadrant].T), initial=0.0)) / math.hypot(*middle))
        covered.append(float(np.max(np.hypot(*(places[in_quadrant] - centre).T), initial=0.0)))
    return filled, tuple(reach), min(covered)


def _doubts(fit: LensFit) -> list[Notice]:
    """What a user should know before relying on the lens."""
    found = []
    if fit.boards < MANY_BOARDS:
        found.append(
            Notice("lens", f"{fit.boards} views of the board; {MANY_BOARDS} to 30 make the result more certain.")
        )
    if fit.rms_px > WARNED_RMS_PX:
        found.append(
            Notice(
                "lens",
                f"The corners deviate from the model by {fit.rms_px:.2f} px rms (0.1 to 0.3 px is usual). Check that "
                "the board is flat, the pictures sharp and the stabiliser off.",
            )
        )
    if fit.focal_std > WARNED_FOCAL:
        found.append(
            Notice("lens", f"The focal length is uncertain by ± {100 * fit.focal_std:.2g} %. Tilt the board more.")
        )
    if fit.coverage < ENOUGH_CELLS:
        found.append(
            Notice(
                "lens",
                f"The boards cover {100 * fit.coverage:.0f} % of the picture; fill at least {100 * ENOUGH_CELLS:.0f} "
                "%.",
            )
        )
    missing = [name for name, reach in zip(QUADRANTS, fit.reach, strict=True) if reach < ENOUGH_REACH]
    if missing:
        found.append(
            Notice(
                "lens",
                f"The image edge is not covered ({', '.join(missing)}): the model is extrapolated there. Move the "
                "board into the corners of the image.",
            )
        )
    if not math.isfinite(fit.rim_std):
        found.append(Notice("lens", "The model is not valid in the image corners; regions there will be refused."))
    return found
