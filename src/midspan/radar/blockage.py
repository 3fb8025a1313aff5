"""Whether a target is still seen, judged against the amplitude that it had when it was calibrated.

Judged against the noise instead, the clutter that is left behind an obstruction would be taken for the target.
"""

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from midspan.checks import positive
from midspan.records import Floats


@dataclass(frozen=True, slots=True)
class BlockageSettings:
    """low, high: amplitude, as a share of the calibrated one, below or above which a frame is blocked; a wider band
    keeps more frames and lets more of what is not the target in. frames: good frames in a row before it counts as back.
    """

    low: float = 0.4
    high: float = 2.5
    frames: int = 5


@njit(cache=True)
def _judge(amplitude, limits, need, run, out):  # type: ignore[no-untyped-def]
    for k in range(len(amplitude)):
        if np.isnan(amplitude[k]):
            # A frame that never arrived says nothing of what stands before the target.
            out[k] = True
            continue
        good = limits[0] <= amplitude[k] <= limits[1]
        run = min(run + 1, need) if good else 0
        out[k] = run < need
    return run


class BlockageMonitor:
    """Blocked or not, frame by frame; any cutting into blocks gives the same output.

    amplitude: the calibrated amplitude of the target, in the unit of what is pushed.
    """

    def __init__(self, amplitude: float, settings: BlockageSettings | None = None) -> None:
        self._settings = settings or BlockageSettings()
        positive("amplitude", amplitude)
        self._limits = (self._settings.low * amplitude, self._settings.high * amplitude)
        self._run = self._settings.frames  # calibrated means seen

    def push(self, amplitude: Floats) -> NDArray[np.bool_]:
        """Whether each frame (n,) is blocked; at once when it leaves the band, no longer after some good frames.

        A frame that was not received (NaN) is not seen either, but hides nothing of those after it.
        """
        values = np.asarray(amplitude, dtype=np.float64)
        out = np.empty(len(values), dtype=np.bool_)
        self._run = _judge(values, self._limits, self._settings.frames, self._run, out)
        return out
