"""The pictures of the key frames taken together: their mix, and where the key frames lie that they belong to."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from midspan.records import Floats
from midspan.vision.reference_alignment import aligned
from midspan.vision.reference_light import Mix, Sight, mixed, placed
from midspan.vision.reference_records import Chain, KeyFrame

# Standard deviation of a picture's place if nothing in it were a mix of others: three times what shading was seen to
# do, and half of what the shadows do that bumps throw in grazing light.
UNMIXED_PX = 2.0
FARTHEST_PX = 1.0  # that a picture may lie from where its frames were found


@dataclass(frozen=True, slots=True, eq=False)
class Pictures:
    """Numbers of the key frames that have pictures, two or more, and the mix of these."""

    numbers: tuple[int, ...]
    mix: Mix

    def place(self, chain: Chain, view: Sight, start: Floats) -> tuple[Floats, Floats] | None:
        """Place (2,) px and variance (2,) px² of the target in a frame, looked for from `start`; None without."""
        found = placed(self.mix, view, start)
        if found is None:
            return None
        covariance = chain.covariance[np.ix_(range(2), self.numbers, self.numbers)]
        return found.place, found.variance + np.einsum("ai,aij,aj->a", found.shares, covariance, found.shares)


def pictures_of(keys: Sequence[KeyFrame]) -> Pictures | None:
    """The pictures of all key frames that have one; None where there are fewer than two."""
    numbers = tuple(k for k, key in enumerate(keys) if key.picture is not None)
    if len(numbers) < 2:
        return None
    made = [key.picture for key in keys if key.picture is not None]
    return Pictures(numbers, mixed(made, [keys[k].offset for k in numbers]))


def realigned(keys: Sequence[KeyFrame], chain: Chain, floor_px: float) -> Chain:
    """The places of the key frames from all pictures anew, each known to `floor_px` at best; sets their offsets."""
    known = pictures_of(keys)
    if known is None:
        return chain
    found = aligned(known.mix)
    numbers, later = list(known.numbers), list(known.numbers[1:])
    place, covariance = chain.place.copy(), chain.covariance.copy()
    # All of them lie as uncertainly as the first of them, which the others are measured from.
    covariance[np.ix_(range(2), numbers, numbers)] = found.covariance + chain.variance(numbers[0])[:, None, None]
    # What is no mix of others may have moved with the light.
    doubt = UNMIXED_PX * (found.alone[0] + found.alone[1:])
    covariance[:, later, later] += floor_px**2 + doubt**2
    for number, move in zip(numbers, found.moves, strict=True):
        before = keys[number].offset
        keys[number].offset = np.clip(before + move, -FARTHEST_PX, FARTHEST_PX)
        place[number] += keys[number].offset - before
    return Chain(place, covariance)
