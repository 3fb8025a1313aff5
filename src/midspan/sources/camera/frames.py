"""What every source of frames offers, whatever it reads from."""

from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from midspan.records import Frame, Nanoseconds


@dataclass(frozen=True, slots=True)
class FrameRequest:
    """How to read frames: `times` a file with column time_s, one row a frame; `rate_hz` and `start_s` (s) without one.

    Stamps of the container come before `rate_hz`; `start_s` is added to them. Every n-th frame is used (`every`).
    """

    times: Path | None = None
    rate_hz: float | None = None
    start_s: float = 0.0
    every: int = 1


@dataclass(frozen=True, slots=True)
class FrameInfo:
    """What is known of a source of frames: `frame_count` counts all frames of the file (None: not known).

    `bit_depth` is that of the luma, `lossless` None where the codec can be either, `radiometric` whether pixels are
    temperatures.
    """

    width: int
    height: int
    bit_depth: int
    frame_count: int | None
    codec: str
    lossless: bool | None
    notes: tuple[str, ...] = ()
    radiometric: bool = False


class FrameSource(ABC):
    """Frames in the order of time; indices count the frames that are left after `every`."""

    @property
    @abstractmethod
    def info(self) -> FrameInfo:
        """What is known by now; notes can be added while frames are read (frames lost to damage)."""

    @abstractmethod
    def times_ns(self) -> Nanoseconds:
        """Time stamps (frames,) in ns of the camera's clock, strictly increasing, after `every`."""

    @abstractmethod
    def frames(self, start: int = 0, stop: int | None = None) -> Iterator[Frame]:
        """Frames start … stop-1 after `every`, one at a time; a frame lost to damage is passed over with its index."""


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
    if image.dtype == np.bool_ or image.dtype == np.int8:
        image = image.astype(np.uint8)
    elif image.dtype not in (np.uint8, np.uint16, np.float32):
        image = image.astype(np.float32)
    return np.ascontiguousarray(image)
