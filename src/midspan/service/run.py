"""The shell of a live site's points: the only place with a clock, threads and an event loop above the engine."""

import asyncio
import json
import math
import time
from collections import deque
from collections.abc import Callable, Coroutine, Sequence
from contextlib import closing, suppress
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from midspan.errors import DataError, MidspanError
from midspan.records import NANOSECONDS, Event
from midspan.service.alarming import Alarming
from midspan.service.calibrations import accepted, added, calibrated_folder, loaded, number_in_force
from midspan.service.commands import Commands
from midspan.service.cutting import needed
from midspan.service.discovery import announcements
from midspan.service.intake import MQTT, Intake
from midspan.service.journal import NEW_DATUM, ROWS
from midspan.service.keeping import Keeper, written_bytes
from midspan.service.live_socket import LiveSocket, of_ready, row_bytes
from midspan.service.mqtt import Broker, even_parts, event_tree, result_payload, summary
from midspan.service.notify import notify
from midspan.service.opening import head_of, opened, resumed
from midspan.service.paused import Paused
from midspan.service.places import place_of
from midspan.service.point import Job, LivePoint
from midspan.service.reasons import sentence
from midspan.service.running import Running, running
from midspan.settings.kinds import ACCELEROMETER
from midspan.settings.site import Site, captures_of
from midspan.store.archive import archive
from midspan.store.database import StoreFault
from midspan.store.store import Batch, Store, open_store

TICK_S, WRITE_S, LOG_S = 0.05, 1.0, 60.0
# Days are archived, and removed once they are too old, so often.
SWEEP_S, DAY_S = 3600.0, 86_400.0
COMMANDS = ("calibrate", "accept")
# Of a command's payload no more bytes are looked at: a calibration's number has fewer.
MAX_WANTED = 20


class Service:
    """Runs a site until it is stopped. say: takes one line for a person; note: one structured record for a log; socket:
    where rows and events go to the page's server.
    """

    def __init__(
        self,
        site: Site,
        say: Callable[[str], None],
        note: Callable[[dict[str, Any]], None] | None = None,
        socket: LiveSocket | None = None,
    ) -> None:
        self.site, self._say, self._note, self._socket = site, say, note, socket
        self._captures = captures_of(site)
        self._keeper = Keeper(site.store, [plan.name for plan in site.points])
        self._points = [running(plan, self._captures / plan.name, site.file.parent) for plan in site.points]
        self._intake = Intake(self._points, site.file.parent, self._begin_job, self._event)
        paused = Paused(place_of(site.store))
        self._alarms = Alarming(site, say, lambda tree: None if socket is None else socket.publish(tree))
        self._commands = Commands(self._points, paused, self._event, self._in_thread, self._alarms.commands)
        for one in self._points:
            for name, stream in one.streams.items():
                stream.paused = paused.reasons.get(f"{one.name}.{name}", "")
        self._broker: Broker | None = None
        self._stop = asyncio.Event()
        # Whether all points are begun, and what comes is kept.
        self.begun = False
        self._acknowledge: deque[Callable[[], None]] = deque()
        self._swept_s, self._dropped = 0.0, 0
        # Why store and broker were away when that was last an event.
        self._away: dict[str, str] = {}
        # Days before this may be removed, by the thread that writes.
        self._old_ns: int | None = None
        self._loop: asyncio.AbstractEventLoop | None = None
        self._jobs: set[asyncio.Task[None]] = set()
        # One calibration at a time, and one opening, which waits for none: the engine needs the processor.
        self._one_at_a_time = {"calibrate": asyncio.Lock(), "open": asyncio.Lock()}

    # Life

    async def run(self, for_s: float | None = None) -> dict[str, Any]:
        """Run for this many seconds; None: until `stop`. Everything that came is kept when it returns how all stands.

        Raises UsageError where another process writes one of the points.
        """
        self._loop = asyncio.get_running_loop()
        notify("READY=1")
        if not await self._patiently(self._keeper.store, for_s):
            return self.record()
        await asyncio.to_thread(self._alarms.open)
        self._intake.start_cameras(self._points)
        begun = [asyncio.create_task(self._patiently(partial(self._begin_point, one))) for one in self._points]
        try:
            await asyncio.gather(*begun)
        except BaseException:
            for starting in begun:
                starting.cancel()
            await asyncio.gather(*begun, return_exceptions=True)
            await self._intake.end(self._points)
            await asyncio.to_thread(self._alarms.close)
            # Another service of this process may have the points then.
            await asyncio.to_thread(self._keeper.close)
            raise
        replays = self._intake.begin(self._points)
        self._begin_broker()
        tasks: list[asyncio.Task[Any]] = [
            asyncio.create_task(self._every(TICK_S, self._tick)),
            asyncio.create_task(self._writing()),
            asyncio.create_task(self._every(LOG_S, self._log)),
            *replays,
        ]
        self.begun = True
        self._say(f"{self.site.name}: {len(self._points)} points run.")
        failed = await self._until_stopped(tasks, for_s)
        notify("STOPPING=1")
        last = self.record()
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
        try:
            await self._end()
        finally:
            if failed is not None:
                raise failed
        return last

    def claim(self) -> None:
        """Lock the points, as long as the store can be reached. Raises UsageError where another process has them."""
        with suppress(StoreFault):
            self._keeper.store()

    async def _patiently(self, work: Callable[[], Any], for_s: float | None = None) -> bool:
        """Do work in a thread that needs the store, again and again while that is away; whether it was done before the
        time was over, or `stop`.
        """
        until_s = math.inf if for_s is None else time.monotonic() + for_s
        while not self._stop.is_set() and time.monotonic() < until_s:
            try:
                await asyncio.to_thread(work)
            except StoreFault as fault:
                if not self._keeper.reason:
                    self._say(f"store: {fault} It is tried again every second.")
                self._keeper.reason, self._keeper.text = fault.code, str(fault)
            else:
                self._keeper.reason = self._keeper.text = ""
                return True
            notify("WATCHDOG=1")
            with suppress(TimeoutError):
                await asyncio.wait_for(self._stop.wait(), WRITE_S)
        return False

    async def _until_stopped(self, tasks: Sequence[asyncio.Task[Any]], for_s: float | None) -> BaseException | None:
        """Wait until `stop`, the end of the time, or a task's failure, which is returned: without it nothing would be
        kept any more, and a service manager starts the whole again.
        """
        stopping = asyncio.create_task(self._stop.wait())
        waiting: set[asyncio.Task[Any]] = {stopping, *tasks}
        end_s = math.inf if for_s is None else time.monotonic() + for_s
        while not self._stop.is_set() and (left_s := end_s - time.monotonic()) > 0.0:
            timeout = None if left_s == math.inf else left_s
            done, waiting = await asyncio.wait(waiting, timeout=timeout, return_when=asyncio.FIRST_COMPLETED)
            failed = next((task.exception() for task in done if task.exception() is not None), None)
            if failed is not None:
                stopping.cancel()
                return failed
        stopping.cancel()
        return None

    def stop(self) -> None:
        """End the run soon."""
        self._stop.set()

    async def _end(self) -> None:
        for job in self._jobs:
            job.cancel()
        await asyncio.gather(*self._jobs, return_exceptions=True)
        await self._intake.end(self._points)
        for one in self._points:
            self._publish_rows(one)
        await asyncio.to_thread(self._alarms.close)
        if self._broker is not None:
            await asyncio.to_thread(self._broker.stop)
        self._collect(last=True)
        try:
            for one in self._points:
                one.live.end()
        finally:
            await asyncio.to_thread(self._keeper.close)

    async def _every(self, step_s: float, work: Callable[[], None]) -> None:
        while True:
            await asyncio.sleep(step_s)
            work()

    # Points

    def _begin_point(self, one: Running) -> None:
        """A point goes on from its checkpoint, else opens with its calibration, else calibrates; called in a thread."""
        with closing(open_store(self.site.store)) as store:
            self._begin_from(one, store)

    def _begin_from(self, one: Running, store: Store) -> None:
        one.live.number = number_in_force(one.live, store, self.site.file.parent)
        one.live.follows = store.newest_ns(one.name, ROWS) is not None
        try:
            kept = store.checkpoint(one.name)
        except DataError as error:
            self._say(f"{one.name}: {error}")
            return
        if kept is None or not one.live.number:
            return
        try:
            self._resume(one, store, kept[1])
        except (MidspanError, ValueError, KeyError, OSError) as error:
            one.live.drop()
            self._say(f"{one.name}: its checkpoint cannot be used ({error}); it opens anew.")

    def _resume(self, one: Running, store: Store, kept: bytes) -> None:
        head = head_of(kept)
        folder = one.live.folder / Path(head["folder"]).name
        number = head["calibration"]
        if not (folder / "recording.toml").is_file():
            return
        # Where another calibration came into force since, the rows go on until the point is opened with it.
        found = opened(folder, one.name, loaded(one.live, store, number), number, push=False)
        if number != one.live.number and {ACCELEROMETER, *found.point.sensors} != set(one.live.plan.sources):
            return
        resumed(found, kept, store)
        one.live.resumed(found, folder)
        one.published_ns = store.newest_ns(one.name, ROWS) or 0
        # That nobody listened meanwhile has to be known before the first record.
        one.live.tick(time.time_ns())
        self._say(f"{one.name}: goes on from its checkpoint.")

    def _begin_job(self, one: Running) -> None:
        if one.live.job is not None and not one.busy:
            one.busy = True
            self._begin(self._work(one, one.live.job))

    def _begin(self, work: Coroutine[Any, Any, None]) -> None:
        assert self._loop is not None
        task = self._loop.create_task(work)
        self._jobs.add(task)
        task.add_done_callback(self._jobs.discard)

    async def _work(self, one: Running, job: Job) -> None:
        """Do a point's job, and hand it the result."""
        live = one.live
        try:
            if job.kind == "open":
                live.narrow(needed(await asyncio.to_thread(self._with_store, loaded, live)))
            async with self._one_at_a_time[job.kind]:
                await (self._calibrate(one, job) if job.kind == "calibrate" else self._open(one, job))
        except Exception as error:
            # Whatever it is, the other points go on, and this one is tried again.
            live.refused(str(error) if isinstance(error, MidspanError) else f"{type(error).__name__}: {error}")
        finally:
            one.busy = False

    async def _calibrate(self, one: Running, job: Job) -> None:
        live, accept = one.live, one.live.plan.settings.accept == "auto"
        self._say(f"{live.name}: calibrating on {job.folder.name}.")
        body = await calibrated_folder(job.folder)
        number = await asyncio.to_thread(self._with_store, added, live, body, accept=accept)
        live.calibrated(number) if accept else live.offered(number)

    async def _open(self, one: Running, job: Job) -> None:
        live = one.live
        calibration = await asyncio.to_thread(self._with_store, loaded, live)
        found = await asyncio.to_thread(opened, job.folder, live.name, calibration, live.number)
        self._intake.cut(one, *(other for other in (live.opened, found) if other is not None))
        live.is_opened(found)
        self._say(f"{live.name}: runs.")

    def _with_store(self, work: Callable[..., Any], live: LivePoint, *arguments: Any, **options: Any) -> Any:
        """What work of a thread of its own gives for a point, with a store that is open for it alone."""
        with closing(open_store(self.site.store)) as store:
            return work(live, store, *arguments, **options)

    async def _in_thread(self, work: Callable[..., Any], live: LivePoint, *arguments: Any) -> Any:
        return await asyncio.to_thread(self._with_store, work, live, *arguments)

    # In

    def _begin_broker(self) -> None:
        if self.site.settings.mqtt is None:
            return
        topics = dict.fromkeys(
            (*self._intake.topics, f"{self.site.settings.mqtt.prefix}/v1/{self.site.name}/+/cmd/+"), 1
        )
        mqtt, name = self.site.settings.mqtt, self.site.name
        announced = announcements(mqtt, name, [one.name for one in self._points])
        self._broker = Broker(mqtt, name, topics, self._message, self.site.file.parent, announced)
        self._broker.start()
        self._alarms.connect(self._broker)

    def _message(self, topic: str, payload: bytes, acknowledge: Callable[[], None]) -> None:
        """A message of the broker, in its thread."""
        if self._loop is not None:
            with suppress(RuntimeError):
                self._loop.call_soon_threadsafe(self._taken, topic, payload, acknowledge)

    def _taken(self, topic: str, payload: bytes, acknowledge: Callable[[], None]) -> None:
        """A message, in the loop: a block is acknowledged once it is kept."""
        if topic in self._intake.topics:
            self._intake.payload(topic, payload)
            self._acknowledge.append(acknowledge)
        else:
            acknowledge()
            name, _, command = topic.split("/")[-3:]
            self._command(name, command, payload[:MAX_WANTED].decode("ascii", "replace").strip())

    def _command(self, name: str, command: str, wanted: str) -> None:
        """`cmd/calibrate`, or `cmd/accept` with the calibration's number (left out: the newest one offered).

        Each is answered at once with an event; those for no point of the site on the topic of the point that is meant.
        """
        one = next((point for point in self._points if point.name == name), None)
        if one is None:
            listed = ", ".join(point.name for point in self._points)
            text = f"{name}: is no point of this site. Points: {listed}."
            self._publish_event(name, Event(time.time_ns(), "command", text))
        elif command == "calibrate":
            self._event(one, "command", one.live.calibrate())
        elif command == "accept":
            self._begin(self._accept(one, wanted))
        else:
            self._event(one, "command", f"{name}: cmd/{command} is no command. Commands: {', '.join(COMMANDS)}.")

    async def _accept(self, one: Running, wanted: str) -> None:
        number = await asyncio.to_thread(self._with_store, accepted, one.live, wanted)
        if number is None:
            self._event(one, "command", f"{one.name}: no calibration {wanted} is offered.".replace("  ", " "))
        else:
            one.live.calibrated(number)

    def _event(self, one: Running, kind: str, text: str) -> None:
        now = Event(time.time_ns(), kind, text)
        self._keeper.put(Batch(events=[(one.name, now)]))
        self._publish_event(one.name, now)

    def _publish_event(self, point: str, event: Event) -> None:
        """An event in the log and to the broker."""
        self._say(f"{point}: {event.kind}: {event.text}")
        if self._note is not None:
            self._note({"point": point, **event_tree(event)})
        if self._socket is not None:
            self._socket.publish({"kind": "event", "point": point, "time_ns": event.time_ns, **event_tree(event)})
        if self._broker is not None:
            self._broker.publish(f"{point}/event", json.dumps(event_tree(event)), qos=1)

    # Out

    def _tick(self) -> None:
        now_ns = time.time_ns()
        away = self._broker is not None and not self._broker.connected
        for one in self._points:
            one.live.tick(now_ns, away=away and one.live.plan.sources[ACCELEROMETER].startswith(MQTT))
            one.looked_at(now_ns / NANOSECONDS)
            self._publish_rows(one)
            self._publish_head(one)
        self._alarms.look(now_ns, self._points)

    async def _writing(self) -> None:
        while True:
            await asyncio.sleep(WRITE_S)
            done = self._collect()
            await asyncio.to_thread(self._keeper.write)
            notify("WATCHDOG=1")
            if time.time() - self._swept_s > SWEEP_S:
                self._swept_s = time.time()
                self._begin(asyncio.to_thread(self._sweep))
            if self._old_ns is not None:
                await asyncio.to_thread(self._keeper.forget_before, self._old_ns)
                self._old_ns = None
            if self._keeper.dropped > self._dropped:
                self._dropped = self._keeper.dropped
                for one in self._points:
                    self._event(one, "rows_dropped", f"store: {sentence('rows_dropped')}")
            # Store and broker that are away, or back, are an event of every point.
            for name, (reason, _) in self._shared().items():
                if reason != self._away.get(name, "") and reason != "starting":
                    text = f"{name}: {sentence(reason) if reason else 'is there again.'}"
                    for one in self._points:
                        self._event(one, reason or "returned", text)
                    self._away[name] = reason
            # While the store is away the broker would hold back all that comes after a few messages without an
            # acknowledgement: live goes on with what is held in memory.
            if not self._keeper.waiting or self._keeper.reason:
                for acknowledge in done:
                    acknowledge()
            else:
                self._acknowledge.extendleft(reversed(done))

    def _sweep(self) -> None:
        """Archive the days that are over; then those that are too old may be removed."""
        folder = self.site.settings.store.archive
        try:
            if folder is not None:
                with closing(open_store(self.site.store)) as store:
                    for place in archive(store, self.site.file.parent / folder, time.time_ns()):
                        self._say(f"archive: {place.parent.name}, {place.name}.")
        except (MidspanError, OSError) as error:
            self._say(f"archive: {error}; it is tried again in an hour.")
            return
        self._old_ns = round((time.time() - DAY_S * self.site.settings.store.keep_days) * NANOSECONDS)

    def _collect(self, *, last: bool = False) -> list[Callable[[], None]]:
        """What every point has to keep, to the store and the broker; returns what is acknowledged once it is kept."""
        done = list(self._acknowledge)
        self._acknowledge.clear()
        for one in self._points:
            self._publish_rows(one)
            batch = one.live.batch(last=last)
            self._keeper.put(batch)
            self._publish(one, batch)
        return done

    def _publish_rows(self, one: Running) -> None:
        """The newest rows, as soon as they are there."""
        rows = one.live.fresh()
        if rows is None:
            return
        new = rows.rows(slice(int(np.searchsorted(rows.time_ns, one.published_ns, side="right")), None))
        one.published_ns = max(int(rows.time_ns[-1]), one.published_ns)
        if not len(new.time_ns):
            return
        self._alarms.rows(one.name, new)
        if self._socket is not None:
            self._socket.publish({"kind": "rows", "point": one.name}, row_bytes(new))
        if self._broker is not None:
            for part in even_parts(new):
                self._broker.publish(f"{one.name}/displacement", result_payload(part, one.results))
                one.results += 1

    def _publish_head(self, one: Running) -> None:
        """The newest row of a point whose rows come later, before it is final: for viewers, one a tick at most."""
        row = one.live.head if self._socket is not None and self._socket.has_readers else None
        if row is not None and self._socket is not None and int(row.time_ns[-1]) > max(one.head_ns, one.published_ns):
            one.head_ns = int(row.time_ns[-1])
            self._socket.publish({"kind": "head", "point": one.name}, row_bytes(row))

    def _publish(self, one: Running, batch: Batch) -> None:
        for _, event in batch.events:
            self._publish_event(one.name, event)
            if event.kind == NEW_DATUM:
                self._alarms.new_datum(one.name, event.time_ns)
        if self._broker is None:
            return
        for rows in [chunk for chunk in batch.chunks if chunk.stream == ROWS]:
            self._broker.publish(f"{one.name}/summary", summary(rows, one.live.status.name.lower()))
        self._broker.publish(f"{one.name}/state", json.dumps(self._standing_of(one, time.time())), qos=1, retain=True)

    def standing(self) -> dict[str, Any]:
        """As the log has it."""
        state = self.state()
        return {
            "ready": state["ready"],
            "points": [of_ready(one) for one in state["points"]],
            "sources": state["sources"],
        }

    def state(self) -> dict[str, Any]:
        """How points, sources, store and broker stand, as the page's server has it; what is paused is no fault."""
        now_s = time.time()
        points = [one.state(now_s, self._standing_of(one, now_s)) for one in self._points]
        sources = [stream for one in points for stream in one["sources"]]
        sources += [
            {"point": "", "source": name, "reason": reason, "text": text}
            for name, (reason, text) in self._shared().items()
            if reason
        ]
        ready = not any(one["reason"] not in ("", "paused") for one in (*sources, *points))
        store = {"waiting": self._keeper.waiting, "dropped": self._keeper.dropped, "written": written_bytes()}
        return {"ready": ready, "points": points, "sources": sources, "store": store}

    async def command(self, head: dict[str, Any]) -> tuple[dict[str, Any], bytes]:
        """A command of the page's server."""
        return await self._commands.run(head)

    def _shared(self) -> dict[str, tuple[str, str]]:
        """Why store and broker are away, as code and text, by their names; empty texts where they are there."""
        reason = "" if self._broker is None else self._broker.reason
        return {"store": (self._keeper.reason, self._keeper.text), "mqtt": (reason, sentence(reason) if reason else "")}

    def _standing_of(self, one: Running, now_s: float) -> dict[str, Any]:
        """As the topic `state` shows it; without the broker its sources are away, not silent."""
        found = one.standing(now_s)
        for source in found["sources"]:
            by_broker = one.live.plan.sources[source["source"]].startswith(MQTT)
            if by_broker and self._broker is not None and self._broker.reason and source["reason"]:
                source["reason"], source["text"] = self._broker.reason, sentence(self._broker.reason)
        return found

    def _log(self) -> None:
        """One line a minute."""
        now = self.standing()
        words = [
            f"{one['point']} {one['status']}" + f" ({one['reason']})" * bool(one["reason"]) for one in now["points"]
        ]
        down = [f"{s['point']}/{s['source']}: {s['reason']}".lstrip("/") for s in now["sources"] if s["reason"]]
        self._say("; ".join([", ".join(words), *down]))
        if self._note is not None:
            self._note(self.record())

    def record(self) -> dict[str, Any]:
        """How all stands, for programs."""
        now_s = time.time()
        return {**self.standing(), "time_s": now_s, "points": [self._standing_of(one, now_s) for one in self._points]}
