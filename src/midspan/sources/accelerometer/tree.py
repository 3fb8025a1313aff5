"""Named arrays of a file that keeps them in a tree (HDF5, MATLAB, NumPy): to channels with unit and rate.

Only what the file says of an array (its shape and type) is read at first; its numbers when a channel is used. MATLAB
files of version 5 to 7 are read with scipy, those of version 7.3, which are HDF5, and HDF5 itself with h5py.
"""

import math
import struct
import zipfile
import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from midspan.sources.accelerometer.channel import Channel, ChannelSet, Stored, Values, columns, numbers
from midspan.sources.accelerometer.clock import texts_to_ns
from midspan.sources.accelerometer.dialect import named_unit
from midspan.sources.boundary import head_of, read_npy_header, require_memory
from midspan.sources.hdf5_members import SIGNATURE, ElsewhereError, member, open_hdf5

_RATES = (
    *("rate_hz", "sampling_rate", "sampling_rate_hz", "sample_rate", "samplerate", "sampling_frequency"),
    *("fs", "rate"),
)
_STEPS = ("dt", "delta_t", "sample_interval", "sampling_interval", "wf_increment")
_UNITS = ("unit", "units")
# More columns than any logger has channels: such an array is a matrix or a picture.
_MAX_COLUMNS = 10_000
# Texts that are looked at to see whether they are times.
_TEXTS = 100
# Groups inside one another; a file that has more is damaged or made to be endless.
_MAX_DEPTH = 32
_MATLAB_TYPES = {
    "double": "f8",
    "single": "f4",
    "logical": "u1",
    **{f"{sign}int{8 * size}": f"{sign or 'i'}{size}" for sign in ("", "u") for size in (1, 2, 4, 8)},
}
# Classes whose size their header does not tell.
_NESTED = ("struct", "cell", "char", "object")
# Numbers that need few bytes are stored in one and become eight.
_MAX_GROWTH = 8
_MATLAB_HEADER_BYTES, _COMPRESSED = 128, 15


@dataclass(frozen=True, slots=True)
class _Leaf:
    """An array of the tree under its full path, with its attributes, then those of the groups around it."""

    # shape, dtype: as the file declares them; read: gives the array.

    name: str
    shape: tuple[int, ...]
    dtype: np.dtype[Any]
    read: Callable[[], NDArray[np.generic]]
    attributes: tuple[dict[str, Any], ...] = ()

    @property
    def size(self) -> int:
        return math.prod(self.shape)


def _loaded(name: str, values: NDArray[np.generic], attributes: tuple[dict[str, Any], ...] = ()) -> _Leaf:
    return _Leaf(name, values.shape, values.dtype, lambda: values, attributes)


def _channels_of(leaves: Sequence[_Leaf], notes: Sequence[str] = ()) -> ChannelSet:
    """Channels of the leaves: columns of arrays (n, k) become `name_1` … `name_k`, single numbers may give the rate."""
    # Arrays of more than two axes or 10 000 columns, complex numbers and words are left out and named in the notes,
    # behind `notes`.
    file_rate = _rate({leaf.name.replace(".", "/").split("/")[-1]: leaf.read() for leaf in leaves if leaf.size == 1})
    channels: list[Channel] = []
    lines, last = list(notes), _Last()
    for leaf in leaves:
        if leaf.size < 2:
            continue
        unit = next((_text(level[key]) for level in leaf.attributes for key in _UNITS if key in level), None)
        rate_hz = next((rate for level in leaf.attributes if (rate := _rate(level))), file_rate)
        if len(leaf.shape) == 2 and leaf.shape[1] > _MAX_COLUMNS:
            lines.append(f"{leaf.name} left out: {leaf.shape[1]} columns")
            continue
        # The columns' names and types from an array like it without a row.
        pairs = columns(leaf.name, np.empty((0, *leaf.shape[1:]), dtype=leaf.dtype)) if leaf.shape else []
        lines += [] if pairs else [f"{leaf.name} left out: {len(leaf.shape)} axes"]
        for k, (heading, empty) in enumerate(pairs):
            name, heading_unit = named_unit(heading)
            stored, said = _values(name, leaf, empty.dtype, partial(last.column, leaf, k))
            lines += said
            if stored is not None:
                is_stamp = empty.dtype.kind in "SUOM"
                channels.append(Channel(name, stored, "ns" if is_stamp else unit or heading_unit, rate_hz))
    return ChannelSet(tuple(channels), tuple(lines))


@dataclass(slots=True)
class _Last:
    """The array that was read last: its columns come one after the other."""

    leaf: _Leaf | None = None
    values: NDArray[np.generic] | None = None

    def column(self, leaf: _Leaf, number: int) -> NDArray[np.generic]:
        """A column (n,) of a leaf, by its number among `columns`."""
        if self.values is None or self.leaf is not leaf:
            # The one before goes first, so that there is never more than one.
            self.leaf, self.values = leaf, None
            self.values = leaf.read()
        return columns(leaf.name, self.values)[number][1]


def _values(
    name: str, leaf: _Leaf, dtype: np.dtype[Any], column: Callable[[], NDArray[np.generic]]
) -> tuple[Values | Stored | None, Sequence[str]]:
    """A column's values, None where they are neither numbers nor times, and notes."""
    if dtype.kind in "SUO":
        texts = column()
        if texts_to_ns([_text(value) for value in texts[:_TEXTS]]) is None:
            return None, ()
        return texts_to_ns([_text(value) for value in texts]) or (None, ())
    if dtype.kind not in "iufbM":
        return None, [f"{name} left out: its numbers are of type {dtype}"]

    def load() -> Values:
        found = numbers(column())
        if found is None:
            raise ValueError(f"{leaf.name} holds no real numbers")
        return found

    # The array as it is, and the column as numbers of eight bytes.
    return Stored(leaf.shape[0], leaf.size * leaf.dtype.itemsize + 8 * leaf.shape[0], load), ()


def _rate(attributes: dict[str, Any]) -> float | None:
    lowered = {key.lower(): value for key, value in attributes.items()}
    for keys, inverse in ((_RATES, False), (_STEPS, True)):
        for key in keys:
            try:
                number = float(np.asarray(lowered.get(key)).reshape(-1)[0])
            except (TypeError, ValueError, IndexError):
                continue
            if np.isfinite(number) and number > 0:
                return 1.0 / number if inverse else number
    return None


def _text(value: Any) -> str:
    if isinstance(value, np.ndarray) and value.size == 1:
        value = value.reshape(-1)[0]
    return value.decode("utf-8", errors="replace") if isinstance(value, bytes) else str(value)


def read_numpy(path: Path) -> ChannelSet:
    """All numeric arrays of an npy or npz file; single numbers named `rate_hz`, `fs` … in an npz give the rate."""
    if not zipfile.is_zipfile(path):
        # In place, so that a file shorter than its header says is refused and nothing is read yet.
        return _channels_of([_loaded("", np.load(path, mmap_mode="r", allow_pickle=False))])

    def read(name: str, needed_bytes: int) -> NDArray[np.generic]:
        require_memory(path, needed_bytes, f"array {name!r}")
        with np.load(path, allow_pickle=False) as arrays:
            return np.asarray(arrays[name])

    leaves = []
    with zipfile.ZipFile(path) as archive:
        for member_name in archive.namelist():
            if member_name.endswith(".npy"):
                with archive.open(member_name) as file:
                    header = read_npy_header(file)
                name = member_name.removesuffix(".npy")
                leaves.append(_Leaf(name, header.shape, header.dtype, partial(read, name, header.array_bytes)))
    return _channels_of(leaves)


def read_hdf5(path: Path, *, matlab: bool = False) -> ChannelSet:
    """All one- and two-axis datasets under their full path; attributes `unit`, `rate_hz`, `sampling_rate`, `fs` count.

    Attributes of the file and of groups hold for all datasets inside unless a dataset has its own. Values that lie in
    another file (external storage, external links, virtual datasets) are left out and named in the notes. matlab: a
    MATLAB 7.3 file: axes in reverse order, fields of structures as `s.field`.
    """
    with open_hdf5(path) as file:
        walk = _Walk(path, matlab)
        walk.enter(file, "", () if matlab else (dict(file.attrs),))
    return _channels_of(walk.leaves, walk.notes)


@dataclass(slots=True)
class _Walk:
    """The way through a file's groups, each once: links can make a small file hold itself."""

    # groups: the name under which each group was met, by its address.

    path: Path
    matlab: bool
    groups: dict[int, str] = field(default_factory=dict)
    leaves: list[_Leaf] = field(default_factory=list)
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
        name = name.replace("/", ".") if self.matlab else name
        read = partial(_dataset_values, self.path, item.name)
        shape, dtype = tuple(item.shape), item.dtype
        if self.matlab and attributes[0].get("MATLAB_class") == b"char":
            if item.ndim != 2:
                return
            shape, dtype = shape[1:], np.dtype(f"U{max(shape[0], 1)}")
            self.leaves.append(_Leaf(name, shape, dtype, lambda: _matlab_texts(read()), attributes))
        elif item.size == 1:
            self.leaves.append(_loaded(name, np.asarray(item[()]), attributes))
        elif self.matlab:
            # A row (1, n) of MATLAB is the same channel as a column (n, 1); HDF5 has its axes in reverse order.
            is_row = len(shape) == 2 and shape[1] == 1
            shape = shape if is_row else shape[::-1]
            self.leaves.append(_Leaf(name, shape, dtype, lambda: read() if is_row else read().T, attributes))
        else:
            self.leaves.append(_Leaf(name, shape, dtype, read, attributes))


def _dataset_values(path: Path, place: str) -> NDArray[np.generic]:
    with open_hdf5(path) as file:
        item = file[place]
        require_memory(path, item.size * item.dtype.itemsize, f"dataset {place!r}")
        return np.asarray(item[()])


def _matlab_texts(codes: NDArray[np.generic]) -> NDArray[np.generic]:
    """A character matrix (characters, rows as HDF5 shows it) as one text a row."""
    return np.array(["".join(chr(int(code)) for code in row) for row in codes.T])


def read_matlab(path: Path) -> ChannelSet:
    """All numeric variables; fields of structures become `structure.field`, columns of matrices `name_1` … `name_k`."""
    head = head_of(path)
    # A 7.3 file has MATLAB's own header of 512 bytes in front of the HDF5 signature.
    if SIGNATURE in (head[:8], head[512:520]):
        return read_hdf5(path, matlab=True)
    from scipy.io import loadmat, whosmat

    def load(name: str, needed_bytes: int) -> Any:
        require_memory(path, needed_bytes, f"variable {name!r}")
        return loadmat(path, simplify_cells=True, variable_names=[name])[name]

    def array(name: str, needed_bytes: int) -> NDArray[np.generic]:
        return np.asarray(load(name, needed_bytes))

    leaves: list[_Leaf] = []
    notes: list[str] = []
    sizes = iter(_matlab_bytes(path))
    for name, shape, kind in whosmat(path):
        stored = next(sizes, 0)
        if kind in _MATLAB_TYPES:
            # As scipy squeezes it: axes of length 1 go.
            axes = tuple(n for n in shape if n != 1)
            leaf = _Leaf(name, axes, np.dtype(_MATLAB_TYPES[kind]), partial(array, name, stored))
            if len(axes) <= 2 and not name.startswith("__"):
                leaves.append(_loaded(name, leaf.read()) if leaf.size == 1 else leaf)
        elif kind in _NESTED:
            leaves += _nested({name: load(name, _MAX_GROWTH * stored)}, "")
        else:
            notes.append(f"{name} left out: it is of class {kind}")
    return _channels_of(leaves, notes)


def _matlab_bytes(path: Path) -> list[int]:
    """The bytes that each variable of a version 5 file takes as it is stored, compressed ones after expansion."""
    # A compressed variable begins with its own size, of which only the first bytes are expanded here.
    sizes: list[int] = []
    with path.open("rb") as file:
        end = file.seek(0, 2)
        file.seek(_MATLAB_HEADER_BYTES - 2)
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


def _nested(variables: dict[str, Any], prefix: str) -> list[_Leaf]:
    leaves: list[_Leaf] = []
    for name, value in variables.items():
        array = np.asarray(value)
        if isinstance(value, dict):
            leaves += _nested(value, f"{prefix}{name}.")
        elif array.dtype.kind in "biufUSO" and array.ndim <= 2:
            leaves.append(_loaded(f"{prefix}{name}", array))
    return leaves
