"""The boundary to files and format libraries: whatever they raise becomes one sentence, and what a file's header
declares is compared with the available memory before anything is allocated.

A header of a few bytes can declare any size, by damage or on purpose; without that check the system ends the process.
"""

import math
import mmap
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

import numpy as np

from midspan.errors import DataError, MidspanError, UsageError

# Characters of a path that a message shows.
_SHOWN = 200
# Where the system does not say how much memory is available, bytes.
_ASSUMED_BYTES = 4 << 30
# No mark of a format lies behind this many bytes.
HEAD_BYTES = 1024
_CONTAINER = "/sys/fs/cgroup"


@contextmanager
def reading(path: Path, kind: str) -> Iterator[None]:
    """Turn whatever a format library raises on a damaged file into one DataError: '{path} cannot be read as {kind}:
    {reason}. Check that the file is whole.'

    It stands around opening and around iterating: a damaged file fails where its damage lies. Errors of midspan pass
    unchanged; a library that is missing is a UsageError.
    """
    try:
        yield
    except MidspanError:
        raise
    except ImportError as error:
        raise UsageError(f"{path}: {kind} needs a library that is not installed. {error}.") from error
    except MemoryError as error:
        raise DataError(
            f"{path} cannot be read as {kind}: it needs more memory than is available. Check that the file is "
            "complete; if so, split it, or use a machine with more memory."
        ) from error
    except Exception as error:  # the format libraries raise whatever they meet in a damaged file
        raise DataError(f"{path} cannot be read as {kind}: {_reason(error)}. Check that the file is whole.") from error


def require_file(path: Path, *, folder: bool = False) -> None:
    """Raise DataError for a path that is no file that can be read to its end; folder: one may be given instead."""
    try:
        kind = path.stat().st_mode
    except ValueError:
        raise DataError(f"{str(path)!r} must be a path without zero characters. Correct the path.") from None
    except FileNotFoundError:
        where = path.absolute().parent
        raise DataError(f"{path} does not exist; it was looked for in the folder {where}. Correct the path.") from None
    except OSError as error:
        text = str(path)
        start = text if len(text) <= _SHOWN else f"{text[:_SHOWN]}… ({len(text)} characters)"
        raise DataError(f"{start} cannot be opened: {error.strerror}. Correct the path.") from None
    if not stat.S_ISREG(kind) and not (folder and stat.S_ISDIR(kind)):
        what = "a folder" if stat.S_ISDIR(kind) else "a pipe, a socket or a device, which has no end"
        raise DataError(f"{path} must be a file; it is {what}. Give the file itself.")


def _reason(error: Exception) -> str:
    """What a library says, in one line."""
    if isinstance(error, RecursionError):
        return "its parts are nested too deeply"
    said = (error.strerror if isinstance(error, OSError) else None) or str(error).strip() or type(error).__name__
    if "Assertion failed" in said:
        # OpenCV prints the line of its own source text.
        return "its header declares an impossible image"
    return said.splitlines()[0].rstrip(" .")


def require_memory(path: Path, declared_bytes: int, what: str) -> None:
    """Raise DataError where `declared_bytes`, what reading `what` of a file would allocate, exceed available memory."""
    limit = available_bytes()
    if declared_bytes > limit:
        raise DataError(
            f"{path}: {what} must fit into the available memory, {shown_bytes(limit)}; it needs "
            f"{shown_bytes(declared_bytes)}. Check that the file is complete; if so, split it, or use a machine with "
            "more memory."
        )


def available_bytes() -> int:
    """Memory that this process can still allocate: what system and container have left, within its own limit."""
    left = _after("/proc/meminfo", "MemAvailable:")
    free = _ASSUMED_BYTES if left is None else 1024 * left
    # Of a container (control groups, version 2); a limit that is not set is the word "max".
    most, taken = _after(f"{_CONTAINER}/memory.max", ""), _after(f"{_CONTAINER}/memory.current", "")
    free = free if most is None or taken is None else min(free, max(most - taken, 0))
    # Both in bytes and in kB, as the kernel writes them; a limit that is not set is no number.
    limit, used = _after("/proc/self/limits", "Max address space"), _after("/proc/self/status", "VmSize:")
    return free if limit is None or used is None else min(free, max(limit - 1024 * used, 0))


def _after(file: str, name: str) -> int | None:
    """The whole number behind a name at the start of a line; None where the file, the name or a number is missing."""
    try:
        lines = Path(file).read_text(encoding="ascii", errors="replace").splitlines()
    except OSError:
        return None
    words = next((line.removeprefix(name).split() for line in lines if line.startswith(name)), [])
    return int(words[0]) if words and words[0].isdigit() else None


def head_of(path: Path) -> bytes:
    """What a file begins with, which tells its kind."""
    with path.open("rb") as file:
        return file.read(HEAD_BYTES)


def shown_bytes(count: int) -> str:
    """A count of bytes for a person."""
    return f"{count / 2**30:.1f} GiB" if count >= 2**30 else f"{count / 2**20:.1f} MiB"


@contextmanager
def mapped(file: Path) -> Iterator[memoryview]:
    """The bytes of a file, mapped into memory."""
    if file.stat().st_size == 0:
        yield memoryview(b"")
        return
    with (
        file.open("rb") as handle,
        mmap.mmap(handle.fileno(), 0, access=mmap.ACCESS_READ) as data,
        memoryview(data) as view,
    ):
        yield view


@dataclass(frozen=True, slots=True)
class NpyHeader:
    """Shape, order of the axes in the file, and type of an array."""

    shape: tuple[int, ...]
    fortran: bool
    dtype: np.dtype[Any]

    @property
    def array_bytes(self) -> int:
        """Bytes of the array."""
        return math.prod(self.shape) * self.dtype.itemsize


def read_npy_header(file: IO[bytes]) -> NpyHeader:
    """The header at a file's place, which is behind it then. Raises ValueError for Python objects and for no array."""
    version = np.lib.format.read_magic(file)
    read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    header = NpyHeader(*read(file))
    if header.dtype.hasobject:
        raise ValueError("it holds Python objects (pickled), which are no array of numbers")
    return header
