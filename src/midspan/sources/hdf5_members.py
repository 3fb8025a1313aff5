"""Objects that lie in an HDF5 file itself: links and datasets can name other files, which are not followed."""

import struct
from pathlib import Path
from typing import Any

from midspan.errors import DataError
from midspan.sources.boundary import require_memory

# Where a file's head may begin, by the format: after a block of the user's of this many bytes.
HEADS = (0, *(512 << k for k in range(12)))
SIGNATURE = b"\x89HDF\r\n\x1a\n"


def open_hdf5(path: Path) -> Any:
    """An HDF5 file, opened for reading. Raises DataError for one that goes on behind its own end.

    The library follows what it finds in a file into which bytes were put, and may not come back.
    """
    import h5py

    size, end = path.stat().st_size, _end(path)
    if end is not None and size > end:
        raise DataError(f"{path} is damaged: it has {size} bytes, its header declares {end}. Copy it again.")
    return h5py.File(path, "r")


def _end(path: Path) -> int | None:
    """Where an HDF5 file ends by its own head, None where no head is found."""
    with path.open("rb") as file:
        for begin in HEADS:
            file.seek(begin)
            head = file.read(64)
            if head[:8] != SIGNATURE or len(head) < 48:
                continue
            base_at, end_at = (24, 40) if head[8] < 2 else (12, 28)
            if (head[13] if head[8] < 2 else head[9]) != 8:
                return None
            base, end = (int(struct.unpack_from("<Q", head, at)[0]) for at in (base_at, end_at))
            # What stands before the head counts in some files' end, and in others' not.
            return max(end, base + end)
    return None


class ElsewhereError(Exception):
    """What an object's values lie in, where that is not the file itself."""


def member(group: Any, key: str) -> Any:
    """The object under a key of an open file or group; None for a link that leads nowhere.

    Raises ElsewhereError for a link to another file, also one on the way of a soft link, external storage and a virtual
    dataset: they would read whatever file they name.
    """
    import h5py

    if isinstance(group.get(key, getlink=True), h5py.ExternalLink):
        raise ElsewhereError("it is a link to another file")
    found = group.get(key)
    if found is None:
        return None
    # HDF5's own number of the open file.
    if h5py.h5o.get_info(found.id).fileno != h5py.h5o.get_info(group.id).fileno:
        raise ElsewhereError("it is a link to another file")
    if isinstance(found, h5py.Dataset) and found.shape is not None:
        if found.external:
            raise ElsewhereError("its values lie in another file (external storage)")
        if found.is_virtual:
            raise ElsewhereError("its values lie in other datasets (virtual dataset)")
    return found


def dataset(path: Path, file: Any, name: str) -> Any:
    """The dataset `name` of an open file or group. Raises KeyError where there is none, DataError for one elsewhere."""
    import h5py

    found = file
    for part in name.split("/"):
        try:
            found = member(found, part)
        except ElsewhereError as error:
            raise DataError(f"{path}: {name} cannot be read: {error}. Copy the values into this file.") from None
        if found is None:
            raise KeyError(f"{name} is missing")
    if not isinstance(found, h5py.Dataset):
        raise DataError(f"{path}: {name} must be a dataset; it is a group. Check the file.")
    return found


def values(path: Path, file: Any, name: str) -> Any:
    """All values of a dataset, if they fit into memory."""
    found = dataset(path, file, name)
    require_memory(path, found.nbytes, name)
    return found[()]
