"""HDF5 files: every dataset of numbers in every group."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from midspan.sources.accelerometer.channel import ChannelSet
from midspan.sources.accelerometer.tree import Leaf, channels_of, loaded
from midspan.sources.boundary import require_memory
from midspan.sources.hdf5_members import ElsewhereError, member, open_hdf5

# Groups inside one another; a file that has more is damaged or made to be endless.
_MAX_DEPTH = 32


def read(path: Path) -> ChannelSet:
    """All one- and two-axis datasets under their full path; attributes `unit`, `rate_hz`, `sampling_rate`, `fs` count.

    Attributes of the file and of groups hold for all datasets inside unless a dataset has its own. Values that lie in
    another file (external storage, external links, virtual datasets) are left out and named in the notes.
    """
    return _read(path, matlab=False)


def read_matlab(path: Path) -> ChannelSet:
    """All variables of a MATLAB 7.3 file: HDF5 with axes in reverse order; fields of structures are `s.field`."""
    return _read(path, matlab=True)


def _read(path: Path, *, matlab: bool) -> ChannelSet:

    with open_hdf5(path) as file:
        walk = _Walk(path, matlab)
        walk.enter(file, "", () if matlab else (dict(file.attrs),))
    return channels_of(walk.leaves, walk.notes)


@dataclass(slots=True)
class _Walk:
    """The way through a file's groups, each once: links can make a small file hold itself.

    groups: the name under which each group was met, by its address.
    """

    path: Path
    matlab: bool
    groups: dict[int, str] = field(default_factory=dict)
    leaves: list[Leaf] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

    def enter(self, group: Any, prefix: str, inherited: tuple[dict[str, Any], ...], depth: int = 0) -> None:
        """Gather the datasets of a group and of the groups in it."""
        import h5py

        address = h5py.h5o.get_info(group.id).addr
        if address in self.groups:
            self.notes.append(f"{prefix[:-1]} left out: it is the same group as {self.groups[address] or '/'}")
            return
        self.groups[address] = prefix[:-1]
        if depth > _MAX_DEPTH:
            self.notes.append(f"{prefix[:-1]} left out: it lies more than {_MAX_DEPTH} groups deep")
            return
        for key in group:
            name = f"{prefix}{key}"
            if key.startswith("#"):
                continue
            try:
                item = member(group, key)
            except ElsewhereError as error:
                self.notes.append(f"{name} left out: {error}; copy its values into this file")
                continue
            if isinstance(item, h5py.Group):
                self.enter(item, f"{name}/", (dict(item.attrs), *inherited), depth + 1)
            elif isinstance(item, h5py.Dataset):
                self._dataset(name, item, (dict(item.attrs), *inherited))

    def _dataset(self, name: str, item: Any, attributes: tuple[dict[str, Any], ...]) -> None:
        import h5py

        if item.shape is None or h5py.check_ref_dtype(item.dtype) is not None:
            return
        if self.matlab:
            self._matlab(name.replace("/", "."), item, attributes)
            return
        if item.size == 1:
            self.leaves.append(loaded(name, np.asarray(item[()]), attributes))
            return
        path, place = self.path, item.name
        self.leaves.append(Leaf(name, tuple(item.shape), item.dtype, lambda: _values(path, place), attributes))

    def _matlab(self, name: str, item: Any, attributes: tuple[dict[str, Any], ...]) -> None:
        """A variable: axes in reverse order, a row (1, n) the same channel as a column (n, 1), texts as codes."""
        path, place = self.path, item.name
        if attributes[0].get("MATLAB_class") == b"char":
            if item.ndim == 2:
                count, dtype = item.shape[1], np.dtype(f"U{max(item.shape[0], 1)}")
                self.leaves.append(Leaf(name, (count,), dtype, lambda: _matlab_texts(path, place), attributes))
            return
        if item.size == 1:
            self.leaves.append(loaded(name, np.asarray(item[()]), attributes))
            return
        shape = tuple(reversed(item.shape))
        shape = shape[::-1] if len(shape) == 2 and shape[0] == 1 else shape
        self.leaves.append(Leaf(name, shape, item.dtype, lambda: _upright(_values(path, place).T), attributes))


def _values(path: Path, place: str) -> NDArray[np.generic]:

    with open_hdf5(path) as file:
        item = file[place]
        require_memory(path, item.size * item.dtype.itemsize, f"dataset {place!r}")
        return np.asarray(item[()])


def _upright(values: NDArray[np.generic]) -> NDArray[np.generic]:
    """A row (1, n) of MATLAB is the same channel as a column (n, 1)."""
    return values.T if values.ndim == 2 and values.shape[0] == 1 else values


def _matlab_texts(path: Path, place: str) -> NDArray[np.generic]:
    """A character matrix (characters, rows as HDF5 shows it) as one text a row."""
    return np.array(["".join(chr(int(code)) for code in row) for row in _values(path, place).T])
