"""Frames that are not taken at their stamps: what the radar differs by then grows with the speed.

An error δ of a frame's instant is one of v δ of the range, and the next frame's is another one. What moves on its own
knows nothing of the structure's speed v; what bends the phase, or a gain that drifts, makes errors that last for some
frames.
"""

import numpy as np

from midspan.calibration.fit import Fit, Pair
from midspan.notices import Notice

# Jitter is named where the squares of the innovations grow with that of the speed by this many standard deviations (one
# in 300 000 records without jitter), and where this share of them at least goes with it.
CERTAIN, MIN_SHARE = 4.5, 0.1
# Of errors that frames have independently no more than this share is common to one frame and those after it: three
# products, each uncertain by up to a fifth where the jitter is CERTAIN; errors that last for some frames had a half.
LAGS, MAX_COMMON = (1, 2, 3), 0.4

JITTER = Notice(
    "clock-uncertain",
    "radar: its time stamps have jitter: the difference from the accelerometer grows with speed. The error band "
    "includes it as noise or target motion. Use time stamps of the radar's own clock.",
)


def frames_jitter(pair: Pair, fit: Fit) -> bool:
    """Whether what the frames differ by from the acceleration goes with the speed, frame by frame."""
    index, residual = fit.whitened.index, fit.residual / max(float(np.sqrt(np.mean(fit.residual**2))), 1e-300)
    speed = pair.responses[0].velocity(pair.rows[index, 0] + fit.offset_s)
    x = speed**2 / max(float(np.mean(speed**2)), 1e-300) - 1.0
    spread = max(float(np.sum(x**2)), 1e-300)
    n = len(residual)
    share, *common = (float(np.sum((x * residual)[: n - lag] * residual[lag:])) for lag in (0, *LAGS))
    certain = share > max(CERTAIN * float(np.std(residual**2)) * np.sqrt(spread), MIN_SHARE * spread)
    return bool(certain and max(map(abs, common)) < MAX_COMMON * share)
