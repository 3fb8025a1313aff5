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

import numpy as np
from numba import njit
from numpy.typing import NDArray

from midspan.calibration.state_space import (
    P00,
    P01,
    P02,
    P22,
    TIME,
    V,
    X,
    add_noise,
    advance_covariance,
    advance_mean,
    begin_interval,
    initial_state,
    input_response,
    predict_covariance,
    update_covariance,
)
from midspan.records import Floats

# Before the first measurements everything is unknown: variances far above any noise, in units of the noise variance.
DIFFUSE = (1e9, 1e9, 1e9)
# The first innovations only settle the unknown start and say nothing about the noise.
SETTLING = 3
# The bias walk that belongs to an acceleration noise, (rad/s)²: bias errors below 0.01 Hz are left to the displacement.
BIAS_WALK_RATIO = 0.003
# Measurements without a slow error: its variance, and a rate (1/s) that has no effect then.
NO_SLOW_ERROR = (0.0, 1.0)
# The mean over an exposure by ten points of Gauss and Legendre, in exposures from its middle: right to 1e-6 up to two
# periods of a motion. Below this exposure its derivative is that at none.
NODES, WEIGHTS = (part / 2.0 for part in np.polynomial.legendre.leggauss(10))
MIN_EXPOSURE_S = 1e-3
# Longest step of the covariance, s: within it the walk of the bias reaches the displacement by 1 % of the noise's part.
MAX_STEP_S = 5.0


@dataclass(frozen=True, slots=True)
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
        return moved + logger[0] * self.derivative(time_s, 2) + logger[1] * self.derivative(time_s, 3)

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
        found = np.empty(np.shape(time_s))
        _evaluate(self.edges_s, self.cubics, np.ascontiguousarray(time_s).reshape(-1), order, found.reshape(-1))
        return found


@njit(cache=True)
def _integrate(time_s, value, state, out):  # type: ignore[no-untyped-def]
    """Coefficients (n - 1, 4) of the displacement in each interval, of the third power first."""
    for k in range(len(time_s) - 1):
        dt = time_s[k + 1] - time_s[k]
        slope = (value[k + 1] - value[k]) / dt
        lead = begin_interval(state, dt, value[k], value[k + 1])
        out[k, 0], out[k, 1], out[k, 2], out[k, 3] = slope / 6.0, 0.5 * value[k], state[V] - lead * slope, state[X]
        advance_mean(state, dt, (0.0, 0.0), input_response(1.0, dt, value[k], value[k + 1], lead))


@njit(cache=True)
def _evaluate(edges_s, cubics, time_s, order, out):  # type: ignore[no-untyped-def]
    """The derivative of an order up to 3 of cubics (n, 4) between edges (n + 1,) at instants (m,), to `out` (m,)."""
    k = 0
    for j in range(len(time_s)):
        if not (edges_s[k] <= time_s[j] and (k + 2 == len(edges_s) or time_s[j] < edges_s[k + 1])):
            k = min(max(np.searchsorted(edges_s, time_s[j], side="right") - 1, 0), len(cubics) - 1)
        s, c = time_s[j] - edges_s[k], cubics[k]
        if order == 0:
            out[j] = c[3] + c[2] * s + c[1] * (s * s) + c[0] * (s * s * s)
        elif order == 1:
            out[j] = c[2] + c[1] * s * 2.0 + c[0] * (s * s) * 3.0
        elif order == 2:
            out[j] = c[1] * 2.0 + c[0] * s * 6.0
        else:
            out[j] = c[0] * 6.0


def integrated(samples: Floats) -> Response:
    """Samples (n, 3) of time (s), acceleration (m/s²) and relative noise density, integrated twice as in the filters.

    A sample's value holds for one interval before the first one.
    """
    first = 2.0 * samples[0, 0] - samples[1, 0]
    time_s, value = np.r_[first, samples[:, 0]], np.r_[samples[0, 1], samples[:, 1]]
    out = np.empty((len(time_s) - 1, 4))
    _integrate(time_s, value, initial_state(first, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)), out)
    last = np.r_[np.flatnonzero(np.diff(samples[:, 2])), len(samples) - 1]
    return Response(time_s, out, samples[last][:, [0, 2]].copy())


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
        return float(np.sum(first * second / self.variance))

    @property
    def input_share(self) -> float:
        """The number of innovations that are accelerometer noise: their shares summed up."""
        return float(np.sum(self.input_part / self.variance))

    @property
    def entropy(self) -> float:
        """Half the sum of the logarithms of the variances."""
        return 0.5 * float(np.sum(np.log(self.variance)))


@njit(cache=True)
def next_step(pieces, g, reached, until):  # type: ignore[no-untyped-def]
    """The piece that holds after an instant (s), `g` or a later one, and how far a step goes there on the way on."""
    while g < len(pieces) - 1 and pieces[g, 0] <= reached:
        g += 1
    ahead = min(until, reached + MAX_STEP_S)
    return g, min(ahead, pieces[g, 0]) if g < len(pieces) - 1 else ahead


@njit(cache=True)
def _whiten(pieces, rows, density, states, values, longer, out):  # type: ignore[no-untyped-def]
    """Innovations take the place of `values` (m, c); out (m, 2): their variances and what accelerometer noise makes.

    rows (m, 2): time and relative variance; states: covariance and that of the accelerometer noise alone; longer (m, c)
    or (0, 0): what is added to a column's step up to a row, s. Returns the bias (c,) at the end of the pieces.
    """
    state, noise = states
    walk, reached = density * BIAS_WALK_RATIO, rows[0, 0]
    x, v, b = np.zeros(values.shape[1]), np.zeros(values.shape[1]), np.zeros(values.shape[1])
    g, end = 0, pieces[-1, 0]
    for j in range(len(rows) + 1):
        until = rows[j, 0] if j < len(rows) else max(end, reached)
        for c in range(len(x)):
            step = until - reached
            if j < len(longer):
                step += longer[j, c]
            x[c] += step * (v[c] - 0.5 * step * b[c])
            v[c] -= step * b[c]
        while reached < until:
            g, ahead = next_step(pieces, g, reached, until)
            advance_covariance(state, ahead - reached, density * pieces[g, 1], walk)
            advance_covariance(noise, ahead - reached, density * pieces[g, 1], walk)
            reached = ahead
        if j == len(rows):
            break
        total = state[P00] + rows[j, 1]
        gain = (state[P00] / total, state[P01] / total, state[P02] / total)
        out[j, 0], out[j, 1] = total, noise[P00]
        for c in range(len(x)):
            e = values[j, c] - x[c]
            values[j, c] = e
            x[c] += gain[0] * e
            v[c] += gain[1] * e
            b[c] += gain[2] * e
        update_covariance(state, gain, rows[j, 1])
        update_covariance(noise, gain, 0.0)
    return b


@njit(cache=True)
def _take(p, gain, variance):  # type: ignore[no-untyped-def]
    """(I − K h') P (I − K h')' + K R K' in place, h = (1, 0, 0, 1)."""
    for j in range(4):
        met = p[0, j] + p[3, j]
        for i in range(4):
            p[i, j] -= gain[i] * met
    for i in range(4):
        met = p[i, 0] + p[i, 3]
        for j in range(4):
            p[i, j] += gain[j] * (gain[i] * variance - met)


@njit(cache=True)
def _whiten_slow(pieces, rows, density, slow, covariances, values, longer, out):  # type: ignore[no-untyped-def]
    """As `_whiten` with a fourth state, the slow error of the measurements; slow = (its variance, its rate in 1/s).

    covariances (2, 4, 4): as the states of `_whiten`.
    """
    walks, gain, n = np.array([0.0, 0.0, density * BIAS_WALK_RATIO, 0.0]), np.zeros(4), len(rows)
    uncertain = np.array([3])
    x, reached, g = np.zeros((4, values.shape[1])), rows[0, 0], 0
    end = max(pieces[-1, 0], rows[-1, 0])
    for j in range(n + 1):
        until = rows[j, 0] if j < n else end
        lapse = until - reached
        for c in range(x.shape[1]):
            step = lapse + (longer[j, c] if j < len(longer) else 0.0)
            x[0, c] += step * (x[1, c] - 0.5 * step * x[2, c])
            x[1, c] -= step * x[2, c]
        while reached < until:
            g, ahead = next_step(pieces, g, reached, until)
            for p in covariances:
                predict_covariance(p, 1, ahead - reached, walks, uncertain, 1)
                add_noise(p, 0, ahead - reached, density * pieces[g, 1])
            reached = ahead
        if j == n:
            break
        kept = np.exp(-slow[1] * lapse)
        x[3] *= kept
        for p in covariances:
            p[3] *= kept
            p[:, 3] *= kept
        covariances[0, 3, 3] += (1.0 - kept * kept) * slow[0]
        for i in range(4):
            gain[i] = covariances[0, i, 0] + covariances[0, i, 3]
        total = gain[0] + gain[3] + rows[j, 1]
        gain /= total
        out[j, 0], out[j, 1] = total, covariances[1, 0, 0]
        for c in range(x.shape[1]):
            values[j, c] -= x[0, c] + x[3, c]
            for i in range(4):
                x[i, c] += gain[i] * values[j, c]
        _take(covariances[0], gain, rows[j, 1])
        _take(covariances[1], gain, 0.0)
    return x[2]


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
    slow: tuple[float, float] = NO_SLOW_ERROR,
) -> Whitened:
    """Run columns (m, c) of levelled values at rows (m, 2) of time (s) and relative variance through the filter.

    pieces: as of `Response`; density: noise density of the acceleration times s² in units of the noise variance; late_s
    (m, c): where the lateness of a column's stamps changes, so does the time that its states move on; slow: variance of
    the measurements' slow error in units of the noise variance, and its rate, 1/s.
    """
    out, found = np.empty((len(rows), 2)), values.copy()
    longer = np.empty((0, 0)) if late_s is None else np.diff(late_s, axis=0, prepend=late_s[:1])
    if slow[0] > 0.0:
        covariances = np.zeros((2, 4, 4))
        covariances[0] = np.diag([*DIFFUSE, slow[0]])
        bias = _whiten_slow(pieces, rows, density, slow, covariances, found, longer, out)
        bias_variance = float(covariances[0, 2, 2])
    else:
        states = tuple(initial_state(rows[0, 0], (0.0, 0.0, 0.0), DIFFUSE) for _ in range(2))
        states[1][P00:TIME] = 0.0
        bias, bias_variance = _whiten(pieces, rows, density, states, found, longer, out), float(states[0][P22])
    index = np.arange(SETTLING, len(rows))
    return Whitened(found[SETTLING:], out[SETTLING:, 0], out[SETTLING:, 1], index, bias, bias_variance)


def usable(rows: Floats, offset_s: float, span_s: tuple[float, float]) -> NDArray[np.int64]:
    """Which rows (m, 3) of time, value and variance are used and, so much later, lie within the acceleration."""
    time_s = rows[:, 0] + offset_s
    return np.flatnonzero(np.isfinite(rows[:, 2]) & (time_s >= span_s[0]) & (time_s <= span_s[1]))
