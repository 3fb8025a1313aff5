"""Lossless JPEG (JPEG-LS) of 16-bit counts, by a small library that is an extra of this package."""

import importlib

import numpy as np
from numpy.typing import NDArray

from midspan.errors import DataError, UsageError

INSTALL = "pip install 'midspan[csq]'"


def decode(packed: bytes) -> NDArray[np.uint16]:
    """Counts (rows, columns) of a JPEG-LS image; UsageError names the install line, DataError says what is damaged."""
    try:
        library = importlib.import_module("jpeg_ls")
    except ImportError:
        raise UsageError(
            f"Compressed FLIR sequences (csq) need a JPEG-LS decoder, which is not installed. Run: {INSTALL}"
        ) from None
    try:
        image = np.asarray(library.decode(np.frombuffer(packed, dtype=np.uint8)))
    except Exception as error:  # the library's own errors have no common base
        raise DataError(f"holds a JPEG-LS image that cannot be decoded: {error}") from error
    if image.dtype != np.uint16 or image.ndim != 2:
        raise DataError(f"must hold 16-bit counts of one plane; its JPEG-LS image is {image.dtype} {image.shape}")
    return image
