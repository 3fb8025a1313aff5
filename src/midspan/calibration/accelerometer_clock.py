"""An accelerometer's clock that steps forward: its stamps leave out a time that the motion does not."""

from dataclasses import replace

import numpy as np

from midspan.calibration.agreement import least_lead
from midspan.calibration.fit import MIN_MEASUREMENTS, Fit, Pair, best_corner, measured_rows
from midspan.errors import UntrustedError
from midspan.records import NANOSECONDS, Floats, Nanoseconds
from midspan.signals.acceleration import PreparedAcceleration
from midspan.signals.health import GAP_STEPS, clock
from midspan.signals.stamps import inside, shown

# Compared on either side of a gap, ns; of this many gaps, the longest ones.
WINDOW_NS, MAX_GAPS = 60 * NANOSECONDS, 5


def refuse_forward_step(prepared: PreparedAcceleration, time_ns: Nanoseconds, value_m: Floats, sensor: str) -> None:
    """UntrustedError where a sensor's values (n,) fit the acceleration far better without a gap in its stamps.

    Where samples are missing, the acceleration after them belongs to the values after the gap; where the clock steps,
    to those right after its beginning. Both are judged by the same values.
    """
    step_ns = round(NANOSECONDS / prepared.rate_hz)
    gaps = clock(prepared.time_ns, GAP_STEPS).gaps
    length_ns = np.diff(prepared.time_ns)[gaps] - step_ns
    for k in np.argsort(length_ns)[::-1][:MAX_GAPS]:
        begin, gap_ns = int(prepared.time_ns[gaps[k]]), int(length_ns[k])
        if begin + gap_ns > time_ns[-1]:
            # What follows is no part of the common time.
            continue
        moved = prepared.time_ns - np.where(np.arange(len(prepared.time_ns)) > gaps[k], gap_ns, 0)
        first = max(begin - WINDOW_NS, int(prepared.time_ns[0]))
        last = min(begin + WINDOW_NS + gap_ns, int(moved[-1]))
        used = inside(time_ns, first, last)
        if used.stop - used.start < MIN_MEASUREMENTS or last < begin + step_ns:
            continue
        rows = measured_rows(time_ns[used], value_m[used], np.where(np.isfinite(value_m[used]), 1.0, np.inf), first)
        as_stamped = _fit(prepared, rows, first, last)
        without_gap = _fit(replace(prepared, time_ns=moved), rows, first, last)
        if without_gap.likelihood - as_stamped.likelihood > least_lead(len(rows)):
            raise UntrustedError(
                f"accelerometer: its time stamps have a gap of {gap_ns / NANOSECONDS:.4g} s at {shown(begin)}, but "
                f"{sensor} fits far better without it: its clock stepped forward and no sample is missing. Subtract "
                "the step from its time column, or cut the recording there."
            )


def _fit(prepared: PreparedAcceleration, rows: Floats, first_ns: int, last_ns: int) -> Fit:
    """The likeliest fit of rows (m, 3) in metres to the acceleration of a window."""
    which = inside(prepared.time_ns, first_ns - NANOSECONDS, last_ns + NANOSECONDS)
    return best_corner(Pair(prepared.rows(first_ns, which), rows, 1.0), 0.0)
