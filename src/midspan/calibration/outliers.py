"""Measurements that are wrong by far: single ones that leave their neighbours, and innovations beyond all noise."""

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from midspan.calibration.fit import MIN_FRAMES, Fit, Pair, aligned, best_corner, refine
from midspan.calibration.whitening import SETTLING, whiten_columns
from midspan.records import Floats
from midspan.signals.clipping import resolution
from midspan.signals.medians import SIGMA_OF_MEDIAN

# An innovation this many robust standard deviations out is left out of the fit; the rest is fitted again.
OUTLIER_LIMIT = 5.0
# A measurement is lonely when it leaves its neighbours by this many times their own range.
LONELY_LIMIT = 2.0
# A structure is shaken where the mean square of its acceleration is this many times the usual: by chance 2 % of the
# time.
SHAKEN = 4.0
# Rounds of marking outliers, at most.
MARKING_ROUNDS = 12


def cleaned(pair: Pair, fit: Fit, bound_s: float = 0.0, *, steps: bool = False) -> Pair:
    """The pair without outliers; each round takes out the largest, which had hidden the smaller ones.

    A wrong measurement kicks the filter, and the next innovations with it, and at the start those of all that come
    later: it is far outside in both directions of time, and only the largest of neighbours is marked. steps: where
    there is none left, what is far outside forwards alone is marked, as the first ones after a step of the zero; not
    where the clocks may differ, for that looks the same where a structure is struck. bound_s: how far the offset may
    move from the fit's meanwhile. The same object where there are none.
    """
    for _ in range(MARKING_ROUNDS):
        index, forwards, backwards = both_ways(pair, fit)
        bad = _far_outside(np.minimum(forwards, backwards))
        if steps and not bad.any():
            bad = _far_outside(np.where(np.isfinite(forwards), forwards, 0.0))
        # Of too few that are left none can be said to be the wrong one.
        left = np.count_nonzero(np.isfinite(pair.rows[:, 2])) - np.count_nonzero(bad)
        if not bad.any() or left < MIN_FRAMES:
            break
        rows = pair.rows.copy()
        rows[index[bad], 2] = np.inf
        pair = pair.changed(rows=rows)
        fit = best_corner(pair, fit.offset_s, fit.corner)
        fit = refine(pair, fit, bound_s) if bound_s > 0.0 else fit
    return pair


def _far_outside(size: Floats) -> NDArray[np.bool_]:
    """Which (k,) of the sizes of innovations are beyond the limit and the largest of their neighbours."""
    # The smaller one of two is beyond a limit by chance even less often than this says.
    spread = SIGMA_OF_MEDIAN * float(np.median(size)) if len(size) else 0.0
    largest = sliding_window_view(np.pad(size, 2), 5).max(axis=1) if len(size) else size
    return np.asarray((size > OUTLIER_LIMIT * max(spread, 1e-12)) & (size == largest) & (spread > 0.0))


def both_ways(pair: Pair, fit: Fit) -> tuple[NDArray[np.int64], Floats, Floats]:
    """Which rows (k,) are compared, and of each its innovation forwards and backwards in time (k,), in predicted
    standard deviations. The first ones of a direction settle its unknown start.
    """
    here = aligned(pair, fit.offset_s)
    # A piece of the noise ends, backwards, where it begins.
    ends, density = pair.pieces.T
    pieces = np.column_stack((-np.r_[pair.samples[0, 0], ends[:-1]], density))[::-1]
    rows, values = here.columns.rows[::-1] * np.array([-1.0, 1.0]), here.columns.values[::-1]
    w = whiten_columns(rows, values, pieces, fit.corner**4 / pair.rate_hz, slow=pair.slow)
    size = np.full((2, len(here.columns.rows)), np.inf)
    size[0, SETTLING:] = np.abs(fit.residual)
    size[1, SETTLING:] = np.abs(w.translation - fit.ratio * w.response) / np.sqrt(fit.noise * w.variance)
    return here.columns.index, size[0], size[1, ::-1]


def without_lonely_outliers(pair: Pair) -> Pair:
    """Mark single measurements that leave their three neighbours on each side far more than these differ.

    What the neighbours do is the measure, not the whole record: a passing vehicle in a quiet minute is no outlier. Nor
    is what a slow sensor sees of a structure that rings: the acceleration tells that there is motion.
    """
    rows, shaken = pair.rows.copy(), shaken_rows(pair)
    for _ in range(MARKING_ROUNDS):
        bad = _lonely(rows)
        bad = bad[~shaken[bad]]
        rows[bad, 2] = np.inf
        if not len(bad):
            break
    return pair.changed(rows=rows)


def shaken_rows(pair: Pair) -> NDArray[np.bool_]:
    """Whether the structure is shaken far more than usual about each measurement (m,), one of them more or less."""
    shaken = np.interp(pair.rows[:, 0], pair.samples[:, 0], pair.lively)
    about = sliding_window_view(np.pad(shaken, 1, mode="edge"), 3).max(axis=1)
    return np.asarray(about > SHAKEN * np.median(shaken))


def _lonely(rows: Floats) -> NDArray[np.int64]:
    index = np.flatnonzero(np.isfinite(rows[:, 2]))
    if len(index) < 8:
        return np.empty(0, dtype=np.int64)
    place, value = np.arange(len(index)), rows[index, 1]
    # At both ends the neighbours are the six nearest: the filter starts from the first ones, they must be right.
    first = np.clip(place - 3, 0, len(index) - 7)
    near = first[:, None] + np.arange(7)
    around = np.sort(value[near[near != place[:, None]].reshape(-1, 6)], axis=1)
    # One more outlier among the six neighbours does no harm.
    low, high = around[:, 1], around[:, -2]
    excess = np.maximum(value - high, low - value)
    # Readings in steps coarser than the motion have neighbours that are equal, and leave them by one step.
    usual = max(float(np.median(high - low)), resolution(value))
    lonely: NDArray[np.int64] = index[excess > LONELY_LIMIT * np.maximum(high - low, usual)]
    return lonely
