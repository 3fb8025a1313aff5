"""How frames are asked for, and what of a colour image is used."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from midspan.errors import UsageError
from midspan.vision.frame_source import FrameSource

# Frames without any time are counted, one a second.
COUNTING_RATE_HZ = 1.0


@dataclass(frozen=True, slots=True)
class FrameRequest:
    """How to read frames: `times` a file with column time_s, one row a frame; `rate_hz` and `start_s` (s) without one.

    Stamps of the container come before `rate_hz`; `start_s` is added to them. Every n-th frame is used (`every`).
    with_missing: give out frames without numbers too, for a reader that fills or passes over them itself.
    """

    times: Path | None = None
    rate_hz: float | None = None
    start_s: float = 0.0
    every: int = 1
    with_missing: bool = False


def timed_or_counted(opened: Callable[[float | None], FrameSource]) -> tuple[FrameSource, bool]:
    """A source with its own times, or counting frames where it has none; and whether they are its own.

    opened: opens it at a rate, Hz; None: with its own times.
    """
    try:
        source = opened(None)
        source.times_ns()
        return source, True
    except UsageError:
        source = opened(COUNTING_RATE_HZ)
        source.times_ns()
        return source, False


def luma(image: NDArray[np.generic], reversed_colours: bool) -> NDArray[np.generic]:
    """Luma (rows, columns) of an image (rows, columns[, 1, 3 or 4]): uint8, uint16 or float32, contiguous.

    Colour is weighted as in ITU-R BT.601; `reversed_colours` says that blue comes first.
    """
    if image.ndim == 3 and image.shape[2] in (1, 2):
        image = image[:, :, 0]
    elif image.ndim == 3:
        weights = np.array([0.299, 0.587, 0.114], dtype=np.float32)
        colours = image[:, :, 2::-1] if reversed_colours else image[:, :, :3]
        mixed = colours.astype(np.float32) @ weights
        image = np.rint(mixed).astype(image.dtype) if image.dtype.kind in "iu" else mixed
    if image.dtype not in (np.uint8, np.uint16, np.float32):
        image = image.astype(np.uint8 if image.dtype in (np.bool_, np.int8) else np.float32)
    return np.ascontiguousarray(image)
