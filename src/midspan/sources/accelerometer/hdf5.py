"""HDF5 files: every dataset of numbers in every group."""

from pathlib import Path
from typing import Any

import numpy as np

from midspan.sources.accelerometer.channel import ChannelSet
from midspan.sources.accelerometer.tree import Leaf, channels_of

# A dataset above this many values is no channel of a logger (a stack of images, say) and is not loaded.
_MOST_VALUES = 2_000_000_000


def read(path: Path) -> ChannelSet:
    """All one- and two-axis datasets under their full path; attributes `unit`, `rate_hz`, `sampling_rate`, `fs` count.

    Attributes of the file and of groups hold for all datasets inside unless a dataset has its own.
    """
    import h5py

    with h5py.File(path, "r") as file:
        return channels_of(_leaves(file, "", (dict(file.attrs),), transposed=False))


def read_matlab(path: Path) -> ChannelSet:
    """All variables of a MATLAB 7.3 file: HDF5 with axes in reverse order; fields of structures are `s.field`."""
    import h5py

    with h5py.File(path, "r") as file:
        leaves = _leaves(file, "", (), transposed=True)
        return channels_of([Leaf(leaf.name.replace("/", "."), leaf.values, leaf.attributes) for leaf in leaves])


def _leaves(group: Any, prefix: str, inherited: tuple[dict[str, Any], ...], transposed: bool) -> list[Leaf]:
    import h5py

    leaves: list[Leaf] = []
    for name in group:
        item = group.get(name)
        if item is None or name.startswith("#"):
            continue
        attributes = (dict(item.attrs), *inherited)
        if isinstance(item, h5py.Group):
            leaves += _leaves(item, f"{prefix}{name}/", attributes, transposed)
        elif isinstance(item, h5py.Dataset) and item.shape is not None and item.ndim <= 2 and item.size <= _MOST_VALUES:
            leaves += _dataset(f"{prefix}{name}", item, attributes, transposed)
    return leaves


def _dataset(name: str, item: Any, attributes: tuple[dict[str, Any], ...], transposed: bool) -> list[Leaf]:
    import h5py

    if h5py.check_ref_dtype(item.dtype) is not None:
        return []
    values = np.asarray(item[()])
    if transposed:
        if attributes[0].get("MATLAB_class") == b"char":
            return _matlab_text(name, values)
        values = _upright(values.T)
    return [Leaf(name, values, attributes)]


def _upright(values: Any) -> Any:
    """A row (1, n) of MATLAB is the same channel as a column (n, 1)."""
    return values.T if values.ndim == 2 and values.shape[0] == 1 else values


def _matlab_text(name: str, values: Any) -> list[Leaf]:
    """A character matrix (characters, rows as HDF5 shows it) as one text a row."""
    if values.ndim != 2:
        return []
    return [Leaf(name, np.array(["".join(chr(int(code)) for code in row) for row in values.T]))]
