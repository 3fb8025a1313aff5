"""The newest states of each group in three files of a folder: one of them is whole, however a process ends.

Written in place each second, most of them never reach the disk: the kernel writes what it holds every few seconds, and
perhaps a state before the rows that lead to it. So each says which rows those are, and the lasting one, which is
synchronised after its rows, stays until there is the next lasting one.
"""

import os
import struct
import zlib
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

from midspan.errors import DataError
from midspan.store.database import StoreFault, sqlite_faults

STATES, FILES = "groups", 3
# Magic, number of the writing, instant, newest row, whether it lasts, length and check sum of the state.
HEAD = struct.Struct("<4sqqq?QI")
MAGIC = b"ms\x02\0"
# Of earlier versions, whose states do not say which rows they rest on.
FIRST_HEAD, FIRST_MAGIC = struct.Struct("<4sqqQI"), b"ms\x01\0"
NO_ROWS_NS = -(2**62)


@dataclass(frozen=True, slots=True)
class GroupState:
    """A state, its instant (ns), and the stamp of the newest row of its group when it was kept: it rests on this."""

    time_ns: int
    body: bytes
    rows_ns: int = NO_ROWS_NS


@dataclass(slots=True)
class _Files:
    """The open files of a group, the number of the newest state, and which file has that and which the lasting one."""

    files: list[int]
    number: int = 0
    newest: int | None = None
    lasting: int | None = None


class StateFiles:
    """The states of a store's groups."""

    def __init__(self, folder: Path, *, read_only: bool = False) -> None:
        self._folder, self._read_only = folder / STATES, read_only
        self._open: dict[str, _Files] = {}

    def put(self, key: str, state: GroupState, *, lasting: bool = True) -> None:
        """Keep a state; lasting: what it rests on is on the disk, and so is the state when this returns.

        Raises StoreFault, after which the one before is there still.
        """
        if self._read_only:
            raise StoreFault("store_unavailable", f"{self._folder.parent}: the store is open read-only.")
        with sqlite_faults(self._folder):
            if key not in self._open:
                self._open[key] = self._opened(key)
            group = self._open[key]
            turn = next(one for one in range(FILES) if one not in (group.newest, group.lasting))
            numbers = (group.number + 1, state.time_ns, state.rows_ns, lasting)
            _write(group.files[turn], HEAD.pack(MAGIC, *numbers, len(state.body), zlib.crc32(state.body)) + state.body)
            if lasting:
                os.fsync(group.files[turn])
                group.lasting = turn
            group.number, group.newest = group.number + 1, turn

    def get(self, key: str) -> list[GroupState]:
        """The states, the newest one first. Raises DataError where no file of them is whole."""
        if is_damaged(files := files_of(self._file(key))):
            raise DataError(f"The store's checkpoint of the group {key} is damaged; its points restart.")
        found = [one for file in files if (one := whole_state(file)) is not None]
        # What a lasting one rests on was on the disk before it, and may have been removed since.
        return [
            replace(state, rows_ns=NO_ROWS_NS) if lasting else state
            for _, lasting, state in sorted(found, key=lambda one: one[0], reverse=True)
        ]

    def close(self) -> None:
        """Let the files go; what they have is brought to the disk."""
        for group in self._open.values():
            for file in group.files:
                # Where it cannot be, the lasting state is there.
                with suppress(OSError):
                    os.fsync(file)
                os.close(file)
        self._open.clear()

    def _opened(self, key: str) -> _Files:
        self._folder.mkdir(parents=True, exist_ok=True)
        flags = os.O_WRONLY | os.O_CREAT | getattr(os, "O_BINARY", 0)
        paths = files_of(self._file(key))
        group = _Files([os.open(path, flags, 0o666) for path in paths])
        found = [(*one[:2], turn) for turn, path in enumerate(paths) if (one := whole_state(path)) is not None]
        for number, lasting, turn in sorted(found):
            group.number, group.newest = number, turn
            group.lasting = turn if lasting else group.lasting
        return group

    def _file(self, key: str) -> Path:
        return self._folder / f"{key.replace(' ', '+')}.0"


def files_of(first: Path) -> list[Path]:
    """The files of a group, of which this is the first one."""
    return [first.with_suffix(f".{turn}") for turn in range(FILES)]


def is_damaged(files: list[Path]) -> bool:
    """Whether none of a group's files is whole. Of the first state of all a process may have written a part alone: the
    other files are empty then.
    """
    written = [file for file in files if file.is_file() and file.stat().st_size]
    return len(written) > 1 and all(whole_state(file) is None for file in written)


def whole_state(file: Path) -> tuple[int, bool, GroupState] | None:
    """The number of a file's state, and whether it is a lasting one; None where it is not whole, or not there."""
    try:
        data = file.read_bytes()
        if data.startswith(FIRST_MAGIC):
            (magic, number, time_ns, length, check), size = FIRST_HEAD.unpack_from(data), FIRST_HEAD.size
            rows_ns, lasting = NO_ROWS_NS, False
        else:
            (magic, number, time_ns, rows_ns, lasting, length, check), size = HEAD.unpack_from(data), HEAD.size
    except (OSError, struct.error):
        return None
    body = data[size : size + length]
    if magic not in (MAGIC, FIRST_MAGIC) or len(body) < length or zlib.crc32(body) != check:
        return None
    return number, lasting, GroupState(time_ns, body, rows_ns)


def _write(file: int, data: bytes) -> None:
    os.lseek(file, 0, os.SEEK_SET)
    done = 0
    while done < len(data):
        done += os.write(file, data[done:])
