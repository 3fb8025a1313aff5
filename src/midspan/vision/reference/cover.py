"""Something in front of a target: the cells in which it is not seen, distinguished from light, which spares no cell or
few.

Light takes contrast from all of a target little by little, and a mix of earlier pictures explains most of what it does.
A body makes cells of it unlike anything expected, from one frame to the next, and leaves the others as they were.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from midspan import _core
from midspan.records import Floats, Floats32
from midspan.vision.reference.light import CELLS, EDGE_PX, Mix, Placed, Sight, inside, placed

Cells = NDArray[np.bool_]

GONE = 0.5  # agreement below which the target is not seen in a cell; light alone leaves 0.6 with mixes, seldom less
BACK = 0.7  # above which a hidden cell is seen again
PALING = 0.1  # agreement that light may take from a cell in a second; bodies take it at once
FRONT = 0.08  # share of cells hidden from which something stands in front: three of 36
MIN_SEEN_SHARE = 0.25  # share of cells in which the target must be seen
EDGE = 0.9  # share of the usual agreement below which a cell with a hidden one is not trusted
ROUNDS = 3
ALL_SEEN: Cells = np.zeros(CELLS**2, dtype=np.bool_)
LATELY: Floats = np.ones(CELLS**2)


@dataclass(frozen=True, slots=True, eq=False)
class Uncovered:
    """Where the target lies by what is seen of it, None where that cannot be reported; the cells (cells,) that are
    hidden, and these with those at their edge that are not seen well; `absent`: so little of it is seen that it is not
    there.
    """

    found: Placed | None
    hidden: Cells
    doubtful: Cells
    absent: bool = False


def uncovered(mix: Mix, view: Sight, start: Floats, before: tuple[Floats32, Cells, Floats]) -> Uncovered:
    """The target in a frame, looked for from `start` (2,) px, by the cells in which it is seen.

    before: what it looked like (pixels,) in the last frame, the cells that were hidden then, and how well each agreed
    (cells,) shortly before: what has paled slowly is light.
    """
    expected, covered, lately = before
    # What no picture shows there is only guessed.
    sure = covered & (np.bincount(mix.cell, mix.weight, CELLS**2) > 0.0)
    whole = None if covered.any() else placed(mix, view, start)
    if whole is not None and np.mean(_hidden(whole.agreement, covered, lately)) < FRONT:
        return Uncovered(whole, ALL_SEEN, ALL_SEEN)
    window = view.window(start)
    if window is None:
        return Uncovered(None, covered, covered, absent=bool(covered.any()))
    seen = inside(window)
    agreed = _core.cell_agreement(seen, seen - expected, mix.cell, CELLS**2)
    hidden = _hidden(agreed, sure, lately)
    if whole is not None and np.mean(_hidden(whole.agreement, sure, lately)) < np.mean(hidden):
        agreed, hidden = whole.agreement, _hidden(whole.agreement, sure, lately)
    found = None
    for _ in range(ROUNDS):
        if np.mean(~hidden) < MIN_SEEN_SHARE:
            return Uncovered(None, hidden, hidden, absent=True)
        found = placed(mix, view, start, (~doubtful(agreed, hidden))[mix.cell].astype(np.float32))
        if found is None:
            return Uncovered(whole, hidden, hidden)
        agreed = found.agreement
        before_round, hidden = hidden, _hidden(agreed, sure, lately)
        if (hidden == before_round).all():
            break
    if np.mean(~hidden) < MIN_SEEN_SHARE:
        return Uncovered(None, hidden, hidden, absent=True)
    if np.mean(hidden) < FRONT:
        return Uncovered(found, ALL_SEEN, ALL_SEEN)
    return Uncovered(found, hidden, doubtful(agreed, hidden))


def doubtful(agreed: Floats, hidden: Cells) -> Cells:
    """Cells that are hidden, or lie next to one that is and agree less than the rest: a body's edge is there."""
    wide = np.pad(hidden.reshape(CELLS, CELLS), 1)
    around = [wide[1 + j : CELLS + 1 + j, 1 + i : CELLS + 1 + i] for j in (-1, 0, 1) for i in (-1, 0, 1)]
    usual = float(np.median(agreed[~hidden])) if not hidden.all() else 1.0
    return np.asarray(hidden | (np.any(around, axis=0).ravel() & (agreed < EDGE * usual)))


def likeness(mix: Mix, seen: Floats32, hidden: Cells) -> float:
    """How well the picture most alike agrees with what is `seen` (pixels,) of the target, 1 at best: the middle one of
    the cells that are not hidden, as light changes most of them and the edge of a body a few.
    """
    weight = mix.weight * (~hidden)[mix.cell]
    best = -1.0
    for picture in mix.pictures:
        amount = np.float32((weight * seen) @ picture / max(float((weight * picture) @ picture), 1e-12))
        agreed = _core.cell_agreement(seen, seen - amount * picture, mix.cell, CELLS**2)[~hidden]
        best = max(best, float(np.median(agreed)))
    return best


def completed(window: Floats32, expected: Floats32, cell: NDArray[np.int64], hidden: Cells) -> Floats32:
    """The window of a frame (with EDGE_PX around the target) with what is `expected` (pixels,) where it is hidden."""
    whole = window.copy()
    target = whole[EDGE_PX:-EDGE_PX, EDGE_PX:-EDGE_PX]
    level = np.float32(target.mean())
    target[:] = np.where(hidden[cell], expected + level, target.ravel()).reshape(target.shape)
    return whole


def _hidden(agreed: Floats, before: Cells, lately: Floats) -> Cells:
    """Cells in which the target is not seen and lately was; those hidden `before` must agree better to come back."""
    return np.asarray((agreed < np.where(before, BACK, GONE)) & (lately >= BACK))
