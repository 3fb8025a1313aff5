"""The boundary to the format libraries: whatever they raise on a damaged file becomes one sentence."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from midspan.errors import DataError, MidspanError, UsageError


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


def _reason(error: Exception) -> str:
    """What a library says, in one line."""
    if isinstance(error, RecursionError):
        return "its parts are nested too deeply"
    said = (error.strerror if isinstance(error, OSError) else None) or str(error).strip() or type(error).__name__
    if "Assertion failed" in said:
        # OpenCV prints the line of its own source text.
        return "its header declares what no picture has"
    return said.splitlines()[0].rstrip(" .")
