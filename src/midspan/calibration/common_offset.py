"""One clock for one camera: the offset that all its targets, along all its axes, share."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from midspan.calibration.fit import best_corner
from midspan.calibration.scale import ScaleCalibration
from midspan.calibration.time_offset import curvature
from midspan.records import Floats, NoiseLevel, ScaleFactor, TimeOffset

# A target whose clock offset leaves the others' by more than this many standard deviations, and this much, is wrong.
OFFSET_STD = 5.0
MIN_OFFSET_S = 3e-3


@dataclass(frozen=True, slots=True)
class Fitted:
    """The targets along one axis: what was found (None: refused), and why a target is not used (empty: it is).

    tilt: of the camera, where the targets show one; what was found is then the same for all of them.
    """

    found: tuple[ScaleCalibration | None, ...]
    reasons: tuple[str, ...]
    # Of `calibration.camera.tilt`, which a radar's calibration must not import.
    tilt: Any = None

    @property
    def used(self) -> list[ScaleCalibration]:
        """The calibrations in use."""
        return [f for f, reason in zip(self.found, self.reasons, strict=True) if f is not None and not reason]


def one_offset(fits: Sequence[Fitted]) -> list[Fitted]:
    """The fits of all axes with one clock offset; targets that contradict it get a reason. One alone stays as it is."""
    used = [found for fit in fits for found in fit.used]
    if len(used) < 2:
        return list(fits)
    offsets = np.array([found.search.offset.value_s for found in used])
    middle_s = weighted_median(offsets, [1.0 / max(found.search.offset.variance, 1e-18) for found in used])

    def contradicts(found: ScaleCalibration) -> bool:
        apart = abs(found.search.offset.value_s - middle_s)
        return bool(apart > max(OFFSET_STD * np.sqrt(found.search.offset.variance), MIN_OFFSET_S))

    offset = _mean([found for found in used if not contradicts(found)])
    joint = []
    for fit in fits:
        found, reasons = list(fit.found), list(fit.reasons)
        for k, one in enumerate(fit.found):
            if one is None or reasons[k]:
                continue
            if contradicts(one):
                reasons[k] = (
                    f"its clock offset would be {1e3 * one.search.offset.value_s:+.1f} ms, that of the others is "
                    f"{1e3 * middle_s:+.1f} ms: it does not move with the structure."
                )
            else:
                found[k] = _at_offset(one, offset)
        joint.append(replace(fit, found=tuple(found), reasons=tuple(reasons)))
    return joint


def weighted_median(values: Floats, weights: Sequence[float] | Floats) -> float:
    """The median of values (k,), each as often as its weight (k,) says."""
    order = np.argsort(values)
    share = np.cumsum(np.asarray(weights)[order])
    return float(values[order][np.searchsorted(share, 0.5 * share[-1])])


def _mean(used: Sequence[ScaleCalibration]) -> TimeOffset:
    """The mean by inverse variance; what the accelerometer's noise does to all of them does not average out."""
    offset = np.array([found.search.offset.value_s for found in used])
    variance = np.array([found.search.offset.variance for found in used])
    known = np.isfinite(variance)
    if not known.any():
        return used[0].search.offset
    weight = 1.0 / variance[known]
    weight /= weight.sum()
    shared = float(np.mean([shared_part(found) for found in used]))
    return TimeOffset(float(weight @ offset[known]), pooled_variance(weight, variance[known], shared))


def shared_part(found: ScaleCalibration) -> float:
    """Share (0 to 1) of the innovations' variance that comes from the accelerometer, which all targets share."""
    whitened = found.search.fit.whitened
    return whitened.input_share / max(len(whitened.variance), 1)


def pooled_variance(weight: Floats, variance: Floats, shared: float) -> float:
    """Variance of a weighted mean (k,) of values whose errors have the share `shared` in common."""
    return float(shared * (weight @ np.sqrt(variance)) ** 2 + (1.0 - shared) * (weight**2 @ variance))


def _at_offset(found: ScaleCalibration, offset: TimeOffset) -> ScaleCalibration:
    search = found.search
    fit = best_corner(search.pair, offset.value_s, search.fit.corner)
    _, drag = curvature(search.pair, fit)
    fit = replace(fit, ratio_variance=fit.ratio_variance + drag * drag * offset.variance)
    value, relative = 1.0 / fit.ratio, float(np.sqrt(fit.ratio_variance)) / abs(fit.ratio)
    typical = found.noise.std**2 / found.variance_factor
    return replace(
        found,
        scale=ScaleFactor(value, (relative * value) ** 2),
        search=replace(search, fit=fit, offset=offset),
        noise=NoiseLevel(float(np.sqrt(fit.noise))),
        variance_factor=fit.noise / typical,
        input_noise=search.pair.input_noise(fit.input_density),
    )
