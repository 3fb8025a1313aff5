"""`midspan run`: the shell of a live site. The only place with a clock, threads and an event loop above the engine."""

import asyncio
import json
import time
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from midspan.engine.support import PointStatus
from midspan.errors import MidspanError
from midspan.records import NANOSECONDS, Arrival, Event, Readings, Region
from midspan.service.camera_process import CameraProcess, Delivered, Failed, Pasted
from midspan.service.capture import capture_settings
from midspan.service.jobs import calibrated_folder
from midspan.service.keeping import Keeper
from midspan.service.mqtt import Broker, event_payload, result_payload, rows_of, summary
from midspan.service.notify import notify
from midspan.service.opening import Opened, head_of, opened, resumed
from midspan.service.point import Job, LivePoint
from midspan.service.reasons import sentence
from midspan.service.replayed import readings
from midspan.service.web import application, server
from midspan.settings.site import ACCELEROMETER, PointPlan, Site, without_secrets
from midspan.settings.stored.calibration import Calibration
from midspan.settings.stored.calibration_file import calibration_from_dict, load_calibration
from midspan.sources.accelerometer.units import si_factor
from midspan.sources.live.blocks import ACCELERATION, DISPLACEMENT, Block, parse
from midspan.sources.live.fault import SourceFault
from midspan.store.store import Batch, Store, open_store

TICK_S, WRITE_S, LOG_S = 0.1, 1.0, 60.0
# Days that are too old are removed so often.
FORGET_S, DAY_S = 3600.0, 86_400.0
# A stream that brings nothing for so long is not fresh.
FRESH_S = 10.0
# Of a camera's frame more than its region leaves the camera's process: by this many of its own widths on each side.
MARGIN = 0.5
SI = {ACCELEROMETER: ("acceleration", "m/s^2"), "displacement": ("displacement", "m")}
COMMANDS = ("calibrate", "accept")
QUANTITY_KIND = {ACCELEROMETER: ACCELERATION, "displacement": DISPLACEMENT}


@dataclass(slots=True)
class Stream:
    """How one source stands: its address without secrets, when it was heard last, why it gives nothing, counts."""

    point: str
    sensor: str
    address: str
    heard_s: float | None = None
    reason: str = "starting"
    text: str = ""
    records: int = 0
    faults: int = 0
    skipped: int = 0
    sequence: int | None = None

    def standing(self, now_s: float) -> dict[str, Any]:
        """As /readyz and the state show it."""
        reason = self.reason
        if not reason and self.heard_s is not None and now_s - self.heard_s > FRESH_S:
            reason = "silent"
        return {
            "point": self.point,
            "source": self.sensor,
            "reason": reason,
            "text": self.text or (sentence(reason) if reason else ""),
            "age_s": None if self.heard_s is None else round(now_s - self.heard_s, 3),
            "records": self.records,
            "faults": self.faults,
            "skipped": self.skipped,
        }


@dataclass(slots=True)
class Running:
    """One point and its sources in the shell."""

    live: LivePoint
    streams: dict[str, Stream]
    factors: dict[str, float]
    cameras: dict[str, CameraProcess] = field(default_factory=dict)
    pasted: dict[str, Pasted] = field(default_factory=dict)
    sizes: dict[str, tuple[int, int]] = field(default_factory=dict)
    results: int = 0
    busy: bool = False

    @property
    def reason(self) -> str:
        """Why the point gives no row that a measurement supports, empty where it does."""
        if self.live.reason or self.live.opened is None:
            return self.live.reason or ("opening" if self.live.number else "calibrating")
        return "lost" if self.live.status is PointStatus.LOST else ""


class Service:
    """Runs a site until it is stopped. say: takes one line for a person; note: one structured record for a log."""

    def __init__(
        self, site: Site, say: Callable[[str], None], note: Callable[[dict[str, Any]], None] | None = None
    ) -> None:
        self.site, self._say, self._note = site, say, note
        self._folder = Path(site.store) if site.settings.store.path else site.file.parent / f"{site.name}-captures"
        self._keeper = Keeper(site.store)
        self._points = [self._running(plan) for plan in site.points]
        self._broker: Broker | None = None
        self._topics: dict[str, list[tuple[Running, str]]] = {}
        self._commands: dict[str, tuple[Running, str]] = {}
        self._stop = asyncio.Event()
        self._acknowledge: deque[Callable[[], None]] = deque()
        self._started_ns = time.time_ns()
        self._forgot_s, self._dropped = 0.0, 0
        self._loop: asyncio.AbstractEventLoop | None = None
        self._jobs: set[asyncio.Task[None]] = set()

    # Life

    async def run(self, for_s: float | None = None) -> dict[str, Any]:
        """Run for so many seconds; None: until `stop`. Everything that came is kept when it returns how all stands."""
        self._loop = asyncio.get_running_loop()
        await asyncio.to_thread(self._keeper.store)
        await self._begin_points()
        self._begin_sources()
        web = server(application(self.standing, self.figures), self.site.settings.service.listen)
        serving = asyncio.create_task(web.serve())
        tasks = [
            asyncio.create_task(self._every(TICK_S, self._tick)),
            asyncio.create_task(self._writing()),
            asyncio.create_task(self._every(LOG_S, self._log)),
            serving,
            *(asyncio.create_task(self._replayed(one, name)) for one, name in self._replays()),
        ]
        self._say(f"{self.site.name}: {len(self._points)} points, http://{self.site.settings.service.listen}/readyz")
        notify("READY=1")
        with suppress(asyncio.TimeoutError):
            await asyncio.wait_for(self._stop.wait(), for_s)
        notify("STOPPING=1")
        web.should_exit, last = True, self.record()
        with suppress(asyncio.TimeoutError):
            # The server closes its sockets by itself.
            await asyncio.wait_for(serving, 2.0)
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
        await self._end()
        return last

    def stop(self) -> None:
        """End the run soon."""
        self._stop.set()

    async def _end(self) -> None:
        for job in self._jobs:
            job.cancel()
        await asyncio.gather(*self._jobs, return_exceptions=True)
        for one in self._points:
            for camera in one.cameras.values():
                await asyncio.to_thread(camera.stop)
        if self._broker is not None:
            await asyncio.to_thread(self._broker.stop)
        self._collect(last=True)
        for one in self._points:
            one.live.close()
        await asyncio.to_thread(self._keeper.close)

    async def _every(self, step_s: float, work: Callable[[], None]) -> None:
        while True:
            await asyncio.sleep(step_s)
            work()

    # Points

    def _running(self, plan: PointPlan) -> Running:
        factors = {}
        kinds = {ACCELEROMETER: ACCELEROMETER} | {one.name: one.kind for one in plan.recording.sensors}
        for name, kind in kinds.items():
            if kind in SI:
                sections: dict[str, Any] = {one.name: one.settings for one in plan.recording.sensors}
                section: Any = sections.get(name, plan.recording.accelerometer)
                quantity, unit = SI[kind]
                sensitivity = getattr(section, "sensitivity", 0.0) or None
                replayed = plan.sources[name].startswith("replay:")
                factors[name] = 1.0 if replayed else si_factor(section.unit or unit, quantity, sensitivity)
        settings = capture_settings(plan.recording, factors)
        live = LivePoint(plan, settings, self._folder / "captures" / plan.name)
        streams = {name: Stream(plan.name, name, without_secrets(at)) for name, at in plan.sources.items()}
        return Running(live, streams, factors)

    async def _begin_points(self) -> None:
        """Each point goes on from its checkpoint, else opens with its calibration, else calibrates."""
        for one in self._points:
            plan, store = one.live.plan, self._keeper.store()
            await asyncio.to_thread(self._take_calibration, one, store)
            kept = store.checkpoint(plan.name)
            if kept is not None and one.live.number:
                try:
                    await asyncio.to_thread(self._resume, one, store, kept[1])
                    self._say(f"{plan.name}: goes on from its checkpoint.")
                except (MidspanError, ValueError, KeyError, OSError) as error:
                    one.live.opened = None
                    self._say(f"{plan.name}: its checkpoint cannot be used ({error}); it opens anew.")

    def _take_calibration(self, one: Running, store: Store) -> None:
        """The calibration in force: that of the site's file, kept under a number, or the store's own."""
        plan = one.live.plan
        if plan.settings.calibration is not None:
            given = load_calibration(self.site.file.parent / plan.settings.calibration)
            body = json.dumps(given.to_dict())
            known = next((c for c in store.calibrations(plan.name) if c.body == body), None)
            one.live.number = (
                known.number
                if known
                else store.add_calibration(
                    plan.name, time.time_ns(), body, one.live.settings.model_dump_json(exclude_none=True), accept=True
                )
            )
            return
        in_force = store.calibration(plan.name)
        one.live.number = in_force.number if in_force else 0

    def _calibration(self, one: Running) -> Calibration:
        found = self._keeper.store().calibration(one.live.name, one.live.number)
        assert found is not None
        return calibration_from_dict(json.loads(found.body))

    def _resume(self, one: Running, store: Store, kept: bytes) -> None:
        head = head_of(kept)
        folder = one.live.folder / Path(head["folder"]).name
        if head["calibration"] != one.live.number or not (folder / "recording.toml").is_file():
            return
        found = opened(
            folder, one.live.name, self._calibration(one), one.live.number, given=self._given(one), push=False
        )
        resumed(found, kept, store)
        one.live._opened_in = folder
        one.live.is_opened(found)

    def _given(self, one: Running) -> bool:
        return one.live.plan.settings.calibration is not None

    async def _work(self, one: Running, job: Job) -> None:
        """Do a point's job, and hand it the result."""
        live = one.live
        try:
            if job.kind == "calibrate":
                self._say(f"{live.name}: calibrating on {job.folder.name}.")
                body = await calibrated_folder(job.folder)
                accept = live.plan.settings.accept == "auto"
                number = await asyncio.to_thread(self._add_calibration, live, body, accept)
                live.calibrated(number) if accept else live.offered(number)
                self._say(f"{live.name}: calibration {number} {'is in force' if accept else 'waits to be accepted'}.")
            else:
                found = await asyncio.to_thread(
                    opened, job.folder, live.name, self._calibration(one), live.number, given=self._given(one)
                )
                self._cut(one, found)
                live.is_opened(found)
                self._say(f"{live.name}: runs.")
        except MidspanError as error:
            live.refused(error)
            self._say(f"{live.name}: {error}")
        finally:
            one.busy = False

    def _add_calibration(self, live: LivePoint, body: str, accept: bool) -> int:
        store, settings = open_store(self.site.store), live.settings.model_dump_json(exclude_none=True)
        try:
            return store.add_calibration(live.name, time.time_ns(), body, settings, accept=accept)
        finally:
            store.close()

    def _cut(self, one: Running, found: Opened) -> None:
        """Let only the regions and what is around them leave the cameras' processes."""
        for name, camera in one.cameras.items():
            if name in found.regions:
                camera.cut(wider(found.regions[name]))

    # Sources

    def _begin_sources(self) -> None:
        topics: dict[str, int] = {}
        for one in self._points:
            for name, address in one.live.plan.sources.items():
                kind = next((s.kind for s in one.live.plan.recording.sensors if s.name == name), ACCELEROMETER)
                if address.startswith("mqtt:"):
                    topic = address.removeprefix("mqtt:")
                    topics[topic] = 1
                    self._topics.setdefault(topic, []).append((one, name))
                elif kind in ("camera", "infrared"):
                    self._begin_camera(one, name, address)
        if self.site.settings.mqtt is not None:
            root = f"{self.site.settings.mqtt.prefix}/v1/{self.site.name}"
            for one in self._points:
                for command in COMMANDS:
                    topics[f"{root}/{one.live.name}/cmd/{command}"] = 1
                    self._commands[f"{root}/{one.live.name}/cmd/{command}"] = (one, command)
            self._broker = Broker(self.site.settings.mqtt, self.site.name, topics, self._message)
            self._broker.start()

    def _begin_camera(self, one: Running, name: str, address: str) -> None:
        assert self._loop is not None
        loop = self._loop
        if address.startswith("replay:"):
            address = self._replay_address(address, name)

        def taken(item: Delivered | Failed) -> None:
            with suppress(RuntimeError):
                loop.call_soon_threadsafe(self._pictured, one, name, item)

        one.cameras[name], one.pasted[name] = CameraProcess(address, taken), Pasted()
        if one.live.opened is not None:
            self._cut(one, one.live.opened)
        one.cameras[name].start()

    def _replay_address(self, address: str, sensor: str) -> str:
        path = self.site.file.parent / address.removeprefix("replay:")
        return f"replay:{path}@{self._started_ns}#{sensor}"

    def _replays(self) -> list[tuple[Running, str]]:
        return [
            (one, name)
            for one in self._points
            for name, address in one.live.plan.sources.items()
            if address.startswith("replay:") and name not in one.cameras
        ]

    async def _replayed(self, one: Running, name: str) -> None:
        """The readings of a recording as they come due."""
        address = self._replay_address(one.live.plan.sources[name], name)
        stream = one.streams[name]
        try:
            for due_s, block in readings(address):
                left_s = due_s - time.time()
                if left_s > 0:
                    await asyncio.sleep(left_s)
                self._heard(one, name, Arrival(name, 0, block))
            stream.reason, stream.text = "ended", "the recording that is replayed has ended"
        except MidspanError as error:
            stream.reason, stream.text = "damaged", str(error)

    def _message(self, topic: str, payload: bytes, acknowledge: Callable[[], None]) -> None:
        """A message of the broker, in its thread."""
        if self._loop is not None:
            taken = self._command if topic in self._commands else self._block
            with suppress(RuntimeError):
                self._loop.call_soon_threadsafe(taken, topic, payload, acknowledge)

    def _command(self, topic: str, payload: bytes, acknowledge: Callable[[], None]) -> None:
        """`cmd/calibrate`, or `cmd/accept` with the calibration's number (left out: the newest one offered)."""
        one, command = self._commands[topic]
        acknowledge()
        if command == "calibrate":
            one.live.calibrate()
            return
        task = asyncio.ensure_future(self._accept(one, payload.decode("ascii", "replace").strip()))
        self._jobs.add(task)
        task.add_done_callback(self._jobs.discard)

    async def _accept(self, one: Running, wanted: str) -> None:
        """Put an offered calibration in force."""
        offered = [c for c in self._keeper.store().calibrations(one.live.name) if c.state == "offered"]
        chosen = next((c for c in reversed(offered) if not wanted or str(c.number) == wanted), None)
        if chosen is None:
            self._event(one, "command", f"{one.live.name}: no calibration {wanted} is offered.".replace("  ", " "))
            return
        await asyncio.to_thread(self._put_in_force, one.live.name, chosen.number)
        one.live.calibrated(chosen.number)

    def _put_in_force(self, name: str, number: int) -> None:
        store = open_store(self.site.store)
        try:
            store.accept(name, number)
        finally:
            store.close()

    def _block(self, topic: str, payload: bytes, acknowledge: Callable[[], None]) -> None:
        for one, name in self._topics.get(topic, ()):
            stream = one.streams[name]
            kind = next((s.kind for s in one.live.plan.recording.sensors if s.name == name), ACCELEROMETER)
            try:
                block = parse(payload, QUANTITY_KIND[kind])
            except SourceFault as fault:
                stream.faults += 1
                if stream.reason != fault.code:
                    self._event(one, "payload", f"{name}: {fault}")
                stream.reason, stream.text = fault.code, str(fault)
                continue
            if self._is_new(one, name, block):
                value = one.factors[name] * block.values[:, None]
                self._heard(one, name, Arrival(name, 0, Readings(block.time_ns, value)))
        self._acknowledge.append(acknowledge)

    def _is_new(self, one: Running, name: str, block: Block) -> bool:
        """Whether a block was not there before; lost ones are an event."""
        stream = one.streams[name]
        last, stream.sequence = stream.sequence, block.sequence
        if last is None:
            return True
        ahead = (block.sequence - last) % 2**32
        if ahead == 0 or ahead > 2**31:
            # Sent again after a restart of the broker or ours; a sender that began anew counts from 0.
            if block.sequence < 16 and ahead != 0:
                return True
            stream.sequence = last
            stream.faults += 1
            return False
        if ahead > 1:
            self._event(one, "lost_records", f"{name}: {ahead - 1} blocks were lost on their way.")
        return True

    def _pictured(self, one: Running, name: str, item: Delivered | Failed) -> None:
        stream = one.streams[name]
        if isinstance(item, Failed):
            if stream.reason != item.code:
                self._event(one, item.code, f"{name}: {item.text}")
            stream.reason, stream.text, stream.faults = item.code, item.text, stream.faults + 1
            return
        stream.skipped = item.skipped
        if one.sizes.setdefault(name, item.shape) != item.shape:
            if stream.reason != "size_changed":
                self._event(one, "size_changed", f"{name}: {sentence('size_changed')}")
            stream.reason, stream.text, stream.faults = "size_changed", sentence("size_changed"), stream.faults + 1
            return
        self._heard(one, name, Arrival(name, 0, one.pasted[name].frame(item)))

    def _heard(self, one: Running, name: str, arrival: Arrival) -> None:
        stream = one.streams[name]
        stream.heard_s, stream.records = time.time(), stream.records + 1
        if stream.reason:
            if stream.reason != "starting":
                self._event(one, "returned", f"{name}: records come again.")
            stream.reason = stream.text = ""
        try:
            one.live.push(arrival)
        except MidspanError as error:
            # One sensor's record that cannot be used leaves the others and the other points alone.
            stream.reason, stream.text, stream.faults = "damaged", str(error), stream.faults + 1
            self._event(one, "damaged", f"{name}: {error}")
        self._begin_job(one)

    def _begin_job(self, one: Running) -> None:
        if one.live.job is not None and not one.busy:
            one.busy = True
            assert self._loop is not None
            task = self._loop.create_task(self._work(one, one.live.job))
            self._jobs.add(task)
            task.add_done_callback(self._jobs.discard)

    def _event(self, one: Running, kind: str, text: str) -> None:
        now = Event(time.time_ns(), kind, text)
        self._keeper.put(Batch(events=[(one.live.name, now)]))
        if self._broker is not None:
            self._broker.publish(f"{one.live.name}/event", event_payload(now), qos=1)

    # Out

    def _tick(self) -> None:
        now_ns = time.time_ns()
        for one in self._points:
            one.live.tick(now_ns)

    async def _writing(self) -> None:
        while True:
            await asyncio.sleep(WRITE_S)
            done = self._collect()
            await asyncio.to_thread(self._keeper.write)
            notify("WATCHDOG=1")
            if time.time() - self._forgot_s > FORGET_S:
                self._forgot_s = time.time()
                before_s = self._forgot_s - DAY_S * self.site.settings.store.keep_days
                await asyncio.to_thread(self._keeper.forget_before, round(before_s * NANOSECONDS))
            if self._keeper.dropped > self._dropped:
                self._dropped = self._keeper.dropped
                for one in self._points:
                    self._event(one, "rows_dropped", f"store: {sentence('rows_dropped')}")
            if not self._keeper.waiting:
                for acknowledge in done:
                    acknowledge()
            else:
                self._acknowledge.extendleft(reversed(done))

    def _collect(self, *, last: bool = False) -> list[Callable[[], None]]:
        """What every point has to keep, to the store and the broker; returns what is acknowledged once it is kept."""
        done = list(self._acknowledge)
        self._acknowledge.clear()
        for one in self._points:
            if last:
                one.live._kept_ns = 0
            batch = one.live.batch()
            self._keeper.put(batch)
            self._publish(one, batch)
        return done

    def _publish(self, one: Running, batch: Batch) -> None:
        if self._broker is None:
            return
        for rows in rows_of(batch.chunks):
            self._broker.publish(f"{one.live.name}/displacement", result_payload(rows, one.results))
            self._broker.publish(f"{one.live.name}/summary", summary(rows, one.live.status.name.lower()))
            one.results += 1
        for _, event in batch.events:
            self._broker.publish(f"{one.live.name}/event", event_payload(event), qos=1)
        self._broker.publish(f"{one.live.name}/state", json.dumps(self._state(one)), qos=1, retain=True)

    def _state(self, one: Running) -> dict[str, Any]:
        now_s = time.time()
        return {
            "point": one.live.name,
            "status": one.live.status.name.lower(),
            "reason": one.reason,
            "calibration": one.live.number,
            "sources": [stream.standing(now_s) for stream in one.streams.values()],
        }

    def standing(self) -> dict[str, Any]:
        """As /readyz shows it."""
        now_s = time.time()
        sources = [stream.standing(now_s) for one in self._points for stream in one.streams.values()]
        others = []
        if self._keeper.reason:
            others.append({"point": "", "source": "store", "reason": self._keeper.reason, "text": self._keeper.text})
        if self._broker is not None and self._broker.reason:
            reason = self._broker.reason
            others.append({"point": "", "source": "mqtt", "reason": reason, "text": sentence(reason)})
        down = [one for one in (*sources, *others) if one["reason"]]
        return {"ready": not down, "sources": [*sources, *others]}

    def figures(self) -> str:
        """As /metrics shows it."""
        from prometheus_client import CollectorRegistry, Gauge, generate_latest

        registry, now_s = CollectorRegistry(), time.time()
        labels = ["point", "source"]
        names = {
            "records": "Records that came.",
            "faults": "Records that could not be used.",
            "skipped": "Frames that were skipped because the engine did not keep up.",
        }
        gauges = {
            name: Gauge(f"midspan_source_{name}", text, labels, registry=registry) for name, text in names.items()
        }
        age = Gauge("midspan_source_age_seconds", "Time since the newest record.", labels, registry=registry)
        status = Gauge(
            "midspan_point_status",
            "0 tracking, 1 coasting, 2 lost, 3 warming, 4 calibrating.",
            ["point"],
            registry=registry,
        )
        for one in self._points:
            status.labels(one.live.name).set(int(one.live.status))
            for name, stream in one.streams.items():
                for key, gauge in gauges.items():
                    gauge.labels(one.live.name, name).set(getattr(stream, key))
                if stream.heard_s is not None:
                    age.labels(one.live.name, name).set(now_s - stream.heard_s)
        store = Gauge("midspan_store_waiting", "Batches that wait for the store.", registry=registry)
        store.set(self._keeper.waiting)
        Gauge("midspan_store_dropped", "Batches that were lost.", registry=registry).set(self._keeper.dropped)
        return str(generate_latest(registry).decode())

    def _log(self) -> None:
        """One line a minute."""
        now = self.standing()
        words = [f"{one.live.name} {one.live.status.name.lower()}" for one in self._points]
        down = [f"{s['point']}/{s['source']}: {s['reason']}".lstrip("/") for s in now["sources"] if s["reason"]]
        self._say("; ".join([", ".join(words), *down]))
        if self._note is not None:
            self._note(self.record())

    def record(self) -> dict[str, Any]:
        """How all stands, for programs."""
        return {"time_s": time.time(), "points": [self._state(one) for one in self._points], **self.standing()}


def wider(region: Region) -> Region:
    """A region with what is around it."""
    x, y = round(MARGIN * region.width), round(MARGIN * region.height)
    left, top = max(region.x - x, 0), max(region.y - y, 0)
    return Region(left, top, region.x + region.width + x - left, region.y + region.height + y - top)
