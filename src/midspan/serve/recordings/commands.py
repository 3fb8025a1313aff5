"""The work: the same commands that are typed, each a process of its own, whose JSON and progress are read.

So the page does nothing that the command line does not, a command that runs out of memory takes nothing else with it,
and one that is no longer wanted is ended by a signal, after which nothing half-written is left.
"""

import asyncio
import ctypes
import json
import os
import signal
import sys
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any

from midspan.serve.problems import Problem
from midspan.serve.serving import PR_SET_PDEATHSIG

Tree = dict[str, Any]
# As `cli.console` names it, which is above this room.
AS_LINES = {"MIDSPAN_PROGRESS": "json"}
# Behind a page that is looked at, of two commands at a time the one that was asked for last.
NICENESS = 5
# A line of progress has some hundred bytes, a document of all columns' metadata some hundred kilobytes.
MAX_LINE_BYTES = 1 << 20
# A command that was asked to end has so long for it, s.
END_S = 10.0
STOPPED = 128 + signal.SIGTERM


@dataclass(slots=True)
class Job:
    """One command on a recording. state: running, done, failed or cancelled; text: why it failed."""

    recording: int
    what: str
    arguments: tuple[str, ...]
    state: str = "running"
    done: int = 0
    total: int = 0
    step: str = ""
    text: str = ""
    document: Tree = field(default_factory=dict)
    begun_s: float = field(default_factory=time.monotonic)
    took_s: float | None = None

    def to_dict(self) -> Tree:
        """As the interface shows it."""
        names = ("what", "state", "done", "total", "step", "text", "document")
        took_s = time.monotonic() - self.begun_s if self.took_s is None else self.took_s
        command = " ".join(("midspan", self.what, *self.arguments))
        return {**{name: getattr(self, name) for name in names}, "seconds": took_s, "command": command}


class Commands:
    """One job at a time, which takes the machine, and the newest one of each recording."""

    def __init__(self) -> None:
        self._process: asyncio.subprocess.Process | None = None
        self._running: asyncio.Task[None] | None = None
        self._newest: dict[int, Job] = {}

    def newest(self, recording: int) -> Job | None:
        """The job of a recording that runs, or ran last."""
        return self._newest.get(recording)

    def start(self, recording: int, what: str, *arguments: str) -> Job:
        """Begin a command. Raises Problem 409 while another one runs."""
        if self._running is not None and not self._running.done():
            raise Problem(409, "Another calculation runs. Wait for its end, or cancel it.")
        job = self._newest[recording] = Job(recording, what, arguments)
        self._running = asyncio.create_task(self._run(job))
        return job

    async def cancel(self) -> None:
        """End the job that runs, if any; returns once it has."""
        if self._running is None or self._running.done():
            return
        if self._process is not None:
            with suppress(ProcessLookupError):
                self._process.terminate()
        await asyncio.wait({self._running}, timeout=END_S)
        if not self._running.done() and self._process is not None:
            with suppress(ProcessLookupError):
                self._process.kill()
            await asyncio.wait({self._running}, timeout=END_S)

    async def _run(self, job: Job) -> None:
        def progress(line: Tree) -> None:
            job.done, job.total, job.step = int(line["done"]), int(line["total"]), str(line["what"])

        code, job.document, job.text = await self._finished(job.what, job.arguments, progress)
        job.state = "done" if code == 0 else "cancelled" if code in (STOPPED, -signal.SIGTERM) else "failed"
        job.took_s = time.monotonic() - job.begun_s

    async def _finished(
        self, what: str, arguments: Sequence[str], progress: Callable[[Tree], None]
    ) -> tuple[int, Tree, str]:
        process = self._process = await _started(what, arguments)
        try:
            return await _read(process, progress)
        finally:
            self._process = None


async def asked(what: str, *arguments: str) -> Tree:
    """The document of a command that takes seconds. Raises Problem 422 with what it refuses."""
    process = await _started(what, arguments)
    try:
        code, document, text = await _read(process, lambda _: None)
    finally:
        if process.returncode is None:
            process.kill()
    if code and not document:
        raise Problem(422, text)
    return document


async def _started(what: str, arguments: Sequence[str]) -> asyncio.subprocess.Process:
    return await asyncio.create_subprocess_exec(
        sys.executable, "-m", "midspan", what, *arguments, "--json",
        stdin=asyncio.subprocess.DEVNULL, stdout=asyncio.subprocess.PIPE, stderr=asyncio.subprocess.PIPE,
        env={**os.environ, **AS_LINES}, limit=MAX_LINE_BYTES, preexec_fn=_begin,
    )  # fmt: skip


def _begin() -> None:
    """A command ends with this process, however that ends, and not by the Ctrl-C that ends this one."""
    os.setpgrp()
    with suppress(OSError):
        os.nice(NICENESS)
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGTERM)


async def _read(process: asyncio.subprocess.Process, progress: Callable[[Tree], None]) -> tuple[int, Tree, str]:
    """Exit code, document and what was wrong, once a command has ended; progress: called with each of its lines."""
    assert process.stdout is not None
    assert process.stderr is not None
    output = asyncio.create_task(process.stdout.read())
    words = []
    async for raw in process.stderr:
        line = raw.decode(errors="replace").rstrip()
        if line.startswith('{"done":'):
            progress(json.loads(line))
        else:
            words.append(line)
    code = await process.wait()
    try:
        document = json.loads(await output)
    except ValueError:
        document = {}
    # What a command refuses is a document of its own.
    refused = str(document["error"]) if set(document) == {"error", "exit_code"} else ""
    text = refused or "\n".join(words[-3:]) or f"The command ended with {code}."
    return code, {} if refused else document, "" if code == 0 else text
