"""A server over a store, and in place of an engine whatever gives it rows; a browser that is logged in."""

import asyncio
import contextlib
import json
import shutil
import subprocess
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.live.servers import command, free_port, wait_for
from midspan.records import NANOSECONDS
from midspan.service.live_socket import LiveSocket, Tree, row_bytes
from midspan.store.chunk import Chunk

RATE_HZ = 100
# The state is said so often, s: a server takes an engine that is silent for longer as away.
STATE_S = 0.5


def rows(point: str, begin_ns: int, seconds: float) -> Chunk:
    """Rows of a slow swing, as the store keeps them."""
    time_ns = begin_ns + np.arange(round(seconds * RATE_HZ)) * (NANOSECONDS // RATE_HZ)
    count = len(time_ns)
    columns = {
        "displacement_m": 1e-3 * np.sin(5.0 * (time_ns % (1000 * NANOSECONDS)) / NANOSECONDS),
        "std_m": np.full(count, 1e-5, dtype=np.float32),
        "velocity_m_s": np.zeros(count, dtype=np.float32),
        "source": np.ones(count, dtype=np.int8),
        "status": np.zeros(count, dtype=np.int8),
        "zero_std_m": np.full(count, 5e-6, dtype=np.float32),
    }
    return Chunk(point, "rows", time_ns, columns, 1, "displacement_m")


class ServedStore:
    """`midspan serve` on a store."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.port = folder, free_port()
        words = command("serve", folder, "--listen", f"127.0.0.1:{self.port}", "--quiet")
        self.process = subprocess.Popen(words, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        wait_for(self.port)

    @property
    def address(self) -> str:
        """Where it answers."""
        return f"http://127.0.0.1:{self.port}"

    def access(self, name: str, kind: str) -> str:
        """A password (kind "user") or a token that may look."""
        asked = command("access", self.folder, f"add-{kind}", name, "--scope", "read", "--json")
        found = json.loads(subprocess.run(asked, capture_output=True, check=True).stdout)
        return str(found["token" if kind == "token" else "password"])

    def stop(self) -> None:
        """End it."""
        self.process.terminate()
        self.process.wait(timeout=60)


class Feed:
    """The engine's end of the local socket, in a thread: points that run, and the rows that it is given."""

    def __init__(self, folder: Path, points: list[str]) -> None:
        self._points = [{
            "point": name, "status": "tracking", "reason": "", "text": "", "rows_age_s": 0.1, "sigma_mm": 0.01,
            "usual_sigma_mm": 0.01, "calibration": 1, "notice": "", "notice_text": "", "phase": "running",
            "sources": [],
        } for name in points]  # fmt: skip
        self._loop, self._ending = asyncio.new_event_loop(), threading.Event()
        self._socket = LiveSocket(folder, self._answer)
        self._thread = threading.Thread(target=self._loop.run_forever, daemon=True)
        self._thread.start()
        self._do(self._socket.start())
        self._repeating = asyncio.run_coroutine_threadsafe(self._repeat(), self._loop)

    def give(self, chunk: Chunk) -> None:
        """Send rows."""
        self._loop.call_soon_threadsafe(self._socket.publish, {"kind": "rows", "point": chunk.point}, row_bytes(chunk))

    def event(self, point: str, time_ns: int) -> None:
        """Send an event."""
        head = {"kind": "event", "point": point, "time_ns": time_ns, "text": "A gap of 2 s."}
        self._loop.call_soon_threadsafe(self._socket.publish, head)

    def stop(self) -> None:
        """Be away."""
        self._repeating.cancel()
        self._do(self._socket.stop())
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join(30.0)
        self._loop.close()

    async def _repeat(self) -> None:
        while True:
            state = {"ready": True, "points": self._points, "sources": [], "settings": None}
            self._socket.publish({"kind": "state", **state, "store": {"waiting": 0, "dropped": 0}})
            await asyncio.sleep(STATE_S)

    async def _answer(self, head: Tree) -> tuple[Tree, bytes]:
        return {"text": "", "alarms": [], "limits": [], "targets": []}, b""

    def _do(self, work: Any) -> Any:
        return asyncio.run_coroutine_threadsafe(work, self._loop).result(30.0)


def chromium() -> str | None:
    """The browser's program, where one is installed."""
    return next(
        (found for name in ("chromium", "chromium-browser", "google-chrome") if (found := shutil.which(name))), None
    )


@contextlib.contextmanager
def browser() -> Iterator[Any]:
    """A browser without a window."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as running:
        started = running.chromium.launch(executable_path=chromium(), args=["--no-sandbox"])
        yield started
        started.close()


def logged_in(started: Any, served: ServedStore, password: str, user: str = "viewer") -> Any:
    """A browser's context, its caches empty, with a session."""
    context = started.new_context(viewport={"width": 1280, "height": 900})
    answer = context.request.post(f"{served.address}/api/v1/login", data={"user": user, "password": password})
    if not answer.ok:
        raise RuntimeError(answer.text())
    return context
