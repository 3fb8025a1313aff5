"""A calibration window in which the slower sensor's clock jumps: it was set, or frames were lost or doubled.

One jump leaves one half of the window without any. Calibrated there, the rest of the window shows the jump and its size
(see `clock_jumps`), and the stamps are moved onto the clock of the window's start.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from midspan.calibration.clock import Compared
from midspan.calibration.clock_jumps import ClockJump, clock_jumps, lateness
from midspan.calibration.fit import MIN_FRAMES, Pair
from midspan.calibration.time_offset import OffsetSearch, search_offset
from midspan.errors import UntrustedError
from midspan.notices import Notice
from midspan.records import Floats


def without_jumps(
    pair: Pair, max_offset_s: float, refuse: Callable[[OffsetSearch], None]
) -> tuple[Pair, list[ClockJump]]:
    """The pair with its stamps on one clock, and the jumps that were taken out; none where nothing shows any.

    refuse: raises UntrustedError where a search is not to be trusted.
    """
    halves = np.array_split(pair.rows, 2)
    found = [search for rows in halves if (search := _trusted(replace(pair, rows=rows), max_offset_s, refuse))]
    if not found:
        return pair, []
    search = max(found, key=lambda one: one.fit.gain)
    fit, index = search.fit, pair.used(search.fit.offset_s)
    samples = pair.samples * np.array([1.0, 1.0, fit.input_density])
    metres = pair.rows[index] / np.array([1.0, fit.ratio, fit.ratio**2 / fit.noise])
    jumps = clock_jumps(Compared(samples, metres + np.array([fit.offset_s, 0.0, 0.0])))
    return replace(pair, rows=_moved(pair.rows[index], jumps)) if jumps else pair, jumps


def _trusted(pair: Pair, max_offset_s: float, refuse: Callable[[OffsetSearch], None]) -> OffsetSearch | None:
    if np.count_nonzero(np.isfinite(pair.rows[:, 2])) < MIN_FRAMES:
        return None
    search = search_offset(pair, max_offset_s)
    try:
        refuse(search)
    except UntrustedError:
        return None
    return search


def _moved(rows: Floats, jumps: list[ClockJump]) -> Floats:
    """Rows (m, 3) on one clock, without those that may be on either side of a jump, or not after those before."""
    rows, kept, late_s = rows.copy(), np.ones(len(rows), dtype=bool), lateness(jumps, len(rows))
    rows[:, 0] += late_s - late_s[0]
    for jump in jumps:
        kept[jump.first : jump.last] = False
    kept[1:] &= rows[1:, 0] > np.maximum.accumulate(rows[:, 0])[:-1]
    return rows[kept]


def jumps_text(jumps: Sequence[ClockJump]) -> tuple[Notice, ...]:
    """A sentence for each jump that was taken out."""
    return tuple(
        Notice(
            "clock-corrected",
            f"The frames' clock jumps in the calibration window: {1e3 * jump.late_s:+.3g} ms must be added to the "
            f"stamps from frame {jump.row} of the window on, as where frames were lost or the clock was set. The "
            "calibration counts with it; give each frame a time stamp, or choose a calibration.window_s without the "
            "jump.",
        )
        for jump in jumps
    )
