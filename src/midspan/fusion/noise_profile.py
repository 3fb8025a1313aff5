"""Where in a record the displacement's noise is other than declared, by the innovations of a first run.

For methods that look at the whole record. The steps between successive innovations are compared with what was
predicted; their median over a window is hardly touched by drift or by a jump, and it keeps the edge of a sudden change
of light where it is. What lies far outside by that is left out, and the steps between the others tell. A short window
sees where the noise changes, long ones tell better how large it is: one around the measurement, or where those before
and after it differ clearly, of these the one that comes nearer to the short one.
"""

import numpy as np

from midspan.fusion.gate import NORMAL_MEDIAN
from midspan.records import Floats, Innovation, part

WINDOW, LONG = 61, 301
# The median of 61 steps scatters by a fifth, that of more of them by less: three and a half times that is a change,
# less is chance. Where the short window leaves all long ones by the factor, it counts alone.
SCATTER, CHANCES, CHANGED = 0.2, 3.5, 2.0
LEAST, MOST = 0.1, 30.0
# Innovations so many times as large as predicted, with the noise that the steps show, are outliers.
OUTLYING = 5.0
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
    normal = innovation.value_m / np.sqrt(innovation.variance_m2) * taken
    short = _running_median(_steps(innovation) * taken, WINDOW)
    kept = np.flatnonzero(np.abs(normal) < OUTLYING * np.maximum(short, LEAST))
    if len(kept) < WINDOW:
        return np.ones(count)
    found, long = _found(_steps(part(innovation, kept)) * taken[kept])
    # What is left out takes after its neighbours: the noisier one, in case it was the first of more noise.
    after, last = np.searchsorted(kept, np.arange(count)), len(kept) - 1
    before = np.maximum(np.searchsorted(kept, np.arange(count), side="right") - 1, 0)
    found = np.maximum(found[before], found[np.minimum(after, last)])
    clear = 1.0 + CHANCES * SCATTER * np.sqrt(WINDOW / long)
    changed = (found > clear) | (found < 1.0 / clear)
    normal = np.clip(normal / found, -4.0, 4.0)[changed]
    if normal[1:] @ normal[:-1] > ALIKE * (normal @ normal):
        return np.ones(count)
    return np.where(changed, found, 1.0)


def _steps(innovation: Innovation) -> Floats:
    """Steps (m,) to the innovation before, over the median of what is predicted; the first as the second."""
    predicted = innovation.variance_m2[1:] + innovation.variance_m2[:-1]
    size = np.abs(np.diff(innovation.value_m)) / np.sqrt(predicted) / NORMAL_MEDIAN
    return np.concatenate((size[:1], size))


def _found(sizes: Floats) -> tuple[Floats, int]:
    """Factor at each measurement (n,) by the medians of its step sizes, and how long the long window is."""
    count = len(sizes)
    long = min(LONG, count - 1 + count % 2)
    short, around = (np.maximum(_running_median(sizes, window), LEAST) for window in (WINDOW, long))
    which, aside = np.arange(count), (long - WINDOW) // 2
    before, after = (around[np.clip(which + shift, 0, count - 1)] for shift in (-aside, aside))
    # The median of the steps around an edge is the harmonic mean of both sides: nearest in the inverse keeps it there.
    nearest = np.where(np.abs(1.0 / before - 1.0 / short) < np.abs(1.0 / after - 1.0 / short), before, after)
    nearest = np.where(np.maximum(before, after) < CHANGED * np.minimum(before, after), around, nearest)
    sudden = (short > CHANGED * nearest) | (CHANGED * short < nearest)
    return np.clip(np.where(sudden, short, nearest), LEAST, MOST), long


def _running_median(values: Floats, window: int) -> Floats:
    """Median of the window around each value (n,); at the ends of the first and last whole window."""
    from scipy.ndimage import median_filter

    half = window // 2
    middle = median_filter(values, window, mode="nearest")
    middle[:half], middle[-half:] = middle[half], middle[-half - 1]
    return np.asarray(middle, dtype=np.float64)
