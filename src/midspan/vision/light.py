"""What light makes of frames: black ones, and a target whose picture is less and less its reference's."""

from dataclasses import dataclass
from typing import Any

from numpy.typing import NDArray

from midspan import _core


def is_dark(pixels: NDArray[Any], step: int = 1) -> bool:
    """Whether an integer frame (rows, columns) is black: neither its mean nor its brightest pixels leave the bottom.

    One in `step` rows and columns is looked at. Cameras put 10 or 12 bits into files of 16, so full scale is not known;
    a dark frame also has no contrast. Black is 0, or in video of limited range 16 of 255.
    """
    return _core.is_dark(pixels, step)


@dataclass(frozen=True, slots=True)
class LightReport:
    """How far changed light may have moved a target with a fixed reference: the largest variance so far (px²), and the
    stamp of the first that is worth reporting; see `core/src/track/light_watch.rs`.
    """

    largest_px2: float = 0.0
    notable_ns: int | None = None
