"""A camera that tilts, seen by targets at different distances.

A tilt θ of the camera moves all its targets by as many pixels, a displacement u the nearer ones by more (ρ: one over
the distance, f: focal length in px):

    p_k = f ρ_k u + f θ + n_k

The difference of two targets holds no tilt. It is one displacement sensor with the scale f (ρ_j − ρ_k), which the
accelerometer tells as that of any other; neither distance is needed. What is left open by the differences, the factors
r_k = f ρ_k + c with one c, changes the tilt by −c u and the displacement not at all: the regression of the targets on
the displacement chooses c. The tilt is a state of the estimator, of the size that shows here. (Of the geometry: R.
Hartley and A. Zisserman, Multiple View Geometry, 2004, section 6.1, doi 10.1017/CBO9780511811685.)
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import combinations

import numpy as np

from midspan.calibration.camera.bystanders import Bystanders, Seen, judged, moves_alone, moves_text
from midspan.calibration.camera.difference import Course, share_in
from midspan.calibration.camera.disagreement import SAME_DISTANCE
from midspan.calibration.camera.view import SeenTarget, View, camera_pair, filter_settings, scale_of
from midspan.calibration.common_offset import Fitted
from midspan.calibration.frequency_response import USUAL_FOCAL_PX
from midspan.calibration.frequency_shapes import Kind
from midspan.calibration.scale import MIN_GAIN, UNEXPLAINED_SHARE, ScaleCalibration
from midspan.errors import UntrustedError
from midspan.fusion.path import at
from midspan.fusion.streams import smooth
from midspan.notices import Notice, rounded
from midspan.records import NANOSECONDS, Displacement, Floats, PixelTrack, ScaleFactor, Source
from midspan.signals.stamps import inside

# Declared distances differ where they do so by this many standard deviations (95 %), and by `SAME_DISTANCE`.
CERTAIN = 2.0
# Closer together across the axis, px, targets are moved by a roll of 10 mdeg by less than the noise of a frame.
ROLL_LEVER_PX = 50
# A tilt is a random walk as steep as it moves over these times, s.
WALK_LAGS_S = (2, 4, 8, 16)


@dataclass(frozen=True, slots=True, eq=False)
class Tilt:
    """What the differences of a camera's targets tell along one image axis.

    found: of the sharpest difference; scales (k,): m per pixel of each target, signed, which are right to one
    constant added to their inverses; noise_px (k,): of one frame of each target; std_px: standard deviation of the
    tilt in the image; pair: numbers of the two targets whose difference is the sharpest; certain: whether the
    accelerometer excludes motion of one target alone; others: what is said of the targets besides; left: share of
    the tilt that is in the difference all the same; roll: displacement of the sharpest targets against each other
    that a roll as large as the tilt makes, over the tilt's, where nothing shows it; walk_px2_s: density of the
    random walk that it goes on by from second to second, px²/s.
    """

    found: ScaleCalibration
    scales: tuple[float, ...]
    noise_px: tuple[float, ...]
    std_px: float
    pair: tuple[int, int]
    certain: bool
    others: Bystanders
    left: float
    roll: float
    walk_px2_s: float

    def scale(self, number: int) -> ScaleFactor:
        """The scale factor of a target, as uncertain as that of the difference."""
        own, whole = self.scales[number], self.found.scale
        return ScaleFactor(own, whole.variance * (own / whole.value_m_per_px) ** 2)

    @property
    def left_m(self) -> float:
        """What is left of the tilt in the displacement, and what a roll may add, rms, m."""
        return float(np.hypot(self.left, self.roll)) * self._tilt_m

    @property
    def _tilt_m(self) -> float:
        """What the tilt would make of a difference's displacement, rms, m."""
        return self.std_px * abs(self.found.scale.value_m_per_px)

    def text(self, names: Sequence[str]) -> Notice:
        """A sentence on it; names: of all targets."""
        one, other = (names[k] for k in self.pair)
        held = ""
        if self.left > 0.0:
            held = (
                f" {rounded(100.0 * self.left)} % of it is left in the difference, as with targets far from the "
                f"optical axis; the error band includes {rounded(1e3 * self.left * self._tilt_m)} mm for it."
            )
        if self.roll > 0.0:
            held += (
                " They lie apart across the measured axis, so that a roll of the camera moves them against each other; "
                f"the error band includes {rounded(1e3 * self.roll * self._tilt_m)} mm, for one as large as the tilt. "
                "Choose targets that lie along the measured axis, or give [camera.lens]."
            )
        alone = len(names) == 2 and not self.certain
        third = " A slow motion of one target alone would look the same; a third target shows it." if alone else ""
        return Notice(
            "tilt",
            f"camera: it tilts by {rounded(self.std_px)} px rms in the image; the difference between targets {one} and "
            f"{other} is free of it and gives the displacement.{held}{third}",
        )


def apart(one: PixelTrack, other: PixelTrack) -> PixelTrack:
    """The difference of two tracks of the same frames."""
    return replace(
        one,
        x_px=one.x_px - other.x_px,
        y_px=one.y_px - other.y_px,
        variance_x_px2=one.variance_x_px2 + other.variance_x_px2,
        variance_y_px2=one.variance_y_px2 + other.variance_y_px2,
    )


def tilt_of(view: View, targets: Sequence[SeenTarget], fit: Fitted, is_certain: Callable[[], bool]) -> Tilt | None:
    """What the differences tell; None where they do not show a tilt.

    fit: of each target alone; is_certain: whether no other cause is left, see `certainly_tilts`.
    """
    may_roll = _may_roll(targets)
    alone = None if may_roll else _moves_alone(view, targets)
    usable = [k for k in range(len(targets)) if k != alone]
    sharpest = _sharpest(view, targets, usable)
    if sharpest is None:
        return None
    pair, found = sharpest
    count = len(found.search.fit.whitened.variance)
    single = [count * np.log(_error_m(one) / _error_m(found)) for one in fit.used]
    # Gravity in the acceleration goes with nothing else that two targets have in common.
    certain = Kind.SIGHT in found.response.known
    if not certain and not _are_apart(*(targets[k] for k in pair)) and any(gain < MIN_GAIN for gain in single):
        certain = is_certain()
        if not certain:
            return None
    seen = _compared(view, targets, pair, found)
    _refuse_sway(seen, pair, found)
    left, ratios = seen.left_px, seen.ratios
    shared = float(np.nanmean(left[pair[0]] * left[pair[1]]))
    if not shared > 0.0:
        return None
    # With a lens and distances the camera's pose takes a roll apart, which is no motion of a target.
    bystanders = [] if may_roll else [k for k in usable if k not in pair]
    others = judged(seen, pair, bystanders, partial(share_in, found.search.pair, found.search.fit))
    if alone is not None:
        others = others.without(alone, moves_text(targets[alone].name))
    noise_px = [_noise_px(target, view.axis, found.variance_factor) for target in targets]
    first, other = (left[k] for k in pair)
    step_s = float(np.median(np.diff(targets[0].rows.time_ns))) / NANOSECONDS
    return Tilt(
        found,
        tuple((1.0 / ratios).tolist()),
        tuple(noise_px),
        float(np.sqrt(shared)),
        pair,
        certain,
        others,
        _left(seen, pair, found, [noise_px[k] for k in pair]),
        _roll(view.axis, *(targets[k] for k in pair)),
        walk_of(0.5 * (first + other), step_s),
    )


def walk_of(tilt: Floats, step_s: float, noise: float = 0.0) -> float:
    """Density (unit²/s) of a random walk that a tilt (n,) goes on by; step_s: between its values; noise: standard
    deviation of one.

    By the steps between means over a second that one of twenty exceeds, as walkers come now and then.
    """
    second = max(round(1.0 / step_s), 1)
    count = len(tilt) // second
    blocks = tilt[: count * second].reshape(count, second)
    seen = np.isfinite(blocks).any(axis=1)
    mean = np.full(count, np.nan)
    mean[seen] = np.nanmean(blocks[seen], axis=1)
    found = []
    for lag in (k for k in WALK_LAGS_S if k < count // 2):
        steps = np.abs(mean[lag:] - mean[:-lag])
        if np.isfinite(steps).any():
            moved = float(np.nanquantile(steps, 0.95) / CERTAIN) ** 2 - 2.0 * noise**2 / second
            found.append(max(moved, 0.0) / (lag * second * step_s))
    return max(found, default=0.0)


def _across_px(axis: str, targets: Sequence[SeenTarget]) -> float:
    """How far targets lie apart across an image axis."""
    first = [one.region.y if axis == "x" else one.region.x for one in targets]
    return float(max(first) - min(first))


def _roll(axis: str, one: SeenTarget, other: SeenTarget) -> float:
    """What a roll moves two targets against each other by, over what a tilt as large moves both by."""
    lever_px = _across_px(axis, (one, other))
    if lever_px <= ROLL_LEVER_PX:
        return 0.0
    known_px = None if one.lens is None else one.lens.focal_px(axis)
    return lever_px / (known_px or max(USUAL_FOCAL_PX, *one.frame_px))


def _may_roll(targets: Sequence[SeenTarget]) -> bool:
    """Whether a roll or motion along the view moves targets that lie apart in the picture against each other, and what
    is known of them shows it.
    """
    known = targets[0].lens is not None and any(one.inverse_distance is not None for one in targets)
    return known and max(_across_px(one, targets) for one in "xy") > ROLL_LEVER_PX


def _are_apart(one: SeenTarget, other: SeenTarget) -> bool:
    """Whether both distances are declared, and differ for certain."""
    if one.inverse_distance is None or other.inverse_distance is None:
        return False
    return differ(one.inverse_distance, other.inverse_distance)


def differ(one: tuple[float, float], other: tuple[float, float]) -> bool:
    """Whether two distances differ for certain, by their inverses and standard deviations (1/m)."""
    (near, near_std), (far, far_std) = one, other
    return abs(near - far) > max(CERTAIN * float(np.hypot(near_std, far_std)), SAME_DISTANCE * max(near, far))


def _noise_px(target: SeenTarget, axis: str, factor: float) -> float:
    """Standard deviation of one frame of a target, px; factor: estimated variance over the tracker's own."""
    variance = target.rows.along(axis)[1]
    return float(np.sqrt(factor * np.median(variance[np.isfinite(variance)])))


def _error_m(found: ScaleCalibration) -> float:
    """What a frame differs from the acceleration by, m: noise, and an error with a course of its own."""
    own_px = 0.0 if found.own is None else found.own.std
    return float(abs(found.scale.value_m_per_px) * np.hypot(found.noise.std, own_px))


def _moves_alone(view: View, targets: Sequence[SeenTarget]) -> int | None:
    """The target that the others show to move, in the calibration window."""
    time_ns = targets[0].rows.time_ns + view.late_ns
    window = inside(time_ns, *view.window_ns)
    rows = [target.rows.along(view.axis) for target in targets]
    value, variance = (np.array([one[which][window] for one in rows]) for which in (0, 1))
    return moves_alone(np.where(np.isfinite(variance), value, np.nan), variance)


def _sharpest(
    view: View, targets: Sequence[SeenTarget], usable: Sequence[int]
) -> tuple[tuple[int, int], ScaleCalibration] | None:
    """The two of the usable targets whose difference is the sharpest, and its calibration."""
    found: dict[tuple[int, int], ScaleCalibration] = {}
    for i, k in combinations(usable, 2):
        try:
            track, other = apart(targets[i].rows, targets[k].rows), targets[k].rows
            found[i, k] = scale_of(view, camera_pair(view, track, targets[i].blur_s, other=other))
        except UntrustedError:
            continue
    if not found:
        return None
    best = min(found, key=lambda two: _error_m(found[two]))
    return best, found[best]


def _left(seen: Seen, pair: tuple[int, int], found: ScaleCalibration, noise_px: Sequence[float]) -> float:
    """Share of the tilt that the difference holds all the same, as far from the optical axis or with a lens' distortion
    it does; 0 where the acceleration does not show one. noise_px: of both targets.
    """
    # The difference's noise is not in the mean by the weights of both.
    weights = np.array(noise_px) ** -2.0 / np.sum(np.array(noise_px) ** -2.0)
    tilt_px = weights @ seen.left_px[list(pair)]
    known = np.isfinite(tilt_px)
    mean_px = float(np.sum(np.array(noise_px) ** -2.0) ** -0.5)
    course = Course(seen.time_s[known], tilt_px[known], lambda value: value, mean_px, 0.0)
    share = share_in(found.search.pair, found.search.fit, course)
    return 0.0 if share.allows(0.0) else abs(share.value)


def _refuse_sway(seen: Seen, pair: tuple[int, int], found: ScaleCalibration) -> None:
    """UntrustedError where two targets move against each other by too much of the motion: no tilt explains that."""
    if found.own is None or found.own.beyond_readings:
        return
    sway_m = found.own.std * abs(found.scale.value_m_per_px)
    most_m = UNEXPLAINED_SHARE * float(np.std(seen.moved_m))
    if sway_m <= most_m:
        return
    at_hz = f" at {rounded(found.own.hertz)} Hz" if found.own.sways else ""
    errs = "" if found.own.alone else ", or the accelerometer errs"
    one, other = (seen.names[k] for k in pair)
    remedy = "Add a third target, which shows" if len(seen.names) == 2 else "Remove from camera.target"
    raise UntrustedError(
        f"The camera tilts, and its targets {one} and {other} move against each other by {rounded(1e3 * sway_m)} mm "
        f"rms{at_hz}, which neither a tilt nor the accelerometer shows: one of them moves on its own or the camera "
        f"rolls{errs}. At most {rounded(1e3 * most_m)} mm, {100 * UNEXPLAINED_SHARE:g} % of the motion, is accepted. "
        f"{remedy} the one that moves."
    )


def _compared(view: View, targets: Sequence[SeenTarget], pair: tuple[int, int], found: ScaleCalibration) -> Seen:
    """The targets in the calibration window, and the displacement that the pair tells."""
    i, k = pair
    track, scale = apart(targets[i].rows, targets[k].rows), found.scale.value_m_per_px
    value, variance = track.along(view.axis)
    time_ns = track.time_ns + view.late_ns + round(NANOSECONDS * found.search.offset.value_s)
    source = np.full(len(value), Source.CAMERA, dtype=np.uint8)
    block = Displacement(time_ns, scale * value, scale**2 * found.variance_factor * variance, source)
    acceleration = view.prepared.with_noise(found.input_noise.density, found.input_noise.motion_s)
    kalman = filter_settings(view.prepared, found.input_noise.density, lean=found.search.pair.lean)
    path = smooth(acceleration, block, kalman).estimate
    window = inside(time_ns, *view.window_ns)
    moved = at(path, time_ns[window])[0]
    ratios, left = np.empty(len(targets)), np.full((len(targets), len(moved)), np.nan)
    values, variances = left.copy(), left.copy()
    for number, target in enumerate(targets):
        value, variance = (one[window] for one in target.rows.along(view.axis))
        usable = np.isfinite(value) & np.isfinite(variance)
        values[number, usable], variances[number, usable] = value[usable], variance[usable]
        moves, place = moved[usable] - np.mean(moved[usable]), value[usable] - np.mean(value[usable])
        ratios[number] = float(moves @ place) / float(moves @ moves)
        left[number, usable] = place - ratios[number] * moves
    # The regressions differ from it by the noise of the displacement.
    ratios[i] = ratios[k] + 1.0 / scale
    time_s = (track.time_ns[window] + view.late_ns - view.window_ns[0]) / NANOSECONDS
    return Seen([target.name for target in targets], time_s, values, variances, ratios, moved, left)
