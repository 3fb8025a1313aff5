"""How lively a motion is: the mean square of its acceleration, as an accelerometer's errors go with it.

Gain, cross axis sensitivity, attitude and lever arm all make an error in proportion to the motion itself, so that the
noise of an accelerometer is taken as q(t) = q0 + kappa <a²>(t).
"""

import math

import numpy as np

from midspan import _core
from midspan.records import Floats

# The mean is over about a second: exponential, of this time constant. On real records 0.1 s to 2 s are alike.
MEMORY_S = 0.5


def mean_square(value: Floats, mean: float, before: float, rate_hz: float) -> Floats:
    """Mean square (n,) of an acceleration (n,) without its `mean`, over what came up to each sample, m²/s⁴.

    before: the mean square at the sample before the first one. Any cutting of the samples gives the same.
    """
    kept = math.exp(-1.0 / (MEMORY_S * rate_hz))
    return _core.mean_square(np.ascontiguousarray(value, dtype=np.float64), mean, before, kept)
