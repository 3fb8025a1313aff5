"""By how much two targets of a camera differ beyond white noise, at any frame rate.

All targets are fixed, so their displacements differ by a constant and by noise that is white from frame to frame,
whatever its size. The spectrum of their difference tells that noise and what exceeds it: squares of white noise have
one mean in all bands (M. S. Bartlett, Properties of sufficiency and statistical tests, Proc. R. Soc. A 160 (1937)
268-282, doi 10.1098/rspa.1937.0109). Neither the acceleration nor any estimated noise takes part, both of which a tilt
of the camera would be taken for.

Which share q of that difference d, known with noise η only, is in one target's translation p is a regression:

    p(t) = s · (D(t) + x) + q · (d(t) − η(t)) + n

of innovations of both columns through the filter of `whitening`. Noise in the regressor draws it to zero (W. A. Fuller,
Measurement error models, Wiley 1987, chapter 1, doi 10.1002/9780470316665); its expected part in the sums is known from
draws of white noise that go the same way, and is taken out of them.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from midspan.calibration.agreement import misfit
from midspan.calibration.fit import Fit, Pair, aligned
from midspan.fusion.targets import AGREE_STD
from midspan.records import Floats

# Bands are octaves up to this many cosines, and as wide as that above: a slow tilt fills few of them, a bracket's
# resonance some tenths of a Hz. Cosines do not take a course that ends elsewhere than it began for a jump.
MAX_ORDINATES = 32
# One of a thousand pairs with white differences is taken for coloured.
COLOURED_BY_CHANCE = 1e-3
# Values farther from the middle than this many robust standard deviations belong to an outlier where they came there by
# a jump of this many, and where such outliers are no more than this share of the frames: what covers a target comes and
# goes, while a camera turns steadily.
FAR_STD, JUMP_STD, MAX_OUTLIERS = 8.0, 4.0, 0.08
# Rounds in which the motion's share in a difference is found together with what else is in each band.
ROUNDS = 4
# Fewer frames tell nothing.
MIN_FRAMES = 20
# Draws of noise: their mean is known to a third of one draw's scatter, and the same ones are used each time.
DRAWS, SEED = 12, 1


@dataclass(frozen=True, slots=True, eq=False)
class Difference:
    """What two targets differ by: noise_m: standard deviation of its white part from frame to frame; excess_m: rms of
    what exceeds it, 0 where it may be white; course_m (n,): that excess as a function of time, as far as its spectrum
    tells it from noise by `gains` (n,) of its cosines.
    """

    noise_m: float
    excess_m: float
    course_m: Floats
    gains: Floats

    @property
    def held_m(self) -> float:
        """Standard deviation that holds the excess in a row and in the zero, which is the first frame's."""
        since = float(np.mean((self.course_m - self.course_m[0]) ** 2))
        return max(self.excess_m, float(np.sqrt(0.5 * since)))

    def shaped(self, value: Floats) -> Floats:
        """What the course would hold of a series (n,)."""
        return _shaped(value, self.gains)

    def octaves(self) -> list["Difference"]:
        """The parts of the excess in each octave that has one."""
        # Bands of cosines begin at 1, 3, 7, 15 …
        order = np.floor(np.log2(np.arange(len(self.gains)) + 1.0))
        parts = []
        for octave in np.unique(order[self.gains > 0.0]):
            here = order == octave
            course = _shaped(self.course_m, here.astype(np.float64))
            parts.append(Difference(self.noise_m, float(np.std(course)), course, np.where(here, self.gains, 0.0)))
        return parts


def difference(value: Floats, variance: Floats, motion: Floats, scale_std: float) -> Difference:
    """Compare two targets by the difference of their displacements.

    value (n,): difference, m, NaN where either is not seen; variance (n,): finite and above 0 where both are seen;
    motion (n,): the displacement itself, m; scale_std: relative standard deviation of the ratio of both scale factors,
    infinite where nothing is known of it.
    """
    usable = np.isfinite(value) & np.isfinite(variance) & (variance > 0.0)
    nothing = Difference(np.nan, 0.0, np.zeros(len(value)), np.zeros(len(value)))
    if np.count_nonzero(usable) < MIN_FRAMES:
        return nothing
    left = np.where(usable, value, np.nan)
    left = left - np.nanmedian(left)
    # Robust, by the steps from each usable value to the next.
    steps = np.diff(left[np.isfinite(left)])
    usable &= ~_outliers(left, float(np.median(np.abs(steps)) / (0.6745 * np.sqrt(2.0))) + 1e-15)
    bands = _bands(len(value))
    if len(bands) < 3:
        return nothing
    left = _without_motion(left, motion - np.mean(motion), usable, (bands, scale_std))
    # A frame that is missing has no noise of its own: what is filled in there is the course alone.
    filled = _filled(left, usable)
    for _ in range(2):
        power = _cosines(filled) ** 2
        noise, exceeding = _floor(power, bands)
        gains = np.zeros(len(power))
        for band in exceeding:
            gains[band] = max(1.0 - noise / max(float(np.mean(power[band])), 1e-300), 0.0)
        course = _shaped(filled, gains)
        filled = np.where(usable, left, course)
    std = float(np.sqrt(noise * len(usable) / np.count_nonzero(usable)))
    if not exceeding:
        return replace(nothing, noise_m=std)
    excess = max(float(np.mean(left[usable] ** 2)) - std**2, 0.0)
    return Difference(std, float(np.sqrt(excess)), course, gains)


def _cosines(value: Floats) -> Floats:
    from scipy.fft import dct

    return np.asarray(dct(value, norm="ortho"))


def _shaped(value: Floats, gains: Floats) -> Floats:
    from scipy.fft import idct

    return np.asarray(idct(_cosines(value) * gains, norm="ortho"))


def _outliers(value: Floats, std: float) -> NDArray[np.bool_]:
    """Frames of runs far from the middle that begin or end with a jump, where these are few."""
    place = np.flatnonzero(np.isfinite(value))
    far = np.zeros(len(value) + 2, dtype=bool)
    far[1:-1][place] = np.abs(value[place]) > FAR_STD * std
    edges = np.flatnonzero(np.diff(far.astype(np.int8)))
    found = np.zeros(len(value), dtype=bool)
    for begin, end in zip(edges[::2], edges[1::2], strict=True):
        outside = [k for k in (begin - 1, end) if 0 <= k < len(value) and np.isfinite(value[k])]
        inner = {begin - 1: begin, end: end - 1}
        if any(abs(value[inner[k]] - value[k]) > JUMP_STD * np.sqrt(2.0) * std for k in outside):
            found[begin:end] = True
    return found if np.count_nonzero(found) <= MAX_OUTLIERS * len(place) else np.zeros(len(value), dtype=bool)


def _filled(value: Floats, usable: NDArray[np.bool_]) -> Floats:
    return np.interp(np.arange(len(value)), np.flatnonzero(usable), value[usable])


def _without_motion(
    value: Floats, motion: Floats, usable: NDArray[np.bool_], known: tuple[list[slice], float]
) -> Floats:
    """The difference without its mean and the share of the motion that the scale factors' ratio may be off by."""
    bands, scale_std = known
    left = value - np.mean(value[usable])
    whole, moved = _cosines(_filled(left, usable)), _cosines(motion)
    share = 0.0
    for _ in range(ROUNDS):
        power = np.full(len(whole), np.inf)
        for band in bands:
            power[band] = max(float(np.mean((whole[band] - share * moved[band]) ** 2)), 1e-300)
        share = float(np.sum(moved * whole / power)) / (float(np.sum(moved**2 / power)) + scale_std**-2.0 + 1e-300)
    out = left - share * motion
    return np.asarray(out - np.mean(out[usable]))


def _bands(count: int) -> list[slice]:
    begin, width, out = 1, 2, list[slice]()
    while begin + width <= count:
        out.append(slice(begin, begin + width))
        begin, width = begin + width, min(2 * width, MAX_ORDINATES)
    return out


def _floor(power: Floats, bands: list[slice]) -> tuple[float, list[slice]]:
    """Level of the white part, as the mean of the most bands that may have one mean, and the bands that exceed it."""
    means = np.array([float(np.mean(power[band])) for band in bands])
    counts = np.array([band.stop - band.start for band in bands], dtype=np.float64)
    order = np.argsort(means)
    means, counts = means[order], counts[order]
    alike = next((k for k in range(len(means), 1, -1) if not _differ(means[:k], counts[:k])), 1)
    level = float(np.average(means[:alike], weights=counts[:alike]))
    return level, [bands[k] for k in order[alike:]]


def _differ(means: Floats, counts: Floats) -> bool:
    """Whether band means of squared normal values cannot have one mean: Bartlett's test, with his correction."""
    from scipy.special import gammainccinv

    free, total = len(means) - 1, float(np.sum(counts))
    apart = np.log(np.average(means, weights=counts)) - np.log(np.maximum(means, 1e-300))
    gain = 0.5 * float(np.sum(counts * apart))
    correction = 1.0 + (float(np.sum(1.0 / counts)) - 1.0 / total) / (3.0 * free)
    return bool(gain / correction > gammainccinv(0.5 * free, COLOURED_BY_CHANCE))


@dataclass(frozen=True, slots=True, eq=False)
class Course:
    """A course: time_s (n,) on the translation's clock, value_px (n,).

    shaped: what became of a series (n,) of white noise in it; noise_px: standard deviation of that series;
    part_of_noise: share of its variance that is the translation's own noise.
    """

    time_s: Floats
    value_px: Floats
    shaped: Callable[[Floats], Floats]
    noise_px: float
    part_of_noise: float


@dataclass(frozen=True, slots=True)
class Share:
    """A share with its standard deviation: std + growth · |share|; infinite where nothing tells it."""

    value: float
    std: float
    growth: float

    def allows(self, share: float) -> bool:
        """Whether it may be this one."""
        return not abs(self.value - share) > AGREE_STD * np.hypot(self.std, self.growth * share)


def share_in(pair: Pair, fit: Fit, course: Course) -> Share:
    """The share of a course in a translation whose fit is given."""
    rng = np.random.default_rng(SEED)
    noise = course.noise_px * rng.normal(0.0, 1.0, (DRAWS, len(course.time_s)))
    columns = [course.value_px, *(course.shaped(one) for one in noise), *noise]

    def at(values: Floats) -> Callable[[Floats], Floats]:
        return lambda time_s: np.interp(time_s - fit.offset_s, course.time_s, values)

    w = aligned(pair, fit.offset_s, *(at(one) for one in columns)).whitened(fit.corner)
    own, added = w.columns[:, 0], w.columns[:, -len(columns) :]
    power = max(w.product(w.response, w.response), 1e-300)

    def without_motion(column: Floats) -> Floats:
        return np.asarray(column - w.product(column, w.response) / power * w.response)

    own = without_motion(own)
    known, *drawn = (without_motion(added[:, k]) for k in range(len(columns)))
    shaped, raw = drawn[:DRAWS], drawn[DRAWS:]
    squares = np.array([w.product(one, one) for one in shaped])
    products = np.array([w.product(one, other) for one, other in zip(shaped, raw, strict=True)])
    left = w.product(known, known) - float(np.mean(squares))
    scatter = float(np.std(squares))
    if left <= AGREE_STD * scatter:
        return Share(0.0, np.inf, 0.0)
    value = (w.product(own, known) - course.part_of_noise * float(np.mean(products))) / left
    white = fit.noise * misfit(pair, fit).factor
    std = np.sqrt(white * w.product(known, known) + (course.part_of_noise * float(np.std(products))) ** 2) / left
    return Share(value, float(std), scatter / left)
