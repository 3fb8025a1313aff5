"""MATLAB files: version 5 to 7 through scipy, version 7.3 (HDF5) through h5py."""

from pathlib import Path
from typing import Any

import numpy as np

from midspan.sources.accelerometer.channel import ChannelSet
from midspan.sources.accelerometer.hdf5 import read_matlab
from midspan.sources.accelerometer.tree import Leaf, channels_of

_HDF5_SIGNATURE = b"\x89HDF\r\n\x1a\n"


def read(path: Path) -> ChannelSet:
    """All numeric variables; fields of structures become `structure.field`, columns of matrices `name_1` … `name_k`."""
    if _is_hdf5(path):
        return read_matlab(path)
    from scipy.io import loadmat

    variables = loadmat(path, simplify_cells=True)
    return channels_of(_leaves({k: v for k, v in variables.items() if not k.startswith("__")}, ""))


def _is_hdf5(path: Path) -> bool:
    """A 7.3 file has MATLAB's own header of 512 bytes in front of the HDF5 signature."""
    with path.open("rb") as file:
        head = file.read(520)
    return head[512:520] == _HDF5_SIGNATURE or head[:8] == _HDF5_SIGNATURE


def _leaves(variables: dict[str, Any], prefix: str) -> list[Leaf]:
    leaves: list[Leaf] = []
    for name, value in variables.items():
        if isinstance(value, dict):
            leaves += _leaves(value, f"{prefix}{name}.")
            continue
        array = np.asarray(value)
        if array.dtype.kind in "biufUSO" and array.ndim <= 2:
            leaves.append(Leaf(f"{prefix}{name}", array))
    return leaves
