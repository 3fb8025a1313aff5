"""Displacement and rotation of a camera in a target's translation, by an accelerometer and a gyroscope on its box.

Along an image axis a target's translation is that of the displacement u and of the rotation θ about the other axis,
with the focal length f in px; accelerometer and gyroscope give both but for their noise:

    p = r u + f θ + n,   u'' = a − b − w,   θ' = ω − c − g

The integrals D of a and Θ of ω go through the filter of `whitening` with p. There the gyroscope's integrated noise is a
coloured error of the translation, a random walk, which a Gauss-Markov process of a long correlation time is. All three
columns are noisy, so r and f are a total least squares estimate: the eigenvector of the smallest eigenvalue of the
columns' products relative to those of their noises (S. Van Huffel and J. Vandewalle, The total least squares problem,
1991, chapter 8, doi 10.1137/1.9781611971002). A regression on D alone would take a tilt in proportion to the
displacement for scale. Products of the random walk are known from draws of it.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, partial

import numpy as np

from midspan.calibration.agreement import clearly_better, misfit
from midspan.calibration.camera.calibrate import CameraFit
from midspan.calibration.camera.turning import DRAWS, Turning
from midspan.calibration.camera.view import SeenTarget, View, camera_pair
from midspan.calibration.fit import MIN_FRAMES, Fit, Pair, aligned, best_corner, evaluate
from midspan.calibration.minimum import global_minimum
from midspan.calibration.outliers import cleaned, without_lonely_outliers
from midspan.calibration.scale import REFUSED_ABOVE, ScaleCalibration, calibrate_scale, too_vague
from midspan.calibration.time_offset import search_offset
from midspan.calibration.whitening import inverse_of
from midspan.errors import UntrustedError
from midspan.records import NANOSECONDS, Floats, ScaleFactor

# Largest offset of the gyroscope's clock against the accelerometer's, s, and the step in which it is looked for.
MAX_LATE_S, LATE_STEP_S = 0.1, 5e-3
# What goes together at the largest offset counts for less than at none, by this share.
FARTHER_COSTS = 0.3
# An offset that is known to no better than this, s, is none; clocks of one logger are as far apart as that then (σ).
MAX_CLOCK_STD_S, USUAL_LATE_S = 0.01, 0.02
# Offsets of simulated records scatter with up to this many times the variance that draws of the noise give.
CLOCK_FACTOR = 2.0
# By this much, s, the clock is moved to see where both go together best: the noise of readings averages out, tilts up
# to 10 Hz do not.
CLOCK_STEP_S = 0.02
# Largest step of the frames' clock offset in a round, s.
MAX_STEP_S = 0.02
# The random walk of the integrated noise is a process of this correlation time, s.
WALK_TIME_S = 100.0
# Rounds in which focal length, clock offsets and noise levels are found in turn, and how well the first is known then.
ROUNDS, SETTLED = 12, 1e-3
# The density of the gyroscope's noise as declared, or as fast readings have it, is right to this (logarithm); around it
# the likeliest one is looked for.
DENSITY_STD = 0.3
# So is the noise of a frame as the tracker has it; sizes of the gyroscope's noise over it that are tried (logarithms).
NOISE_STD, SIZES = 1.5, (-4.0, -3.0, -2.0, -1.0, 0.0, 1.0, 2.0, 3.0, 4.0)
# Draws of a frame's own noise.
OWN_DRAWS = 4
# A focal length that is less certain, relative, is none.
MAX_FOCAL_STD = 0.1
# Rotation shows where it exceeds the scatter of the noise's power by this factor.
SHOWS = 4.0
# Two focal lengths contradict each other by this many standard deviations and this share.
CONTRADICT_STD, CONTRADICT_SHARE = 5.0, 0.1


@dataclass(frozen=True, slots=True)
class Place:
    """Where columns are compared: by how much the accelerometer's clock and the gyroscope's are ahead of the frames'
    (s), the corner frequency (rad/s), r, f, the noise of a frame (px²), and what the angle jumps by at gaps (k,), px.

    density: of the gyroscope's noise, two-sided, (rad/s)²/Hz; doubt: standard deviation of its logarithm.
    """

    offset_s: float
    turned_s: float
    corner: float
    ratio: float
    focal: float
    noise: float
    jumps: Floats
    density: float
    doubt: float = DENSITY_STD

    @property
    def slow(self) -> tuple[float, float, float]:
        """The gyroscope's integrated noise in the image, as of `Pair`."""
        return 0.5 * WALK_TIME_S * self.density * self.focal**2 / self.noise, 1.0 / WALK_TIME_S, 0.0


@dataclass(frozen=True, slots=True, eq=False)
class Joint:
    """Displacement and rotation in a target's translation.

    ratio, focal: r and f; focal_variance; step_s: what the frames' clock offset gains, step_variance: of that; drag:
    d(ratio)/d(focal); known: power of Θ beyond its noise and what goes with D, in standard deviations of the noise's
    power; jumps (k,): of the angle at gaps, px.
    """

    ratio: float
    focal: float
    focal_variance: float
    step_s: float
    step_variance: float
    drag: float
    known: float
    jumps: Floats = field(default_factory=lambda: np.empty(0))

    @property
    def shows(self) -> bool:
        """Whether the rotation is more than the gyroscope's noise."""
        return self.known > SHOWS


@dataclass(frozen=True, slots=True, eq=False)
class Settled:
    """A target's estimate: the focal length's variance, and those of the gyroscope's clock against the frames' and the
    accelerometer's, s².
    """

    place: Place
    joint: Joint
    variance: float
    turned_variance: float
    late_variance: float

    @property
    def tells(self) -> bool:
        """Whether the focal length is certain enough."""
        return self.joint.shows and np.sqrt(self.variance) <= MAX_FOCAL_STD * abs(self.joint.focal)

    def contradicts(self, focal: tuple[float, float]) -> bool:
        """Whether another focal length with its standard deviation, px, cannot be the same."""
        apart, std = abs(self.joint.focal - focal[0]), np.sqrt(self.variance + focal[1] ** 2)
        return bool(self.joint.shows and apart > CONTRADICT_STD * std and apart > CONTRADICT_SHARE * focal[0])

    def widened(self, scale: ScaleFactor, focal_std: float) -> ScaleFactor:
        """A scale factor with what the focal length makes of it."""
        value = scale.value_m_per_px
        variance = scale.variance + (self.joint.drag * focal_std * value**2) ** 2
        if (relative := float(np.sqrt(variance)) / abs(value)) > REFUSED_ABOVE:
            raise UntrustedError(f"The scale factor is too uncertain: {too_vague(value, relative)}.")
        return ScaleFactor(value, variance)


class Compared:
    """A target's translation, the acceleration and a rotation, in the calibration window."""

    def __init__(self, view: View, target: SeenTarget, turning: Turning) -> None:
        self.view, self.target, self.turning = view, target, turning
        pair = camera_pair(view, target.rows, target.blur_s)
        usable = np.isfinite(pair.rows[:, 2])
        if np.count_nonzero(usable) < MIN_FRAMES:
            raise UntrustedError(
                f"Only {np.count_nonzero(usable)} usable frames of target {target.name} lie in the calibration "
                f"window; at least {MIN_FRAMES} are needed."
            )
        self.typical = float(np.median(pair.rows[usable, 2]))
        self.pair = pair.changed(rows=pair.rows / np.array([1.0, 1.0, self.typical]))

    def start(self, offset_s: float) -> Place:
        """Noise levels without the rotation, at a clock offset of the frames."""
        self.pair = without_lonely_outliers(self.pair)
        fit = best_corner(self.pair, offset_s)
        self.pair = cleaned(self.pair, fit)
        fit = best_corner(self.pair, offset_s, fit.corner)
        usable = self.turning.seen(self.pair.rows[:, 0] + fit.offset_s, MAX_LATE_S + self.pair.exposure_s)
        rows = self.pair.rows.copy()
        rows[~usable, 2] = np.inf
        self.pair = self.pair.changed(rows=rows)
        if np.count_nonzero(np.isfinite(rows[:, 2])) < MIN_FRAMES:
            raise UntrustedError(
                "gyroscope: its readings and the frames of the calibration window hardly overlap. Check the time "
                "stamps of both and gyroscope.start_s."
            )
        jumps = np.zeros(len(self.turning.gaps))
        return Place(fit.offset_s, fit.offset_s, fit.corner, fit.ratio, 0.0, fit.noise, jumps, self.turning.density)

    def offsets_s(self, fits: Sequence[CameraFit]) -> list[float]:
        """The frames' clock offset, s, as calibrated or without the rotation; two where both fit alike."""
        known = [fit.calibration.offset.value_s for fit in fits if fit.calibration.direction == self.view.axis]
        if known:
            return [known[0] - self.view.late_ns / NANOSECONDS]
        found = search_offset(self.pair, self.view.max_offset_s)
        other = found.runner_up
        if other is None or clearly_better(found.fit, other):
            return [found.fit.offset_s]
        return [found.fit.offset_s, other.offset_s]

    def without_tilt(self, place: Place) -> Pair:
        """The pair whose translation is without the tilt, and noisier by the gyroscope's."""
        rows, time_s = self.pair.rows.copy(), self.pair.rows[:, 0] + place.turned_s
        rows[:, 1] -= place.focal * self.turning.angle(time_s, self.pair.exposure_s)
        for number, jump in enumerate(place.jumps):
            rows[:, 1] -= jump * self.turning.jumped(time_s, number)
        return self.pair.changed(rows=rows, slow=place.slow)

    def joint(self, place: Place, focal: float | None = None, density_share: float = 1.0) -> Joint:
        """Displacement and rotation in the translation, with a focal length where one is given.

        density_share: of Θ's noise as it is reckoned with.
        """
        turning, gaps = self.turning, len(self.turning.gaps)
        pair, apart_s = self.pair.changed(slow=place.slow), place.turned_s - place.offset_s
        columns = [lambda time_s: turning.angle(time_s + apart_s, pair.exposure_s)]
        columns += [partial(lambda time_s, k: turning.jumped(time_s + apart_s, k), k=k) for k in range(gaps)]
        columns += [partial(lambda time_s, k: turning.walk(time_s + apart_s, k), k=k) for k in range(DRAWS)]
        columns += [partial(self._drawn, k, place.offset_s) for k in range(OWN_DRAWS)]
        w = aligned(pair, place.offset_s, *columns).whitened(place.corner)
        white = w.columns / np.sqrt(w.variance)[:, None]
        angle, jumped, walks, frames = np.split(white[:, -len(columns) :], (1, 1 + gaps, 1 + gaps + DRAWS), axis=1)
        other = np.column_stack((jumped, white[:, 3 : -len(columns)]))
        noisy = np.column_stack((white[:, :2], angle, white[:, 2], walks))
        free = noisy - other @ np.linalg.lstsq(other, noisy, rcond=None)[0] if other.shape[1] else noisy
        walked = place.density / turning.density * np.sum(free[:, 4:] ** 2, axis=0)
        own = place.noise * float(np.mean(np.sum(frames**2, axis=0)))
        noises = np.array([own, place.noise * w.input_share / place.ratio**2, density_share * float(np.mean(walked))])
        found = _solved(free[:, :4], noises, (float(np.std(walked)), place.doubt * float(np.mean(walked))), focal)
        left = noisy[:, 0] - noisy[:, 1:3] @ np.array([found.ratio, found.focal])
        return replace(found, jumps=np.linalg.lstsq(other, left, rcond=None)[0][:gaps] if gaps else np.empty(0))

    def _drawn(self, number: int, offset_s: float, time_s: Floats) -> Floats:
        """A draw of the frames' own noise (m,), in units of its variance."""
        relative = self.pair.rows[self.pair.used(offset_s), 2]
        return np.asarray(np.sqrt(relative) * np.random.default_rng(number).normal(size=len(time_s)))

    def settled(self, offset_s: float) -> Settled:
        """The likeliest r, f, clock offsets and noise levels near a clock offset of the frames."""
        self.begun = place = self.start(offset_s)
        return self.near(replace(place, turned_s=place.offset_s + self._scanned(place)))

    def near(self, place: Place, focal: float | None = None) -> Settled:
        """The same near a place, with a focal length where one is given."""
        factor = 1.0
        for turn in range(ROUNDS):
            before, found = place.focal, self.joint(place, focal)
            place = replace(place, ratio=found.ratio, focal=found.focal, jumps=found.jumps)
            step_s, turned_s = float(np.clip(found.step_s, -MAX_STEP_S, MAX_STEP_S)), self._clock_step(place)[0]
            place = replace(place, offset_s=place.offset_s + step_s, turned_s=place.turned_s + turned_s)
            place, fit = self._with_noise(place)
            pair = self.without_tilt(place)
            if turn == 1:
                unusable = np.isinf(cleaned(pair, fit).rows[:, 2])
                rows = np.column_stack((self.pair.rows[:, :2], np.where(unusable, np.inf, self.pair.rows[:, 2])))
                self.pair = self.pair.changed(rows=rows)
            if turn > 1 and abs(place.focal - before) < SETTLED * abs(place.focal):
                factor = misfit(pair, fit).factor
                break
        return self._judged(place, factor, focal)

    def _with_noise(self, place: Place) -> tuple[Place, Fit]:
        """The place with the likeliest noise levels, and its fit."""
        pair, unit = self.without_tilt(place), 0.5 * WALK_TIME_S * place.focal**2
        if unit == 0.0:
            fit = best_corner(pair, place.offset_s)
            return replace(place, corner=fit.corner, noise=fit.noise), fit

        @cache
        def fit_of(log_size: float) -> tuple[Fit, float, float]:
            size = float(np.exp(log_size))
            fit = best_corner(pair.changed(slow=(size, *place.slow[1:])), place.offset_s, place.corner)
            density = float(np.log(size * fit.noise / (unit * self.turning.density)))
            own = float(np.log(fit.noise / self.typical))
            return fit, density, 0.5 * ((density / DENSITY_STD) ** 2 + (own / NOISE_STD) ** 2) - fit.likelihood

        middle = float(np.log(unit * self.turning.density / self.typical))
        tried = middle + np.array(SIZES)
        best = global_minimum(lambda one: fit_of(one)[2], *tried[[0, -1]].tolist(), tried=len(tried), tolerance=0.1)
        fit, density, least = fit_of(best)
        weight = np.exp(least - np.array([fit_of(float(one))[2] for one in tried]))
        apart = np.array([fit_of(float(one))[1] for one in tried]) - density
        doubt = np.sqrt(weight @ apart**2 / np.sum(weight) + 2.0 / len(fit.whitened.variance))
        density = self.turning.density * float(np.exp(density))
        return replace(place, corner=fit.corner, noise=fit.noise, density=density, doubt=float(doubt)), fit

    def _alike(self, place: Place, aheads_s: Floats, draws: int = 0) -> Floats:
        """Products (k, 1 + draws) of what the displacement and its clock leave of the translation with Θ and draws of
        its noise at clocks of the gyroscope that are so much farther ahead (k,), s.
        """
        turning, apart_s = self.turning, place.turned_s - place.offset_s
        columns = list[Callable[[Floats], Floats]]()
        for ahead_s in apart_s + aheads_s:
            columns.append(partial(lambda t, late: turning.angle(t + late, self.pair.exposure_s), late=ahead_s))
            columns += [partial(lambda t, late, k: turning.walk(t + late, k), late=ahead_s, k=k) for k in range(draws)]
        gaps = [partial(lambda t, k: turning.jumped(t + apart_s, k), k=k) for k in range(len(turning.gaps))]
        pair = self.pair.changed(slow=place.slow)
        w = aligned(pair, place.offset_s, *gaps, *columns).whitened(place.corner)
        white = w.columns / np.sqrt(w.variance)[:, None]
        known = white[:, 1 : -len(columns)]
        left = white[:, 0] - known @ np.linalg.lstsq(known, white[:, 0], rcond=None)[0]
        return np.asarray(left @ white[:, -len(columns) :]).reshape(len(aheads_s), 1 + draws)

    def _scanned(self, place: Place) -> float:
        """By how much the gyroscope's clock is ahead of the accelerometer's where both go together best, s."""
        count = round(MAX_LATE_S / LATE_STEP_S)
        tried = LATE_STEP_S * np.arange(-count, count + 1, dtype=np.float64)
        # Half a period of a tone farther off the opposite sign is as good.
        alike = np.abs(self._alike(place, tried)[:, 0]) * (1.0 - FARTHER_COSTS * np.abs(tried) / MAX_LATE_S)
        return float(tried[int(np.argmax(alike))])

    def _clock_step(self, place: Place) -> tuple[float, float]:
        """Step (s) of the gyroscope's clock to where both go together best, and its variance, s²."""
        alike = self._alike(place, CLOCK_STEP_S * np.array([-1.0, 0.0, 1.0]), DRAWS)
        before, here, after = np.sign(place.focal) * alike
        curved = float(2.0 * here[0] - before[0] - after[0]) / CLOCK_STEP_S**2
        # Where nothing shows the offset, it may be any.
        unknown = place.offset_s - place.turned_s, USUAL_LATE_S**2
        if not curved > 0.0:
            return unknown
        slopes = 0.5 * (after - before) / CLOCK_STEP_S
        drawn = place.density / self.turning.density * float(np.mean(slopes[1:] ** 2))
        variance = CLOCK_FACTOR * (drawn / curved**2 + place.noise / (abs(place.focal) * curved))
        step_s = float(np.clip(slopes[0] / curved, -CLOCK_STEP_S, CLOCK_STEP_S))
        return (step_s, variance) if variance < MAX_CLOCK_STD_S**2 else unknown

    def _judged(self, place: Place, factor: float, focal: float | None) -> Settled:
        """What was found with its variances; factor: of the residual's power where that is not white."""
        found, turned = self.joint(place, focal), self._clock_step(place)[1]
        aside = [self.joint(replace(place, turned_s=place.turned_s + k * LATE_STEP_S), focal) for k in (-1, 1)]
        # The frames' clock offset goes with the gyroscope's.
        along = 0.5 * (aside[1].step_s - aside[0].step_s) / LATE_STEP_S
        clocks = turned, float((1.0 - along) ** 2 * turned + factor * found.step_variance)
        if focal is not None:
            return Settled(place, found, 0.0, *clocks)
        late = 0.5 * (aside[1].focal - aside[0].focal) / LATE_STEP_S * np.sqrt(turned)
        more = self.joint(place, density_share=1.0 + place.doubt).focal - found.focal
        return Settled(place, found, float(factor * found.focal_variance + more**2 + late**2), *clocks)

    def fit(self, at: Settled) -> Fit:
        """The fit without the tilt."""
        return best_corner(self.without_tilt(at.place), at.place.offset_s, at.place.corner)

    def scale(self, at: Settled) -> ScaleCalibration:
        """The scale factor without the tilt, of a focal length that is certain."""
        place = at.place
        pair, late_s = self.without_tilt(place), np.array([place.offset_s, 0.0, 0.0])
        pair = pair.changed(rows=pair.rows * np.array([1.0, 1.0, self.typical]) + late_s)
        declared = self.view.exposure_s is not None
        # The tilt was taken out at this clock offset.
        reach_s = min(self.view.max_offset_s, MAX_LATE_S)
        found = calibrate_scale(pair, reach_s, exposure_declared=declared, slow_errors=False)
        relative = float(np.hypot(found.response.relative_std, self._doubt(at)))
        response = replace(found.response, relative_std=relative)
        return replace(found, search=found.search.on_clock(place.offset_s), response=response)

    def _doubt(self, at: Settled) -> float:
        """What the gyroscope's clock offset makes of r, relative standard deviation."""
        place, late_s = at.place, float(np.sqrt(at.turned_variance))
        shifted = [replace(place, turned_s=place.turned_s + k * late_s) for k in (-1.0, 0.0, 1.0)]
        before, here, after = (evaluate(self.without_tilt(one), one.offset_s, one.corner).ratio for one in shifted)
        return float(np.sqrt(0.5 * ((before - here) ** 2 + (after - here) ** 2))) / abs(here)


def _solved(columns: Floats, noises: Floats, walked: tuple[float, float], focal: float | None) -> Joint:
    """Total least squares of translation, D, Θ and D' (n, 4), whitened; of all but f where that is given.

    noises (3,): in the sums of the first three; walked: scatter and doubt of the last one.
    """
    moved, angle = columns[:, 1], columns[:, 2]
    power, shared = float(moved @ moved), float(moved @ angle)
    known = float(angle @ angle) - shared**2 / power - float(noises[2])
    noisy = columns[:, :3]
    if focal is not None:
        noisy = np.column_stack((columns[:, 0] - focal * angle, moved))
        noises = np.array([noises[0] + focal**2 * noises[2], noises[1]])
    found, misfit = least_squares(noisy, noises)
    left, taken = noisy[:, 0] - noisy[:, 1:] @ found, np.append(misfit * noises[1:], 0.0)
    own = np.column_stack((noisy[:, 1:], found[0] * columns[:, 3]))
    inverse = inverse_of(own.T @ own - np.diag(taken))
    step = inverse @ (own.T @ left + taken * np.append(found, 0.0))
    covariance = inverse @ (float(left @ left) / len(left) * (own.T @ own)) @ inverse
    variance = 0.0
    if focal is None:
        focal = float(found[1])
        variance = float(covariance[1, 1] + (focal * walked[0] * inverse[1, 1]) ** 2)
    return Joint(
        ratio=float(found[0]),
        focal=focal,
        focal_variance=variance,
        step_s=float(step[-1]),
        step_variance=float(covariance[-1, -1]),
        drag=-shared / power,
        known=known / max(float(np.hypot(*walked)), 1e-300),
    )


def least_squares(columns: Floats, noises: Floats) -> tuple[Floats, float]:
    """Coefficients (k,) of the columns after the first one (n, 1 + k) that give it, and the power of what is left over
    that of the noises.
    """
    # In units of the noises, as columns are of very different ones.
    power = columns.T @ columns
    unit = np.sqrt(np.maximum(noises, 1e-12 * np.diag(power)))
    values, vectors = np.linalg.eigh(power / np.outer(unit, unit))
    least = vectors[:, 0] / unit
    return -least[1:] / least[0], float(values[0])
