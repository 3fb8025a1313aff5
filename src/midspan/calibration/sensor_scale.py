"""The scale of a displacement sensor that is not calibrated, learnt beside the accelerometer, or a refusal.

An LVDT read in volts, a unit that is wrong, a sign that is reversed: the reading is the displacement times an unknown
number. It is the same likelihood as a camera's (see `fit`), with noise that nobody declared.
"""

from dataclasses import replace

import numpy as np

from midspan.calibration.fit import Fit, Pair, best_corner
from midspan.calibration.noise import CERTAIN_S, LEAST_GAIN, NoiseCalibration, without_outliers
from midspan.calibration.scale import (
    IMPLIED_NOISE,
    IMPLIED_SHARE,
    REFUSED_ABOVE,
    alias_in_words,
    is_ambiguous,
    white_noise,
)
from midspan.calibration.scale import LEAST_GAIN as LEAST_AGREEMENT
from midspan.calibration.time_offset import OffsetSearch, curvature, search_offset, without_lonely_outliers
from midspan.errors import UntrustedError
from midspan.records import TimeOffset


def calibrate_sensor_scale(pair: Pair, max_offset_s: float, *, one_clock: bool) -> NoiseCalibration:
    """Learn scale, noise levels and clock offset of a displacement sensor by maximum likelihood.

    pair: readings in m as if the unit were right, with relative variances, and the acceleration. one_clock: the clocks
    are one, so that the offset found within ±`max_offset_s` s is only told and the scale is learnt at no offset.
    Raises UntrustedError when the motion does not tell the scale to 5 %, when two offsets fit alike, or when the
    sensors do not agree.
    """
    pair = without_lonely_outliers(replace(pair, ratio=None))
    if not one_clock and max_offset_s > 0.0:
        search = search_offset(pair, max_offset_s)
        _refuse(search.pair, search.fit)
        _refuse_ambiguity(search, max_offset_s)
        return _scaled(search.fit, search.offset)
    pair, still = without_outliers(pair)
    offset = TimeOffset(0.0, np.inf)
    if max_offset_s > 0.0:
        offset = _apparent_offset(search_offset(pair, max_offset_s), max_offset_s)
    try:
        _refuse(pair, still)
    except UntrustedError:
        if offset.value_s == 0.0:
            raise
        raise UntrustedError(
            f"displacement: its clock differs from the accelerometer's by {offset.value_s:+.4f} s, too much to learn "
            "its scale on one clock. Set displacement.estimate_offset = true to have the offset learnt and applied, "
            "or correct its time column."
        ) from None
    return _scaled(still, offset)


def _scaled(fit: Fit, offset: TimeOffset) -> NoiseCalibration:
    """The calibration of readings that are multiplied by the factor found."""
    factor, relative = 1.0 / fit.ratio, float(np.sqrt(fit.ratio_variance)) / abs(fit.ratio)
    return NoiseCalibration(
        variance_factor=fit.noise * factor * factor,
        input_noise_density=fit.input_density,
        offset=offset,
        scale=1.0,
        scale_std=relative,
        factor=factor,
        factor_std=abs(factor) * relative,
    )


def _apparent_offset(search: OffsetSearch, max_offset_s: float) -> TimeOffset:
    """The clock offset that shows, 0 where none does; of two that fit alike the one nearer to 0."""
    pair, fit, offset = search.pair, search.fit, search.offset
    other = search.runner_up
    if other is not None and abs(other.offset_s) < abs(fit.offset_s) and is_ambiguous(search):
        fit, offset = other, TimeOffset(other.offset_s, curvature(pair, other)[0])
    gain = fit.likelihood - best_corner(pair, 0.0).likelihood
    certain = offset.variance < CERTAIN_S**2 and gain > LEAST_GAIN and not _objection(pair, fit)
    if certain and abs(fit.offset_s) < 0.99 * max_offset_s:
        return offset
    return TimeOffset(0.0, offset.variance)


def _refuse(pair: Pair, fit: Fit) -> None:
    objection = _objection(pair, fit)
    if objection:
        raise UntrustedError(f"displacement.estimate_scale: {objection}")


def _objection(pair: Pair, fit: Fit) -> str:
    """Why the scale of a fit is not to be trusted; empty where it is."""
    gain, relative = fit.likelihood - fit.without, float(np.sqrt(fit.ratio_variance)) / max(abs(fit.ratio), 1e-300)
    rows = pair.rows[np.isfinite(pair.rows[:, 2])]
    seen, shaken = float(np.std(rows[:, 1])), float(np.std(pair.samples[:, 1]))
    figures = f"({1e3 * seen:.3g} mm rms as read, acceleration {1e3 * shaken:.3g} mm/s² rms)"
    if gain < LEAST_AGREEMENT or relative > REFUSED_ABOVE:
        return (
            f"the motion does not tell the sensor's scale {figures}: it would be "
            f"{1.0 / fit.ratio:.4g} ± {100 * relative:.2g} %, and at most ± {100 * REFUSED_ABOVE:g} % is given out. "
            f"{alias_in_words(pair)}Record livelier motion, check that both sensors measure the same axis and event, "
            "or leave estimate_scale out and set displacement.unit."
        )
    rate = (len(pair.samples) - 1) / float(pair.samples[-1, 0] - pair.samples[0, 0])
    implied, own = float(np.sqrt(fit.input_density * rate)), white_noise(pair.samples[:, 1])
    if implied > shaken or (implied > IMPLIED_SHARE * shaken and implied > IMPLIED_NOISE * own):
        return (
            "no agreement between the displacement and the accelerometer: their "
            f"difference would need accelerometer noise of {1e3 * implied:.3g} mm/s² per sample where the signal has "
            f"{1e3 * shaken:.3g} mm/s² rms. Check that both measure the same axis and event; where the clocks may "
            "differ, set displacement.estimate_offset = true and calibration.max_offset_s."
        )
    return ""


def _refuse_ambiguity(search: OffsetSearch, max_offset_s: float) -> None:
    other, fit = search.runner_up, search.fit
    if other is not None and is_ambiguous(search):
        raise UntrustedError(
            f"displacement: clock offset and scale together are ambiguous: {fit.offset_s:+.4f} s with a scale of "
            f"{1.0 / fit.ratio:.4g} and {other.offset_s:+.4f} s with {1.0 / other.ratio:.4g} fit almost alike within "
            f"±{max_offset_s:g} s, as they do when the motion is nearly a single tone. Set a smaller "
            "calibration.max_offset_s that excludes one of them, or learn only one of the two."
        )
