"""Shapes by which the ratio of translation and acceleration depends on frequency, and their regression.

See `frequency_response`.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from enum import IntEnum
from functools import lru_cache

import numpy as np

from midspan.calibration.fit import PRIOR_POWER, Fit, Pair, aligned, kept, likeliest_corner
from midspan.calibration.whitening import Response, Whitened, integrated, inverse_of
from midspan.records import Floats
from midspan.signals.acceleration import GRAVITY_M_S2
from midspan.signals.health import dominant_frequency

# Steeper slopes are none: a cantilever of 9 m.
MAX_SLOPE = 0.15
# An accelerometer that reads this much all the time, m/s², is upright: gravity's share goes with its tilt squared.
VERTICAL_M_S2 = 9.0
# The slowest mode ends at its frequency times this.
MODE_CORNER = 2.5
# The camera's tilt moves the image by this many px a radian at least: a wide lens.
MIN_FOCAL_PX = 300.0
# Parts of the record by which the scatter of a coefficient is judged: each several periods of the slowest motion.
PARTS = 12
# No resonance lies below this, Hz: the motion itself would be beyond it.
MIN_RESONANCE_HZ = 2.0
# Columns of what is whitened: translation, response, velocity; then one for each kind.
RESPONSE, VELOCITY, FIRST = 1, 2, 3


class Kind(IntEnum):
    """What makes the ratio depend on frequency; its number is that of its column, from FIRST on."""

    EXPOSURE = 0
    LEAN = 1
    LAG = 2
    DROOP = 3
    RESONANCE = 4
    SIGHT = 5


@dataclass(frozen=True, slots=True)
class Seen:
    """What the camera alone shows at the samples: displacement (n,) in m, tilt besides (n,) in px or None."""

    moved_m: Floats
    tilted_px: Floats | None

    def integrated(self, samples: Floats) -> "Integrated":
        """As accelerations at samples (n, 3)."""

        def twice(values: Floats) -> Response:
            return integrated(np.column_stack((samples[:, 0], values, samples[:, 2])))

        return Integrated(twice(self.moved_m), None if self.tilted_px is None else twice(self.tilted_px))


@dataclass(frozen=True, slots=True)
class Integrated:
    """What the camera shows, integrated twice."""

    moved: Response
    tilted: Response | None


@dataclass(frozen=True, slots=True)
class Term:
    """One kind: its column at times (s), the pair with its number changed, and whether that may be.

    column: by the pair and what the camera alone shows, integrated; changed: with that at the samples; possible:
    exposure, slope, droop and resonance are positive, and no more than they can be.
    """

    column: Callable[[Pair, "Integrated", Floats], Floats]
    changed: Callable[[Pair, float, "Seen"], Pair]
    possible: Callable[[Pair, float], bool]


def _exposed(pair: Pair, change: float, _: Seen) -> Pair:
    square = max(pair.exposure_s**2 + 24.0 * change, 0.0)
    return pair.changed(exposure_s=min(float(np.sqrt(square)), 1.0 / pair.rate_hz))


def _with_acceleration(pair: Pair, more: Floats, **fields: float) -> Pair:
    samples = pair.samples.copy()
    samples[:, 1] += more
    return pair.changed(samples=samples, **fields)


def _leaning(pair: Pair, change: float, seen: Seen) -> Pair:
    return _with_acceleration(pair, change * seen.moved_m, lean=pair.lean + change)


def _sighted(pair: Pair, change: float, seen: Seen) -> Pair:
    assert seen.tilted_px is not None
    return _with_acceleration(pair, change * seen.tilted_px, sight=pair.sight + change)


def _tilted(seen: Integrated, time_s: Floats) -> Floats:
    assert seen.tilted is not None
    return seen.tilted.at(time_s)


def with_logger(pair: Pair, square: float, cube: float) -> Pair:
    """The pair with a logger's low-pass of so much more in it."""
    return pair.changed(logger=(pair.logger[0] + square, pair.logger[1] + cube))


TERMS = {
    Kind.EXPOSURE: Term(
        lambda pair, _, time_s: pair.responses[0].widened(time_s, pair.exposure_s),
        _exposed,
        lambda pair, change: 0.0 < pair.exposure_s**2 + 24.0 * change <= 1.0 / pair.rate_hz**2,
    ),
    Kind.LEAN: Term(
        lambda _, seen, time_s: seen.moved.at(time_s),
        _leaning,
        lambda pair, change: 0.0 < pair.lean + change < GRAVITY_M_S2 * MAX_SLOPE,
    ),
    Kind.LAG: Term(
        lambda pair, _, time_s: pair.responses[0].shaken(time_s, 1),
        lambda pair, change, _: with_logger(pair, 0.0, change),
        lambda pair, change: True,
    ),
    Kind.DROOP: Term(
        lambda pair, _, time_s: -pair.responses[0].shaken(time_s, 0),
        lambda pair, change, _: with_logger(pair, -change, 0.0),
        lambda pair, change: pair.logger[0] - change < 0.0,
    ),
    Kind.RESONANCE: Term(
        lambda pair, _, time_s: pair.responses[0].shaken(time_s, 0),
        lambda pair, change, _: with_logger(pair, change, 0.0),
        lambda pair, change: 0.0 < pair.logger[0] + change < (2.0 * np.pi * MIN_RESONANCE_HZ) ** -2,
    ),
    Kind.SIGHT: Term(
        lambda _, seen, time_s: _tilted(seen, time_s),
        _sighted,
        lambda pair, change: abs(pair.sight + change) < GRAVITY_M_S2 / MIN_FOCAL_PX,
    ),
}
# What is compared, each as a whole.
SHAPES = (
    (Kind.EXPOSURE,),
    (Kind.LEAN,),
    (Kind.SIGHT, Kind.LEAN),
    (Kind.LAG,),
    (Kind.DROOP,),
    (Kind.LAG, Kind.DROOP),
    (Kind.RESONANCE,),
    (Kind.RESONANCE, Kind.LAG),
)
# They make the ratio fall with the frequency's square, as a sensor of first order does.
FALLING = (Kind.EXPOSURE, Kind.RESONANCE)
# One of each at most: one number with two signs; two that differ in the fourth power of the frequency only.
ALIKE = ({Kind.DROOP, Kind.RESONANCE}, {Kind.EXPOSURE, Kind.RESONANCE})


@dataclass(frozen=True, slots=True)
class Regression:
    """The translation regressed on some of the columns, at its most likely corner frequency (rad/s).

    free: the columns' numbers; coefficients (k,) and covariance (k, k) in their order. scatter: variance of the last
    coefficient by how far parts of the record differ in it, over that in the covariance; 1 at least.
    """

    free: tuple[int, ...]
    corner: float
    likelihood: float
    coefficients: Floats
    covariance: Floats
    scatter: float = 1.0

    def of(self, kind_column: int) -> tuple[float, float]:
        """The coefficient of a column over the ratio, and its standard deviation."""
        k, ratio = self.free.index(kind_column), self.coefficients[0]
        return float(self.coefficients[k] / ratio), float(np.sqrt(self.covariance[k, k])) / abs(float(ratio))


class Columns:
    """A pair at the offset of a fit with one column for each kind; whitened once at each corner frequency."""

    def __init__(
        self, pair: Pair, fit: Fit, *, slow: bool = False, waves: Sequence[Callable[[Floats], Floats]] = ()
    ) -> None:
        self.seen = seen_by(pair, fit)
        if slow:
            self.seen = replace(self.seen, moved_m=_slow(self.seen.moved_m, pair.sample_rate_hz))
        twice = self.seen.integrated(pair.samples)

        def column(kind: Kind) -> Callable[[Floats], Floats]:
            return lambda time_s: TERMS[kind].column(pair, twice, time_s)

        self._pair = pair
        able = [kind for kind in Kind if kind is not Kind.SIGHT or shows_gravity(pair)]
        first = FIRST + len(able)
        self._waves = tuple(range(first, first + len(waves)))
        here = aligned(pair, fit.offset_s, *(column(kind) for kind in able), *waves)
        self.whitened = lru_cache(kept(here.columns.rows))(here.whitened)

    def regressed(self, known: Sequence[Kind]) -> Regression:
        """The most likely regression on the columns of some kinds."""
        free = (*free_columns(known), *self._waves)
        corner = likeliest_corner(self._pair, lambda one: regressed_at(self.whitened(one), free, one).likelihood)
        w = self.whitened(corner)
        found = regressed_at(w, free, corner)
        return replace(found, scatter=_scatter(w, found))


def free_columns(known: Sequence[Kind]) -> tuple[int, ...]:
    """The columns of a regression on some kinds: response, velocity, one for each kind."""
    return (RESPONSE, VELOCITY, *(FIRST + kind for kind in known))


def seen_by(pair: Pair, fit: Fit) -> Seen:
    """What the camera shows at the samples, about its mean; beyond its ends as there."""
    from scipy.interpolate import CubicSpline

    def at_samples(values: Floats) -> Floats:
        used = np.isfinite(pair.rows[:, 2]) & np.isfinite(values)
        own_s = pair.rows[used, 0] + fit.offset_s
        time_s = np.clip(pair.samples[:, 0], own_s[0], own_s[-1])
        return np.asarray(CubicSpline(own_s, values[used])(time_s) - values[used].mean())

    moved_m = np.asarray(at_samples(pair.rows[:, 1]) / fit.ratio)
    if pair.seen is None or not shows_gravity(pair):
        return Seen(moved_m, None)
    tilted_px = at_samples(pair.seen)
    # What goes with the displacement is the slope's.
    return Seen(moved_m, tilted_px - float(tilted_px @ moved_m) / float(moved_m @ moved_m) * moved_m)


def _slow(moved_m: Floats, rate_hz: float) -> Floats:
    """The part of a displacement (n,) in its slowest mode."""
    from scipy.signal import butter, sosfiltfilt

    corner_hz = MODE_CORNER * dominant_frequency(moved_m, rate_hz)
    if not 0.0 < corner_hz < 0.5 * rate_hz:
        return moved_m
    return np.asarray(sosfiltfilt(butter(2, corner_hz, fs=rate_hz, output="sos"), moved_m))


def regressed_at(w: Whitened, free: tuple[int, ...], corner: float) -> Regression:
    """The regression on columns at a corner frequency (rad/s)."""
    coefficients, covariance, left = solved(w, free)
    n = len(w.variance)
    likelihood = -0.5 * n * np.log(left / n) + PRIOR_POWER * float(np.log(corner)) - w.entropy
    return Regression(free, corner, float(likelihood), coefficients, covariance)


def solved(w: Whitened, free: tuple[int, ...], last_std: float | None = None) -> tuple[Floats, Floats, float]:
    """Coefficients (k,), covariance (k, k), and what is left of the squares; last_std: prior of the last one."""
    power, cross = w.regression(w.columns[:, list(free)])
    coefficients = inverse_of(power) @ cross
    left = max(w.product(w.translation, w.translation) - float(coefficients @ cross), 1e-300)
    noise = left / max(len(w.variance) - len(free), 1)
    if last_std is not None:
        power[-1, -1] += noise / last_std**2
    return coefficients, noise * inverse_of(power), left


def _scatter(w: Whitened, found: Regression) -> float:
    """Variance of the last coefficient by parts of the record over that of white innovations; 1 at least.

    Sums of its score over parts scatter as the errors do that are correlated and go with the motion as well (K.-Y.
    Liang, S. L. Zeger, Biometrika 73 (1986) 13-22, doi 10.1093/biomet/73.1.13).
    """
    columns = w.columns[:, list(found.free)] / np.sqrt(w.variance)[:, None]
    left = w.translation / np.sqrt(w.variance) - columns @ found.coefficients
    last = columns @ inverse_of(columns.T @ columns)[:, -1]
    sums = np.array([np.sum(part) for part in np.array_split(last * left, PARTS)])
    white = float(np.mean(left**2)) * float(np.sum(last**2))
    return max(float(np.sum(sums**2)) / white, 1.0) if white > 0.0 else 1.0


def _is_upright(pair: Pair) -> bool:
    """Whether gravity's share of the acceleration goes with the square of a tilt."""
    return abs(pair.level_m_s2) > VERTICAL_M_S2


def shows_gravity(pair: Pair) -> bool:
    """Whether another target shows the tilt by which gravity enters the acceleration."""
    return pair.seen is not None and not _is_upright(pair)


def kinds_of(pair: Pair, *, exposure_declared: bool) -> tuple[Kind, ...]:
    """The kinds that may be there: none where a band decides the ratio."""
    if pair.outside is not None:
        return ()
    excluded = {Kind.EXPOSURE} if exposure_declared else set[Kind]()
    if _is_upright(pair):
        excluded.add(Kind.LEAN)
    if not shows_gravity(pair):
        excluded.add(Kind.SIGHT)
    return tuple(kind for kind in Kind if kind not in excluded)
