"""Two cameras on one box: how the tilt that both images show compares, and their clocks.

A tilt θ of the box moves the image of each camera by its focal length f (px), a displacement u by f over the distance
(ρ: its inverse). Each has a clock of its own:

    p_1 = f_1 ρ_1 u + f_1 θ + n_1,   p_2 = f_2 ρ_2 u + f_2 θ + n_2

    p_1 = f_1 (ρ_1 − ρ_2) u + r p_2 + n,   r = f_1 / f_2

So p_2, at the frames of the first camera, is to p_1 what the angle of a gyroscope is (`rotation`): r and both clocks
are those by which the innovations of p_1 are the smallest. p_2 is noisy as p_1 and the acceleration are: r is a total
least squares estimate, as there. r times p_2 is then a second target of the first camera, and `tilt` does the rest.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from midspan.calibration.agreement import misfit
from midspan.calibration.camera.geometry import FOCAL_STD
from midspan.calibration.camera.rotation import least_squares
from midspan.calibration.camera.view import SeenTarget, View, camera_pair
from midspan.calibration.fit import MIN_FRAMES, Fit, Pair, aligned, best_corner
from midspan.calibration.outliers import cleaned, without_lonely_outliers
from midspan.calibration.time_offset import search_offset
from midspan.calibration.whitening import Whitened, inverse_of
from midspan.records import NANOSECONDS, Floats

if TYPE_CHECKING:
    from scipy.interpolate import CubicSpline

# Frames of the second camera that are farther apart than this many of its usual intervals are not interpolated between.
GAP_INTERVALS = 2.5
# Least share of the innovations that is the frames' own noise.
MIN_OWN = 0.02
# Least share of the first camera's frames that the second one must see too.
MIN_TOGETHER = 0.5
# Clock offsets of the second camera are tried in this step, s, and refined by no more than the second in a round.
SCAN_STEP_S, MAX_STEP_S = 0.01, 0.02
ROUNDS, SETTLED = 12, 1e-4
# A clock offset that one camera alone shows is right to this, s (σ).
ALONE_S, MIN_ALONE_S = 2e-3, 1e-4
# The trackers' variances may be off by this factor from one camera to the other; what the second one shows apart from
# the displacement must exceed its noise by it.
NOISE_FACTOR = 4.0
# A cubic spline through all frames errs by a sixteenth of what one through every second frame does, where it errs
# little; by this share where it errs more.
SPLINE_SHARE = 0.25
# A ratio that is less certain, relative, is none.
MAX_RATIO_STD = 0.05


# Half of the step, s, over which a course's speed is taken.
SPEED_STEP_S = 1e-3

Moves = Callable[[Floats], Floats]


@dataclass(frozen=True, slots=True)
class Together:
    """How the images of two cameras on one box compare.

    ratio: pixels of the first one for a pixel of the second by a tilt, signed; std: its standard deviation; late_s,
    late_std_s: what is to be added to the second one's stamps for them to be on the first one's clock.
    """

    ratio: float
    std: float
    late_s: float
    late_std_s: float

    @property
    def tells(self) -> bool:
        """Whether the ratio is certain enough."""
        return self.std <= MAX_RATIO_STD * abs(self.ratio)


@dataclass(frozen=True)
class _Course:
    """A target's translation as a function of time: time_s (n,) of its usable frames, after an instant.

    value: without what the displacement makes of it, `moves`, which need not be interpolated.
    """

    time_s: Floats
    value: Floats
    variance: Floats
    interval_s: float
    moves: Moves

    @cached_property
    def _spline(self) -> "CubicSpline":
        from scipy.interpolate import CubicSpline

        return CubicSpline(self.time_s, self.value)

    def at(self, time_s: Floats) -> Floats:
        """The translation (m,), px."""
        rest = self._spline(np.clip(time_s, self.time_s[0], self.time_s[-1]))
        return np.asarray(rest + self.moves(time_s))

    def speed(self, time_s: Floats) -> Floats:
        """Its derivative (m,), px/s."""
        after, before = (self.at(time_s + step_s) for step_s in (SPEED_STEP_S, -SPEED_STEP_S))
        return (after - before) / (2.0 * SPEED_STEP_S)

    @property
    def halved(self) -> "_Course":
        """The same by every second frame."""
        every = (self.time_s[::2], self.value[::2], self.variance[::2])
        return _Course(*every, 2.0 * self.interval_s, self.moves)

    def seen(self, time_s: Floats) -> NDArray[np.bool_]:
        """Which instants (m,) lie between frames that follow each other."""
        after = np.clip(np.searchsorted(self.time_s, time_s), 1, len(self.time_s) - 1)
        near = self.time_s[after] - self.time_s[after - 1] <= GAP_INTERVALS * self.interval_s
        return np.asarray(near & (time_s >= self.time_s[0]) & (time_s <= self.time_s[-1]))


def _course_of(view: View, target: SeenTarget, origin_ns: int, moves: Moves) -> _Course | None:
    """A target's course along the view's axis, its times from an instant on; None where hardly a frame is usable."""
    value, variance = target.rows.along(view.axis)
    usable = np.isfinite(value) & np.isfinite(variance)
    if np.count_nonzero(usable) < MIN_FRAMES:
        return None
    time_s = (target.rows.time_ns + view.late_ns - origin_ns) / NANOSECONDS
    interval_s, time_s = float(np.median(np.diff(time_s))), time_s[usable]
    return _Course(time_s, value[usable] - moves(time_s), variance[usable], interval_s, moves)


def as_seen_by(
    one: SeenTarget, view: View, other: SeenTarget, other_view: View, found: Together, moves: Moves = np.zeros_like
) -> SeenTarget | None:
    """The second camera's target as one of the first camera, at whose frames its translation is interpolated.

    moves: as of `together`.
    """
    course = _course_of(other_view, other, view.window_ns[0], moves)
    if course is None:
        return None
    time_s = (one.rows.time_ns + view.late_ns - view.window_ns[0]) / NANOSECONDS - found.late_s
    seen = course.seen(time_s)
    value = np.where(seen, found.ratio * course.at(time_s), np.nan)
    variance = np.where(seen, found.ratio**2 * np.interp(time_s, course.time_s, course.variance), np.nan)
    moved = {f"{view.axis}_px": value, f"variance_{view.axis}_px2": variance}
    reference = found.ratio**2 * np.broadcast_to(other.reference_px2[:1], (len(time_s), 2))
    return replace(other, rows=replace(one.rows, **moved), reference_px2=reference)


def together(
    view: View,
    one: SeenTarget,
    other_view: View,
    other: SeenTarget,
    offsets_s: tuple[float | None, float | None] = (None, None),
    moves: Moves = np.zeros_like,
) -> Together | None:
    """How the second camera's image compares with the first one's; None where they hardly see at the same time.

    offsets_s: the clock offset of each besides its view's, as calibrated; None: looked for. moves: what the
    displacement makes of the second one's image (n,), px, at times (n,) of its clock with its view's offset, s after
    the first one's window begins, as far as it is known.
    """
    course = _course_of(other_view, other, view.window_ns[0], moves)
    if course is None:
        return None
    compared = _Compared(view, one, course)
    offset_s = compared.offset_s if offsets_s[0] is None else offsets_s[0]
    if not compared.covered(offset_s, offsets_s[1], view.max_offset_s):
        return None
    first = compared.place(offset_s)
    turned_s = compared.scanned(first, other_view.max_offset_s) if offsets_s[1] is None else offsets_s[1]
    lenses = [target.lens for target in (one, other)]
    focal = [None if lens is None else lens.focal_px(view.axis) for lens in lenses]
    known = None if None in focal else focal[0] / focal[1]  # type: ignore[operator]
    compared.alone_s = offsets_s
    return compared.near(replace(first, turned_s=turned_s), known)


@dataclass(frozen=True, slots=True)
class _Place:
    """Clock offsets of both cameras (s), the corner frequency (rad/s), s and r, and the noise of a frame, px²."""

    offset_s: float
    turned_s: float
    corner: float
    scale: float
    ratio: float
    noise: float
    ratio_std: float = np.inf
    late_std_s: float = 0.0


class _Compared:
    """The first camera's translation, the acceleration, and the second one's course, in the calibration window."""

    def __init__(self, view: View, one: SeenTarget, course: _Course) -> None:
        self.course, self.reach_s = course, view.max_offset_s
        self.alone_s: tuple[float | None, float | None] = (None, None)
        pair = without_lonely_outliers(camera_pair(view, one.rows, one.blur_s))
        usable = np.isfinite(pair.rows[:, 2])
        self.typical = float(np.median(pair.rows[usable, 2])) if usable.any() else 1.0
        self.pair = pair.changed(rows=pair.rows / np.array([1.0, 1.0, self.typical]))
        self.noise_share = float(np.median(course.variance)) / self.typical

    @property
    def offset_s(self) -> float:
        """The first camera's clock offset without a tilt, s."""
        return search_offset(self.pair, self.reach_s).fit.offset_s

    def covered(self, offset_s: float, turned_s: float | None, margin_s: float) -> bool:
        """Leaves out the frames that the second camera does not see; whether enough are left."""
        rows, apart_s = self.pair.rows.copy(), offset_s - (turned_s or 0.0)
        usable = np.isfinite(rows[:, 2])
        seen = self.course.seen(rows[:, 0] + apart_s)
        if turned_s is None:
            inner = rows[:, 0] + apart_s
            seen &= (inner > self.course.time_s[0] + margin_s) & (inner < self.course.time_s[-1] - margin_s)
        rows[~seen, 2] = np.inf
        self.pair = self.pair.changed(rows=rows)
        left = np.count_nonzero(usable & seen)
        return bool(left >= max(MIN_FRAMES, MIN_TOGETHER * np.count_nonzero(usable)))

    def place(self, offset_s: float) -> _Place:
        """Noise levels without the second camera."""
        fit = best_corner(self.pair, offset_s)
        return _Place(offset_s, offset_s, fit.corner, fit.ratio, 0.0, fit.noise)

    def scanned(self, place: _Place, reach_s: float) -> float:
        """The second camera's clock offset with which both go together best, s."""
        count = round(reach_s / SCAN_STEP_S)
        tried = SCAN_STEP_S * np.arange(-count, count + 1, dtype=np.float64)
        columns = [partial(lambda t, late: self.course.at(t - late), late=late) for late in tried.tolist()]
        _, white, known = self._whitened(place, columns)
        own = _without(white[:, :1], known)[:, 0]
        others = _without(white[:, -len(columns) :], known)
        alike = (own @ others) ** 2 / np.maximum(np.sum(others**2, axis=0), 1e-300)
        return float(tried[int(np.argmax(alike))])

    def _whitened(
        self, place: _Place, columns: Sequence[Callable[[Floats], Floats]]
    ) -> tuple[Whitened, Floats, Floats]:
        """Innovations of the translation, D, D' and the columns; and of D, D' and what else the pair has."""
        w = aligned(self.pair, place.offset_s, *columns).whitened(place.corner)
        white = w.columns / np.sqrt(w.variance)[:, None]
        return w, white, white[:, 1 : white.shape[1] - len(columns)]

    def without_tilt(self, place: _Place) -> Pair:
        """The pair without what the second camera shows of the tilt."""
        rows = self.pair.rows.copy()
        rows[:, 1] -= place.ratio * self.course.at(rows[:, 0] + place.offset_s - place.turned_s)
        return self.pair.changed(rows=rows)

    def near(self, place: _Place, known: float | None) -> Together:
        """The likeliest ratio and clocks near a place; known: the ratio by both lenses."""
        fit = None
        for turn in range(ROUNDS):
            before, place = place, self._step(place, known, fit)
            pair = self.without_tilt(place)
            fit = best_corner(pair, place.offset_s, place.corner if turn > 1 else None)
            place = replace(place, corner=fit.corner, noise=fit.noise)
            if turn == 1:
                unusable = np.isinf(cleaned(pair, fit).rows[:, 2])
                rows = np.column_stack((self.pair.rows[:, :2], np.where(unusable, np.inf, self.pair.rows[:, 2])))
                self.pair = self.pair.changed(rows=rows)
            moved_s = max(abs(place.offset_s - before.offset_s), abs(place.turned_s - before.turned_s))
            if turn > 1 and abs(place.ratio - before.ratio) < SETTLED * abs(place.ratio) and moved_s < SETTLED:
                break
        return Together(place.ratio, place.ratio_std, place.turned_s - place.offset_s, place.late_std_s)

    def _step(self, place: _Place, known: float | None, fit: Fit | None) -> _Place:
        late, halved = place.turned_s, self.course.halved
        columns = [lambda t: halved.at(t - late), lambda t: self.course.at(t - late)]
        columns.append(lambda t: self.course.speed(t - late))
        w, white, _ = self._whitened(place, columns)
        other = np.column_stack((white[:, 2:-3], white[:, -1:]))
        noisy, share = _without(white[:, [0, 1, -2, -3]], other), self.noise_share
        factor = 1.0 if fit is None else misfit(self.without_tilt(place), fit).factor
        (scale, ratio), std = _ratio(noisy[:, :3], w, place, share)
        unsure = [_ratio(noisy[:, :3], w, place, share * one)[0][1] for one in (1.0 / NOISE_FACTOR, NOISE_FACTOR)]
        by_half = SPLINE_SHARE * (_ratio(noisy[:, [0, 1, 3]], w, place, share)[0][1] - ratio)
        std = float(np.hypot(np.sqrt(factor) * std, np.hypot(np.max(np.abs(np.array(unsure) - ratio)), by_half)))
        weight = 1.0
        if known is not None:
            known_std = np.sqrt(2.0) * FOCAL_STD * abs(known)
            weight = std**-2.0 / (std**-2.0 + known_std**-2.0)
            ratio, std = weight * ratio + (1.0 - weight) * known, float(np.sqrt(1.0 / (std**-2.0 + known_std**-2.0)))
            scale = float(noisy[:, 1] @ (noisy[:, 0] - ratio * noisy[:, 2]) / (noisy[:, 1] @ noisy[:, 1]))
        left = white[:, 0] - scale * white[:, 1] - ratio * white[:, -2]
        moves = np.column_stack((scale * white[:, 2], -ratio * white[:, -1], white[:, 3:-3]))
        rest = left - moves @ np.linalg.lstsq(moves, left, rcond=None)[0]
        unit = factor * float(rest @ rest) / len(rest)
        power, pulled = moves.T @ moves, moves.T @ left
        # Where the lenses give the ratio, what their error leaves of a slow tilt looks like a clock's offset.
        alone_std = max(weight * ALONE_S, MIN_ALONE_S)
        for k, (alone_s, now_s) in enumerate(zip(self.alone_s, (place.offset_s, place.turned_s), strict=True)):
            if alone_s is not None:
                power[k, k] += unit / alone_std**2
                pulled[k] += unit / alone_std**2 * (alone_s - now_s)
        inverse = inverse_of(power)
        steps, covariance = (inverse @ pulled)[:2], unit * inverse
        first_s, second_s = np.clip(steps, -MAX_STEP_S, MAX_STEP_S).tolist()
        return replace(
            place,
            offset_s=place.offset_s + first_s,
            turned_s=place.turned_s + second_s,
            scale=scale,
            ratio=float(ratio),
            ratio_std=std,
            late_std_s=float(np.sqrt(covariance[1, 1])),
        )


def _without(columns: Floats, known: Floats) -> Floats:
    """Columns (n, k) without what goes with others (n, m)."""
    return np.asarray(columns - known @ np.linalg.lstsq(known, columns, rcond=None)[0])


def _ratio(noisy: Floats, w: Whitened, place: _Place, share: float) -> tuple[tuple[float, float], float]:
    """s and r, and the standard deviation of r, by total least squares of translation, D and p_2 (n, 3), whitened;
    share: variance of a frame of the second camera over that of the first one.
    """
    count = float(len(w.variance))
    own = place.noise / (1.0 + place.ratio**2 * share) * max(count - w.input_share, MIN_OWN * count)
    noises = np.array([own, place.noise * w.input_share / max(place.scale**2, 1e-300), share * own])
    moved, angle = noisy[:, 1], noisy[:, 2]
    shown = float(angle @ angle) - float(moved @ angle) ** 2 / max(float(moved @ moved), 1e-300)
    found, power = least_squares(noisy, noises)
    left = noisy[:, 0] - noisy[:, 1:] @ found
    own_power = noisy[:, 1:].T @ noisy[:, 1:]
    inverse = inverse_of(own_power - np.diag(power * noises[1:]))
    covariance = inverse @ (float(left @ left) / len(left) * own_power) @ inverse
    std = float(np.sqrt(max(covariance[1, 1], 0.0))) if shown > NOISE_FACTOR * noises[2] else np.inf
    return (float(found[0]), float(found[1])), std
