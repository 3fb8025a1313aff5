"""A displacement sensor of which many values contradict the acceleration: its clock steps, or something else is wrong.

After a step of the clock all values are outliers for a calibration on one clock. They must not be left out in silence:
the calibration would be that of the rest, and its error band would not hold what the record then shows.
"""

from dataclasses import replace

import numpy as np

from midspan.calibration.causes import Cause, likeliest_cause
from midspan.calibration.clock import Compared
from midspan.calibration.clock_jumps import clock_jumps, lateness
from midspan.calibration.displacement.cause_words import disagreement
from midspan.calibration.fit import Fit, Pair
from midspan.calibration.noise import without_outliers
from midspan.errors import UntrustedError
from midspan.notices import Notice
from midspan.records import NANOSECONDS, TimeSeries

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
    samples = pair.samples * np.array([1.0, 1.0, fit.input_density])
    metres = pair.rows[used] / np.array([1.0, fit.ratio, fit.ratio**2 / fit.noise])
    jumps = clock_jumps(Compared(samples, metres + np.array([fit.offset_s, 0.0, 0.0])))
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
    compared = replace(pair, ratio=1.0)
    cause = likeliest_cause(compared, fit.offset_s)
    if cause is not None and cause.named and cause.cause is Cause.STEP:
        measured = f"displacement: it differs from the accelerometer by {1e3 * cause.difference_m:.3g} mm rms"
        raise UntrustedError(disagreement(compared, fit.offset_s, measured))


def many_left_out(pair: Pair, fit: Fit, share: float) -> Notice:
    """What to say of many values that are left out; UntrustedError where one cause explains them."""
    measured = f"displacement: {100 * share:.0f} % of its values contradict the acceleration"
    cause = likeliest_cause(pair, fit.offset_s)
    if cause is not None and cause.named:
        raise UntrustedError(disagreement(pair, fit.offset_s, measured))
    return Notice(
        "outliers",
        f"{measured} and were left out of the calibration as outliers. Where that is too many, check both sensors.",
    )
