"""`midspan run`: the site's measuring, the page's server next to it, and what holds where SITE.toml is wrong.

The server is a process of its own, which gets states and rows over the local socket. Settings that come into force
leave the points as they are that they do not change; wrong ones leave the settings that were in force before, or the
server alone.
"""

import asyncio
import errno
import json
import os
import socket
import stat
import sys
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from midspan.errors import DataError, MidspanError, UsageError
from midspan.service.changes import Changes
from midspan.service.checking import checked
from midspan.service.live_socket import LiveSocket, Tree
from midspan.service.notify import notify
from midspan.service.places import place_of
from midspan.service.reasons import sentence
from midspan.service.run import Service
from midspan.service.settings_fault import SettingsFault
from midspan.settings.shard import shard_of
from midspan.settings.site import SITE_FILE, ServiceSettings, Shard, Site, load_site, require_folders
from midspan.trees import TreeError, read_toml
from midspan.writing import write_whole

# How all stands is sent to the server so often, s.
STATE_S = 0.5
# A server whose process ended is started again after this time; at the end it is waited for so long, s.
SERVER_AGAIN_S, SERVER_END_S = 1.0, 5.0
# For points that begin it waits so long at most, s.
FIRST_S = 2.0
# The server of a process that was killed leaves its address soon after, s.
ADDRESS_S = 3.0
SERVER = "from midspan.serve.process import main; main()"


@dataclass(frozen=True, slots=True)
class Settings:
    """site: what is run, None for nothing; fault: what is wrong with the file, None where nothing is.

    where, service: the store and the address, which hold until the process ends. content: of the file, where it is
    right. shard: that runs a part of the site alone.
    """

    file: Path
    site: Site | None
    fault: SettingsFault | None
    where: str
    service: ServiceSettings
    content: bytes | None = None
    shard: Shard | None = None


def in_force_file(file: Path) -> Path:
    """Where the newest settings that were run are kept."""
    return file.with_name(f".{file.name}.in-force")


def settings_of(path: str | Path, shard: Shard | None = None) -> Settings:
    """The settings of a site's file, or what holds in their place; shard: that runs a part of the site alone.

    Raises UsageError and DataError for a wrong file where nothing ever ran with its settings.
    """
    # Absolute: the server may stand elsewhere.
    file = Path(path).absolute()
    file = file / SITE_FILE if file.is_dir() else file
    try:
        content = file.read_bytes() if file.is_file() else b""
        site = load_part(file, shard)
        require_folders(site)
    except (UsageError, DataError) as error:
        fault = SettingsFault.of(str(error))
        with suppress(UsageError, DataError):
            kept = load_part(in_force_file(file), shard)
            return Settings(file, kept, fault, kept.store, kept.settings.service, shard=shard)
        place = _lenient(file)
        if place is None or shard is not None:
            raise
        return Settings(file, None, fault, *place)
    return Settings(file, site, None, site.store, site.settings.service, content, shard)


def load_part(file: Path, shard: Shard | None) -> Site:
    """A site, or the part of it that a shard runs. Raises as `load_site` and `shard_of` do."""
    return load_site(file) if shard is None else shard_of(load_site(file), shard)


def _lenient(file: Path) -> tuple[str, ServiceSettings] | None:
    """Store and address of a wrong file, where these are right and somebody was given access to the store."""
    try:
        tree = read_toml(file)
        service = ServiceSettings.model_validate(tree.get("service", {}))
        store = file.parent / str(tree["store"]["path"])
    except (TreeError, OSError, ValueError, KeyError, TypeError):
        return None
    return (str(store), service) if (store / "access.sqlite").is_file() else None


def listening(listen: str, where: str) -> socket.socket:
    """A socket that listens at HOST:PORT; `where` names the setting. Raises UsageError where it cannot."""
    host, _, port = listen.rpartition(":")
    host = host.strip("[]")
    until_s = time.monotonic() + ADDRESS_S
    while True:
        try:
            family = socket.AF_INET6 if ":" in host else socket.AF_INET
            return socket.create_server((host, int(port)), family=family)
        except OSError as error:
            if error.errno == errno.EADDRINUSE and time.monotonic() < until_s:
                time.sleep(0.1)
                continue
            why = error.strerror if isinstance(error, socket.gaierror) else os.strerror(error.errno or 0)
            raise UsageError(
                f"{where}: cannot listen on {listen} ({why}). Stop the program that uses it, or set another address "
                "or port."
            ) from None


class Supervisor:
    """Runs a site's file until it is stopped. say: takes one line for a person; note: one structured record.

    serve: whether the page's server is started; announce: called before that.
    """

    def __init__(
        self,
        settings: Settings,
        say: Callable[[str], None],
        note: Callable[[dict[str, Any]], None] | None = None,
        *,
        serve: bool = True,
        announce: Callable[[], None] = lambda: None,
    ) -> None:
        self.settings, self._say, self._note, self._serve = settings, say, note, serve
        self._announce = announce
        self._socket = LiveSocket(place_of(settings.where), self._command)
        self._service: Service | None = None
        # Whose settings are kept.
        self._kept: Site | None = None
        self._stop, self._again = asyncio.Event(), asyncio.Event()

    def stop(self) -> None:
        """End soon."""
        self._stop.set()
        if self._service is not None:
            self._service.stop()

    async def run(self, for_s: float | None = None) -> Tree:
        """Run for this many seconds; None: until `stop`. Returns how all stood.

        Raises UsageError where the address is in use, or another process writes one of the points, runs on the store or
        runs the site in another number of shards: before anything is touched.
        """
        address, site = self.settings.service.listen, self.settings.site
        tasks: list[asyncio.Task[Any]] = []
        with ExitStack() as opened:
            listener = None
            if self._serve:
                listener = opened.enter_context(listening(address, f"{self.settings.file}: service.listen"))
            if site is not None:
                self._service = self._service_of(site)
                await asyncio.to_thread(self._service.claim)
            try:
                await self._socket.start()
                tasks.append(asyncio.create_task(self._states()))
                if listener is not None:
                    self._announce()
                    host, port = address.rpartition(":")[0], listener.getsockname()[1]
                    scheme = "http" if self.settings.service.tls_cert is None else "https"
                    self._say(f"page: {scheme}://{host}:{port}")
                    tasks.append(asyncio.create_task(self._serving(listener)))
                measuring = asyncio.create_task(self._measuring(for_s))
                tasks.append(measuring)
                # Nothing but the measuring ends as it should.
                done, _ = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
                if measuring not in done:
                    self.stop()
                    await measuring
                    next(iter(done)).result()
                return measuring.result()
            finally:
                for task in tasks:
                    task.cancel()
                await asyncio.gather(*tasks, return_exceptions=True)
                await self._socket.stop()

    def _service_of(self, site: Site) -> Service:
        return Service(site, self._say, self._note, self._socket)

    async def _measuring(self, for_s: float | None) -> Tree:
        """One set of settings after another."""
        until_s = None if for_s is None else time.monotonic() + for_s
        while True:
            self._again.clear()
            left_s = None if until_s is None else max(until_s - time.monotonic(), 0.0)
            site = self.settings.site
            try:
                last = await (self._idle(left_s) if site is None else self._run_site(site, left_s))
            except (UsageError, DataError) as error:
                # What a site names may be missing, or damaged, though its file is right.
                self.settings = self._instead(error)
                continue
            if self._stop.is_set() or not self._again.is_set():
                return last

    def _instead(self, error: UsageError | DataError) -> Settings:
        """What holds where a site cannot run with its settings. Raises `error` where nothing else ever ran."""
        kept = in_force_file(self.settings.file)
        if self.settings.fault is not None:
            return replace(self.settings, site=None)
        try:
            if not self._serve or kept.read_bytes() == self.settings.content:
                raise error
            site = load_part(kept, self.settings.shard)
        except (OSError, UsageError, DataError):
            raise error from None
        return replace(self.settings, site=site, fault=SettingsFault.of(str(error)), content=None)

    async def _run_site(self, site: Site, for_s: float | None) -> Tree:
        fault = self.settings.fault
        if fault is not None:
            self._say(f"settings: {fault.text} The previous settings stay in force.")
        self._service = self._service or self._service_of(site)
        self._socket.publish({"kind": "hello", "site": site.name, "site_file": str(self.settings.file)})
        try:
            if self._stop.is_set():
                self._service.stop()
            return await self._service.run(for_s)
        finally:
            self._service = None

    async def _idle(self, for_s: float | None) -> Tree:
        """Nothing runs: the server shows why, and takes better settings."""
        fault = self.settings.fault
        self._say(f"settings: {fault.text if fault else ''} midspan does not measure until they are corrected.")
        self._socket.publish({"kind": "hello", "site": "", "site_file": str(self.settings.file)})
        notify("READY=1")
        waiting = [asyncio.create_task(one.wait()) for one in (self._stop, self._again)]
        await asyncio.wait(waiting, timeout=for_s, return_when=asyncio.FIRST_COMPLETED)
        for task in waiting:
            task.cancel()
        return self._state()

    def _state(self) -> Tree:
        """How all stands, with what is wrong with the settings."""
        state: Tree = {"ready": False, "points": [], "sources": [], "store": {}}
        if self._service is not None:
            state = self._service.state()
        fault = self.settings.fault
        if fault is not None:
            source = {"point": "", "source": "settings", "reason": "settings", "text": fault.text}
            state = {**state, "ready": False, "sources": [source, *state["sources"]]}
        return {**state, "settings": None if fault is None else fault.to_dict()}

    def _keep_settings(self, site: Site) -> None:
        """What runs is what a wrong change falls back to."""
        self._kept, file, content = site, self.settings.file, self.settings.content
        if content is not None:
            with suppress(OSError, MidspanError):
                write_whole(in_force_file(file), content, mode=stat.S_IMODE(file.stat().st_mode))

    async def _states(self) -> None:
        while True:
            service = self._service
            if service is not None and service.begun and not service.is_changing and service.site is not self._kept:
                self._keep_settings(service.site)
            self._socket.publish({"kind": "state", **self._state()})
            # Points that are begun are watched by what writes them.
            if self._service is None or not self._service.begun:
                notify("WATCHDOG=1")
            await asyncio.sleep(STATE_S)

    async def _command(self, head: Tree) -> tuple[Tree, bytes]:
        """A command of the server."""
        if head.get("command") == "reload":
            trial = head.get("trial")
            return await (self._reload() if trial is None else self._tried(Path(str(trial)))), b""
        if self._service is None:
            raise MidspanError(f"midspan does not measure at present. {sentence('settings')}")
        return await self._service.command(head)

    async def _tried(self, file: Path) -> Tree:
        """What settings would change, of a file in the folder of the site's. Raises what is wrong with them."""
        site = load_part(file, self.settings.shard)
        require_folders(site)
        restart = self._fixed(site.store, site.settings.service)
        changes = Changes.between(self._running, site)
        sizes_px = {} if self._service is None else self._service.sizes_px()
        await asyncio.to_thread(checked, site, changes.beginning, sizes_px)
        text = _needs_restart(restart) if restart else changes.text
        return {"text": f"Not saved. {text}", "restart": restart, **changes.to_dict()}

    async def _reload(self) -> Tree:
        """New settings of the file come into force, where that can be without a new start."""
        new, service = settings_of(self.settings.file, self.settings.shard), self._service
        restart = self._fixed(new.where, new.service)
        changes = Changes() if new.site is None else Changes.between(self._running, new.site)
        if restart:
            return {"text": f"Written. {_needs_restart(restart)}", "restart": restart, **changes.to_dict()}
        if service is None or not service.begun or new.site is None:
            self.settings = new
            self._again.set()
            if service is not None:
                service.stop()
            return {"text": "Saved. Measuring restarts with the new settings.", "restart": [], **changes.to_dict()}
        try:
            changes = await service.take(new.site)
        except (UsageError, DataError) as error:
            self.settings = replace(self.settings, fault=SettingsFault.of(str(error)), content=None)
            raise
        self.settings = new
        self._socket.publish({"kind": "hello", "site": new.site.name, "site_file": str(self.settings.file)})
        return {"text": f"Written. {changes.text}", "restart": [], **changes.to_dict()}

    def _fixed(self, where: str, service: ServiceSettings) -> list[str]:
        """The sections of other settings that hold only after a new start."""
        fixed = {"store": where != self.settings.where, "service": service != self.settings.service}
        return [key for key, changed in fixed.items() if changed]

    @property
    def _running(self) -> Site | None:
        return None if self._service is None else self._service.site

    async def _serving(self, listener: socket.socket) -> None:
        """The server's process, started again where it ends."""
        service, folder = self.settings.service, self.settings.file.parent
        paths = [None if one is None else str(folder / one) for one in (service.tls_cert, service.tls_key)]
        settings = {
            "where": self.settings.where, "site_file": str(self.settings.file),
            "tls_cert": paths[0], "tls_key": paths[1], "listener": listener.fileno(),
        }  # fmt: skip
        await self._first_begun()
        while True:
            process = await asyncio.create_subprocess_exec(
                sys.executable, "-c", SERVER,
                stdin=asyncio.subprocess.PIPE, stdout=asyncio.subprocess.DEVNULL, pass_fds=[listener.fileno()],
            )  # fmt: skip
            assert process.stdin is not None
            try:
                process.stdin.write(json.dumps(settings).encode() + b"\n")
                code = await process.wait()
            finally:
                await _ended(process)
            self._say(f"page: the server ended with code {code} and is restarted.")
            await asyncio.sleep(SERVER_AGAIN_S)

    async def _first_begun(self) -> None:
        """Let points begin first, for some time: the server's start takes as much of the processors as theirs."""
        until_s = time.monotonic() + FIRST_S
        while self._service is not None and not self._service.begun and time.monotonic() < until_s:
            await asyncio.sleep(0.05)


def _needs_restart(sections: Sequence[str]) -> str:
    named = " and ".join(f"[{key}]" for key in sections)
    return f"Changes of {named} need a restart of `midspan run`; until then none of the changes takes effect."


async def _ended(process: asyncio.subprocess.Process) -> None:
    """End a server's process: the end of its standard input is the sign, force comes after it."""
    if process.returncode is not None:
        return
    assert process.stdin is not None
    process.stdin.close()
    try:
        await asyncio.wait_for(process.wait(), SERVER_END_S)
    except TimeoutError:
        with suppress(ProcessLookupError):
            process.kill()
        await process.wait()
