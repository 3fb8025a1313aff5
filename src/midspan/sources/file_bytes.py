"""The bytes of a file without reading them all into memory."""

import mmap
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def mapped(file: Path) -> Iterator[memoryview]:
    """The bytes of a file, mapped into memory."""
    with file.open("rb") as handle:
        if file.stat().st_size == 0:
            yield memoryview(b"")
            return
        with mmap.mmap(handle.fileno(), 0, access=mmap.ACCESS_READ) as data:
            view = memoryview(data)
            try:
                yield view
            finally:
                view.release()
