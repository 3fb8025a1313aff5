"""Active pixels and phase scale factor by the accelerometer, as printed.

Z. Ma, J. Choi, P. Liu, H. Sohn, "Structural displacement estimation by fusing vision camera and accelerometer using
hybrid computer vision algorithm and adaptive multi-rate Kalman filter", Automation in Construction 140 (2022) 104338,
doi 10.1016/j.autcon.2022.104338, section 3.1, step 3: residual motion and phases of the moved region go through one
band-pass; the threshold of correlation with the largest R² chooses the pixels, and least squares give the ratio of
translation to their mean phase, which is beta / alpha of the paper.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from midspan.errors import DataError
from midspan.signals.band_pass import band_passed
from midspan.vision.active_pixels import Selection, by_amplitude, by_ratio, by_threshold
from midspan.vision.phase_model import Field, Learning, PhaseModel

MIN_FILTERED = 30  # frames, as the band-pass needs


@dataclass(frozen=True, slots=True)
class PrintedRule:
    """How a model is learnt as printed.

    active_pixels: "correlation" (the paper's), "amplitude" or "all". along: number of the image axis that the
    accelerometer showed, None for both. band_hz: of the comparison, None for no filter; rate_hz: of the frames.
    """

    active_pixels: str
    along: int | None
    band_hz: tuple[float, float] | None
    rate_hz: float


def printed_model(fields: Sequence[Field], first: PhaseModel, learning: Learning, rule: PrintedRule) -> PhaseModel:
    """The model with active pixels and ratio of each axis that is learnt; the other one stays as it was at `first`.

    Raises DataError with too few frames for the band-pass.
    """
    axes, ratios, fits = list(first.axes), list(first.gains_px_per_rad), list(first.r_squared)
    for k in (0, 1) if rule.along is None else (rule.along,):
        found = _selected(fields[k], learning, k, rule)
        count = int(np.count_nonzero(found.active))
        axes[k] = fields[k].chosen(found.active, np.ones(count), fields[k].slope[found.active], 0.0)
        ratios[k], fits[k] = found.gain_px_per_rad, found.r_squared
    x, y = axes
    return replace(first, x=x, y=y, ratios=(ratios[0], ratios[1]), r_squared=(fits[0], fits[1]), along=rule.along)


def _selected(field: Field, learning: Learning, k: int, rule: PrintedRule) -> Selection:
    """Steps b to d along the axis `k`."""
    phase, residual = learning.phase[k], learning.residual_px[:, k]
    phase, residual = phase - phase.mean(axis=0), residual - residual.mean()
    if rule.band_hz is not None:
        if len(residual) < MIN_FILTERED:
            raise DataError(f"Learning needs at least {MIN_FILTERED} frames with the target; received {len(residual)}.")
        filtered = band_passed(phase, rule.rate_hz, rule.band_hz)
        residual = band_passed(residual, rule.rate_hz, rule.band_hz)
    else:
        filtered = phase.astype(np.float64)
    if rule.active_pixels == "correlation":
        return by_threshold(filtered, residual)
    amplitude = by_amplitude(field.amplitude).ravel()
    return by_ratio(filtered, residual, amplitude | (rule.active_pixels == "all"))
