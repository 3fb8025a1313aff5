"""The engine's end of the local socket that a page's server reads live rows and states from, and sends commands over.

A frame is its length (u32, little-endian), a line of JSON and the bytes after it. The socket is a file of the service's
own folder that only its user may open. `publish` never waits: a reader that does not keep up is dropped.
"""

import asyncio
import json
import os
import struct
from collections import deque
from collections.abc import Awaitable, Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO, Any

import numpy as np

from midspan.errors import DataError, MidspanError, UsageError
from midspan.store.chunk import Chunk
from midspan.store.database import lock_file

SOCKET_FILE, LOCK_FILE = "live.sock", "live.lock"
# A picture of 4K as JPEG is below that.
MAX_FRAME_BYTES = 8_000_000
# What waits for a reader at most, and how many readers there are: a page's server reads megabytes a second.
MAX_WAITING_BYTES, MAX_READERS = 16_000_000, 8
# The commands that a reader may have on their way at a time.
MAX_COMMANDS = 16
LENGTH = struct.Struct("<I")

Tree = dict[str, Any]
Command = Callable[[Tree], Awaitable[tuple[Tree, bytes]]]
"""Takes a command and gives its answer, and bytes with it."""


def packed(head: Tree, body: bytes = b"") -> bytes:
    """A frame."""
    text = json.dumps(head, separators=(",", ":")).encode()
    return LENGTH.pack(len(text) + 1 + len(body)) + text + b"\n" + body


async def read_frame(reader: asyncio.StreamReader) -> tuple[Tree, bytes]:
    """The next frame. Raises DataError for what is none, IncompleteReadError at the end."""
    (length,) = LENGTH.unpack(await reader.readexactly(LENGTH.size))
    if not 0 < length <= MAX_FRAME_BYTES:
        raise DataError(f"The local socket received a frame of {length} bytes; the limit is {MAX_FRAME_BYTES}.")
    text, _, body = (await reader.readexactly(length)).partition(b"\n")
    try:
        head = json.loads(text)
    except ValueError:
        head = None
    if not isinstance(head, dict):
        raise DataError("The local socket received an invalid frame.")
    return head, body


@contextmanager
def short_address(folder: Path) -> Iterator[str]:
    """The socket's address: a path of more than 107 bytes cannot be one, so that it leads over an open folder."""
    file = folder / SOCKET_FILE
    if len(os.fsencode(file)) < 100 or not Path("/proc/self/fd").is_dir():
        yield str(file)
        return
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        yield f"/proc/self/fd/{descriptor}/{SOCKET_FILE}"
    finally:
        os.close(descriptor)


ROW = np.dtype([("time_ns", "<i8"), ("displacement_mm", "<f8"), ("displacement_std_mm", "<f4"), ("status", "u1")])
"""A row as it goes over the local socket."""


def row_bytes(rows: Chunk) -> bytes:
    """Rows as they go over the local socket."""
    made = np.empty(len(rows.time_ns), dtype=ROW)
    made["time_ns"], made["status"] = rows.time_ns, rows.columns["status"]
    made["displacement_mm"] = 1e3 * np.asarray(rows.columns["displacement_m"])
    made["displacement_std_mm"] = 1e3 * np.asarray(rows.columns["std_m"], dtype=np.float64)
    return made.tobytes()


def of_ready(state: dict[str, Any]) -> dict[str, Any]:
    """A point's state without its sources, as /readyz shows it."""
    return {key: state[key] for key in READY}


READY = ("point", "status", "reason", "text", "rows_age_s", "sigma_mm", "usual_sigma_mm")


class _Reader:
    """One connection: what waits for it, and how much that is."""

    def __init__(self, writer: asyncio.StreamWriter) -> None:
        self.writer, self.waiting, self.bytes = writer, deque[bytes](), 0
        self.some = asyncio.Event()
        self.commands = 0

    def put(self, frame: bytes) -> bool:
        """Queue a frame; whether there was room."""
        self.waiting.append(frame)
        self.bytes += len(frame)
        self.some.set()
        return self.bytes <= MAX_WAITING_BYTES

    async def send(self) -> None:
        """Send what is queued, for ever."""
        while True:
            await self.some.wait()
            self.some.clear()
            while self.waiting:
                frame = self.waiting.popleft()
                self.writer.write(frame)
                await self.writer.drain()
                self.bytes -= len(frame)


class LiveSocket:
    """command: answers what readers send; its MidspanError is the answer `error`. dropped: readers that were too slow.

    A new reader first gets the newest frame of each kind in `hello` and `state`.
    """

    def __init__(self, folder: Path, command: Command) -> None:
        self._folder, self._command = folder, command
        self._readers: set[_Reader] = set()
        self._newest: dict[str, bytes] = {}
        self._server: asyncio.Server | None = None
        self._lock: IO[bytes] | None = None
        self._tasks: set[asyncio.Task[None]] = set()
        self.dropped = 0

    async def start(self) -> None:
        """Listen; what an earlier process left under the name is replaced.

        Raises UsageError where another process listens there.
        """
        self._folder.mkdir(parents=True, exist_ok=True)
        self._lock = lock_file(self._folder / LOCK_FILE)
        if self._lock is None:
            raise UsageError(
                f"{self._folder}: another `midspan run` uses this store. Stop it, put the points of both into one "
                "SITE.toml, or use two stores."
            )
        with suppress(FileNotFoundError):
            (self._folder / SOCKET_FILE).unlink()
        before = os.umask(0o177)
        try:
            with short_address(self._folder) as address:
                self._server = await asyncio.start_unix_server(self._connected, address, backlog=MAX_READERS)
        finally:
            os.umask(before)

    async def stop(self) -> None:
        """Let all readers go."""
        if self._server is None:
            return
        self._server.close()
        with suppress(OSError):
            (self._folder / SOCKET_FILE).unlink()
        for reader in list(self._readers):
            reader.writer.transport.abort()
        for task in list(self._tasks):
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)
        if self._lock is not None:
            self._lock.close()

    def publish(self, head: Tree, body: bytes = b"") -> None:
        """Send a frame to every reader; its `kind` says what it is. States are kept for readers that come later."""
        keep = head["kind"] in ("hello", "state")
        if not (self._readers or keep):
            return
        frame = packed(head, body)
        if keep:
            self._newest[head["kind"]] = frame
        for reader in list(self._readers):
            if not reader.put(frame):
                self.dropped += 1
                self._readers.discard(reader)
                reader.writer.transport.abort()

    @property
    def has_readers(self) -> bool:
        """Whether anyone listens."""
        return bool(self._readers)

    async def _connected(self, incoming: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        if len(self._readers) >= MAX_READERS:
            writer.transport.abort()
            return
        reader = _Reader(writer)
        self._readers.add(reader)
        for frame in self._newest.values():
            reader.put(frame)
        sending = self._begin(reader.send())
        try:
            while True:
                head, _ = await read_frame(incoming)
                if reader.commands >= MAX_COMMANDS:
                    reader.put(packed({"kind": "answer", "id": head.get("id"), "error": "busy"}))
                    continue
                reader.commands += 1
                self._begin(self._answer(reader, head))
        except (asyncio.IncompleteReadError, OSError, DataError):
            pass
        finally:
            self._readers.discard(reader)
            sending.cancel()
            writer.transport.abort()

    def _begin(self, work: Any) -> asyncio.Task[None]:
        task = asyncio.get_running_loop().create_task(work)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)
        return task

    async def _answer(self, reader: _Reader, head: Tree) -> None:
        number = head.pop("id", None)
        try:
            answer, body = await self._command(head)
        except MidspanError as error:
            answer, body = {"error": str(error)}, b""
        finally:
            reader.commands -= 1
        reader.put(packed({"kind": "answer", "id": number, **answer}, body))
