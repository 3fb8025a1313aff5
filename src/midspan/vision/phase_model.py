"""What the phase trackers know of their target: active pixels and how their phases follow the translation."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from midspan import _core
from midspan.records import Floats, Floats32, Region
from midspan.signals.health import Mask
from midspan.vision.active_pixels import by_amplitude, by_correlation, slope_and_r_squared
from midspan.vision.steerable import MARGIN_PX, Complex64, noise_power, quadrature, spread_back, taps_of
from midspan.vision.texture import noise_std


def phase_slopes(field: Complex64) -> tuple[Floats, Floats]:
    """Slope of the local phase along x and y, rad/px, of responses (rows + 2, columns + 2): two arrays (rows, columns).

    The mean of the steps to the neighbours on either side, each unwrapped on its own: good up to half a cycle a px.
    """
    across = np.angle(field[1:-1, 1:] * np.conj(field[1:-1, :-1]))
    down = np.angle(field[1:, 1:-1] * np.conj(field[:-1, 1:-1]))
    x, y = 0.5 * (across[:, 1:] + across[:, :-1]), 0.5 * (down[1:] + down[:-1])
    return x.astype(np.float64), y.astype(np.float64)


def phase_curvatures(field: Complex64) -> tuple[Floats, Floats, Floats]:
    """Second derivatives xx, yy, xy of the local phase, rad/px², of responses (rows + 2, columns + 2): (rows, columns).

    Differences of neighbours as complex products, as in `phase_slopes`.
    """
    middle = field[1:-1, 1:-1]
    x = np.angle(field[1:-1, 2:] * np.conj(middle) * field[1:-1, :-2] * np.conj(middle))
    y = np.angle(field[2:, 1:-1] * np.conj(middle) * field[:-2, 1:-1] * np.conj(middle))
    xy = 0.25 * np.angle(field[2:, 2:] * np.conj(field[2:, :-2]) * np.conj(field[:-2, 2:]) * field[:-2, :-2])
    return x.astype(np.float64), y.astype(np.float64), xy.astype(np.float64)


BLOCKS = 4  # the residual is watched in 4 by 4 blocks
INSET_PX = MARGIN_PX + 1  # the reference needs a pixel more than the filter, for the slope of the phase
# The gain from the reference alone is off by what aliasing and noise in the reference do to the slope of its phase.
FIRST_GAIN_ERROR = 0.003
GAIN_ERROR_OF_NOISE = 0.35
SPLIT_FRAMES = 20
MIN_MOTION_PX = 0.05  # rms of residual motion from which a slope can be learned
MIN_R_SQUARED = 0.5


@dataclass(frozen=True, slots=True)
class PhaseAxis:
    """The active pixels (k,) of the filter along one axis.

    index: their places in the flattened region. reference: complex responses. weight: in the mean, sum 1. slope (k, 2):
    phase by translation x and y, rad/px. curve (k, 3): by half the squares of x and y and by their product, rad/px².
    unit: variance of the phase for image noise of variance 1; sensitivity: the
    same of the mean phase, with the noise's correlation between pixels. block: 0 … 15, the part of the region.
    gain_error: standard deviation of the gain over the gain.
    """

    index: NDArray[np.int64]
    reference: Complex64
    weight: Floats
    slope: Floats
    curve: Floats
    unit: Floats
    block: NDArray[np.int64]
    sensitivity: float
    gain_error: float

    @property
    def mean_slope(self) -> Floats:
        """Mean phase by translation along x and y (2,), rad/px."""
        return np.asarray(self.weight @ self.slope, dtype=np.float64)


@dataclass(frozen=True, slots=True)
class PhaseModel:
    """Both axes of a target, whether learned from its motion, and R² of that (NaN where it was not).

    ratios: translation by mean phase along x and y, px/rad, by least squares (None: from the slopes). along: number of
    the axis that the accelerometer showed, None where both were learned alike.
    """

    x: PhaseAxis
    y: PhaseAxis
    r_squared: tuple[float, float] = (math.nan, math.nan)
    ratios: tuple[float, float] | None = None
    along: int | None = None

    @property
    def axes(self) -> tuple[PhaseAxis, PhaseAxis]:
        """The filter along x and the one along y."""
        return self.x, self.y

    @property
    def gains_px_per_rad(self) -> tuple[float, float]:
        """Translation by mean phase along x and y, signed: negative, as phase falls when the image moves forward."""
        return self.ratios or (1.0 / float(self.x.mean_slope[0]), 1.0 / float(self.y.mean_slope[1]))

    def mask(self, axis: str, shape: tuple[int, int]) -> Mask:
        """Active pixels of `axis` "x" or "y" in a region of `shape` (rows, columns)."""
        flat = np.zeros(shape[0] * shape[1], dtype=bool)
        flat[self.axes["xy".index(axis)].index] = True
        return flat.reshape(shape)


@dataclass(frozen=True, slots=True)
class Field:
    """Reference of one axis over the whole region.

    Its responses (rows, columns), and how their phases follow the translation: slopes (rows · columns, 2) and
    curvatures (rows · columns, 3) as in `PhaseAxis`.
    """

    response: Complex64
    slope: Floats
    curve: Floats
    axis: str
    spacing: float
    noise_dn: float

    @property
    def noise_share(self) -> float:
        """Share of the responses' power that is noise, 0 to 1."""
        noise = self.noise_dn**2 * sum(noise_power(self.spacing))
        return min(noise / max(float(np.mean(self.amplitude**2)), 1e-300), 1.0)

    @property
    def amplitude(self) -> Floats:
        """Local amplitude (rows, columns)."""
        return np.abs(self.response).astype(np.float64)

    def chosen(self, active: Mask, weight: Floats, slope: Floats, gain_error: float) -> PhaseAxis:
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
        return PhaseAxis(
            index, reference, weight, slope, self.curve[index], unit, block, float(np.sum(spread**2)), gain_error
        )

    def everywhere(self) -> PhaseAxis:
        """The model with all pixels, alike."""
        count = self.response.size
        same, none = np.ones(count), np.zeros(count, dtype=np.int64)
        index, reference = np.arange(count), self.response.ravel()
        return PhaseAxis(index, reference, same / count, self.slope, self.curve, same, none, 0.0, 0.0)


def reference_field(patch: Floats32, axis: str, spacing: float) -> Field:
    """Responses and phase slopes of a reference `patch` with `INSET_PX` more than the region on every side."""
    wide = quadrature(patch, axis, spacing)
    slope = -np.stack([plane.ravel() for plane in phase_slopes(wide)], axis=1)
    curve = np.stack([plane.ravel() for plane in phase_curvatures(wide)], axis=1)
    noise = noise_std(patch.astype(np.float64))
    return Field(np.ascontiguousarray(wide[1:-1, 1:-1]), slope, curve, axis, spacing, noise)


def first_model(fields: Sequence[Field], *, weighted: bool, everywhere: bool = False) -> PhaseModel:
    """Active pixels by amplitude and the gain from the reference's own phase slopes: what is known before learning.

    everywhere: all pixels are active.
    """
    x, y = (_before_learning(field, weighted, everywhere) for field in fields)
    return PhaseModel(x, y)


def _before_learning(field: Field, weighted: bool, everywhere: bool) -> PhaseAxis:
    active = by_amplitude(field.amplitude).ravel() | everywhere
    amplitude = field.amplitude.ravel()[active]
    weight = amplitude**2 if weighted else np.ones(len(amplitude))
    gain_error = FIRST_GAIN_ERROR + GAIN_ERROR_OF_NOISE * field.noise_share
    return field.chosen(active, weight, field.slope[active], gain_error)


@dataclass(frozen=True, slots=True)
class Learning:
    """Responses of n frames: `phase` two arrays (n, pixels) rad, along x and y, and the residual motion (n, 2) px."""

    phase: tuple[Floats32, Floats32]
    residual_px: Floats


def learned_model(
    fields: Sequence[Field], first: PhaseModel, learning: Learning, *, weighted: bool, least_information: float
) -> PhaseModel:
    """Active pixels and gains by regression of phase on residual motion; an axis that hardly moved stays as it was."""
    axes, fits = [], []
    for k, (field, known) in enumerate(zip(fields, first.axes, strict=True)):
        axis, fit = _learned_axis(field, known, learning, k, (weighted, least_information))
        axes.append(axis)
        fits.append(fit)
    return replace(first, x=axes[0], y=axes[1], r_squared=(fits[0], fits[1]))


def _learned_axis(
    field: Field, known: PhaseAxis, learning: Learning, k: int, rule: tuple[bool, float]
) -> tuple[PhaseAxis, float]:
    """The axis `k` as its phases followed the residual motion, and the R² of that."""
    residual = learning.residual_px - learning.residual_px.mean(axis=0)
    moved = np.sqrt(np.mean(residual**2, axis=0))
    if len(residual) < 5 or moved[k] < MIN_MOTION_PX:
        return known, math.nan
    phase = learning.phase[k] - (squares(learning.residual_px) @ field.curve.T).astype(np.float32)
    phase -= phase.mean(axis=0)
    slopes = _learned_slopes(field, phase, residual, [j for j in (k, 1 - k) if moved[j] >= MIN_MOTION_PX])
    along = phase - np.outer(residual[:, 1 - k], slopes[:, 1 - k]).astype(np.float32)
    power = field.amplitude.ravel() ** 2
    weighted, share = rule
    weight = power if weighted else np.ones(len(power))
    # Pixels are chosen in one half of the frames and their slopes taken from the other: the same noise would do both,
    # and the chosen ones would be those whose slopes it has raised.
    choosing, measuring = (np.s_[0::2], np.s_[1::2]) if len(residual) >= SPLIT_FRAMES else (np.s_[:], np.s_[:])
    selection = by_correlation(
        along[choosing],
        residual[choosing, k],
        weight=weight,
        # The information that a pixel of this amplitude and slope has about the translation under white noise.
        information=power * slopes[:, k] ** 2,
        least_information=share,
    )
    active = selection.active
    if not math.isfinite(selection.gain_px_per_rad) or selection.r_squared < MIN_R_SQUARED:
        return known, selection.r_squared
    slopes[:, k] = slope_and_r_squared(along[measuring], residual[measuring, k])[0]
    mean = along[:, active] @ (weight[active] / weight[active].sum())
    r_squared = float(slope_and_r_squared(mean, residual[:, k])[1])
    gain_error = math.sqrt((1.0 - r_squared) / r_squared / (0.5 * len(residual)))
    return field.chosen(active, weight[active], slopes[active], gain_error), r_squared


def _learned_slopes(field: Field, phase: Floats32, residual: Floats, used: list[int]) -> Floats:
    """Slopes (pixels, 2) by regression on the axes `used`; along the other the reference's own."""
    slopes = field.slope.copy()
    rest = [j for j in (0, 1) if j not in used]
    left = phase - (residual[:, rest] @ slopes[:, rest].T).astype(np.float32)
    slopes[:, used] = np.linalg.lstsq(residual[:, used], left.astype(np.float64), rcond=None)[0].T
    return slopes


def squares(shift: Floats) -> Floats:
    """Half the squares of x and y and their product, (…, 3), of translations (…, 2)."""
    x, y = shift[..., 0], shift[..., 1]
    return np.stack([0.5 * x * x, 0.5 * y * y, x * y], axis=-1)


def target_of(
    model: PhaseModel,
    window: Region,
    offset: float,
    spacing: float,
    ratios: tuple[float, float] | None = None,
) -> _core.PhaseTarget:
    """What measures frames with this model: the pixels of `window` less `offset`, filtered with taps every `spacing`.

    Both axes are solved together, and active pixels whose phase contradicts the others (something stands before them)
    do not count in a frame, unless they are the majority.
    ratios: translation by mean phase along x and y, px/rad: each axis is then measured alone, by the mean phase of all
    active pixels (equations 4 and 17), with the variance that one frame's noise makes of it.
    """
    place = (window.x, window.y, window.width, window.height)
    return _core.PhaseTarget(place, offset, taps_of(spacing), model.axes, ratios)


def whole_region(fields: Sequence[Field]) -> PhaseModel:
    """The model of which every pixel of the region is active, all alike: for the phases of all."""
    x, y = (field.everywhere() for field in fields)
    return PhaseModel(x, y)


def region_patch(region: Region, x: int, y: int, margin: int) -> tuple[slice, slice]:
    """Rows and columns of the image under `region` moved by whole pixels, with a margin."""
    top, left = region.y + y - margin, region.x + x - margin
    return slice(top, top + region.height + 2 * margin), slice(left, left + region.width + 2 * margin)
