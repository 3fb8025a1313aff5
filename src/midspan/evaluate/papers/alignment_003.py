"""The two-stage paper's calibration, section 3: scale factor and clock offset at 30 and 3 frames/s; figures 18, 19, 23.

Steps as printed: double integral, band-pass, cross-correlation with or without a spline, least squares. "proposed"
samples the displacement as the camera does before it is filtered, "existing" after.
"""

from typing import Any

import numpy as np

from midspan.evaluate.papers.claims import Effort, Measured
from midspan.evaluate.papers.two_stage_003 import (
    CAMERA_HZ,
    FIRS,
    RATE_HZ,
    STOREY,
    STOREY_S,
    TONES_HZ,
    Record,
    alias_hz,
    errors_mm,
    recorded,
    storey_motion,
)
from midspan.records import Floats

LOW_HZ = 0.5
# The filter's beginning and end, s: a Butterworth filter of 0.5 Hz has settled.
EDGE_S = 4.0
MAX_LAG_S = 1.0


def _passed(values: Floats, rate_hz: float, high_hz: float) -> Floats:
    """Values (n,) from 0.5 Hz to `high_hz`, or without an upper end where that is half the rate."""
    from scipy.signal import butter, sosfiltfilt

    kind, edges = ("highpass", LOW_HZ) if high_hz > 0.49 * rate_hz else ("bandpass", [LOW_HZ, high_hz])
    return np.asarray(sosfiltfilt(butter(4, edges, kind, fs=rate_hz, output="sos"), values - np.mean(values)))


def aligned(record: Record, slow_hz: float, *, sampled_first: bool, spline: bool, late_s: float) -> tuple[float, float]:
    """Scale factor over the true one, and the clock offset's error in s; the camera's stamps are `late_s` late."""
    high_hz = min(3.0, 0.5 * slow_hz)
    at_s = record.displacement.time_ns / 1e9
    track = _passed(record.displacement.value_m, slow_hz, high_hz)
    felt_s = record.acceleration.time_ns / 1e9
    speed = np.cumsum(record.acceleration.value_m_s2 - np.mean(record.acceleration.value_m_s2)) / RATE_HZ
    # A sum over the samples holds half a step more, a sum of sums a whole one.
    moved, moved_s = np.cumsum(speed - np.mean(speed)) / RATE_HZ, felt_s + 1 / RATE_HZ
    moved -= np.polynomial.Polynomial.fit(moved_s, moved, 2)(moved_s)

    def seen(time_s: Floats) -> Floats:
        if sampled_first:
            return _passed(np.interp(time_s, moved_s, moved), slow_hz, high_hz)
        return np.asarray(np.interp(time_s, moved_s, _passed(moved, RATE_HZ, high_hz)))

    offset_s = _lag_s(seen(at_s + late_s), track, slow_hz, spline=spline)
    inner = slice(round(EDGE_S * slow_hz), -round(EDGE_S * slow_hz))
    known, found = seen(at_s + late_s + offset_s)[inner], track[inner]
    return float(found @ known / (found @ found)), offset_s + late_s


def _lag_s(known: Floats, track: Floats, rate_hz: float, *, spline: bool) -> float:
    """By how much later `known` must be taken for its correlation with `track` to be largest, s."""
    from scipy.interpolate import CubicSpline

    most = max(int(MAX_LAG_S * rate_hz), 3)
    lags = np.arange(-most, most + 1)
    middle = slice(most, len(track) - most)
    whole = np.array([float(np.roll(known, -lag)[middle] @ track[middle]) for lag in lags])
    best = int(np.argmax(whole))
    if not spline:
        return float(lags[best] / rate_hz)
    fine = np.linspace(lags[max(best - 1, 0)], lags[min(best + 1, len(lags) - 1)], 2001)
    return float(fine[np.argmax(CubicSpline(lags, whole)(fine))] / rate_hz)


def scales(effort: Effort) -> Measured:
    """Figures 18 and 19: excitation 1 at 30 and at 3 frames/s, clocks as they are."""
    found: dict[str, Any] = {}
    for rate, every in ((30, 1), (3, 10)):
        slow_hz = CAMERA_HZ / every
        record = recorded(storey_motion(TONES_HZ[0], effort.seed), STOREY_S, slow_hz, STOREY, effort.seed)
        for name, first in (("proposed", True), ("existing", False)):
            scale, _ = aligned(record, slow_hz, sampled_first=first, spline=True, late_s=0.0)
            found[f"{name} at {rate} frames/s"] = scale
    found["proposed, change %"] = 100 * abs(found["proposed at 3 frames/s"] / found["proposed at 30 frames/s"] - 1)
    found["existing, change %"] = 100 * abs(found["existing at 3 frames/s"] / found["existing at 30 frames/s"] - 1)
    return Measured(found)


def offsets(effort: Effort) -> Measured:
    """Figure 23: the proposed fusion with what each way of aligning leaves of an unknown offset."""
    rng = np.random.default_rng([12, effort.seed])
    ratio: dict[str, list[float]] = {"aliased below 1 Hz": [], "others": []}
    for every in (3, 10) if effort.quick else (3, 5, 6, 10):
        slow_hz = CAMERA_HZ / every
        for tone in TONES_HZ:
            late_s = float(rng.uniform(0.2, 0.5)) / slow_hz
            motion = storey_motion(tone, effort.seed)
            record = recorded(motion, STOREY_S, slow_hz, STOREY, effort.seed)
            error = []
            for spline in (True, False):
                _, left_s = aligned(record, slow_hz, sampled_first=True, spline=spline, late_s=late_s)
                sensors = type(STOREY)(STOREY.acceleration_std, STOREY.displacement_std, STOREY.bias_m_s2, left_s)
                again = recorded(motion, STOREY_S, slow_hz, sensors, effort.seed)
                error.append(errors_mm(again, {"proposed": FIRS["proposed"]})["proposed"])
            low = slow_hz < 2 * tone and alias_hz(tone, slow_hz) < 1.0
            ratio["aliased below 1 Hz" if low else "others"].append(error[0] / error[1])
    return Measured({f"with over without spline, {name}": float(np.mean(one)) for name, one in ratio.items()})
