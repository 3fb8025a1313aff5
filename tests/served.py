"""A store with ten minutes of rows, an engine that says what a test lets it, and the server's own process on both."""

import asyncio
import contextlib
import io
import json
import signal
import subprocess
import threading
import time

import httpx
import numpy as np
import pytest
from benchmarks.live.servers import command, free_port, wait_for

from midspan.cli.main import run
from midspan.errors import MidspanError
from midspan.records import NANOSECONDS, Event
from midspan.service.live_socket import LiveSocket, row_bytes
from midspan.store.chunk import Chunk
from midspan.store.store import Batch, open_store

SECONDS, RATE = 600, 100
# Rows that are missing, that are lost, and the one that is far from all others; s from the first row.
GAP_S, LOST_S, PEAK_S, PEAK_MM = (200.0, 260.0), (400.0, 410.0), 123.45, 77.0


def rows(begin_ns, seconds=SECONDS, *, point="p"):
    """Rows of a point, in the columns of the store."""
    time_s = np.arange(round(seconds * RATE)) / RATE
    value = 1e-3 * np.sin(2 * np.pi * 0.8 * time_s)
    status = np.zeros(len(time_s), dtype=np.int8)
    if seconds == SECONDS:
        value[round(PEAK_S * RATE)] = 1e-3 * PEAK_MM
        inside = (time_s >= LOST_S[0]) & (time_s < LOST_S[1])
        status[inside], value[inside] = 2, 1.0
    columns = {
        "displacement_m": value,
        "std_m": np.full(len(time_s), 1e-5, dtype=np.float32),
        "velocity_m_s": np.zeros(len(time_s), dtype=np.float32),
        "source": np.ones(len(time_s), dtype=np.int8),
        "status": status,
        "zero_std_m": np.full(len(time_s), 5e-6, dtype=np.float32),
    }
    time_ns = begin_ns + np.round(1e9 * time_s).astype(np.int64)
    chunk = Chunk(point, "rows", time_ns, columns, 1, "displacement_m")
    return chunk if seconds != SECONDS else chunk.rows((time_s < GAP_S[0]) | (time_s >= GAP_S[1]))


def made_store(folder, begin_ns):
    """A store of the points p, which has rows, events and calibrations, and q, which has an event alone."""
    store = open_store(folder)
    for part in rows(begin_ns).split(1.0):
        store.write(Batch(chunks=[part]))
    store.write(
        Batch(events=[("p", Event(begin_ns + NANOSECONDS, "gap", "<b>a</b> gap")), ("q", Event(begin_ns, "x", "y"))])
    )
    store.add_calibration("p", begin_ns, json.dumps({"version": 1}), "{}", accept=True)
    store.add_calibration("p", begin_ns + 1, json.dumps({"version": 1}), "{}", accept=False)
    store.close()


# A radar's frame: a target at 3 m, and a stronger one beside it that is none of the point's.
PROFILE = {
    "time_ns": 1, "range_m": [0.5 * k for k in range(16)],
    "magnitude_db": [-3.0 if k == 6 else 0.0 if k == 9 else -40.0 - k % 3 for k in range(16)],
    "targets": [{"bin": 6.1, "range_m": 3.05, "snr_db": 31.0}],
}  # fmt: skip


class Engine:
    """The engine's end of the local socket in a thread: it says what it is given, and keeps the commands."""

    def __init__(self, folder):
        self.folder, self.commands, self.refuse = folder, [], ""
        self.site_file = ""
        # What answers commands instead of a sentence that says nothing: functions of the command, by its name.
        self.answers = {"profile": lambda _: PROFILE}
        # A camera's frame as JPEG, its width and height, px.
        self.picture = b"\xff\xd8jpeg", 2, 3
        # What black and white of it stand for.
        self.shown = {"low": None, "high": None, "unit": ""}
        self.state = state()
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._loop.run_forever, daemon=True)
        self._thread.start()

    def start(self):
        """Listen."""
        self.socket = LiveSocket(self.folder, self._answer)
        self._do(self.socket.start())
        self.say({"kind": "hello", "site": "site", "site_file": self.site_file})
        self._repeating = asyncio.run_coroutine_threadsafe(self._repeat(), self._loop)

    def stop(self):
        """Be away."""
        self._repeating.cancel()
        self._do(self.socket.stop())

    def end(self):
        """Be away for good."""
        self.stop()
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join(30.0)
        self._loop.close()

    def say(self, head, body=b""):
        """Send a frame."""
        self._do(self._said(head, body))

    def tell(self, head):
        """Send a frame as soon as the loop comes to it, without waiting."""
        self._loop.call_soon_threadsafe(self.socket.publish, head)

    def give(self, chunk):
        """Send rows."""
        self.say({"kind": "rows", "point": chunk.point}, row_bytes(chunk))

    async def _repeat(self):
        while True:
            self.socket.publish({"kind": "state", **self.state})
            await asyncio.sleep(0.2)

    async def _said(self, head, body):
        self.socket.publish(head, body)

    async def _answer(self, head):
        self.commands.append(head)
        if self.refuse:
            raise MidspanError(self.refuse)
        if head["command"] in self.answers:
            return self.answers[head["command"]](head), b""
        jpeg, width, height = self.picture
        answer = {"text": f"{head['command']} done", "restart": [], "time_ns": 1, "width": width, "height": height}
        if head["command"] == "picture":
            answer |= self.shown
        return answer, jpeg

    def _do(self, work):
        return asyncio.run_coroutine_threadsafe(work, self._loop).result(30.0)


def state(**changes):
    """How a site stands whose points p and q run."""
    source = {
        "point": "p", "source": "camera", "reason": "", "text": "", "age_s": 0.1, "records": 5, "faults": 1,
        "skipped": 0, "stamps": "sender", "address": "rtsp://camera/x", "rate_hz": 20.0,
        "nominal_rate_hz": 25.0, "delay_s": 0.2, "late": 3, "restarts": 1, "clock_offset_s": 0.012,
        "clock_offset_std_s": 0.001, "clock_drift_ppm": None,
    }  # fmt: skip
    point = {
        "point": "p", "status": "tracking", "reason": "", "text": "", "rows_age_s": 0.1, "sigma_mm": 0.01,
        "usual_sigma_mm": 0.01, "calibration": 1, "notice": "", "notice_text": "",
        "stage": "", "stage_left_s": None, "latency_s": 0.3,
        "sources": [source],
    }  # fmt: skip
    other = {**point, "point": "q", "sources": []}
    return {
        "ready": True, "points": [point, other], "sources": [source], "settings": None,
        "store": {"waiting": 0, "dropped": 0}, **changes,
    }  # fmt: skip


def logged_in(folder, name, scope, state=None, kind="token"):
    """A token of a store, or with kind "user" a password."""
    said = io.StringIO()
    with pytest.MonkeyPatch.context() as patch, contextlib.redirect_stdout(said):
        for key, value in (state or {}).items():
            patch.setenv(key, value)
        assert run(["access", str(folder), f"add-{kind}", name, "--scope", scope, "--json"]) == 0
    return json.loads(said.getvalue())["token" if kind == "token" else "password"]


class Served:
    """`midspan serve` on a store, and clients of it."""

    def __init__(self, folder, *options):
        self.folder, self.port = folder, free_port()
        with open(folder / f"serve-{self.port}.log", "wb") as log:
            self.process = subprocess.Popen(
                command("serve", folder, "--listen", f"127.0.0.1:{self.port}", *options), stdout=log, stderr=log
            )
        wait_for(self.port)

    @property
    def log(self):
        """What it printed."""
        return (self.folder / f"serve-{self.port}.log").read_text()

    def client(self, token=None, **options):
        """A client that sends a token."""
        headers = {} if token is None else {"Authorization": f"Bearer {token}"}
        return httpx.Client(base_url=f"http://127.0.0.1:{self.port}", headers=headers, timeout=60.0, **options)

    def stop(self):
        """End it as a service manager does."""
        self.process.send_signal(signal.SIGTERM)
        assert self.process.wait(timeout=60) == 0


def opened_recordings(where):
    """`midspan open` as a person starts it, and its document."""
    process = subprocess.Popen(
        command("open", where, "--no-browser", "--json"), stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    text = ""
    while not text.rstrip().endswith("}"):
        line = process.stdout.readline()
        assert line, process.stderr.read()
        text += line
    return process, json.loads(text)


def until(condition, seconds=60.0):
    """Wait for a condition; its value."""
    end_s = time.monotonic() + seconds
    while time.monotonic() < end_s:
        if value := condition():
            return value
        time.sleep(0.05)
    raise TimeoutError
