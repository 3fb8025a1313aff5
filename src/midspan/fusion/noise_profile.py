"""Where in a record the displacement's noise is other than declared, by the innovations of a first run.

For methods that look at the whole record. The steps between innovations, the smaller one of those from the two before,
so that an outlier counts once, are compared with what was predicted; their median over a window is hardly touched by drift, by a jump or by one outlier in ten, and it keeps the
edge of a sudden change of light where it is. A short window sees where the noise changes, long ones before, around and
after a measurement tell better how large it is: of these the one counts that comes nearest to the short one.
"""

import numpy as np

from midspan.fusion.noise_online import LEAST_OF_TWO
from midspan.records import Floats, Innovation

WINDOW, LONG = 61, 301
# The median of 61 steps scatters by a fifth, that of more of them by less: three and a half times that is a change,
# less is chance. Where the short window leaves all long ones by the factor, it counts alone.
SCATTER, CHANCES, CHANGED = 0.2, 3.5, 2.0
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
    size = np.minimum(_step(innovation, 1), _step(innovation, 2)) / np.sqrt(LEAST_OF_TWO)
    found, long = _found(size * taken)
    clear = 1.0 + CHANCES * SCATTER * np.sqrt(WINDOW / long)
    changed = (found > clear) | (found < 1.0 / clear)
    normal = np.clip(innovation.value_m / np.sqrt(innovation.variance_m2) * taken / found, -4.0, 4.0)[changed]
    if normal[1:] @ normal[:-1] > ALIKE * (normal @ normal):
        return np.ones(count)
    return np.where(changed, found, 1.0)


def _step(innovation: Innovation, back: int) -> Floats:
    """Steps (m,) from so many innovations before, in predicted standard deviations; the first as the one after it."""
    size = np.abs(innovation.value_m[back:] - innovation.value_m[:-back])
    size /= np.sqrt(innovation.variance_m2[back:] + innovation.variance_m2[:-back])
    return np.concatenate((np.full(back, size[0]), size))


def _found(sizes: Floats) -> tuple[Floats, int]:
    """Factor at each measurement (n,) by the medians of its step sizes, and how long the long window is."""
    count = len(sizes)
    long = min(LONG, count - 1 + count % 2)
    short, around = _running_median(sizes, WINDOW), _running_median(sizes, long)
    which, aside = np.arange(count), (long - WINDOW) // 2
    sides = np.stack([around[np.clip(which + shift, 0, count - 1)] for shift in (0, -aside, aside)])
    nearest = sides[np.argmin(np.abs(np.log(np.maximum(sides, LEAST) / np.maximum(short, LEAST))), axis=0), which]
    sudden = (short > CHANGED * nearest) | (CHANGED * short < nearest)
    return np.clip(np.where(sudden, short, nearest), LEAST, MOST), long


def _running_median(values: Floats, window: int) -> Floats:
    """Median of the window around each value (n,); at the ends of the first and last whole window."""
    from scipy.ndimage import median_filter

    half = window // 2
    middle = median_filter(values, window, mode="nearest")
    middle[:half], middle[-half:] = middle[half], middle[-half - 1]
    return np.asarray(middle, dtype=np.float64)
