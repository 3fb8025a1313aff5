"""Innovations of a measured translation and of the acceleration integrated twice, through one and the same filter.

The translation p of the image (px) follows the displacement divided by the scale factor. The acceleration integrated
twice, D, is the displacement but for what integration leaves open and what the accelerometer's bias b and white noise w
add to it:

    p(t) = s · (D(t + offset) + x) + noise,   x' = v,   v' = −b − w

with s the inverse scale factor. So a filter with the states x, v, b and no input whitens p − s D, and its innovations
are linear in s. Where the noise is coloured (the slow error of a GNSS receiver), a fourth state is the coloured part, a
first-order Gauss-Markov process. Gains and covariance depend on neither signal: one run whitens any number of columns,
such as p, D at many offsets, and D' (the velocity), by which the innovations change with the offset. The filter steps
from measurement to measurement, and D is known at any instant: nothing is resampled, an aliased camera is treated
exactly.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from midspan import _core
from midspan.records import Floats

if TYPE_CHECKING:
    from scipy.interpolate import CubicHermiteSpline

# The first innovations only settle the unknown start and say nothing about the noise.
SETTLING = 3
# The bias walk that belongs to an acceleration noise, (rad/s)².
BIAS_WALK_RATIO = _core.BIAS_WALK_RATIO
# Measurements without a slow error: its variance, a rate (1/s) and an angular frequency without effect then.
NO_SLOW_ERROR = (0.0, 1.0, 0.0)
# The mean over an exposure by ten points of Gauss and Legendre, in exposures from its middle: right to 1e-6 up to two
# periods of a motion. Below this exposure its derivative is that at none.
NODES, WEIGHTS = (part / 2.0 for part in np.polynomial.legendre.leggauss(10))
MIN_EXPOSURE_S = 1e-3


@dataclass(frozen=True)
class Response:
    """An acceleration integrated twice.

    The displacement in m is a cubic in each interval: edges_s (n + 1,), its coefficients (n, 4), the third power first;
    pieces (g, 2): times until which the relative density of the acceleration's noise is constant, and that density.
    """

    edges_s: Floats
    cubics: Floats
    pieces: Floats

    def at(self, time_s: Floats, exposure_s: float = 0.0, logger: tuple[float, float] = (0.0, 0.0)) -> Floats:
        """Displacement (...,) in m, the mean over exposures around instants (...,).

        logger: so much of the second derivative (s²) and of the third one (s³) in addition, as behind a low-pass.
        """
        moved = self._mean(time_s, exposure_s, 0)
        if logger == (0.0, 0.0):
            return moved
        return moved + logger[0] * self.shaken(time_s, 0) + logger[1] * self.shaken(time_s, 1)

    def shaken(self, time_s: Floats, order: int) -> Floats:
        """The acceleration (...,), m/s², or its first derivative, between its samples by cubics.

        Straight lines, as `derivative` has them, weaken motion of ω by (ω h)²/12, h the interval of the samples.
        """
        return np.asarray(self._shaken(np.clip(time_s, self.edges_s[0], self.edges_s[-1]), order))

    @cached_property
    def _shaken(self) -> "CubicHermiteSpline":
        from scipy.interpolate import CubicHermiteSpline

        value = self.derivative(self.edges_s, 2)
        # Slopes of parabolas through neighbours: at a gap nothing rings.
        return CubicHermiteSpline(self.edges_s, value, np.gradient(value, self.edges_s))

    def velocity(self, time_s: Floats, exposure_s: float = 0.0) -> Floats:
        """Velocity (...,) in m/s at instants (...,), each the mean over an exposure about it."""
        return self._mean(time_s, exposure_s, 1)

    def _mean(self, time_s: Floats, exposure_s: float, order: int) -> Floats:
        if exposure_s == 0.0:
            return self.derivative(time_s, order)
        parts = (w * self.derivative(time_s + n * exposure_s, order) for n, w in zip(NODES, WEIGHTS, strict=True))
        return np.asarray(sum(parts))

    def widened(self, time_s: Floats, exposure_s: float) -> Floats:
        """What one s² of exposure²/24 more makes of the mean over an exposure (...,), m/s²."""
        if exposure_s < MIN_EXPOSURE_S:
            return self.derivative(time_s, 2)
        ends = 0.5 * sum(self.derivative(time_s + side * exposure_s, 0) for side in (-0.5, 0.5))
        return 12.0 / exposure_s**2 * (ends - self.at(time_s, exposure_s))

    def derivative(self, time_s: Floats, order: int) -> Floats:
        """The derivative of an order up to 3; beyond the edges that of the cubic there."""
        time_s = np.ascontiguousarray(time_s, dtype=np.float64)
        return _core.derivative(self.edges_s, self.cubics, time_s.reshape(-1), order).reshape(time_s.shape)


def integrated(samples: Floats) -> Response:
    """Samples (n, 3) of time (s), acceleration (m/s²) and relative noise density, integrated twice as in the filters.

    A sample's value holds for one interval before the first one.
    """
    first = 2.0 * samples[0, 0] - samples[1, 0]
    time_s, value = np.r_[first, samples[:, 0]], np.r_[samples[0, 1], samples[:, 1]]
    last = np.r_[np.flatnonzero(np.diff(samples[:, 2])), len(samples) - 1]
    return Response(time_s, _core.integrate(time_s, value), samples[last][:, [0, 2]].copy())


@dataclass(frozen=True, slots=True)
class Whitened:
    """Innovations of columns of measurements, (k, c), without the first ones, which only settle the unknown start.

    Columns as whitened: the translation, the response to the acceleration, and others. variance (k,): of the
    innovations, in units of the noise variance of the translation; input_part (k,): its share that comes from
    accelerometer noise; index (k,): which measurement each belongs to. bias (c,): the filter's bias after the last
    sample out of each column, in its unit/s²; bias_variance: in units of the noise variance / s⁴.
    """

    columns: Floats
    variance: Floats
    input_part: Floats
    index: NDArray[np.int64]
    bias: Floats
    bias_variance: float

    @property
    def translation(self) -> Floats:
        """Innovations (k,) of the first column."""
        return self.columns[:, 0]

    @property
    def response(self) -> Floats:
        """Innovations (k,) of the second column."""
        return self.columns[:, 1]

    def product(self, first: Floats, second: Floats) -> float:
        """Sum of the products of two innovations (k,) over their variance."""
        # Not by BLAS, whose threads cost more than these sums.
        return float(np.add.reduce(first * second / self.variance))

    @property
    def input_share(self) -> float:
        """The number of innovations that are accelerometer noise: their shares summed up."""
        return share_of(self.input_part, self.variance)

    @property
    def entropy(self) -> float:
        """Half the sum of the logarithms of the variances."""
        return entropy_of(self.variance)

    def regression(self, columns: Floats) -> tuple[Floats, Floats]:
        """Products (c, c) of columns (k, c) with each other and (c,) with the translation, over the variance."""
        power = np.einsum("mi,mj,m->ij", columns, columns, 1.0 / self.variance)
        return power, np.einsum("mi,m->i", columns, self.translation / self.variance)


def share_of(input_part: Floats, variance: Floats) -> float:
    """The number of innovations that are accelerometer noise, as of `Whitened`."""
    return float(np.add.reduce(input_part / variance))


def entropy_of(variance: Floats) -> float:
    """Half the sum of the logarithms of variances."""
    return 0.5 * float(np.add.reduce(np.log(variance)))


def inverse_of(power: Floats) -> Floats:
    """The inverse of a matrix (k, k) of products of columns whose units differ; what none determines is left out."""
    size = np.sqrt(np.maximum(np.diag(power), 1e-300))
    return np.asarray(np.linalg.pinv(power / np.outer(size, size), hermitian=True) / np.outer(size, size))


def levelled(time_s: Floats, values: Floats, *, drifts: bool) -> tuple[Floats, Floats]:
    """Columns (m, c) of values without what is open of them, and of that (2, c) the second derivative at the last row
    and the third one.

    A parabola is what the filter's unknown start leaves open: taken out first, it need not pass the filter. A bias that
    drifts at one rate leaves a cubic open.
    """
    middle, half = 0.5 * (time_s[0] + time_s[-1]), 0.5 * (time_s[-1] - time_s[0])
    u = (time_s - middle) / half
    basis, shape = np.linalg.qr(np.column_stack((np.ones(len(u)), u, u * u, u * u * u)))
    share = np.einsum("mk,mc->kc", basis, values)
    if not drifts:
        share[3] = 0.0
    left = values - np.einsum("mk,kc->mc", basis, share)
    cubic = 6.0 * share[3] / shape[3, 3]
    square = 2.0 * (share[2] - shape[2, 3] * share[3] / shape[3, 3]) / shape[2, 2]
    return left, np.stack(((square + cubic) / half**2, cubic / half**3))


def whiten_columns(
    rows: Floats,
    values: Floats,
    pieces: Floats,
    density: float,
    *,
    late_s: Floats | None = None,
    slow: tuple[float, float, float] = NO_SLOW_ERROR,
    index: NDArray[np.int64] | None = None,
    open_bias: Floats | float = 0.0,
) -> Whitened:
    """Run columns (m, c) of levelled values at rows (m, 2) of time (s) and relative variance through the filter.

    pieces: as of `Response`; density: noise density of the acceleration times s² in units of the noise variance; late_s
    (m, c): where the lateness of a column's stamps changes, so does the time that its states move on; slow: as of
    `Pair`; index (m,): of the measurements, else counted; open_bias (c,): what levelling took from the bias.
    """
    longer = None if late_s is None else np.diff(late_s, axis=0, prepend=late_s[:1])
    coloured = slow if slow[0] > 0.0 else None
    found, variance, input_part, bias, bias_variance = _core.whiten(pieces, rows, values, density, coloured, longer)
    index = np.arange(len(rows)) if index is None else index
    s = slice(SETTLING, None)
    return Whitened(found[s], variance[s], input_part[s], index[s], bias - open_bias, bias_variance)


@dataclass(frozen=True, slots=True)
class Products:
    """Sums over innovations of their products, over the variance.

    squares (c,): of each column; with_first (c,): of each one with the first; with_later (c − apart,): of each one with
    the column `apart` places after it; count: of innovations; entropy, input_share: as of `Whitened`.
    """

    squares: Floats
    with_first: Floats
    with_later: Floats
    count: int
    entropy: float
    input_share: float


def products_of(rows: Floats, values: Floats, pieces: Floats, density: float, apart: int = 0) -> Products:
    """What `whiten_columns` leaves summed up, for many columns: their innovations are not kept."""
    values = np.ascontiguousarray(values)
    sums = _core.whitened_products(pieces, rows, values, density, apart, SETTLING)
    squares, with_first, with_later, variance, input_part = sums
    variance, input_part = variance[SETTLING:], input_part[SETTLING:]
    entropy, share = entropy_of(variance), share_of(input_part, variance)
    return Products(squares, with_first, with_later, len(variance), entropy, share)


def usable(rows: Floats, offset_s: float, span_s: tuple[float, float]) -> NDArray[np.int64]:
    """Which rows (m, 3) of time, value and variance are used and, so much later, lie within the acceleration."""
    time_s = rows[:, 0] + offset_s
    return np.flatnonzero(np.isfinite(rows[:, 2]) & (time_s >= span_s[0]) & (time_s <= span_s[1]))
