"""The pictures of the key frames taken together: their mix, and where the key frames lie that they belong to.

Pictures lie such that they are mixes of the fewest: where log det of their products is least, see
`core/src/track/reference.rs`.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from midspan import _core
from midspan.records import Floats
from midspan.vision.reference.light import BLOCKS, CELLS, MAX_OFFSET_PX, TRUST, Mix, Placed, mixed, steadiness
from midspan.vision.reference.records import Chain, KeyFrame

ROUNDS = 40
ROUNDS_OF_PART = 10  # of a jackknife, which starts from the whole's solution
REWEIGHTED = 4
MIN_SHOWN_SHARE = 1.0 / 3.0  # of the target that all pictures must show


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
    # Here all pixels count: what the weights leave out is what is to be reported.
    alone = steadiness(value + across * moves[:, 0] + down * moves[:, 1], (weight > 0.0).astype(np.float64))[1]
    return Alignment(moves, scale * np.einsum("bia,bja->aij", without, without), alone)


def _least(products: Floats, moves: Floats, rounds: int) -> Floats:
    """Moves (n, 2) of least log det from `products` (3 n, 3 n) of pictures and slopes, from `moves` on."""
    return _core.least_rank_moves(products, moves, rounds, TRUST)


@dataclass(frozen=True, slots=True, eq=False)
class Pictures:
    """Numbers of the key frames that have pictures, and the mix of these."""

    numbers: tuple[int, ...]
    mix: Mix

    @property
    def several(self) -> bool:
        """Whether there is a mix to speak of."""
        return len(self.numbers) > 1

    def variance(self, chain: Chain, found: Placed) -> Floats:
        """Variance (2,) px² of a place found with the mix, with that of the pictures' own places."""
        covariance = chain.covariance[np.ix_(range(2), self.numbers, self.numbers)]
        own: Floats = found.variance + np.einsum("ai,aij,aj->a", found.shares, covariance, found.shares)
        return own


def pictures_of(keys: Sequence[KeyFrame]) -> Pictures | None:
    """The pictures of the key frames that have one, as far as they show the same of the target; None without any."""
    shown = np.ones(CELLS**2, dtype=np.bool_)
    numbers = []
    # Those that show all of the target, then the newest of those that something stood before.
    for k in sorted(range(len(keys)), key=lambda k: (keys[k].hidden.any(), -k)):
        left = shown & ~keys[k].hidden
        if keys[k].picture is not None and np.mean(left) >= MIN_SHOWN_SHARE:
            numbers.append(k)
            shown = left
    if not numbers:
        return None
    numbers.sort()
    made = [picture for picture in (keys[k].picture for k in numbers) if picture is not None]
    return Pictures(tuple(numbers), mixed(made, [keys[k].offset for k in numbers], shown))


def realigned(
    keys: tuple[KeyFrame, ...], chain: Chain, floor_px: float, unmixed_px: float
) -> tuple[tuple[KeyFrame, ...], Chain]:
    """Key frames with their offsets and places from all pictures anew, each known to `floor_px` at best.

    unmixed_px: standard deviation of a picture's place if nothing in it were a mix of others.
    """
    known = pictures_of(keys)
    if known is None or not known.several:
        return keys, chain
    found = aligned(known.mix)
    numbers, later = list(known.numbers), list(known.numbers[1:])
    place, covariance = chain.place.copy(), chain.covariance.copy()
    # All of them lie as uncertainly as the first of them, which the others are measured from.
    covariance[np.ix_(range(2), numbers, numbers)] = found.covariance + chain.variance(numbers[0])[:, None, None]
    # What is no mix of others may have moved with the light; what is known at best no mean over pictures makes better.
    doubt = unmixed_px * (found.alone[0] + found.alone[1:])
    covariance[:, later, later] += doubt**2
    covariance[np.ix_(range(2), later, later)] += floor_px**2
    aside = list(keys)
    for number, move in zip(numbers, found.moves, strict=True):
        before = keys[number].offset
        offset = np.clip(before + move, -MAX_OFFSET_PX, MAX_OFFSET_PX)
        aside[number] = replace(keys[number], offset=offset)
        place[number] += offset - before
    return tuple(aside), Chain(place, covariance)
