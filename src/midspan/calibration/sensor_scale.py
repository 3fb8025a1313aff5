"""The scale of a displacement sensor that is not calibrated, estimated relative to the accelerometer, or a refusal.

An LVDT read in volts, a unit that is wrong, a sign that is reversed: the reading is the displacement times an unknown
number. It is the same likelihood as a camera's (see `fit`), with noise that nobody declared.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from midspan.calibration.agreement import straightened, unexplained
from midspan.calibration.fit import Fit, Pair, with_corner_doubt
from midspan.calibration.noise import Findings, NoiseCalibration, applied, edge_s, levels_of, nearest, without_outliers
from midspan.calibration.outliers import without_lonely_outliers
from midspan.calibration.own_noise import exceeds_own_noise
from midspan.calibration.scale import MIN_GAIN as MIN_AGREEMENT
from midspan.calibration.scale import REFUSED_ABOVE, alias_in_words, is_ambiguous, noise_needed
from midspan.calibration.slow_error import SlowError, find_slow_error
from midspan.calibration.time_offset import OffsetSearch, search_offset
from midspan.errors import UntrustedError
from midspan.records import TimeOffset

# The share of what a clock that drifts does to the scale that stays uncertain after its correction.
UNEVEN = 0.2


def calibrate_sensor_scale(
    pair: Pair,
    max_offset_s: float,
    *,
    one_clock: bool,
    length_s: float = np.inf,
    look: Callable[[Fit], None] | None = None,
    noise_time_s: float | None = None,
) -> NoiseCalibration:
    """Learn scale, noise levels and clock offset of a displacement sensor by maximum likelihood.

    pair: readings in m as if the unit were right, with relative variances, and the acceleration. one_clock: the clocks
    are one, so that the offset found within ±`max_offset_s` s is only reported and the scale is estimated at no offset.
    length_s: of the record, see `edge_s`. noise_time_s: as of `calibrate_noise`. look: given the best fit of scale and
    offset together, may raise before it is judged here.
    Raises UntrustedError when the motion does not tell the scale to 5 %, when two offsets fit alike, or when the
    sensors do not agree.
    """
    pair = without_lonely_outliers(pair.changed(ratio=None))
    search: OffsetSearch | None = None
    if not one_clock and max_offset_s > 0.0:
        search = search_offset(pair, max_offset_s, edge_s(max_offset_s, length_s))
        if look is not None:
            look(search.fit)
        _refuse(search.pair, search.fit)
        _refuse_ambiguity(search, max_offset_s)
        if unexplained(search.pair, search.fit):
            raise UntrustedError(unexplained_text(search.fit.offset_s, max_offset_s))
        return _scaled(_with_slow_error(search.pair, search.fit, noise_time_s), search.offset, search)
    pair, still = without_outliers(pair)
    still = with_corner_doubt(pair, still, disputed=exceeds_own_noise(pair, still))
    offset, found = TimeOffset(0.0, np.inf), still
    if max_offset_s > 0.0:
        search = search_offset(pair, max_offset_s, edge_s(max_offset_s, length_s))
        found, variance = nearest(search)
        reported = applied(search, found, variance, max_offset_s)
        offset = TimeOffset(0.0, reported.variance) if _objection(search.pair, found) else reported
    late = offset.value_s != 0.0
    try:
        _refuse(pair, still)
    except UntrustedError:
        if not late:
            raise
        raise _clocks_differ(offset) from None
    estimated = _scaled(_with_slow_error(pair, still, noise_time_s), offset, search)
    # An offset that was left as it is takes from the scale, or adds to it, what it then would be.
    bias = abs(still.ratio / found.ratio - 1.0) if late else 0.0
    relative = estimated.factor_std / abs(estimated.factor)
    if np.hypot(bias, relative) > REFUSED_ABOVE:
        if late:
            raise _clocks_differ(offset)
        raise UntrustedError(f"displacement.estimate_scale: {_too_vague(pair, estimated.factor, relative)}")
    return replace(estimated, factor_std=float(np.hypot(estimated.factor_std, bias * estimated.factor)))


def _with_slow_error(pair: Pair, fit: Fit, time_s: float | None) -> SlowError:
    """The slow error of the readings, and the fit with what it adds to the doubt about the scale."""
    slow = find_slow_error(pair, fit, time_s)
    if slow.fit is fit:
        return slow
    disputed = exceeds_own_noise(slow.pair, slow.fit)
    return replace(slow, fit=with_corner_doubt(slow.pair, slow.fit, disputed=disputed))


def _clocks_differ(offset: TimeOffset) -> UntrustedError:
    return UntrustedError(
        f"displacement: its clock differs from the accelerometer's by {offset.value_s:+.4f} s, too much to estimate "
        "its scale with a common clock. Set displacement.estimate_offset = true, or correct its time column."
    )


def _scaled(slow: SlowError, offset: TimeOffset, search: OffsetSearch | None) -> NoiseCalibration:
    pair, fit = slow.pair, slow.fit
    factor, relative = 1.0 / fit.ratio, fit.relative_std
    straight = straightened(pair, fit)
    if straight is not None:
        # A clock that drifts takes from the scale: how much is known only as well as it runs evenly.
        even, rate = straight
        relative = float(np.hypot(even.relative_std, UNEVEN * (even.ratio / fit.ratio - 1.0)))
        factor = 1.0 / even.ratio
        if relative > REFUSED_ABOVE:
            raise UntrustedError(
                f"displacement: its clock drifts by about {1e6 * rate:+.0f} ppm relative to the accelerometer's, "
                f"which makes its scale of {factor:.4g} uncertain by {100 * relative:.2g} %; at most ± "
                f"{100 * REFUSED_ABOVE:g} % is accepted. Correct its time column, or estimate the scale on a shorter "
                "recording."
            )
    return NoiseCalibration(
        **levels_of(pair, fit, factor),
        offset=offset,
        scale=1.0,
        scale_std=relative,
        slow_time_s=1.0 / pair.slow[1] if pair.slow[0] > 0.0 else np.inf,
        unseen_m=tuple(abs(factor) * one for one in slow.unseen),
        exposure_s=pair.exposure_s,
        factor=factor,
        factor_std=abs(factor) * relative,
        findings=Findings(pair, fit, search, fit, fit),
    )


def _refuse(pair: Pair, fit: Fit) -> None:
    objection = _objection(pair, fit)
    if objection:
        raise UntrustedError(f"displacement.estimate_scale: {objection}")


def _objection(pair: Pair, fit: Fit) -> str:
    if fit.gain < MIN_AGREEMENT or fit.relative_std > REFUSED_ABOVE:
        return _too_vague(pair, 1.0 / fit.ratio, fit.relative_std)
    if needed := noise_needed(pair, fit):
        return (
            f"no agreement between the displacement and the accelerometer: {needed}. Check that both measure the same "
            "axis and event; if the clocks may differ by more, raise calibration.max_offset_s, with "
            "displacement.estimate_offset = true."
        )
    return ""


def _too_vague(pair: Pair, factor: float, relative: float) -> str:
    rows = pair.rows[np.isfinite(pair.rows[:, 2])]
    seen, shaken = float(np.std(rows[:, 1])), float(np.std(pair.samples[:, 1]))
    figures = f"({1e3 * seen:.3g} mm rms as read, acceleration {1e3 * shaken:.3g} mm/s² rms)"
    if seen == 0.0:
        return (
            f"its readings without outliers are constant {figures} and determine no scale. Record more motion, or use "
            "a sensor of finer resolution."
        )
    return (
        f"the motion does not determine the sensor's scale {figures}: {factor:.4g} ± {100 * relative:.2g} %; at most "
        f"± {100 * REFUSED_ABOVE:g} % is accepted. {alias_in_words(pair)}Record more motion, check that both sensors "
        "measure the same axis and event, or leave estimate_scale out and set displacement.unit."
    )


def unexplained_text(offset_s: float, max_offset_s: float) -> str:
    """What to tell where the best clock offset leaves motion."""
    return (
        f"displacement: at the best clock offset within ±{max_offset_s:g} s, {offset_s:+.4f} s, its remaining "
        "difference from the accelerometer is motion, not noise. If the clocks may differ by more, raise "
        "calibration.max_offset_s or set displacement.start_s; else check that both measure the same axis and event, "
        "and check its clock."
    )


def _refuse_ambiguity(search: OffsetSearch, max_offset_s: float) -> None:
    other, fit = search.runner_up, search.fit
    if other is not None and is_ambiguous(search):
        raise UntrustedError(
            f"displacement: clock offset and scale together are ambiguous: {fit.offset_s:+.4f} s with a scale of "
            f"{1.0 / fit.ratio:.4g} and {other.offset_s:+.4f} s with {1.0 / other.ratio:.4g} fit almost equally well "
            f"within ±{max_offset_s:g} s, as with nearly a single tone. Set a smaller calibration.max_offset_s that "
            "excludes one of them, or estimate only one of the two."
        )
