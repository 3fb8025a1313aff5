"""Objects that lie in an HDF5 file itself: links and datasets can name other files, which are not followed."""

from typing import Any


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
