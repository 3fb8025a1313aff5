"""Files and folders that appear whole or not at all, also after a kill, on a full disk and through a power cut.

The new content goes under a temporary name into the folder of the final one, is brought to the disk (fsync) and takes
its name by a rename. What a killed process leaves there is removed by the next write to the same folder: every
temporary is locked while it is written, and the kernel drops the lock with the process. That is safer than a process id
in the name, which another process, another container or another machine on the same disk may have too. Where the file
system has no locks, such remains stay.
"""

import errno
import os
import secrets
import shutil
import sys
from collections.abc import Iterable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

from midspan._version import __version__
from midspan.errors import UsageError

WRITTEN_BY = f"written by midspan {__version__}"
"""What a file says of itself where its format has room for a text, so that it is known again; see `cli/targets.py`."""

PREFIX, SUFFIX = ".midspan-", ".part"
_FULL = (errno.ENOSPC, errno.EDQUOT)
_BINARY = getattr(os, "O_BINARY", 0)  # Windows would change line ends


def write_whole(path: Path, content: bytes, *, mode: int | None = None) -> None:
    """Write one file; it appears whole or not at all. Raises UsageError where it cannot be written.

    mode: who may read and write it; None: as the process makes files.
    """
    with replacing(path) as (file,):
        if mode is not None and sys.platform != "win32":
            # Before there is anything to read.
            os.fchmod(file.descriptor, mode)
        file.write(content)


@contextmanager
def replacing(*paths: Path) -> Iterator[tuple["NewFile", ...]]:
    """New files, one for each of `paths`; if the block ends without error they take these names, in this order.

    Raises UsageError, naming the file that failed, where a folder is missing or cannot be written.
    """
    with ExitStack() as stack:
        files = tuple(stack.enter_context(_new_file(path)) for path in paths)
        yield files
        for file in files:
            with cannot_be_written(file.path):
                os.fsync(file.descriptor)
        for file in files:
            file.publish()
        for folder in {path.parent for path in paths}:
            _sync_folder(folder)


class NewFile:
    """A file that is being written under a temporary name."""

    def __init__(self, path: Path, temporary: Path, descriptor: int) -> None:
        self.path, self._temporary, self.descriptor = path, temporary, descriptor

    def write(self, content: bytes) -> None:
        """Append bytes. Raises UsageError where the disk does not take them."""
        with cannot_be_written(self.path):
            rest = memoryview(content)
            while rest:
                rest = rest[os.write(self.descriptor, rest) :]

    def publish(self) -> None:
        """Give the file its final name."""
        with cannot_be_written(self.path):
            if sys.platform == "win32":
                # An open file cannot be renamed there.
                os.close(self.descriptor)
                self.descriptor = -1
            os.replace(self._temporary, self.path)

    def discard(self) -> None:
        """Close, and remove what has not got its final name."""
        if self.descriptor >= 0:
            os.close(self.descriptor)
        # Without an error here: the one that matters is on its way already.
        with suppress(OSError):
            self._temporary.unlink(missing_ok=True)


@contextmanager
def cannot_be_written(path: Path) -> Iterator[None]:
    """Turn an error of the system inside the block into a UsageError that names `path`."""
    try:
        yield
    except OSError as error:
        remedy = "Free some space there or choose another place." if error.errno in _FULL else "Choose another place."
        raise UsageError(f"{path} cannot be written: {error.strerror or error}. {remedy}") from error


@contextmanager
def _new_file(path: Path) -> Iterator[NewFile]:
    folder = path.parent
    if not folder.is_dir():
        raise UsageError(f"{path} cannot be written: the folder {folder} does not exist. Create it or choose another.")
    if path.is_dir():
        raise UsageError(f"{path} cannot be written: it is a folder. Give the name of a file.")
    with cannot_be_written(path):
        remove_remains(folder)
        file = NewFile(path, *_reserve(folder, directory=False))
    try:
        yield file
    finally:
        file.discard()


def _reserve(folder: Path, *, directory: bool) -> tuple[Path, int]:
    """A new temporary file or folder, locked, and its descriptor (-1 where the system has none for a folder)."""
    while True:
        path = folder / f"{PREFIX}{secrets.token_hex(8)}{SUFFIX}"
        if directory:
            path.mkdir()
            if sys.platform == "win32":
                return path, -1
            descriptor = os.open(path, os.O_RDONLY)
        else:
            descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_EXCL | _BINARY, 0o666)
        # Another process that removes remains may have come between the creation and the lock.
        if _lock(descriptor) is not False:
            with suppress(OSError):
                if os.path.samestat(os.fstat(descriptor), os.stat(path, follow_symlinks=False)):
                    return path, descriptor
        os.close(descriptor)


def remove_remains(folder: Path) -> None:
    """Remove the temporaries that killed processes left in a folder; those of living ones are locked and stay."""
    with suppress(OSError), os.scandir(folder) as entries:
        for entry in entries:
            if entry.name.startswith(PREFIX) and entry.name.endswith(SUFFIX):
                with suppress(OSError):
                    _remove_unlocked(Path(entry.path), directory=entry.is_dir(follow_symlinks=False))


def _remove_unlocked(path: Path, *, directory: bool) -> None:
    descriptor = os.open(path, (os.O_RDONLY if directory else os.O_RDWR) | getattr(os, "O_NOFOLLOW", 0))
    try:
        if _lock(descriptor):
            if directory:
                shutil.rmtree(path)
            else:
                path.unlink()
    finally:
        os.close(descriptor)


def _lock(descriptor: int) -> bool | None:
    """Lock a file for its descriptor's life: False where somebody else has it, None where there are no locks."""
    if sys.platform == "win32":
        return None
    import fcntl

    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:
        return None
    return True


def _sync(paths: Iterable[Path], flags: int) -> None:
    """Bring files, or the names in a folder, to the disk."""
    for path in paths:
        descriptor = os.open(path, flags)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)


def _sync_folder(folder: Path) -> None:
    """Bring the names in a folder to the disk, where the system can; the content is there already."""
    with suppress(OSError):
        _sync((folder,), os.O_RDONLY)


@contextmanager
def replacing_folder(folder: Path) -> Iterator[Path]:
    """A temporary folder that takes the name `folder` if the block ends without error, in place of an older one.

    The older one keeps its name until the new one is whole, is moved aside for the instant between two renames, and is
    removed last. Raises UsageError where it cannot be written.
    """
    with cannot_be_written(folder):
        partial, descriptor = _reserve(folder.parent, directory=True)
        try:
            yield partial
            for place, _, names in os.walk(partial):
                _sync((Path(place) / name for name in names), os.O_RDWR)
                _sync_folder(Path(place))
            with _alone_in(folder.parent):
                _settle(folder)
                if folder.exists():
                    os.rename(folder, _aside(folder))
                try:
                    os.rename(partial, folder)
                finally:
                    _sync_folder(folder.parent)
                    _settle(folder)
        finally:
            shutil.rmtree(partial, ignore_errors=True)
            if descriptor >= 0:
                os.close(descriptor)


def settle_folder(folder: Path) -> None:
    """Bring `folder` into order after a kill in its replacement, and make its parent: the older one comes back.

    Where the new one is in its place already, the older one is removed. Raises UsageError where that cannot be done.
    """
    with cannot_be_written(folder):
        folder.parent.mkdir(parents=True, exist_ok=True)
        remove_remains(folder.parent)
        with _alone_in(folder.parent):
            _settle(folder)


def _settle(folder: Path) -> None:
    aside = _aside(folder)
    if not aside.exists():
        return
    if not folder.exists():
        os.rename(aside, folder)
        return
    # Under a temporary's name first, so that half a folder is never taken for the older one.
    doomed = folder.with_name(f"{PREFIX}{secrets.token_hex(8)}{SUFFIX}")
    os.rename(aside, doomed)
    shutil.rmtree(doomed, ignore_errors=True)


def _aside(folder: Path) -> Path:
    return folder.with_name(f".{folder.name}.midspan-older")


@contextmanager
def _alone_in(folder: Path) -> Iterator[None]:
    """Keep other processes of midspan from moving folders here meanwhile, where the file system has locks."""
    if sys.platform == "win32":
        yield
        return
    import fcntl

    descriptor = os.open(folder, os.O_RDONLY)
    try:
        with suppress(OSError):
            fcntl.flock(descriptor, fcntl.LOCK_EX)
        yield
    finally:
        os.close(descriptor)
