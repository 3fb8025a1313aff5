"""NumPy arrays: npy (plain or structured) and npz (one array a channel)."""

import zipfile
from functools import partial
from pathlib import Path
from typing import Any, BinaryIO, cast

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from midspan.sources.accelerometer.channel import ChannelSet
from midspan.sources.accelerometer.tree import Leaf, channels_of, loaded
from midspan.sources.declared_size import require_memory


def read(path: Path) -> ChannelSet:
    """All numeric arrays of an npy or npz file; single numbers named `rate_hz`, `fs` … in an npz give the rate."""
    if not zipfile.is_zipfile(path):
        # In place, so that a file shorter than its header says is refused and nothing is read yet.
        return channels_of([loaded("", np.load(path, mmap_mode="r", allow_pickle=False))])
    with zipfile.ZipFile(path) as archive:
        members = [name for name in archive.namelist() if name.endswith(".npy")]
        return channels_of([_leaf(path, archive, name) for name in members])


def _leaf(path: Path, archive: zipfile.ZipFile, member: str) -> Leaf:
    with archive.open(member) as file:
        shape, dtype = _header(cast(BinaryIO, file))
    name = member.removesuffix(".npy")
    return Leaf(name, shape, dtype, partial(_member, path, name))


def _header(file: BinaryIO) -> tuple[tuple[int, ...], np.dtype[Any]]:
    """Shape and type that an array's header declares."""
    version = npy.read_magic(file)
    shape, _, dtype = npy.read_array_header_1_0(file) if version == (1, 0) else npy.read_array_header_2_0(file)
    if dtype.hasobject:
        raise ValueError("it holds Python objects (pickled), which are not loaded")
    return shape, dtype


def _member(path: Path, name: str) -> NDArray[np.generic]:
    with np.load(path, allow_pickle=False) as archive:
        shape, dtype = _header_of(path, name)
        require_memory(path, int(np.prod(shape, dtype=object)) * dtype.itemsize, f"array {name!r}")
        return np.asarray(archive[name])


def _header_of(path: Path, name: str) -> tuple[tuple[int, ...], np.dtype[Any]]:
    with zipfile.ZipFile(path) as archive, archive.open(f"{name}.npy") as file:
        return _header(cast(BinaryIO, file))
