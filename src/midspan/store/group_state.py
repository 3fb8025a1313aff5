"""The newest state of each group in two files of a folder, written in turns: one of them is whole, however a process
ends. Written in place, most of them never reach the disk: the kernel writes what it holds every few seconds.
"""

import os
import struct
import zlib
from pathlib import Path

from midspan.errors import DataError
from midspan.store.database import StoreFault, sqlite_faults

STATES = "groups"
# Magic, number of the writing, instant, length and check sum of the state.
HEAD = struct.Struct("<4sqqQI")
MAGIC = b"ms\x01\0"


class StateFiles:
    """The states of a store's groups."""

    def __init__(self, folder: Path, *, read_only: bool = False) -> None:
        self._folder, self._read_only = folder / STATES, read_only
        self._open: dict[str, tuple[int, int]] = {}
        self._number: dict[str, int] = {}

    def put(self, key: str, time_ns: int, body: bytes) -> None:
        """Keep a state. Raises StoreFault, after which the one before is there still."""
        if self._read_only:
            raise StoreFault("store_unavailable", f"{self._folder.parent}: the store is open read-only.")
        with sqlite_faults(self._folder):
            if key not in self._open:
                self._folder.mkdir(parents=True, exist_ok=True)
                self._number[key] = max((number for number, _, _ in self._found(key)), default=0)
                flags = os.O_WRONLY | os.O_CREAT | getattr(os, "O_BINARY", 0)
                first, second = (os.open(self._file(key, turn), flags, 0o666) for turn in (0, 1))
                self._open[key] = first, second
            number = self._number[key] + 1
            file = self._open[key][number % 2]
            data = HEAD.pack(MAGIC, number, time_ns, len(body), zlib.crc32(body)) + body
            os.lseek(file, 0, os.SEEK_SET)
            done = 0
            while done < len(data):
                done += os.write(file, data[done:])
            self._number[key] = number

    def get(self, key: str) -> tuple[int, bytes] | None:
        """The newest state and its instant (ns); None without one. Raises DataError where no file of it is whole."""
        found = self._found(key)
        if is_damaged(self._file(key, 0)):
            raise DataError(f"The store's checkpoint of the group {key} is damaged; its points restart.")
        _, time_ns, body = max(found, key=lambda one: one[0], default=(0, 0, None))
        return None if body is None else (time_ns, body)

    def close(self) -> None:
        """Let the files go."""
        for files in self._open.values():
            for file in files:
                os.close(file)
        self._open.clear()

    def _file(self, key: str, turn: int) -> Path:
        return self._folder / f"{key.replace(' ', '+')}.{turn}"

    def _found(self, key: str) -> list[tuple[int, int, bytes]]:
        """Number, instant and state of the files that are whole."""
        return [one for turn in (0, 1) if (one := whole_state(self._file(key, turn))) is not None]


def is_damaged(first: Path) -> bool:
    """Whether neither of two files, of which this is the first one, is whole. Of the first state of all a process may
    have written a part alone: the other file is empty then.
    """
    files = (first, first.with_suffix(".1"))
    return all(file.is_file() and file.stat().st_size and whole_state(file) is None for file in files)


def whole_state(file: Path) -> tuple[int, int, bytes] | None:
    """Number, instant and state of a file; None where it is not whole, or not there."""
    try:
        data = file.read_bytes()
        magic, number, time_ns, length, check = HEAD.unpack_from(data)
    except (OSError, struct.error):
        return None
    body = data[HEAD.size : HEAD.size + length]
    if magic != MAGIC or len(body) < length or zlib.crc32(body) != check:
        return None
    return number, time_ns, body
