"""Steps of a displacement sensor's zero, taken out before its noise is estimated.

A step of centimetres looks like noise of the accelerometer, or like a slow error, of the whole record: both sensors are
then worth little in all of it. The estimator takes such a step out where it is beyond doubt
(`core/src/estimator/steps.rs`); here the same generalised likelihood ratio is asked of the innovations of the whole
record.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from midspan.calibration.fit import Fit, Pair, best_corner
from midspan.calibration.slow_error import BEYOND_DOUBT, STEP_SHOWS, change_shown
from midspan.notices import Notice
from midspan.records import NANOSECONDS, TimeSeries
from midspan.signals.stamps import shown

# A step is looked for at this many of the largest innovations: at its own instant it is one of them, and few others
# are as large by chance or after it.
LARGEST = 5
# The largest number of steps that are taken out of a record; a zero that steps more often is no zero.
MAX_STEPS = 12


class ZeroStep(NamedTuple):
    """A step of a sensor's zero: the stamp (ns) from which on readings have it, and its size in their own unit."""

    time_ns: int
    size: float


def zero_steps(pair: Pair, fit: Fit, origin_ns: int) -> tuple[ZeroStep, ...]:
    """The steps that a record shows beyond doubt, largest first; origin_ns: the stamp that the pair's times count from.

    pair, fit: as calibrated, with its slow error. None are claimed where the acceleration has gaps: what bridges them
    parts the sensors from there on as a step does.
    """
    steps = list[ZeroStep]()
    if np.ptp(pair.samples[:, 2]) > 0.0:
        return ()
    for _ in range(MAX_STEPS):
        chi, at_s, size = max(_step(pair, fit, k) for k in np.argsort(-np.abs(fit.residual))[:LARGEST])
        if not chi > BEYOND_DOUBT * STEP_SHOWS:
            break
        steps.append(ZeroStep(origin_ns + round(NANOSECONDS * at_s), size))
        rows = pair.rows.copy()
        rows[rows[:, 0] >= at_s, 1] -= size
        pair = pair.changed(rows=rows)
        fit = best_corner(pair, fit.offset_s, fit.corner)
    return tuple(steps)


def without_steps(series: TimeSeries, steps: Sequence[ZeroStep]) -> TimeSeries:
    """The values without the steps."""
    value = series.value.copy()
    for step in steps:
        value[series.time_ns >= step.time_ns] -= step.size
    return replace(series, value=value)


def steps_taken_out(steps: Sequence[ZeroStep], factor: float = 1.0) -> Notice:
    """A sentence on steps that were taken out; factor: metres in one metre read."""
    where = ", ".join(f"{1e3 * factor * step.size:+.3g} mm at {shown(step.time_ns)}" for step in sorted(steps))
    text = (
        f"displacement: its zero stepped ({where}); the step was removed for the calibration. Check what moved the "
        "sensor."
    )
    return Notice("zero-shifted", text)


def _step(pair: Pair, fit: Fit, k: int) -> tuple[float, float, float]:
    """Chi-square of a step at the innovation `k`, its instant and its size."""
    used = fit.whitened.index
    # Readings that are left out before it belong to what follows the step.
    first = int(used[k - 1]) + 1 if k > 0 else int(used[k])
    at_s = float(pair.rows[first, 0])
    change = change_shown(pair, fit, at_s)
    return change.chi_square, at_s, change.size
