"""Whether a target is still seen, judged against the amplitude that it had when it was calibrated.

Judged against the noise instead, the clutter that is left behind an obstruction would be taken for the target.
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


@njit(cache=True)
def _judge(share, out):  # type: ignore[no-untyped-def]
    run = CLEAR_FRAMES  # calibrated means seen
    for k in range(len(share)):
        if np.isnan(share[k]):
            # A frame that never arrived says nothing of what stands before the target.
            out[k] = True
            continue
        run = min(run + 1, CLEAR_FRAMES) if MIN_SHARE <= share[k] <= MAX_SHARE else 0
        out[k] = run < CLEAR_FRAMES


def blocked(amplitude: Floats, usual: float) -> NDArray[np.bool_]:
    """Whether each frame (n,) is blocked, by a target's amplitude (n,) and its calibrated one, which is above 0.

    At once when it leaves the band, no longer after some good frames. A frame that was not received (NaN) is not seen
    either, but hides nothing of those after it.
    """
    out = np.empty(len(amplitude), dtype=np.bool_)
    _judge(np.asarray(amplitude, dtype=np.float64) / usual, out)
    return out
