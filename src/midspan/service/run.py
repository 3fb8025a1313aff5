"""The shell of a live site's points: the only place with a clock, threads and an event loop above the engine."""

import asyncio
import itertools
import json
import math
import time
from collections import deque
from collections.abc import Callable, Coroutine, Sequence
from contextlib import closing, suppress
from functools import partial
from typing import Any

import numpy as np

from midspan.errors import MidspanError
from midspan.records import NANOSECONDS, Event
from midspan.service.alarming import Alarming
from midspan.service.beginning import begin
from midspan.service.calibrations import added, calibrated_folder, loaded
from midspan.service.changes import Changes
from midspan.service.changing import end_points, look_at_calibration
from midspan.service.checking import checked
from midspan.service.commands import Commands
from midspan.service.cutting import needed
from midspan.service.discovery import announcements
from midspan.service.ending import until_stopped
from midspan.service.group import max_bytes_of
from midspan.service.groups import Given, Groups, ended_points, group_sources
from midspan.service.intake import MQTT, Intake
from midspan.service.journal import NEW_DATUM, ROWS
from midspan.service.keeping import Keeper, written_bytes
from midspan.service.live_socket import LiveSocket, of_ready, row_bytes
from midspan.service.mqtt import Broker, even_parts, event_tree, result_payload, summary
from midspan.service.notify import notify
from midspan.service.opening import opened
from midspan.service.paused import Paused
from midspan.service.places import place_of
from midspan.service.point import Job, LivePoint
from midspan.service.reasons import sentence
from midspan.service.retention import sweeping
from midspan.service.running import Running, drafted, line_of, sizes_of
from midspan.service.topic_commands import TopicCommands
from midspan.settings.kinds import ACCELEROMETER
from midspan.settings.site import Site
from midspan.store.database import Division, StoreFault
from midspan.store.store import Batch, Store, open_store

TICK_S, FIRST_S, WRITE_S, LOG_S = 0.05, 0.2, 1.0, 60.0
# The first times that all is written follow one another after FIRST_S.
FIRST = 5


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
        self._keeper = Keeper(site.store, site.names, Division(site.name, site.shard.count if site.shard else 0))
        self._groups = Groups(self._keeper.put, say)
        self._points = drafted(site, [plan.name for plan in site.points])
        self.sizes_px = partial(sizes_of, self._points)
        self._intake = Intake(self._points, site.file.parent, self._begin_job, self._event)
        self._paused = paused = Paused(place_of(site.store))
        self._alarms = Alarming(site, say, lambda tree: None if socket is None else socket.publish(tree))
        commands = {**self._alarms.commands, "watch": self._groups.watch}
        self._commands = Commands(self._points, paused, self._event, self._in_thread, commands, self._groups.table)
        heard = (self._points, self._event, self._publish_event, self._begin, self._in_thread)
        self._topic_commands = TopicCommands(*heard, self._groups.has_point)
        self._pause(self._points)
        self._broker: Broker | None = None
        self._stop = asyncio.Event()
        # Whether all points are begun, and what comes is kept.
        self.begun = False
        self._acknowledge: deque[Callable[[], None]] = deque()
        self._dropped = 0
        # Why store and broker were away when that was last an event.
        self._away: dict[str, str] = {}
        self._loop: asyncio.AbstractEventLoop | None = None
        self._jobs: set[asyncio.Task[None]] = set()
        # One calibration at a time, and one opening, which waits for none: the engine needs the processor.
        self._one_at_a_time = {"calibrate": asyncio.Lock(), "open": asyncio.Lock()}
        # One change of the settings at a time; what fails unexpectedly ends the run.
        self._changing = asyncio.Lock()
        self._failing: asyncio.Future[None] | None = None

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
        self._failing = self._loop.create_future()
        self._intake.start_cameras(self._points)
        begun = [asyncio.create_task(self._patiently(partial(self._begin_point, one))) for one in self._points]
        begun += [asyncio.create_task(self._patiently(self._begin_groups))] * bool(self.site.groups)
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
        self._begin_intake(self._points)
        self._begin_broker()
        tasks: list[asyncio.Future[Any]] = [
            asyncio.create_task(self._every(TICK_S, self._tick)),
            asyncio.create_task(self._writing()),
            asyncio.create_task(sweeping(lambda: self.site, self._keeper, self._say)),
            asyncio.create_task(self._every(LOG_S, self._log)),
            self._failing,
        ]
        self.begun = True
        self._say(f"{self.site.name}: {len(self._points) + self._groups.points} points run.")
        failed = await until_stopped(self._stop, tasks, for_s)
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
        """Lock the points and the division, as long as the store can be reached. Raises UsageError where another
        process has them.
        """
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
                    self._say(f"store: {fault} midspan retries every second.")
                self._keeper.reason, self._keeper.text = fault.code, str(fault)
            else:
                self._keeper.reason = self._keeper.text = ""
                return True
            notify("WATCHDOG=1")
            with suppress(TimeoutError):
                await asyncio.wait_for(self._stop.wait(), WRITE_S)
        return False

    def stop(self) -> None:
        """End the run soon."""
        self._stop.set()

    async def _end(self) -> None:
        for job in self._jobs:
            job.cancel()
        await asyncio.gather(*self._jobs, return_exceptions=True)
        await self._intake.end(self._points)
        try:
            for one in self._points:
                self._publish_rows(one)
            await asyncio.to_thread(self._alarms.close)
            self._show(await asyncio.to_thread(self._groups.second, time.time_ns(), self._broker))
            if self._broker is not None:
                await asyncio.to_thread(self._broker.stop)
            self._collect(last=True)
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
        begin(one, store, self.site.file.parent, self._say)

    def _begin_groups(self) -> None:
        """Groups go on from what the store has of them, those that run already as they are; called in a thread."""
        with closing(open_store(self.site.store)) as store:
            self._groups.begin(self.site.groups, store)

    def _begin_job(self, one: Running) -> None:
        if one.live.job is not None and not one.busy:
            one.work = self._begin(self._work(one, one.live.job))

    def _begin(self, work: Coroutine[Any, Any, None]) -> asyncio.Task[None]:
        assert self._loop is not None
        task = self._loop.create_task(work)
        self._jobs.add(task)
        task.add_done_callback(self._jobs.discard)
        return task

    def _begin_intake(self, points: Sequence[Running]) -> None:
        """Let records of points come."""
        for task in self._intake.begin(points):
            task.add_done_callback(self._ended)

    def _ended(self, task: asyncio.Task[None]) -> None:
        """Work that is watched ended: where it failed, so does the run."""
        failing, error = self._failing, None if task.cancelled() else task.exception()
        if error is not None and failing is not None and not failing.done():
            failing.set_exception(error)

    async def _work(self, one: Running, job: Job) -> None:
        """Do a point's job, and hand it the result."""
        live = one.live
        try:
            if job.kind == "open":
                live.narrow(needed(await asyncio.to_thread(self._with_store, loaded, live)))
            async with self._one_at_a_time[job.kind]:
                with one.timed(job.kind):
                    await (self._calibrate(one, job) if job.kind == "calibrate" else self._open(one, job))
        except Exception as error:
            # Whatever it is, the other points go on, and this one is tried again.
            live.refused(str(error) if isinstance(error, MidspanError) else f"{type(error).__name__}: {error}")

    async def _calibrate(self, one: Running, job: Job) -> None:
        live, accept = one.live, one.live.plan.settings.accept == "auto"
        self._say(f"{live.name}: calibrating on {job.folder.name}.")
        body = await calibrated_folder(job.folder)
        number = await asyncio.to_thread(self._with_store, added, live, body, accept=accept)
        warnings = (await asyncio.to_thread(self._with_store, loaded, live, number)).to_act_on
        live.calibrated(number, warnings) if accept else live.offered(number, warnings)

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

    # Other settings

    @property
    def is_changing(self) -> bool:
        """Whether points are being begun with other settings."""
        return self._changing.locked()

    async def take(self, site: Site) -> Changes:
        """Go on with other settings of the same store; returns as soon as it is certain that they can be run. The
        points that they leave as they are lose no row.

        Raises what `checked` does, and UsageError for a point that another process writes; nothing has changed then.
        """
        await self._changing.acquire()
        try:
            changes = Changes.between(self.site, site)
            fresh = await asyncio.to_thread(checked, site, changes.beginning, self.sizes_px())
            if changes.added:
                names = dict.fromkeys((*self.site.names, *site.names))
                await asyncio.to_thread(self._keeper.lock, list(names))
        except BaseException:
            self._changing.release()
            raise
        self._begin(self._change(site, changes, fresh)).add_done_callback(self._ended)
        return changes

    async def _change(self, site: Site, changes: Changes, fresh: Sequence[Running]) -> None:
        try:
            named = {one.name: one for one in (*self._points, *fresh)}
            for one in fresh:
                one.beginning = True
            self._pause(fresh)
            ending = [one for one in self._points if one.name in changes.ending]
            unused = self._intake.leave(ending)
            # At once: what comes while points end waits for those that follow them.
            self._intake.join(fresh)
            await self._intake.stop(unused)
            await end_points(ending, partial(self._keep, last=True))
            # In place: who commands points and gives them records has the same list.
            self._points[:] = [named[plan.name] for plan in site.points]
            before, self.site = self.site, site
            await self._alarms.change(site)
            if before.groups != site.groups:
                await self._patiently(self._change_groups)
            await self._change_broker(before)
            await self._begin_points(fresh)
            for one in self._points:
                if one.live.plan.settings.calibration is not None and one not in fresh:
                    await look_at_calibration(one, site.file.parent, self._in_thread, self._event)
            if changes.removed:
                await asyncio.to_thread(self._keeper.lock, site.names)
        finally:
            self._changing.release()

    async def _begin_points(self, fresh: Sequence[Running]) -> None:
        """Begin points while others run."""
        self._intake.start_cameras(fresh)
        if all(await asyncio.gather(*(self._patiently(partial(self._begin_after, one)) for one in fresh))):
            self._begin_intake(fresh)

    def _change_groups(self) -> None:
        """Other groups go on from what is kept of them, which what they have given is first; called in a thread."""
        self._keeper.require()
        self._begin_groups()

    def _begin_after(self, one: Running) -> None:
        """A point goes on from what the one before it has left, which is kept first; called in a thread."""
        self._keeper.require()
        self._begin_point(one)

    async def _change_broker(self, before: Site) -> None:
        """Connect to the broker of other settings, or listen to other topics of the same."""
        now = self.site
        if (now.settings.mqtt, now.name) != (before.settings.mqtt, before.name):
            if self._broker is not None:
                await asyncio.to_thread(self._broker.stop)
            self._broker = None
            self._begin_broker()
        elif self._broker is not None:
            gone = [*Changes.between(before, now).removed, *ended_points(before, now)]
            self._broker.change(self._topics, self._announced, gone, self._groups.inboxes)

    def _pause(self, points: Sequence[Running]) -> None:
        """Leave out what was paused."""
        for one in points:
            for name, stream in one.streams.items():
                stream.paused = self._paused.reasons.get(f"{one.name}.{name}", "")

    # In

    @property
    def _topics(self) -> dict[str, int]:
        """What is listened to at the broker, with the quality of service."""
        assert self.site.settings.mqtt is not None
        root = f"{self.site.settings.mqtt.prefix}/v1/{self.site.name}"
        # A shard leaves the commands of other points to the other shards.
        named = ["+"] if self.site.shard is None else [one.name for one in self._points]
        commands = [f"{root}/{name}/cmd/+" for name in named]
        return dict.fromkeys((*self._intake.topics, *commands, *self._groups.inboxes), 1)

    @property
    def _announced(self) -> dict[str, str]:
        assert self.site.settings.mqtt is not None
        return announcements(self.site.settings.mqtt, self.site.name, [one.name for one in self._points])

    def _begin_broker(self) -> None:
        mqtt = self.site.settings.mqtt
        if mqtt is None:
            return
        self._broker = Broker(
            mqtt, self.site.name, self._topics, self._message, self.site.file.parent, self._announced,
            self._groups.inboxes, max_bytes_of(self.site.groups), self.site.shard,
        )  # fmt: skip
        self._broker.start()
        self._alarms.connect(self._broker)

    def _message(self, topic: str, payload: bytes, acknowledge: Callable[[], None]) -> None:
        """A message of the broker, in its thread."""
        if self._loop is not None:
            with suppress(RuntimeError):
                self._loop.call_soon_threadsafe(self._taken, topic, payload, acknowledge)

    def _taken(self, topic: str, payload: bytes, acknowledge: Callable[[], None]) -> None:
        """A message, in the loop: a block is acknowledged once it is kept, and at the end to whoever goes on."""
        if self._stop.is_set():
            return
        if topic in self._intake.topics:
            self._intake.payload(topic, payload)
            self._acknowledge.append(acknowledge)
        else:
            acknowledge()
            self._topic_commands.came(topic, payload)

    def _event(self, one: Running, kind: str, text: str) -> None:
        self._event_of(one.name, kind, text)

    def _event_of_all(self, kind: str, text: str) -> None:
        """An event of every point and group."""
        for name in (*(one.name for one in self._points), *(plan.name for plan in self.site.groups)):
            self._event_of(name, kind, text)

    def _event_of(self, name: str, kind: str, text: str) -> None:
        now = Event(time.time_ns(), kind, text)
        self._keeper.put(Batch(events=[(name, now)]))
        self._publish_event(name, now)

    def _publish_event(self, point: str, event: Event) -> None:
        """An event in the log and to the broker."""
        self._say(f"{point}: {event.kind}: {event.text}")
        if self._note is not None:
            self._note({"point": point, **event_tree(event)})
        if self._socket is not None:
            self._socket.publish({"kind": "event", "point": point, "time_ns": event.time_ns, **event_tree(event)})
        if self._broker is not None:
            self._broker.publish(f"{point}/event", json.dumps(event_tree(event)))

    # Out

    def _tick(self) -> None:
        now_ns = time.time_ns()
        away = self._broker is not None and not self._broker.connected
        for one in self._begun:
            one.live.tick(now_ns, away=away and one.live.plan.sources[ACCELEROMETER].startswith(MQTT))
            one.looked_at(now_ns / NANOSECONDS)
            self._publish_rows(one)
            self._publish_head(one)
        self._alarms.look(now_ns, self._points)

    @property
    def _begun(self) -> list[Running]:
        """The points that are not being begun at present."""
        return [one for one in self._points if not one.beginning]

    async def _writing(self) -> None:
        # Soon first: after a restart what the broker has kept is there at once.
        for pause_s in itertools.chain(itertools.repeat(FIRST_S, FIRST), itertools.repeat(WRITE_S)):
            await asyncio.sleep(pause_s)
            done = self._collect()
            self._show(await asyncio.to_thread(self._groups.second, time.time_ns(), self._broker))
            await asyncio.to_thread(self._keeper.write)
            notify("WATCHDOG=1")
            if self._keeper.dropped > self._dropped:
                self._dropped = self._keeper.dropped
                self._event_of_all("rows_dropped", f"store: {sentence('rows_dropped')}")
            if self._broker is not None and (count := self._broker.dropped_results(time.monotonic())):
                self._event_of_all("results_dropped", f"mqtt: {count} messages: {sentence('results_dropped')}")
            # Store and broker that are away, or back, are an event of every point.
            for name, (reason, _) in self._shared().items():
                if reason != self._away.get(name, "") and reason != "starting":
                    text = f"{name}: {sentence(reason) if reason else 'is available again.'}"
                    self._event_of_all(reason or "returned", text)
                    self._away[name] = reason
            # While the store is away the broker would hold back all that comes after a few messages without an
            # acknowledgement: live goes on with what is held in memory.
            if not self._keeper.waiting or self._keeper.reason:
                for acknowledge in done:
                    acknowledge()
                if self._broker is not None:
                    self._broker.acknowledge(self._groups.receipts(kept=not self._keeper.waiting))
            else:
                self._acknowledge.extendleft(reversed(done))

    def _collect(self, *, last: bool = False) -> list[Callable[[], None]]:
        """What every point has to keep, to the store and the broker; returns what is acknowledged once it is kept."""
        done = list(self._acknowledge)
        self._acknowledge.clear()
        for one in self._begun:
            self._keep(one, last=last)
        return done

    def _keep(self, one: Running, *, last: bool) -> None:
        self._publish_rows(one)
        batch = one.live.batch(last=last)
        self._keeper.put(batch)
        self._publish(one, batch)

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
            blocks = [result_payload(part, one.results + k) for k, part in enumerate(even_parts(new))]
            one.results += len(blocks)
            self._broker.publish_results((f"{one.name}/displacement", block) for block in blocks)

    def _show(self, given: Given) -> None:
        """What groups gave, to the log, the broker and viewers."""
        for name, event in given.events:
            self._publish_event(name, event)
        if self._socket is not None:
            for name, body in given.frames:
                self._socket.publish({"kind": "rows", "point": name}, body)

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
        topic, status = f"{one.name}/summary", one.live.status.name.lower()
        self._broker.publish_results(
            (topic, summary(rows, status).encode()) for rows in batch.chunks if rows.stream == ROWS
        )
        self._broker.publish(f"{one.name}/state", json.dumps(self._standing_of(one, time.time())), retain=True)

    def standing(self) -> dict[str, Any]:
        """As the log has it."""
        state = self.state()
        points = [of_ready(one) for one in state["points"]]
        return {"ready": state["ready"], "points": points, "sources": state["sources"]}

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
        groups = self._groups.state()
        sources += group_sources(groups)
        ready = not any(one["reason"] not in ("", "paused") for one in (*sources, *points))
        store = {"waiting": self._keeper.waiting, "dropped": self._keeper.dropped, "written": written_bytes()}
        return {"ready": ready, "points": points, "groups": groups, "sources": sources, "store": store}

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
            if self._broker is None or not one.live.plan.sources[source["source"]].startswith(MQTT):
                continue
            source["restarts"] = self._broker.restarts
            if self._broker.reason and source["reason"]:
                source["reason"], source["text"] = self._broker.reason, sentence(self._broker.reason)
        return found

    def _log(self) -> None:
        """One line a minute."""
        self._say(line_of(self.standing()) or "all groups are measured.")
        if self._note is not None:
            self._note(self.record())

    def record(self) -> dict[str, Any]:
        """How all stands, for programs."""
        now_s = time.time()
        return {**self.standing(), "time_s": now_s, "points": [self._standing_of(one, now_s) for one in self._points]}
