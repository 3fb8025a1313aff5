"""NumPy arrays: npy (plain or structured) and npz (one array a channel)."""

import zipfile
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from midspan.sources.accelerometer.channel import ChannelSet
from midspan.sources.accelerometer.tree import Leaf, channels_of, loaded
from midspan.sources.boundary import read_npy_header, require_memory


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
        header = read_npy_header(file)
    name = member.removesuffix(".npy")
    return Leaf(name, header.shape, header.dtype, partial(_member, path, name, header.array_bytes))


def _member(path: Path, name: str, needed_bytes: int) -> NDArray[np.generic]:
    require_memory(path, needed_bytes, f"array {name!r}")
    with np.load(path, allow_pickle=False) as archive:
        return np.asarray(archive[name])
