"""A camera's targets without the tilt that a gyroscope on its box measures."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from midspan.calibration.camera.gyroscope import GyroscopeFit
from midspan.calibration.camera.turning import SEEN_HZ, Turning
from midspan.calibration.camera.view import SeenTarget, View
from midspan.records import Floats, seconds

# Lengths of the running mean that is taken off the angle: below, its integrated noise exceeds the tilt.
PERIODS = 2.0


def untilted(view: View, targets: Sequence[SeenTarget], turning: Turning, fit: GyroscopeFit) -> list[SeenTarget]:
    """The targets without what the camera tilts by above `turning.SEEN_HZ`; frames where nothing measured it are lost.

    turning: the gyroscope's readings about the view's window, fit: what was found of it.
    """
    offset_s = next(one.search.offset.value_s for one in fit.found if one is not None) - fit.offset_s
    fast = _fast(turning)
    found = []
    for target, known in zip(targets, fit.found, strict=True):
        time_s = seconds(target.rows.time_ns + view.late_ns, view.window_ns[0]) + offset_s
        angle = np.interp(time_s, turning.time_s, fast)
        if target.blur_s > 0.0:
            offsets = target.blur_s * (np.arange(8) - 3.5) / 8.0
            angle = np.mean([np.interp(time_s + one, turning.time_s, fast) for one in offsets], axis=0)
        value, variance = target.rows.along(view.axis)
        seen = turning.seen(time_s, 0.0)
        moved = np.where(seen, value - fit.focal_px * angle, np.nan)
        own = np.where(seen, variance, np.inf)
        rows = (
            replace(target.rows, x_px=moved, variance_x_px2=own)
            if view.axis == "x"
            else replace(target.rows, y_px=moved, variance_y_px2=own)
        )
        found.append(replace(target, rows=rows, untilted=known))
    return found


def _fast(turning: Turning) -> Floats:
    """The angle (n,) at the readings, rad, without its running mean, from which it counts at the ends."""
    angle = turning.angle(turning.time_s)
    width = 2 * round(0.5 * PERIODS / SEEN_HZ * turning.rate_hz) + 1
    window = np.hanning(width + 2)[1:-1]
    padded = np.pad(angle, width // 2, mode="reflect", reflect_type="odd")
    return np.asarray(angle - np.convolve(padded, window / window.sum(), mode="valid"))
