"""Where in a record the displacement's noise is other than declared, by the innovations of a first run.

For methods that look at the whole record. The steps between successive innovations are compared with what was
predicted; their median over a window is hardly touched by drift, by a jump or by one outlier in ten, and it keeps the
edge of a sudden change of light where it is.
"""

import numpy as np

from midspan.fusion.gate import NORMAL_MEDIAN
from midspan.records import Floats, Innovation

WINDOW = 61
# The median of 61 steps scatters by a fifth: three and a half times that is a change, less is chance.
CHANGED = 2.0
LEAST, MOST = 0.1, 30.0
# Innovations that follow each other this closely come from the acceleration, not from the displacement's noise.
ALIKE = 0.4


def noise_factors(innovation: Innovation, taken: Floats) -> Floats:
    """Standard deviation of each measurement's noise over the declared one (m,): 1 where it does not clearly differ.

    innovation: of one sensor, in time order; taken (m,): the standard deviation that the run took its noise with over
    the declared one. Fewer than 61 tell nothing: all 1.
    """
    count = len(innovation.value_m)
    if count < WINDOW:
        return np.ones(count)
    step = np.diff(innovation.value_m)
    predicted = innovation.variance_m2[1:] + innovation.variance_m2[:-1]
    size = np.abs(step) / np.sqrt(predicted) / NORMAL_MEDIAN
    found = np.clip(_running_median(np.concatenate((size[:1], size)) * taken), LEAST, MOST)
    changed = (found > CHANGED) | (found < 1.0 / CHANGED)
    normal = np.clip(innovation.value_m / np.sqrt(innovation.variance_m2) * taken / found, -4.0, 4.0)[changed]
    if normal[1:] @ normal[:-1] > ALIKE * (normal @ normal):
        return np.ones(count)
    return np.where(changed, found, 1.0)


def _running_median(values: Floats) -> Floats:
    """Median of the window around each value (n,); at the ends of the first and last whole window."""
    from scipy.ndimage import median_filter

    half = WINDOW // 2
    middle = median_filter(values, WINDOW, mode="nearest")
    middle[:half], middle[-half:] = middle[half], middle[-half - 1]
    return np.asarray(middle, dtype=np.float64)
