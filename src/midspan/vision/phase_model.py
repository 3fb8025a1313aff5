"""What the phase trackers know of their target: active pixels and how their phases follow the translation."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numba import njit
from numpy.typing import NDArray

from midspan.records import Floats, Region
from midspan.signals.health import Mask
from midspan.vision.active_pixels import by_amplitude, by_correlation
from midspan.vision.phase_flow import phase_change, phase_slopes
from midspan.vision.spline import Floats32
from midspan.vision.steerable import AXES, MARGIN_PX, Complex64, noise_power, quadrature, spread_back

BLOCKS = 4  # the residual is watched in 4 by 4 blocks
INSET_PX = MARGIN_PX + 1  # the reference needs a pixel more than the filter, for the slope of the phase
LEAST_MOTION_PX = 0.05  # rms of residual motion from which a slope can be learnt
LEAST_R_SQUARED = 0.5


@dataclass(frozen=True, slots=True)
class PhaseAxis:
    """The active pixels (k,) of the filter along one axis.

    index: their places in the flattened region. reference: complex responses. weight: in the mean, sum 1. slope (k, 2):
    phase by translation x and y, rad/px. unit: variance of the phase for image noise of variance 1; sensitivity: the
    same of the mean phase, with the noise's correlation between pixels. block: 0 … 15, the part of the region.
    """

    index: NDArray[np.int64]
    reference: Complex64
    weight: Floats
    slope: Floats
    unit: Floats
    block: NDArray[np.int64]
    sensitivity: float

    @property
    def mean_slope(self) -> Floats:
        """Mean phase by translation along x and y (2,), rad/px."""
        return np.asarray(self.weight @ self.slope, dtype=np.float64)

    @property
    def effective_pixels(self) -> float:
        """As many independent pixels of the same noise would give the mean phase the same variance."""
        return float(self.weight @ self.unit) / max(self.sensitivity, 1e-300)


@dataclass(frozen=True, slots=True)
class PhaseModel:
    """Both axes of a target, whether learnt from its motion, and R² of that (NaN where it was not)."""

    x: PhaseAxis
    y: PhaseAxis
    r_squared: tuple[float, float] = (math.nan, math.nan)

    @property
    def axes(self) -> tuple[PhaseAxis, PhaseAxis]:
        """The filter along x and the one along y."""
        return self.x, self.y

    @property
    def gains_px_per_rad(self) -> tuple[float, float]:
        """Translation by mean phase along x and y, signed: negative, as phase falls when the image moves forward."""
        return 1.0 / float(self.x.mean_slope[0]), 1.0 / float(self.y.mean_slope[1])

    def mask(self, axis: str, shape: tuple[int, int]) -> Mask:
        """Active pixels of `axis` "x" or "y" in a region of `shape` (rows, columns)."""
        flat = np.zeros(shape[0] * shape[1], dtype=bool)
        flat[self.axes[AXES.index(axis)].index] = True
        return flat.reshape(shape)


@dataclass(frozen=True, slots=True)
class Field:
    """Reference of one axis over the whole region: responses (rows, columns) and phase slopes (rows, columns, 2)."""

    response: Complex64
    slope: Floats
    axis: str
    spacing: float

    @property
    def amplitude(self) -> Floats:
        """Local amplitude (rows, columns)."""
        return np.abs(self.response).astype(np.float64)

    def chosen(self, active: Mask, weight: Floats, slope: Floats) -> PhaseAxis:
        """The model with the pixels `active` (rows · columns,), their weights (k,) and slopes (k, 2)."""
        rows, columns = self.response.shape
        index = np.flatnonzero(active)
        reference = self.response.ravel()[index]
        weight = weight / weight.sum()
        power = np.maximum(np.abs(reference).astype(np.float64) ** 2, 1e-30)
        of_even, of_odd = noise_power(self.spacing)
        unit = (reference.imag.astype(np.float64) ** 2 * of_even + reference.real.astype(np.float64) ** 2 * of_odd) / (
            power**2
        )
        kernel = np.zeros(rows * columns, dtype=np.complex64)
        kernel[index] = reference * (weight / power)
        spread = spread_back(kernel.reshape(rows, columns), self.axis, self.spacing)
        block = (index // columns * BLOCKS // rows) * BLOCKS + index % columns * BLOCKS // columns
        return PhaseAxis(index, reference, weight, slope, unit, block, float(np.sum(spread**2)))


def reference_field(patch: Floats32, axis: str, spacing: float) -> Field:
    """Responses and phase slopes of a reference `patch` with `INSET_PX` more than the region on every side."""
    wide = quadrature(patch, axis, spacing)
    x, y = phase_slopes(wide)
    inner = np.ascontiguousarray(wide[1:-1, 1:-1])
    return Field(inner, -np.stack([x, y], axis=-1), axis, spacing)


def first_model(fields: Sequence[Field], *, weighted: bool) -> PhaseModel:
    """Active pixels by amplitude and the gain from the reference's own phase slopes: what is known before learning."""
    return PhaseModel(*(_by_amplitude(field, weighted) for field in fields))


def _by_amplitude(field: Field, weighted: bool) -> PhaseAxis:
    active = by_amplitude(field.amplitude).ravel()
    amplitude = field.amplitude.ravel()[active]
    weight = amplitude**2 if weighted else np.ones(len(amplitude))
    return field.chosen(active, weight, field.slope.reshape(-1, 2)[active])


@dataclass(frozen=True, slots=True)
class Learning:
    """Responses of n frames: `phase` two arrays (n, pixels) rad, along x and y, and the residual motion (n, 2) px."""

    phase: tuple[Floats32, Floats32]
    residual_px: Floats


def learnt_model(
    fields: Sequence[Field], first: PhaseModel, learning: Learning, *, weighted: bool, least_information: float
) -> PhaseModel:
    """Active pixels and gains by regression of phase on residual motion; an axis that hardly moved stays as it was."""
    axes, fits = [], []
    for k, (field, known) in enumerate(zip(fields, first.axes, strict=True)):
        axis, fit = _learnt_axis(field, known, learning, k, (weighted, least_information))
        axes.append(axis)
        fits.append(fit)
    return replace(first, x=axes[0], y=axes[1], r_squared=(fits[0], fits[1]))


def _learnt_axis(
    field: Field, known: PhaseAxis, learning: Learning, k: int, rule: tuple[bool, float]
) -> tuple[PhaseAxis, float]:
    residual = learning.residual_px - learning.residual_px.mean(axis=0)
    moved = np.sqrt(np.mean(residual**2, axis=0))
    if len(residual) < 5 or moved[k] < LEAST_MOTION_PX:
        return known, math.nan
    other = 1 - k
    phase = learning.phase[k]
    phase = phase - phase.mean(axis=0)
    slopes = field.slope.reshape(-1, 2).copy()
    # Motion across the axis also turns phases: its part is taken out, learnt where there was enough of it.
    used = [k, other] if moved[other] >= LEAST_MOTION_PX else [k]
    if len(used) == 1:
        phase = phase - np.outer(residual[:, other], slopes[:, other]).astype(np.float32)
    fit = np.linalg.lstsq(residual[:, used], phase.astype(np.float64), rcond=None)[0]
    slopes[:, used] = fit.T
    if len(used) == 2:
        phase = phase - np.outer(residual[:, other], slopes[:, other]).astype(np.float32)
    weighted, share = rule
    weight = field.amplitude.ravel() ** 2 if weighted else np.ones(phase.shape[1])
    selection = by_correlation(phase, residual[:, k], weight, least_information=share)
    active = selection.active
    if not math.isfinite(selection.gain_px_per_rad) or selection.r_squared < LEAST_R_SQUARED:
        return known, selection.r_squared
    return field.chosen(active, weight[active], slopes[active]), selection.r_squared


@njit(cache=True)
def _sums(now: tuple[Floats32, Floats32], phase: Floats32, model: tuple[Floats, ...], extra: Floats) -> Floats:
    """Sums over active pixels; see `residual_sums`."""
    index, reference, weight, slope_x, slope_y, unit, block = model
    even, odd = now[0].ravel(), now[1].ravel()
    out = np.zeros(36)
    for k in range(index.shape[0]):
        expected = slope_x[k] * extra[0] + slope_y[k] * extra[1]
        error = phase[k] - expected
        if error > np.pi:
            error -= 2.0 * np.pi
        elif error < -np.pi:
            error += 2.0 * np.pi
        b = block[k]
        out[b] += weight[k] * error
        out[16 + b] += weight[k]
        out[32] += error * error / unit[k]
        a = np.hypot(even[index[k]], odd[index[k]])
        r = np.abs(reference[k])
        out[33] += a * r * np.cos(error)
        out[34] += a * a
        out[35] += r * r
    return out


@dataclass(frozen=True, slots=True)
class PhaseFix:
    """A translation (2,) px beside the region's whole-pixel place, its variances (2,) px², and coherence 0 to 1."""

    shift_px: Floats
    variance_px2: Floats
    coherence: float


def measure(model: PhaseModel, now: Sequence[tuple[Floats32, Floats32]]) -> PhaseFix | None:
    """Translation from the mean phases of both axes; None when their slopes do not tell x from y.

    `now` are the responses (even, odd) of the frame's region along x and y.
    """
    phases = [phase_change(n, axis.reference, axis.index) for n, axis in zip(now, model.axes, strict=True)]
    slopes = np.stack([axis.mean_slope for axis in model.axes])
    # Mean of the phases about what the last estimate expects, so that single pixels near ±π do not wrap.
    determinant = float(np.linalg.det(slopes))
    if not abs(determinant) > 1e-3:
        return None
    inverse = np.linalg.inv(slopes)
    shift, sums = np.zeros(2), []
    for _ in range(2):
        sums = [_of_axis(n, p, axis, shift) for n, p, axis in zip(now, phases, model.axes, strict=True)]
        shift = shift + inverse @ np.array([float(s[:16].sum()) for s in sums])
    sums = [_of_axis(n, p, axis, shift) for n, p, axis in zip(now, phases, model.axes, strict=True)]
    variance = np.array([_variance(s, axis) for s, axis in zip(sums, model.axes, strict=True)])
    coherences = [float(s[33]) / max(math.sqrt(float(s[34] * s[35])), 1e-300) for s in sums]
    return PhaseFix(shift, (inverse**2) @ variance, min(coherences))


def _of_axis(now: tuple[Floats32, Floats32], phase: Floats32, axis: PhaseAxis, shift: Floats) -> Floats:
    slope = axis.slope
    arrays = (axis.index, axis.reference, axis.weight, slope[:, 0], slope[:, 1], axis.unit, axis.block)
    return np.asarray(_sums(now, phase, arrays, shift))


def _variance(sums: Floats, axis: PhaseAxis) -> float:
    """Variance (rad²) of the mean phase: from the pixels' scatter, or from the blocks' where that is much larger."""
    white = float(sums[32]) / max(len(axis.index) - 2, 1) * axis.sensitivity
    share = sums[16:32]
    used = share > 0.0
    count = int(np.count_nonzero(used))
    if count < 4:
        return white
    # Leaving one block out changes the weighted mean by this much.
    without = (sums[:16].sum() - sums[:16][used]) / np.maximum(1.0 - share[used], 1e-9)
    blocks = (count - 1) * float(np.var(without))
    return blocks if blocks > 3.0 * white else white


def region_patch(region: Region, x: int, y: int, margin: int) -> tuple[slice, slice]:
    """Rows and columns of the image under `region` moved by whole pixels, with a margin."""
    top, left = region.y + y - margin, region.x + x - margin
    return slice(top, top + region.height + 2 * margin), slice(left, left + region.width + 2 * margin)
