"""MATLAB files: version 5 to 7 through scipy, version 7.3 (HDF5) through h5py."""

import struct
import zlib
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from midspan.sources.accelerometer.channel import ChannelSet
from midspan.sources.accelerometer.hdf5 import read_matlab
from midspan.sources.accelerometer.tree import Leaf, channels_of, loaded
from midspan.sources.boundary import require_memory

_HDF5_SIGNATURE = b"\x89HDF\r\n\x1a\n"
_TYPES = {
    "double": "f8",
    "single": "f4",
    "logical": "u1",
    **{f"{sign}int{8 * size}": f"{sign or 'i'}{size}" for sign in ("", "u") for size in (1, 2, 4, 8)},
}
# Classes whose size their header does not tell.
_NESTED = ("struct", "cell", "char", "object")
# Numbers that need few bytes are stored in one and become eight.
_MAX_GROWTH = 8
_HEADER_BYTES = 128
_COMPRESSED = 15


def read(path: Path) -> ChannelSet:
    """All numeric variables; fields of structures become `structure.field`, columns of matrices `name_1` … `name_k`."""
    if _is_hdf5(path):
        return read_matlab(path)
    from scipy.io import whosmat

    leaves: list[Leaf] = []
    notes: list[str] = []
    sizes = iter(_stored_bytes(path))
    for name, shape, kind in whosmat(path):
        stored = next(sizes, 0)
        if kind in _TYPES:
            # As scipy squeezes it: axes of length 1 go.
            axes = tuple(n for n in shape if n != 1)
            leaf = Leaf(name, axes, np.dtype(_TYPES[kind]), partial(_variable, path, name, stored))
            if leaf.size == 1:
                leaf = loaded(name, _variable(path, name, stored))
            leaves += [leaf] if len(axes) <= 2 and not name.startswith("__") else []
        elif kind in _NESTED:
            leaves += _nested({name: _load(path, name, _MAX_GROWTH * stored)}, "")
        else:
            notes.append(f"{name} left out: it is of class {kind}")
    return channels_of(leaves, notes)


def _is_hdf5(path: Path) -> bool:
    """A 7.3 file has MATLAB's own header of 512 bytes in front of the HDF5 signature."""
    with path.open("rb") as file:
        head = file.read(520)
    return head[512:520] == _HDF5_SIGNATURE or head[:8] == _HDF5_SIGNATURE


def _load(path: Path, name: str, needed_bytes: int) -> Any:
    from scipy.io import loadmat

    require_memory(path, needed_bytes, f"variable {name!r}")
    return loadmat(path, simplify_cells=True, variable_names=[name])[name]


def _variable(path: Path, name: str, needed_bytes: int) -> NDArray[np.generic]:
    return np.asarray(_load(path, name, needed_bytes))


def _stored_bytes(path: Path) -> list[int]:
    """The bytes that each variable of a version 5 file takes as it is stored, compressed ones after expansion.

    A compressed variable begins with its own size, of which only the first bytes are expanded here.
    """
    sizes: list[int] = []
    with path.open("rb") as file:
        end = file.seek(0, 2)
        file.seek(_HEADER_BYTES - 2)
        order = {b"IM": "<", b"MI": ">"}.get(file.read(2))
        # Version 4 has no such header, and no compression: a variable is no larger than the file.
        while order is not None and file.tell() + 8 <= end:
            kind, count = struct.unpack(f"{order}II", file.read(8))
            after = file.tell() + count
            if kind == _COMPRESSED:
                head = zlib.decompressobj().decompress(file.read(min(count, 256)), 8)
                count = struct.unpack(f"{order}II", head)[1] if len(head) == 8 else count
            sizes.append(count)
            file.seek(after)
    return sizes


def _nested(variables: dict[str, Any], prefix: str) -> list[Leaf]:
    leaves: list[Leaf] = []
    for name, value in variables.items():
        if isinstance(value, dict):
            leaves += _nested(value, f"{prefix}{name}.")
            continue
        array = np.asarray(value)
        if array.dtype.kind in "biufUSO" and array.ndim <= 2:
            leaves.append(loaded(f"{prefix}{name}", array))
    return leaves
