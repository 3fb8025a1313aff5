"""Pixel sums of a mix of pictures: weighted least squares, and where the mix holds."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from midspan import _core
from midspan.records import Floats
from midspan.vision.spline import Floats32

Integers = NDArray[np.int64]


@dataclass(frozen=True, slots=True, eq=False)
class Explained:
    """What a mix says of what is seen: the `amount` (n,) of each column, what they leave (`left`, pixels,), the mix's
    slopes with weights and without what another mix would explain (`own`, 2, pixels), and their products with the
    slopes (`information`, 2, 2) and with what is left (`force`, 2,).
    """

    amount: Floats32
    left: Floats32
    own: Floats32
    information: Floats
    force: Floats


def explained(columns: Floats32, slopes: Floats32, weight: Floats32, seen: Floats32, ridge: Floats) -> Explained:
    """Weighted least squares of what is `seen` (pixels,) by `columns` (n, pixels), whose slopes are (2, n - 1, pixels).

    ridge (n,): what is added to the squares of the columns.
    """
    weighted = weight * columns
    inverse = np.linalg.inv((weighted @ columns.T).astype(np.float64) + np.diag(ridge))
    amount = (inverse @ (weighted @ seen)).astype(np.float32)
    left = seen - amount @ columns
    slope = amount[:-1] @ slopes
    other = (slope @ weighted.T @ inverse).astype(np.float32)
    own = weight * slope - other @ weighted
    return Explained(amount, left, own, (own @ slope.T).astype(np.float64), (own @ left).astype(np.float64))


def agreement(seen: Floats32, left: Floats32, cell: Integers, cells: int) -> Floats:
    """How well what is expected is `seen` (both `pixels`,; `left`: the difference), in each of so many cells: 1 alike,
    0 unrelated or one of them without contrast, which is what a thing in front leaves; the level is free.

    For cells of equal contrast this is their correlation. Cells without texture agree while nothing is seen in them.
    """
    return _core.cell_agreement(seen, left, cell, cells)
