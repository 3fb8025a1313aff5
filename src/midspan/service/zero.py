"""The zero of a point's displacement, carried over from one opening of the point to the next.

Rows of both openings, before the change: a(t) counts from the zero in force, b(t) from the new one. Both have the same
errors of the sensors, so that d = mean(a - b) over the common rows is the distance of the zeros. Then b(t) + d
counts from the zero in force: the error of the new zero cancels, and what is left is that of the zero in force, of d,
and of the scale in force over the way from its zero to where the structure is.
"""

from dataclasses import dataclass

import numpy as np

from midspan.records import Estimate, Floats, Status

# The mean's variance is that of the means of so many segments: errors of rows are correlated over the filter's memory,
# which is below an eighth of what is compared. Of so few it is Student's, whose variance is (n - 1)/(n - 3) times it.
SEGMENTS = 8
# Rows that both must have: a tenth of a second a segment at 100 Hz.
MIN_COMMON_ROWS = 10 * SEGMENTS


@dataclass(frozen=True, slots=True)
class Zero:
    """What is added to rows (m) so that they count from an earlier zero, and the variance (m²) of that zero in them."""

    offset_m: float
    variance_m2: float

    def shift(self, rows: Estimate, own_m2: float) -> Estimate:
        """Rows that count from this zero; own_m2: variance of the zero that they counted from, which is in theirs."""
        variance_m2 = np.maximum(rows.variance_m2 - own_m2, 0.0) + self.variance_m2
        return Estimate(
            rows.time_ns, rows.displacement_m + self.offset_m, variance_m2, rows.velocity_m_s, rows.source, rows.status
        )


def carried(older: Estimate, newer: Estimate, zero: Zero, scale_std: float) -> Zero | None:
    """The zero in force for the rows of the new opening; None where too few rows of both rest on measurements.

    older: rows that count from the zero in force; newer: of the new opening, as it counts them. zero: in force, with
    what was added to the older rows. scale_std: relative standard deviation of the scale in force.
    """
    before, after = supported(older), supported(newer)
    _, of_older, of_newer = np.intersect1d(before.time_ns, after.time_ns, assume_unique=True, return_indices=True)
    if len(of_older) < MIN_COMMON_ROWS:
        return None
    apart = before.displacement_m[of_older] - after.displacement_m[of_newer]
    # The first rows of an opening are less certain than those after them.
    weight = 1.0 / (before.variance_m2[of_older] + after.variance_m2[of_newer])
    offset_m, mean_m2 = weighted_mean(apart, weight)
    way_m = float(np.average(before.displacement_m[of_older], weights=weight)) - zero.offset_m
    return Zero(offset_m, zero.variance_m2 + mean_m2 + (scale_std * way_m) ** 2)


def weighted_mean(values: Floats, weight: Floats) -> tuple[float, float]:
    """The mean of correlated values (n,) by their weights (n,), and its variance."""
    mean, whole = float(np.average(values, weights=weight)), float(np.sum(weight))
    parts = zip(np.array_split(values, SEGMENTS), np.array_split(weight, SEGMENTS), strict=True)
    shares = [(float(np.sum(w)) / whole, float(np.average(v, weights=w))) for v, w in parts]
    scatter = sum(share * (of_part - mean) ** 2 for share, of_part in shares) / (SEGMENTS - 1)
    return mean, scatter * (SEGMENTS - 1) / (SEGMENTS - 3)


def supported(rows: Estimate) -> Estimate:
    """The rows that rest on measurements."""
    good = (rows.status == Status.TRACKING) & np.isfinite(rows.displacement_m)
    return Estimate(*[getattr(rows, name)[good] for name in Estimate.__slots__])
