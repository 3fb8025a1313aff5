"""Objects of a radar's HDF5 file that lie in the file itself, and are no larger than memory."""

from pathlib import Path
from typing import Any

from midspan.errors import DataError
from midspan.sources.declared_size import require_memory
from midspan.sources.hdf5_members import ElsewhereError, member


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
