"""How pictures of one target under different lights lie to each other: such that they are mixes of the fewest.

A picture that lies wrong adds dimensions to what the pictures span. The places are those at which log det of the
pictures' products is least: a mutual information of Gaussian pictures, which for two is the correlation's peak (rank
instead of log det: Y. Peng and others, "RASL", 2012, doi 10.1109/TPAMI.2011.282).
"""

from dataclasses import dataclass

import numpy as np

from midspan import _core
from midspan.records import Floats
from midspan.vision.reference.light import BLOCKS, TRUST, Mix, steadiness

ROUNDS = 40
ROUNDS_OF_PART = 10  # of a jackknife, which starts from the whole's solution
REWEIGHTED = 4


@dataclass(frozen=True, slots=True, eq=False)
class Alignment:
    """How much farther on each picture is to be read: `moves` (n, 2) px, the first none; their covariances (2, n, n)
    in px² by a jackknife over blocks of the target, whose relief differs; `alone` (n,): the share of each picture's
    contrast, squared, that is no mix of the others.
    """

    moves: Floats
    covariance: Floats
    alone: Floats


def aligned(mix: Mix) -> Alignment:
    """Where the pictures lie such that they are mixes of each other, pixels that are not counting less."""
    count = len(mix.pictures)
    columns = np.concatenate([mix.pictures, *mix.slopes]).T.astype(np.float64)
    value, across, down = (columns[:, k * count : (k + 1) * count] for k in range(3))
    moves, weight = np.zeros((count, 2)), mix.weight.astype(np.float64)
    for _ in range(REWEIGHTED):
        moves = _least(columns.T @ (weight[:, None] * columns), moves, ROUNDS)
        weight = steadiness(value + across * moves[:, 0] + down * moves[:, 1], weight)[0]
    weighted = weight[:, None] * columns
    products = np.stack([columns[mix.block == b].T @ weighted[mix.block == b] for b in range(BLOCKS**2)])
    total = products.sum(axis=0)
    moves = _least(total, moves, ROUNDS)
    without = np.stack([_least(total - part, moves, ROUNDS_OF_PART) for part in products])
    without -= without.mean(axis=0)
    scale = (BLOCKS**2 - 1.0) / BLOCKS**2
    # Here all pixels count: what the weights leave out is what is to be told.
    alone = steadiness(value + across * moves[:, 0] + down * moves[:, 1], (weight > 0.0).astype(np.float64))[1]
    return Alignment(moves, scale * np.einsum("bia,bja->aij", without, without), alone)


def _least(products: Floats, moves: Floats, rounds: int) -> Floats:
    """Moves (n, 2) of least log det from `products` (3 n, 3 n) of pictures and slopes, from `moves` on."""
    return _core.least_rank_moves(products, moves, rounds, TRUST)
