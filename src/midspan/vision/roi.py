"""Regions of interest: the choice of a target that can be tracked well and does not move on its own.

The camera moves with the structure, so that all fixed targets move alike in its image (more or less of it with their
distance); foliage, water, vehicles and people do not. Where to look is decided by the predicted standard deviation of
a shift, from the structure tensor and the noise; which of the best places to take by tracking them all for a while.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from midspan import _core
from midspan.checks import option, refuse
from midspan.errors import DataError, UsageError
from midspan.records import Floats, Frame, Region, Status
from midspan.vision.candidates import Candidate, rank_candidates, repeats, track_candidates
from midspan.vision.texture import gaussian_taps, noise_std, values

MIN_CHOICE_PX = 24
MAX_STD_PX = 0.25  # a place that predicts more than this for a single frame is not worth tracking
SMOOTHING_PX = 0.8
CROSS_SHARE = 0.1  # what the variance across the measured direction counts
CLIPPED_SHARE = 0.02  # more black or saturated pixels than this rule a place out


@dataclass(frozen=True, slots=True)
class Grid:
    """Predicted standard deviation (px) (rows, columns) of a region centred at centre_y and centre_x; NaN: ruled out.

    noise: standard deviation of the image's noise in its own unit.
    """

    std_px: Floats
    centre_x: NDArray[np.int64]
    centre_y: NDArray[np.int64]
    noise: float


@dataclass(frozen=True, slots=True)
class RoiSettings:
    """Settings of the choice of a region.

    direction: image axis of the measured motion, "x" or "y"; its standard deviation counts more.
    size_px: side of the region, 24 px or more; left out: 128 px in images of 640 px and more, 64 px down to 160 px,
    else 60 % of the image.
    margin_px: distance from the border that leaves room for the motion, 0 px or more; left out: 10 % of the side of the
    image, at least 16 px.
    candidates: how many places are tracked to see which are fixed, 1 to 30; more is safer and slower.
    regions: how many regions are chosen, up to `candidates`; they do not overlap.
    """

    direction: str = "y"
    size_px: int | None = None
    margin_px: int | None = None
    candidates: int = 10
    regions: int = 1

    def __post_init__(self) -> None:
        option("direction", self.direction, ("x", "y"))
        if self.size_px is not None and self.size_px < MIN_CHOICE_PX:
            raise refuse("size_px", f"{MIN_CHOICE_PX} px or more", self.size_px)
        if self.margin_px is not None and self.margin_px < 0:
            raise refuse("margin_px", "0 px or more", self.margin_px)
        if not 1 <= self.candidates <= 30:
            raise refuse("candidates", "from 1 to 30", self.candidates)
        if not 1 <= self.regions <= self.candidates:
            raise refuse("regions", "from 1 to the number of candidates", self.regions)


@dataclass(frozen=True, slots=True)
class RegionChoice:
    """The chosen regions, best first, why, and the map for the report.

    score_px: (grid rows, grid columns) predicted standard deviation (px) of a region centred there, NaN where it was
    ruled out; score_x and score_y: the centres' columns and rows (px). candidates: all that were tracked, best first.
    """

    regions: tuple[Region, ...]
    reasons: tuple[str, ...]
    score_px: Floats
    score_x: NDArray[np.int64]
    score_y: NDArray[np.int64]
    candidates: tuple[Candidate, ...]

    @property
    def region(self) -> Region:
        """The best region."""
        return self.regions[0]


def choose_region(frames: Sequence[Frame], settings: RoiSettings | None = None) -> RegionChoice:
    """Choose the region of interest in the first of `frames` (10 to 30, spaced over the first seconds, in time order).

    With a single frame texture alone decides. Raises DataError when no place can be tracked, UsageError when the
    size does not fit the image.
    """
    settings = settings or RoiSettings()
    image = _first_image(frames)
    rows, columns = image.shape
    size = _size(settings, columns, rows)
    grid = score_grid(image, size, _margins(settings, size, columns, rows), settings.direction)
    places = _best_places(grid, size, settings.candidates * 3)
    usable, repeating = _without_repeats(image, places, settings.candidates)
    ranked = rank_candidates(track_candidates(frames, usable or places[: settings.candidates]))
    fixed = [c for c in ranked if c.fixed]
    if not fixed:
        raise DataError(_nothing(len(places), size))
    return RegionChoice(
        regions=tuple(c.region for c in fixed[: settings.regions]),
        reasons=(*_reasons(grid, fixed[0], ranked), *_repeats_reason(repeating, len(usable))),
        score_px=grid.std_px,
        score_x=grid.centre_x,
        score_y=grid.centre_y,
        candidates=tuple(_reported(ranked, settings.regions)),
    )


def _reported(ranked: list[Candidate], count: int) -> list[Candidate]:
    """The candidates with a word on why each of them was taken or not; the first `count` fixed ones were."""
    reported = []
    for place, candidate in enumerate(ranked):
        if candidate.fixed:
            verdict = "taken" if place < count else "fixed, but less sharp"
        elif np.isfinite(candidate.disagreement_px):
            verdict = f"moves on its own: {candidate.disagreement_px:.2g} px rms relative to the others"
        else:
            verdict = "could not be tracked"
        reported.append(replace(candidate, verdict=verdict))
    return reported


def _first_image(frames: Sequence[Frame]) -> NDArray[np.generic]:
    if not isinstance(frames, Sequence) or not frames or not all(isinstance(one, Frame) for one in frames):
        raise refuse("frames", "a list of at least one Frame", frames, "Frame(time_ns, pixels) makes one of an array.")
    shapes = {f.pixels.shape for f in frames}
    if len(shapes) > 1 or len(frames[0].pixels.shape) != 2:
        raise DataError(f"All frames must be image planes of one size (rows, columns); received {sorted(shapes)}.")
    return frames[0].pixels


def _size(settings: RoiSettings, columns: int, rows: int) -> int:
    side = min(columns, rows)
    size = settings.size_px
    if size is None:
        size = 128 if side >= 640 else (64 if side >= 160 else max(MIN_CHOICE_PX, side * 3 // 5))
    if size > side:
        raise UsageError(
            f"The region's side must fit into the image ({columns}x{rows} px); received {size} px. "
            "Give a smaller size or roi."
        )
    return size


def _margins(settings: RoiSettings, size: int, columns: int, rows: int) -> tuple[int, int]:
    """Columns and rows kept free at the border, less where the image is too small for them."""
    wanted = [max(16, n // 10) if settings.margin_px is None else settings.margin_px for n in (columns, rows)]
    return min(wanted[0], (columns - size) // 2), min(wanted[1], (rows - size) // 2)


def _best_places(grid: Grid, size: int, count: int) -> list[tuple[Region, float]]:
    """Up to `count` regions with their predicted standard deviation (px), best first.

    First those two sides apart, so that one vehicle or tree does not fill the list; then the others that do not
    overlap.
    """
    left = np.where(np.isfinite(grid.std_px), grid.std_px, np.inf)
    places = _separate(left.copy(), grid, [], count, 2 * size)
    places = _separate(left, grid, places, count, size)
    return _regions(places, grid, size)


def further_places(
    choice: RegionChoice, kept: Sequence[Region], avoided: Sequence[Region], count: int
) -> list[tuple[Region, float]]:
    """Up to `count` more places of a choice with their predicted standard deviation (px), best first.

    They do not overlap those `kept`, and overlap those `avoided` by less than half.
    """
    size = choice.region.width
    grid = Grid(choice.score_px, choice.score_x, choice.score_y, 0.0)
    left = np.where(np.isfinite(grid.std_px), grid.std_px, np.inf)
    for region, distance in (*((r, size) for r in kept), *((r, size // 2) for r in avoided)):
        rows = np.abs(grid.centre_y - (region.y + size // 2)) < distance
        columns = np.abs(grid.centre_x - (region.x + size // 2)) < distance
        left[rows[:, None] & columns[None, :]] = np.inf
    return _regions(_separate(left, grid, [], count, size), grid, size)


def _regions(places: list[tuple[int, int]], grid: Grid, size: int) -> list[tuple[Region, float]]:
    """Grid points (row, column) as regions with their predicted standard deviation (px)."""
    half = size // 2
    return [
        (Region(int(grid.centre_x[i]) - half, int(grid.centre_y[j]) - half, size, size), float(grid.std_px[j, i]))
        for j, i in places
    ]


def _separate(
    left: Floats, grid: Grid, taken: list[tuple[int, int]], count: int, distance: int
) -> list[tuple[int, int]]:
    """Add the best grid points (row, column) that keep `distance` px from those taken; `left` is overwritten."""
    places = list(taken)
    for j, i in places:
        left[_near(grid, j, i, distance)] = np.inf
    while len(places) < count and left.size and left.min() <= MAX_STD_PX:
        j, i = divmod(int(left.argmin()), left.shape[1])
        places.append((j, i))
        left[_near(grid, j, i, distance)] = np.inf
    return places


def _near(grid: Grid, j: int, i: int, distance: int) -> NDArray[np.bool_]:
    rows = np.abs(grid.centre_y - grid.centre_y[j]) < distance
    columns = np.abs(grid.centre_x - grid.centre_x[i]) < distance
    return np.asarray(rows[:, None] & columns[None, :])


def _without_repeats(
    image: NDArray[np.generic], places: list[tuple[Region, float]], count: int
) -> tuple[list[tuple[Region, float]], int]:
    """The first `count` places whose texture does not repeat, and how many were passed over."""
    usable: list[tuple[Region, float]] = []
    repeating = 0
    for region, std_px in places:
        if len(usable) == count:
            break
        if repeats(image, region):
            repeating += 1
        else:
            usable.append((region, std_px))
    return usable, repeating


def _nothing(places: int, size: int) -> str:
    remedy = "Give camera.roi by hand, or improve focus, light or contrast"
    if places == 0:
        return (
            f"No place of {size}x{size} px has enough texture that is in focus and neither black nor saturated. "
            f"{remedy}."
        )
    return f"None of {places} textured places could be tracked through the first frames. {remedy}."


def _repeats_reason(repeating: int, usable: int) -> tuple[str, ...]:
    if repeating == 0:
        return ()
    if usable == 0:
        return (
            "All textured places repeat nearby: one copy may be taken for another when the target moves by more than "
            "half the pattern between frames. Check the region.",
        )
    return (f"{repeating} textured places were rejected because their pattern repeats nearby.",)


def _reasons(grid: Grid, best: Candidate, ranked: list[Candidate]) -> tuple[str, ...]:
    tracked = sum(c.status_share(Status.TRACKING) for c in ranked) / len(ranked)
    alike = sum(c.fixed for c in ranked)
    return (
        f"Predicted standard deviation {best.predicted_std_px:.4f} px a frame at an image noise of {grid.noise:.2g}.",
        f"{len(ranked)} places were tracked ({100 * tracked:.0f} % of their frames found); {alike} move alike. "
        f"The chosen one differs from them by {best.disagreement_px:.3f} px (rms), correlation {best.quality:.3f}.",
    )


def score_grid(image: NDArray[np.generic], size: int, margins: tuple[int, int], direction: str) -> Grid:
    """Score regions of `size` px on a grid of a quarter of it, `margins` (columns, rows) away from the border."""
    wide = np.asarray(image, dtype=np.float64)
    finite = np.isfinite(wide)
    plain = np.where(finite, wide, np.median(wide[finite]) if finite.any() else 0.0)
    noise = max(noise_std(plain), _rounding(image))
    step = max(size // 4, 4)
    x = np.arange(margins[0], image.shape[1] - margins[0] - size + 1, step)
    y = np.arange(margins[1], image.shape[0] - margins[1] - size + 1, step)
    variance = _variance(plain, noise, (y, x), size, direction)
    bad = _window_sums((~finite | clipped(image)).astype(np.float64), y, x, size) > CLIPPED_SHARE * size * size
    return Grid(np.where(bad, np.nan, np.sqrt(variance)), x + size // 2, y + size // 2, noise)


def _rounding(image: NDArray[np.generic]) -> float:
    """Standard deviation of rounding to whole numbers; a trifle of the level for other types."""
    if image.dtype.kind in "iub":
        return float(1.0 / np.sqrt(12.0))
    finite = np.abs(image[np.isfinite(image)])
    return 1e-6 * float(finite.max(initial=0.0)) + 1e-30


def _variance(
    plain: Floats, noise: float, places: tuple[NDArray[np.int64], NDArray[np.int64]], size: int, direction: str
) -> Floats:
    """Variance (px²) of a shift measured between two frames at each place (rows, columns)."""
    taps = gaussian_taps(SMOOTHING_PX).astype(np.float32)
    m = len(taps) // 2
    level = float(plain.mean())
    raw = values(np.pad(plain, m, mode="edge"), level)
    smoothed = _core.smooth(raw, taps).astype(np.float64) if raw is not None else np.zeros_like(plain)
    gy, gx = np.asarray(np.gradient(smoothed), dtype=np.float64)
    y, x = places
    # The noise's own gradients: central difference of the smoothed noise along one axis.
    own = float(np.sum(np.convolve(taps, [0.5, 0.0, -0.5]) ** 2) * np.sum(taps.astype(np.float64) ** 2))
    base = noise**2 * own * size * size
    xx = np.maximum(_window_sums(gx * gx, y, x, size) - 1.5 * base, 1e-30)
    yy = np.maximum(_window_sums(gy * gy, y, x, size) - 1.5 * base, 1e-30)
    xy = _window_sums(gx * gy, y, x, size)
    det = np.maximum(xx * yy - xy * xy, 1e-6 * xx * yy)
    along, across = (yy, xx) if direction == "x" else (xx, yy)
    return np.asarray(2.0 * noise**2 * (along + CROSS_SHARE * across) / det, dtype=np.float64)


def clipped(image: NDArray[np.generic]) -> NDArray[np.bool_]:
    """Where the image (rows, columns) is black or saturated: within 1 % of the ends of an 8 bit scale, or, for other
    types, at an extreme value that more than one pixel in a thousand shares.
    """
    if image.dtype == np.uint8:
        grey = image.astype(np.uint8, copy=False)
        return np.asarray((grey <= 2) | (grey >= 253))
    flat = image[np.isfinite(image)]
    if flat.size == 0:
        return np.ones(image.shape, dtype=np.bool_)
    out = np.zeros(image.shape, dtype=np.bool_)
    for extreme in (flat.min(), flat.max()):
        same = image == extreme
        if np.count_nonzero(same) > 1e-3 * image.size:
            out |= same
    return out


def _window_sums(a: Floats, y: NDArray[np.int64], x: NDArray[np.int64], size: int) -> Floats:
    """Sums of `a` over the squares of `size` px with the top left corners at all y and x."""
    total = np.zeros((a.shape[0] + 1, a.shape[1] + 1))
    total[1:, 1:] = a.cumsum(0).cumsum(1)
    top, bottom = y[:, None], y[:, None] + size
    left, right = x[None, :], x[None, :] + size
    return np.asarray(total[bottom, right] - total[top, right] - total[bottom, left] + total[top, left])
