"""Temperatures as a compressed stack that is written frame by frame."""

import zipfile
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from midspan.records import Floats
from midspan.simulate.scene.scene import Image

# Temperatures are rounded to 1/64 K: that adds a hundredth to the noise of a good camera, and half the bytes are zeros.
STEPS_A_KELVIN = 64.0
_FASTEST = 1


def write_celsius(path: Path, pictures: Iterable[Image], stamps_s: Floats, size_px: tuple[int, int]) -> None:
    """An npz of `celsius` (n, rows, columns), float32 in °C rounded to 1/64 K, and `time_s` (n,), n stamps."""
    form = {"descr": "<f4", "fortran_order": False, "shape": (len(stamps_s), *size_px)}
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=_FASTEST) as archive:
        with archive.open("time_s.npy", "w") as file:
            np.lib.format.write_array(file, np.asarray(stamps_s, dtype=np.float64), allow_pickle=False)
        with archive.open("celsius.npy", "w", force_zip64=True) as file:
            np.lib.format.write_array_header_1_0(file, form)
            for picture in pictures:
                rounded = np.rint(picture * np.float32(STEPS_A_KELVIN)) / np.float32(STEPS_A_KELVIN)
                file.write(rounded.astype("<f4").tobytes())
