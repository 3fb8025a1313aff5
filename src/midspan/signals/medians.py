"""What the median of a normal variable's deviations says of its standard deviation."""

# Standard deviation over the median distance from the median, which is 0.6745 standard deviations.
SIGMA_OF_MEDIAN = 1.4826
MEDIAN_DEVIATION = 0.6745
# Median of the square of a normal variable of variance 1.
MEDIAN_OF_SQUARE = 0.4549
