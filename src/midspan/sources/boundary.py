"""The boundary to files and format libraries: whatever they raise becomes one sentence."""

import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from midspan.errors import DataError, MidspanError, UsageError

# Characters of a path that a message shows.
_SHOWN = 200


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
            f"{path} cannot be read as {kind}: it needs more memory than there is. Check that the file is whole; if it "
            "is, split it, or read it on a machine with more memory."
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
        raise DataError(f"{_start(path)} cannot be opened: {error.strerror}. Correct the path.") from None
    if not stat.S_ISREG(kind) and not (folder and stat.S_ISDIR(kind)):
        what = "a folder" if stat.S_ISDIR(kind) else "a pipe, a socket or a device, which has no end"
        raise DataError(f"{path} must be a file; it is {what}. Give the file itself.")


def _start(path: Path) -> str:
    """The beginning of a path that may be very long."""
    text = str(path)
    return text if len(text) <= _SHOWN else f"{text[:_SHOWN]}… ({len(text)} characters)"


def _reason(error: Exception) -> str:
    """What a library says, in one line."""
    if isinstance(error, RecursionError):
        return "its parts are nested too deeply"
    said = (error.strerror if isinstance(error, OSError) else None) or str(error).strip() or type(error).__name__
    if "Assertion failed" in said:
        # OpenCV prints the line of its own source text.
        return "its header declares what no picture has"
    return said.splitlines()[0].rstrip(" .")
