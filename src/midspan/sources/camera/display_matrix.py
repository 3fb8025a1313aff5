"""How a film is turned to be shown: by the display matrix of its container or codec, as players do."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from midspan.notices import Notice

# What a matrix of each number of quarter turns, counted counterclockwise, does to a picture in words.
_WORDS = {1: "90 degrees to the left", 2: "180 degrees", 3: "90 degrees to the right"}


def turn_of(picture: Any) -> tuple[int, Notice | None]:
    """How many quarter turns counterclockwise show a decoded picture upright, 0 to 3, and what to tell of it.

    Mirrored pictures, and those turned by another angle, are left as they are.
    """
    matrix = picture.side_data.get("DISPLAYMATRIX")
    if matrix is None:
        return 0, None
    # Its first two rows say where a step to the right and one down in the picture point on the screen, in fixed point.
    (a, b), (c, d) = np.frombuffer(bytes(matrix), dtype=np.int32).reshape(3, 3)[:2, :2].tolist()
    upright, sideways = b == c == 0 and a * d > 0, a == d == 0 and b * c < 0
    if not upright and not sideways:
        text = (
            "its display matrix mirrors the picture or turns it by no multiple of 90 degrees, which is left out; "
            "directions and places are those of the picture as it is stored"
        )
        return 0, Notice("film-turned", text)
    turns = (0 if a > 0 else 2) if upright else (3 if b > 0 else 1)
    if not turns:
        return 0, None
    text = (
        f"its pictures are turned by {_WORDS[turns]}, as the film's display matrix says; so are directions and places"
    )
    return turns, Notice("film-turned", text)


def turned(pixels: NDArray[np.generic], quarter_turns: int) -> NDArray[np.generic]:
    """A picture turned counterclockwise, its rows one after the other in memory."""
    return np.ascontiguousarray(np.rot90(pixels, quarter_turns)) if quarter_turns else pixels
