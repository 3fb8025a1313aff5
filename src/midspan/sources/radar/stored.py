"""Objects of a radar's HDF5 file that lie in the file itself, and are no larger than memory."""

from pathlib import Path
from typing import Any

from midspan.errors import DataError
from midspan.sources.declared_size import require_memory


def dataset(path: Path, file: Any, name: str) -> Any:
    """The dataset `name` of an open file or group. Raises KeyError where there is none, DataError for one outside.

    Links to other files, virtual datasets and external storage would read whatever file they name.
    """
    import h5py

    group = file
    for part in name.split("/"):
        if isinstance(group.get(part, getlink=True), h5py.ExternalLink):
            raise _outside(path, name)
        group = group[part]
    if not isinstance(group, h5py.Dataset):
        raise DataError(f"{path}: {name} must be a dataset; it is a group. Check the file.")
    if group.is_virtual or group.external:
        raise _outside(path, name)
    return group


def values(path: Path, file: Any, name: str) -> Any:
    """All values of a dataset, if they fit into memory."""
    found = dataset(path, file, name)
    require_memory(path, found.nbytes, name)
    return found[()]


def _outside(path: Path, name: str) -> DataError:
    return DataError(f"{path}: {name} lies in another file, which is not followed. Copy the values into this file.")
