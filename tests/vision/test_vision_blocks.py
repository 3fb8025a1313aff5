"""Blocks of a place tell whether it lies across the edge of what moves."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter, shift

from midspan.records import Frame, Region
from midspan.vision.blocks import Blocks

PLACE = Region(40, 160, 128, 128)


def followed(edge: int, blank: bool = False) -> Blocks:
    """A place in frames of which the rows above `edge` move; blank: its corner has no texture."""
    rng = np.random.default_rng(1)
    texture = 128 + 200 * gaussian_filter(rng.normal(size=(420, 220)), 1.5)
    if blank:
        texture[160:192, 40:104] = 128.0
    blocks = Blocks(PLACE, "y")
    for k in range(20):
        picture = texture.copy()
        picture[:edge] = shift(texture, (2.0 * np.sin(0.7 * k), 0.0), order=3, mode="nearest")[:edge]
        noisy = picture + rng.normal(0.0, 1.0, picture.shape)
        blocks.push(Frame(k * 10**8, np.clip(noisy, 0, 255).astype(np.uint8), k))
    return blocks


@pytest.mark.parametrize(
    ("edge", "places"),
    [
        (420, (PLACE,)),
        (100, (PLACE,)),
        (224, (Region(40, 96, 128, 128), Region(40, 160, 128, 64))),
        (236, (Region(40, 96, 128, 128), Region(40, 160, 128, 64))),
    ],
)
def test_a_place_across_an_edge_is_moved_or_shrunk_to_what_moves(edge: int, places: tuple[Region, ...]) -> None:
    assert followed(edge).places() == places


def test_a_place_with_a_blank_corner_moves_as_one() -> None:
    assert followed(420, blank=True).places() == (PLACE,)
