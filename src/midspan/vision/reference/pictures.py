"""The pictures of the key frames taken together: their mix, and where the key frames lie that they belong to."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from midspan.records import Floats
from midspan.vision.reference.alignment import aligned
from midspan.vision.reference.light import CELLS, Mix, Placed, mixed
from midspan.vision.reference.records import Chain, KeyFrame

LEAST_SHOWN = 1.0 / 3.0  # of the target that all pictures must show
FARTHEST_PX = 1.0  # that a picture may lie from where its frames were found


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
        if keys[k].picture is not None and np.mean(left) >= LEAST_SHOWN:
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
        offset = np.clip(before + move, -FARTHEST_PX, FARTHEST_PX)
        aside[number] = replace(keys[number], offset=offset)
        place[number] += offset - before
    return tuple(aside), Chain(place, covariance)
