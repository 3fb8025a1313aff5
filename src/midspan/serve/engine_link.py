"""The server's end of the engine's local socket: the newest states, the rows that come, and commands."""

import asyncio
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

from midspan.errors import DataError, MidspanError
from midspan.service.live_socket import MAX_FRAME_BYTES, SOCKET_FILE, Tree, packed, read_frame, short_address

# An engine that is away is looked for so often; one that says nothing for so long, though it does so twice a second, is
# away for whoever asks, s.
AGAIN_S, SILENT_S = 0.5, 5.0
# A command is answered within this time, s: a picture waits for the next frame.
ANSWER_S = 10.0


class AwayError(MidspanError):
    """No process measures, or it does not answer."""


class EngineLink:
    """came: called with each frame's head and body, other than answers. folder: of the socket."""

    def __init__(self, folder: Path, came: Callable[[Tree, bytes], None]) -> None:
        self._folder, self._came = folder, came
        self.hello: Tree = {}
        self.state: Tree = {}
        self.heard_s: float | None = None
        self._writer: asyncio.StreamWriter | None = None
        self._answers: dict[int, asyncio.Future[tuple[Tree, bytes]]] = {}
        self._count = 0

    @property
    def is_connected(self) -> bool:
        """Whether a process measures, or stands by with wrong settings."""
        return self._writer is not None

    @property
    def may_connect(self) -> bool:
        """Whether a process has, or had, its socket there."""
        return (self._folder / SOCKET_FILE).exists()

    @property
    def silent_s(self) -> float:
        """How long nothing was heard of the engine, s; endless before it was."""
        return float("inf") if self.heard_s is None else time.monotonic() - self.heard_s

    @property
    def reason(self) -> str:
        """Why there is no newest state, as a code of the documentation's table; empty where there is."""
        if self._writer is None:
            return "not_measuring"
        return "engine_silent" if self.silent_s > SILENT_S else ""

    async def run(self) -> None:
        """Connect, again and again."""
        while True:
            with suppress(OSError, asyncio.IncompleteReadError, DataError):
                await self._connected()
            self._writer = None
            for answer in self._answers.values():
                if not answer.done():
                    answer.set_exception(AwayError("The measuring process ended before answering. Try again."))
            self._answers.clear()
            await asyncio.sleep(AGAIN_S)

    async def ask(self, command: str, **values: Any) -> tuple[Tree, bytes]:
        """Send a command; its answer. Raises AwayError, and MidspanError for what the engine refuses."""
        if self._writer is None:
            raise AwayError("No measuring process is running. Start `midspan run`, then try again.")
        self._count += 1
        number = self._count
        answer = self._answers[number] = asyncio.get_running_loop().create_future()
        self._writer.write(packed({"command": command, "id": number, **values}))
        try:
            found, body = await asyncio.wait_for(answer, ANSWER_S)
        except TimeoutError:
            raise AwayError("The measuring process does not answer at present. Try again in some seconds.") from None
        finally:
            self._answers.pop(number, None)
        if "error" in found:
            raise MidspanError(str(found["error"]))
        return found, body

    async def _connected(self) -> None:
        with short_address(self._folder) as address:
            reader, writer = await asyncio.open_unix_connection(address, limit=MAX_FRAME_BYTES)
        self._writer = writer
        try:
            while True:
                head, body = await read_frame(reader)
                self.heard_s = time.monotonic()
                self._taken(head, body)
        finally:
            writer.transport.abort()

    def _taken(self, head: Tree, body: bytes) -> None:
        kind = head.get("kind")
        if kind == "answer":
            answer = self._answers.get(head.get("id", 0))
            if answer is not None and not answer.done():
                answer.set_result((head, body))
            return
        if kind == "hello":
            self.hello = head
        elif kind == "state":
            self.state = head
        self._came(head, body)
