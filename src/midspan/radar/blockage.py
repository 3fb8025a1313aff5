"""Whether a target is still seen, judged against the amplitude that it had when it was calibrated.

Judged against the noise instead, the clutter that is left behind an obstruction would be taken for the target. The
noise of a weak target dips as deep in single frames: its power is averaged over as many as tell a dip from an
obstruction.
"""

import numpy as np
from numpy.typing import NDArray

from midspan import _core
from midspan.records import Floats

# Amplitude, as a share of the calibrated one, below or above which a frame is blocked; a wider band keeps more frames
# and lets more of what is not the target in.
MIN_SHARE, MAX_SHARE = 0.4, 2.5
# Good frames in a row before the target counts as seen again.
CLEAR_FRAMES = 5
# By this many standard deviations the mean power of a target that is seen stays above that of MIN_SHARE: noise hides
# it once in 30 000 frames.
SEEN_STD = 4.0


def power_gain(noise_share: float) -> float:
    """The share of a new frame in the running mean of a target's power, 0 … 1; noise_share: noise power over its own.

    The power of a frame varies by 2 n + n² (variance, n the share); a running mean by g / (2 - g) of that.
    """
    variance = 2.0 * noise_share + noise_share**2
    if not variance > 0.0:
        return 1.0
    allowed = ((1.0 - MIN_SHARE**2) / SEEN_STD) ** 2 / variance
    return min(2.0 * allowed / (1.0 + allowed), 1.0)


def mean_power(before: float, share: float, noise_share: float, gain: float) -> float:
    """The running mean of a target's power, without that of the noise, with a frame of amplitude `share` more."""
    return before + gain * (min(share, MAX_SHARE) ** 2 - noise_share - before)


def blocked(amplitude: Floats, usual: float, noise: float = 0.0) -> NDArray[np.bool_]:
    """Whether each frame (n,) is blocked, by a target's amplitude (n,) and its calibrated one, which is above 0.

    noise: variance of the complex noise of a frame.
    At once when it leaves the band, no longer after some good frames. A frame that was not received (NaN) is not seen
    either, but hides nothing of those after it.
    """
    share, noise_share = np.asarray(amplitude, dtype=np.float64) / usual, noise / usual**2
    return _core.blocked(share, noise_share, power_gain(noise_share), (MIN_SHARE, MAX_SHARE), CLEAR_FRAMES)
