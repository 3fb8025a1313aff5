"""The work: the same commands that are typed, each a process of its own, whose JSON and progress are read.

So the page does nothing that the command line does not, a command that runs out of memory takes nothing else with it,
and one that is no longer wanted is ended by a signal, after which nothing half-written is left.
"""

import asyncio
import ctypes
import json
import os
import shlex
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
# Questions that are answered at a time: each is a process that begins for half a second.
MAX_ASKED = 2
# A command that was asked to end has so long for it, s.
END_S = 10.0
# How it ends then, before and after it could say so itself.
ENDED = (-signal.SIGTERM, 128 + signal.SIGTERM, -signal.SIGKILL)


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
    begun_s: float = field(default_factory=time.monotonic)
    took_s: float | None = None

    def to_dict(self) -> Tree:
        """As the interface shows it."""
        names = ("what", "state", "done", "total", "step", "text")
        took_s = time.monotonic() - self.begun_s if self.took_s is None else self.took_s
        command = shlex.join(("midspan", self.what, *self.arguments))
        return {**{name: getattr(self, name) for name in names}, "seconds": took_s, "command": command}


class Commands:
    """One job at a time, which takes the machine, and the newest one of each recording."""

    def __init__(self) -> None:
        self._process: asyncio.subprocess.Process | None = None
        self._running: asyncio.Task[None] | None = None
        self._newest: dict[int, Job] = {}
        self._asking = asyncio.Semaphore(MAX_ASKED)
        self._asked: set[asyncio.subprocess.Process] = set()

    async def asked(self, what: str, *arguments: str) -> Tree:
        """The document of a command that takes seconds. Raises Problem 422 with what it refuses."""
        async with self._asking:
            process = await _started(what, arguments)
            self._asked.add(process)
            try:
                code, document, text = await _read(process, lambda _: None)
            finally:
                self._asked.discard(process)
        if code and not document:
            raise Problem(422, text)
        return document

    def newest(self, recording: int) -> Job | None:
        """The job of a recording that runs, or ran last."""
        return self._newest.get(recording)

    def start(self, recording: int, what: str, *arguments: str) -> Job:
        """Begin a command. Raises Problem 409 while another one runs."""
        if self._running is not None and not self._running.done():
            raise Problem(409, "Another calculation is running. Wait for its end, or cancel it.")
        job = self._newest[recording] = Job(recording, what, arguments)
        self._running = asyncio.create_task(self._run(job))
        return job

    async def cancel(self) -> None:
        """End the job that runs, if any; returns once it has."""
        if self._running is None or self._running.done():
            return
        while self._process is None and not self._running.done():
            await asyncio.sleep(0.01)
        for end in (asyncio.subprocess.Process.terminate, asyncio.subprocess.Process.kill):
            if self._process is not None:
                with suppress(ProcessLookupError):
                    end(self._process)
                await asyncio.wait({self._running}, timeout=END_S)

    async def close(self) -> None:
        """End all that runs; returns once it has."""
        await self.cancel()
        asked = list(self._asked)
        for process in asked:
            with suppress(ProcessLookupError):
                process.kill()
        await asyncio.gather(*(process.wait() for process in asked))

    async def _run(self, job: Job) -> None:
        def progress(line: Tree) -> None:
            job.done, job.total, job.step = int(line["done"]), int(line["total"]), str(line["what"])

        code = 1
        try:
            self._process = await _started(job.what, job.arguments)
            code, _, job.text = await _read(self._process, progress)
        except OSError as error:
            job.text = f"The command cannot be started ({error.strerror})."
        finally:
            self._process = None
            job.state = "done" if code == 0 else "cancelled" if code in ENDED else "failed"
            job.took_s = time.monotonic() - job.begun_s


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
    try:
        async for raw in process.stderr:
            line = raw.decode(errors="replace").rstrip()
            if line.startswith('{"done":'):
                progress(json.loads(line))
            else:
                words.append(line)
        written, code = await output, await process.wait()
    except BaseException:
        # Nobody waits for it any more.
        with suppress(ProcessLookupError):
            process.kill()
        await process.wait()
        raise
    try:
        document = json.loads(written)
    except ValueError:
        document = {}
    # What a command refuses is a document of its own.
    refused = str(document["error"]) if set(document) == {"error", "exit_code"} else ""
    text = refused or "\n".join(words[-3:]) or f"The command ended with {code}."
    return code, {} if refused else document, "" if code == 0 else text
