"""What the header of an array of NumPy declares, without its numbers."""

import math
from dataclasses import dataclass
from typing import IO, Any

import numpy as np


@dataclass(frozen=True, slots=True)
class NpyHeader:
    """Shape, order of the axes in the file, and type of an array."""

    shape: tuple[int, ...]
    fortran: bool
    dtype: np.dtype[Any]

    @property
    def array_bytes(self) -> int:
        """Bytes of the array."""
        return math.prod(self.shape) * self.dtype.itemsize


def read_npy_header(file: IO[bytes]) -> NpyHeader:
    """The header at a file's place, which is behind it then. Raises ValueError for Python objects and for no array."""
    version = np.lib.format.read_magic(file)
    read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    header = NpyHeader(*read(file))
    if header.dtype.hasobject:
        raise ValueError("it holds Python objects (pickled), which are no array of numbers")
    return header
