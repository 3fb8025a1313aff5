"""The server's process: alone over a store, or as the child of `midspan run`."""

import asyncio
import json
import os
import resource
import signal
import socket
import sys
import threading
import time
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from midspan.serve.application import application
from midspan.serve.connection import server
from midspan.serve.serving import Serving
from midspan.serve.viewers import SEND_S

# As of POSIX (0 usual, 19 least urgent): rows go before whoever looks at them.
NICENESS = 5
# For an engine's first state it is waited so long, s.
FIRST_S = 1.0


@dataclass(frozen=True, slots=True)
class ServeSettings:
    """where: the store; site_file: its SITE.toml, None where none is known; certificate and key: of TLS."""

    where: str
    site_file: Path | None = None
    tls_cert: Path | None = None
    tls_key: Path | None = None


async def served(settings: ServeSettings, listener: socket.socket, ending: asyncio.Event) -> None:
    """Serve until `ending` is set."""
    serving = Serving(settings.where, settings.site_file, secure=settings.tls_cert is not None)
    web = server(application(serving), tls_cert=settings.tls_cert, tls_key=settings.tls_key)
    tasks: list[asyncio.Task[Any]] = [asyncio.create_task(work) for work in (serving.link.run(), _sending(serving))]
    await _first_state(serving)
    web_task = asyncio.create_task(web.serve(sockets=[listener]))
    stopping = asyncio.create_task(ending.wait())
    try:
        await asyncio.wait({stopping, web_task, *tasks}, return_when=asyncio.FIRST_COMPLETED)
        web.should_exit = True
        with suppress(TimeoutError):
            await asyncio.wait_for(web_task, 3.0)
        for task in tasks:
            if task.done() and task.exception() is not None:
                raise task.exception()  # type: ignore[misc]
    finally:
        for task in (*tasks, stopping):
            task.cancel()
        await asyncio.gather(*tasks, stopping, return_exceptions=True)
        serving.close()


async def _first_state(serving: Serving) -> None:
    """Wait for the engine's first state, where there may be one: the first answer is not that nothing measures."""
    until_s = time.monotonic() + FIRST_S
    while not serving.link.state and serving.link.may_connect and time.monotonic() < until_s:
        await asyncio.sleep(0.02)


async def _sending(serving: Serving) -> None:
    reason = ""
    while True:
        await asyncio.sleep(SEND_S)
        serving.live.send()
        await serving.watch()
        # That no process measures any more comes in no message of its.
        if serving.link.reason != reason:
            reason = serving.link.reason
            serving.report_changes()


def more_descriptors() -> None:
    """As many open files as this process may have: connections are counted, and this is more than they need."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    wanted = 4096 if hard == resource.RLIM_INFINITY else min(hard, 4096)
    if soft < wanted:
        with suppress(OSError, ValueError):
            resource.setrlimit(resource.RLIMIT_NOFILE, (wanted, hard))


def main() -> None:
    """The child of `midspan run`: its settings are the first line of standard input, whose end is the parent's."""
    given: dict[str, Any] = json.loads(sys.stdin.readline())
    paths = {key: None if given[key] is None else Path(given[key]) for key in ("site_file", "tls_cert", "tls_key")}
    settings = ServeSettings(given["where"], **paths)
    # The parent's end stops this process, and nothing else does.
    for number in (signal.SIGINT, signal.SIGHUP, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)
    with suppress(OSError):
        os.setpriority(os.PRIO_PROCESS, 0, NICENESS)
    more_descriptors()

    async def run() -> None:
        ending, loop = asyncio.Event(), asyncio.get_running_loop()

        def await_parent() -> None:
            sys.stdin.read()
            with suppress(RuntimeError):
                loop.call_soon_threadsafe(ending.set)

        threading.Thread(target=await_parent, daemon=True).start()
        with socket.socket(fileno=given["listener"]) as listener:
            await served(settings, listener, ending)

    asyncio.run(run())
    # Workers that are in the middle of something end with their process.
    os._exit(0)
