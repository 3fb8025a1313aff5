"""Whether a target is still seen, judged against the amplitude that it had when it was calibrated.

Judged against the noise instead, the clutter that is left behind an obstruction would be taken for the target. The
noise of a weak target dips as deep in single frames: its power is averaged over as many as tell a dip from an
obstruction.
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

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


_mean_power = njit(cache=True)(mean_power)


@njit(cache=True)
def _judge(share, noise_share, gain, out):  # type: ignore[no-untyped-def]
    run, power = CLEAR_FRAMES, 1.0  # calibrated means seen
    for k in range(len(share)):
        if np.isnan(share[k]):
            # A frame that never arrived says nothing of what stands before the target.
            out[k] = True
            continue
        power = _mean_power(power, share[k], noise_share, gain)
        run = min(run + 1, CLEAR_FRAMES) if power >= MIN_SHARE**2 and share[k] <= MAX_SHARE else 0
        out[k] = run < CLEAR_FRAMES


def blocked(amplitude: Floats, usual: float, noise: float = 0.0) -> NDArray[np.bool_]:
    """Whether each frame (n,) is blocked, by a target's amplitude (n,) and its calibrated one, which is above 0.

    noise: variance of the complex noise of a frame.
    At once when it leaves the band, no longer after some good frames. A frame that was not received (NaN) is not seen
    either, but hides nothing of those after it.
    """
    out = np.empty(len(amplitude), dtype=np.bool_)
    noise_share = noise / usual**2
    _judge(np.asarray(amplitude, dtype=np.float64) / usual, noise_share, power_gain(noise_share), out)
    return out
