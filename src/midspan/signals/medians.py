"""What the median of a normal variable's deviations says of its standard deviation."""

import numpy as np

from midspan.records import Floats

# Standard deviation over the median distance from the median, which is 0.6745 standard deviations.
SIGMA_OF_MEDIAN = 1.4826
MEDIAN_DEVIATION = 0.6745
# Median of the square of a normal variable of variance 1.
MEDIAN_OF_SQUARE = 0.4549


def white_noise(value: Floats) -> float:
    """White noise per sample of a signal (n,) far slower than its rate: third differences sum 20 variances."""
    third = np.diff(value, 3)
    return float(SIGMA_OF_MEDIAN * np.median(np.abs(third)) / np.sqrt(20.0)) if len(third) else 0.0
