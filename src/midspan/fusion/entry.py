"""Checks of plain arrays where they enter from outside: what a record promises, and what no number may be."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from midspan.checks import instance, refuse, same_length
from midspan.records import Acceleration, Displacement, Nanoseconds, Source

# Beyond any structure: a thousand kilometres, and a thousand times the shock range of a sensor.
MAX_M, MAX_M_S2 = 1e6, 1e7


def sound_acceleration(record: Acceleration) -> Acceleration:
    """The block itself; UsageError where it is not as `Acceleration` promises."""
    instance("acceleration", record, Acceleration, "a block of midspan.Acceleration")
    same_length(time_ns=record.time_ns, value_m_s2=record.value_m_s2, noise_density=record.noise_density)
    _stamps("time_ns of the acceleration", record.time_ns, strictly=True)
    remedy = "Leave such samples out, or bridge them and raise noise_density there."
    _within("value_m_s2", record.value_m_s2, (-MAX_M_S2, MAX_M_S2), f"within ±{MAX_M_S2:g}", remedy)
    limits = (np.nextafter(0.0, 1.0), np.finfo(np.float64).max)
    _within("noise_density", record.noise_density, limits, "finite and above 0 ((m/s²)²/Hz)", "")
    return record


def sound_displacement(record: Displacement, *, ordered: bool = True) -> Displacement:
    """The block itself; UsageError where it is not as `Displacement` promises; ordered: its stamps must be."""
    instance("displacement", record, Displacement, "a block of midspan.Displacement")
    value, variance, source = record.value_m, record.variance_m2, record.source
    same_length(time_ns=record.time_ns, value_m=value, variance_m2=variance, source=source)
    _stamps("time_ns of the displacement", np.sort(record.time_ns) if not ordered else record.time_ns, strictly=False)
    used = np.isfinite(value) & np.isfinite(variance)
    far = used & ~(np.abs(value) <= MAX_M)
    _numbers("value_m", record.value_m, ~far, f"within ±{MAX_M:g} m, or NaN", "Check the unit: it is metres.")
    _numbers("variance_m2", record.variance_m2, ~used | (record.variance_m2 > 0.0), "above 0 (m²), or NaN", "")
    known = np.isin(record.source, [int(one) for one in Source])
    _numbers("source", record.source, known, f"a code of Source, 0 to {max(Source).value}", "")
    return record


def require_record(acceleration: Acceleration, displacement: Displacement) -> None:
    """UsageError where the blocks of a whole record are not as they promise."""
    sound_acceleration(acceleration)
    sound_displacement(displacement, ordered=False)
    if len(acceleration.time_ns) < 2:
        raise refuse("acceleration", "at least 2 samples", len(acceleration.time_ns))


def _stamps(name: str, time_ns: Nanoseconds, *, strictly: bool) -> None:
    if not np.issubdtype(np.asarray(time_ns).dtype, np.integer):
        remedy = "Give np.rint(1e9 * time_s).astype(np.int64)."
        raise refuse(name, "whole nanoseconds (int64)", str(np.asarray(time_ns).dtype), remedy)
    bad = time_ns[1:] <= time_ns[:-1] if strictly else time_ns[1:] < time_ns[:-1]
    if bad.any():
        wrong = np.flatnonzero(bad)
        rule = "increasing from sample to sample" if strictly else "in the order of time"
        raise refuse(name, rule, f"{time_ns[wrong[0] + 1]} after {time_ns[wrong[0]]} at index {wrong[0] + 1}")


def _within(name: str, values: NDArray[Any], limits: tuple[float, float], rule: str, remedy: str) -> None:
    low, high = limits
    # Two reductions without arrays between: most of a whole record's entry. NaN is the least and the greatest.
    if len(values) and not (values.min() >= low and values.max() <= high):
        _numbers(name, values, (values >= low) & (values <= high), rule, remedy)


def _numbers(name: str, values: NDArray[Any], good: NDArray[np.bool_], rule: str, remedy: str) -> None:
    if not good.all():
        wrong = np.flatnonzero(~good)
        raise refuse(name, rule, f"{values[wrong[0]]} at index {wrong[0]}", remedy)
