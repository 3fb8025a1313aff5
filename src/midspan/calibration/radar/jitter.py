"""Frames that are not taken at their stamps: what the radar differs by then grows with the speed.

An error δ of a frame's instant is one of v δ of the range. What moves on its own, or bends the phase, knows nothing of
the structure's speed v.
"""

import numpy as np

from midspan.calibration.fit import Fit, Pair
from midspan.notices import Notice

# Jitter is named where the squares of the innovations grow with that of the speed by this many standard deviations (one
# in 300 000 records without jitter), and where this share of them at least goes with it.
CERTAIN, MIN_SHARE = 4.5, 0.1

JITTER = Notice(
    "clock-uncertain",
    "radar: its frames are not taken at their stamps (jitter): what it and the accelerometer differ by grows with the "
    "speed. The error band holds it as noise, or as motion of the target. Take the stamps from the radar's own clock.",
)


def frames_jitter(pair: Pair, fit: Fit) -> bool:
    """Whether what the frames differ by from the acceleration goes with the speed."""
    w, square = fit.whitened, fit.residual**2
    speed = pair.responses[0].velocity(pair.rows[w.index, 0] + fit.offset_s)
    x, y = speed**2 / max(float(np.mean(speed**2)), 1e-300), square / max(float(np.mean(square)), 1e-300)
    spread = max(float(np.sum((x - 1.0) ** 2)), 1e-300)
    share = float(np.sum((x - 1.0) * y)) / spread
    return bool(share > max(CERTAIN * float(np.std(y)) / np.sqrt(spread), MIN_SHARE))
