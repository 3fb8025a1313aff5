"""The two-stage paper's calibration, section 3: scale factor and clock offset at 30 and 3 frames/s; figures 18, 19, 23.

The steps are those of `papers.printed.camera`. "proposed" samples the displacement as the camera does before it is
filtered, "existing" after; with or without a spline of the cross-correlation.
"""

from typing import Any

import numpy as np

from midspan.calibration.camera.view import PrintedSteps
from midspan.calibration.fit import Pair
from midspan.papers.claims import Effort, Measured
from midspan.papers.motions import CAMERA_HZ
from midspan.papers.printed.camera import calibrate_printed
from midspan.papers.two_stage_003 import (
    FIRS,
    STOREY,
    STOREY_S,
    TONES_HZ,
    Record,
    alias_hz,
    errors_mm,
    recorded,
    storey_motion,
)


def aligned(record: Record, slow_hz: float, *, sampled_first: bool, spline: bool, late_s: float) -> tuple[float, float]:
    """Scale factor over the true one, and the clock offset's error in s; the camera's stamps are `late_s` late."""
    felt, seen = record.acceleration, record.displacement
    samples = np.column_stack((felt.time_ns / 1e9, felt.value_m_s2, np.ones(len(felt.time_ns))))
    rows = np.column_stack((seen.time_ns / 1e9 + late_s, seen.value_m, np.ones(len(seen.time_ns))))
    steps = PrintedSteps((0.5, min(3.0, 0.5 * slow_hz)), spline, sampled_first, sign=1)
    scale, offset = calibrate_printed(Pair(samples, rows), 1.0, steps)
    return scale.value_m_per_px, offset.value_s + late_s


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
