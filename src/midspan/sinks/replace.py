"""Files that appear whole or not at all: written under a temporary name beside the final one, then renamed."""

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from midspan.errors import UsageError


@contextmanager
def replacing(*paths: Path) -> Iterator[tuple[Path, ...]]:
    """Temporary paths, one for each of `paths` and with its suffix; renamed together if the block ends without error.

    Raises UsageError where the folder is missing or cannot be written.
    """
    temporary = tuple(_reserve(path) for path in paths)
    try:
        yield temporary
        for source, target in zip(temporary, paths, strict=True):
            os.replace(source, target)
    except OSError as error:
        raise UsageError(f"{paths[0]} cannot be written: {error.strerror or error}. Choose another place.") from error
    finally:
        for source in temporary:
            source.unlink(missing_ok=True)


def _reserve(path: Path) -> Path:
    folder = path.parent
    if not folder.is_dir():
        raise UsageError(f"{path} cannot be written: the folder {folder} does not exist. Make it or choose another.")
    if path.is_dir():
        raise UsageError(f"{path} cannot be written: it is a folder. Give the name of a file.")
    try:
        handle, name = tempfile.mkstemp(prefix=f".{path.stem}-", suffix=path.suffix, dir=folder)
        os.close(handle)
        os.chmod(name, 0o666 & ~_mask())
    except OSError as error:
        raise UsageError(f"{path} cannot be written: {error.strerror or error}. Choose another folder.") from error
    return Path(name)


def _mask() -> int:
    """The user's mask of permissions, which can only be read by setting it; a temporary file would be private."""
    mask = os.umask(0)
    os.umask(mask)
    return mask
