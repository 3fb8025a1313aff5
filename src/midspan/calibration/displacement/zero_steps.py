"""Steps of a displacement sensor's zero, taken out before its noise is estimated.

A step of centimetres looks like noise of the accelerometer, or like a slow error, of the whole record: both sensors are
then worth little in all of it. The estimator takes such a step out where it is beyond doubt
(`core/src/estimator/steps.rs`); here the same generalised likelihood ratio is asked of the innovations of the whole
record.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from midspan.calibration.fit import Fit, Pair, best_corner
from midspan.calibration.outliers import MARKING_ROUNDS
from midspan.calibration.slow_error import BEYOND_DOUBT, STEP_SHOWS, change_innovations
from midspan.records import NANOSECONDS, TimeSeries

# A step is looked for at this many of the largest innovations: at its own instant it is one of them, and few others
# are as large by chance or after it.
LARGEST = 5


def zero_steps(pair: Pair, fit: Fit) -> list[tuple[float, float]]:
    """Instants (s, on the sensor's own clock) and sizes of the steps that a record shows beyond doubt, largest first.

    pair, fit: as calibrated, with its slow error. None are claimed where the acceleration has gaps: what bridges them
    parts the sensors from there on as a step does.
    """
    steps = list[tuple[float, float]]()
    if np.ptp(pair.samples[:, 2]) > 0.0:
        return steps
    for _ in range(MARKING_ROUNDS):
        chi, at_s, size = max(_step(pair, fit, k) for k in np.argsort(-np.abs(fit.residual))[:LARGEST])
        if not chi > BEYOND_DOUBT * STEP_SHOWS:
            break
        steps.append((at_s, size))
        rows = pair.rows.copy()
        rows[rows[:, 0] >= at_s, 1] -= size
        pair = pair.changed(rows=rows)
        fit = best_corner(pair, fit.offset_s, fit.corner)
    return steps


def without_steps(series: TimeSeries, steps: Sequence[tuple[float, float]], origin_ns: int) -> TimeSeries:
    """The values without steps at instants in s from `origin_ns` on, of sizes in their own unit."""
    since_s, value = (series.time_ns - origin_ns) / NANOSECONDS, series.value.copy()
    for at_s, size in steps:
        value[since_s >= at_s] -= size
    return replace(series, value=value)


def _step(pair: Pair, fit: Fit, k: int) -> tuple[float, float, float]:
    """Chi-square of a step at the innovation `k`, its instant and its size."""
    used = fit.whitened.index
    # Readings that are left out before it belong to what follows the step.
    first = int(used[k - 1]) + 1 if k > 0 else int(used[k])
    at_s = float(pair.rows[first, 0])
    signature, left, noise = change_innovations(pair, fit, at_s, 0.0)
    known, matched = float(signature @ signature), float(signature @ left)
    if not (known > 0.0 and noise > 0.0):
        return 0.0, at_s, 0.0
    return matched * matched / (known * noise), at_s, matched / known
