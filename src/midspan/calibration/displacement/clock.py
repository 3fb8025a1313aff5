"""The clock of a displacement sensor: the rate and the offset that were corrected, and steps.

Values after a step are outliers for a calibration on one clock. They must not be left out in silence: the calibration
would be that of the rest, and its error band would not hold what the record then shows.
"""

from dataclasses import replace

import numpy as np

from midspan.calibration.agreement import compared_by
from midspan.calibration.causes import Cause, cause_of_lateness, disagreement, named_cause
from midspan.calibration.clock_jumps import clock_jumps, lateness
from midspan.calibration.clock_rate import ClockRate
from midspan.calibration.fit import Fit, Pair
from midspan.calibration.noise import NoiseCalibration, without_outliers
from midspan.errors import UntrustedError
from midspan.notices import Notice
from midspan.records import NANOSECONDS, TimeSeries


def with_rate(learnt: NoiseCalibration, rate: ClockRate | None) -> NoiseCalibration:
    """The calibration with the rate of the clock that was corrected."""
    if rate is None:
        return learnt
    offset = replace(learnt.offset, variance=learnt.offset.variance + rate.offset_variance)
    text = (
        f"displacement: its clock gains {rate.ppm:+.1f} ± {1e6 * rate.std:.1f} ppm on the accelerometer's, "
        f"{1e3 * abs(rate.late) * rate.length_s:.4g} ms in {rate.length_s:.4g} s; this was corrected."
    )
    return replace(learnt, offset=offset, warnings=(*learnt.warnings, Notice("clock-corrected", text)))


def with_offset(learnt: NoiseCalibration) -> NoiseCalibration:
    """The calibration with a sentence on an offset that was not asked for.

    late_m: what it makes of the displacement where it may be a logger's delay.
    """
    assert learnt.findings is not None
    text = (
        f"displacement: its readings come as if its clock differs from the accelerometer's by "
        f"{1e3 * learnt.offset.value_s:+.4g} ± {1e3 * np.sqrt(learnt.offset.variance):.2g} ms; this was corrected. "
        f"{cause_of_lateness(learnt.findings.pair, learnt.offset.value_s)}"
    )
    if learnt.late_m > 0.0:
        text += (
            "With a low-pass in the accelerometer's logger the result is late by as much: the error band holds what "
            f"that makes, {1e3 * learnt.late_m:.2g} mm rms. displacement.estimate_offset = true says that it is the "
            "clock; "
        )
    else:
        text += "displacement.estimate_offset = true asks for that; "
    text += "false says that both have one clock."
    return replace(learnt, warnings=(*learnt.warnings, Notice("clock-corrected", text)))


def two_rates(rate: ClockRate) -> UntrustedError:
    """The refusal of clocks that are said to be one, and run at two rates."""
    return UntrustedError(
        f"displacement: its clock gains {rate.ppm:+.0f} ± {1e6 * rate.std:.1g} ppm on the accelerometer's, "
        f"{1e3 * abs(rate.late) * rate.length_s:.4g} ms in {rate.length_s:.4g} s, and displacement.estimate_offset "
        "= false says that both have one clock. Leave estimate_offset out to have the clock corrected, or correct "
        "the time column; live, set both clocks by NTP."
    )


# Beyond this share the values that are left out are more than single outliers; beyond the smaller one they may be those
# after a clock's step, which the motion hides in part.
MANY_LEFT_OUT, FEW_LEFT_OUT = 0.2, 0.05


def left_out(pair: Pair, cleaned: Pair) -> float:
    """Share of the usable values of a pair that are outliers in the other."""
    usable = pair.rows[:, 2] < np.inf
    return float(np.mean(np.isinf(cleaned.rows[usable, 2]))) if usable.any() else 0.0


def on_one_clock(series: TimeSeries, origin_ns: int, pair: Pair) -> TimeSeries | None:
    """The values with the steps of their clock taken out of the stamps; None where none is found.

    origin_ns: what the pair's times count from. Values that may lie on either side of a step are NaN.
    """
    # A step leaves one half without any, in which the sensors agree; in the other it looks like the accelerometer's
    # noise.
    halves = [without_outliers(replace(pair, rows=rows, ratio=1.0))[1] for rows in np.array_split(pair.rows, 2)]
    fit = min(halves, key=lambda one: one.input_density)
    used = pair.used(fit.offset_s)
    jumps = clock_jumps(compared_by(pair, fit, pair.rows[used]))
    if not jumps:
        return None
    late_s, certain = lateness(jumps, len(used)), np.ones(len(used), dtype=bool)
    for jump in jumps:
        certain[jump.first : jump.last] = False
    place = np.searchsorted(origin_ns + np.rint(NANOSECONDS * pair.rows[used, 0]), series.time_ns, side="right") - 1
    place = np.clip(place, 0, len(used) - 1)
    moved = series.time_ns + np.rint(NANOSECONDS * (late_s - late_s[0])[place]).astype(np.int64)
    kept = np.concatenate(([True], moved[1:] > np.maximum.accumulate(moved)[:-1]))
    value = np.where(certain[place], series.value, np.nan)
    return replace(series, time_ns=moved[kept], value=value[kept])


def refuse_step(pair: Pair, fit: Fit) -> None:
    """UntrustedError where a clock that steps explains what the sensors differ by, but could not be taken out.

    None is claimed where the acceleration has gaps: what bridges them parts the sensors from there on as a step does.
    """
    if np.ptp(pair.samples[:, 2]) > 0.0:
        return
    cause = named_cause(replace(pair, ratio=1.0), fit.offset_s)
    if cause is not None and cause.cause is Cause.STEP:
        measured = f"displacement: it differs from the accelerometer by {1e3 * cause.difference_m:.3g} mm rms"
        raise UntrustedError(disagreement(cause, measured))


def many_left_out(pair: Pair, fit: Fit, share: float) -> Notice:
    """What to say of many values that are left out; UntrustedError where one cause explains them."""
    measured = f"displacement: {100 * share:.0f} % of its values contradict the acceleration"
    cause = named_cause(pair, fit.offset_s)
    if cause is not None:
        raise UntrustedError(disagreement(cause, measured))
    return Notice(
        "outliers",
        f"{measured} and were left out of the calibration as outliers. Where that is too many, check both sensors.",
    )
