"""What brings records to the points of a site: topics of the broker, cameras, serial lines, replayed recordings.

All of it runs in the service's loop; cameras and lines have threads of their own, which hand over what they have. What
several points have the same address of is opened once, and each of them gets what comes.
"""

import asyncio
import time
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from midspan.errors import MidspanError
from midspan.records import NANOSECONDS, Arrival, Floats, Frame, RangeFrame, Readings
from midspan.service.camera_process import CameraProcess, Delivered, ReadingThread
from midspan.service.cutting import around, whole_frame, wider
from midspan.service.mqtt import SESSION_S
from midspan.service.opening import Opened
from midspan.service.reasons import sentence
from midspan.service.replayed import range_frames, readings
from midspan.service.running import Running
from midspan.settings.kinds import CAMERAS, LIVE
from midspan.settings.live_sources import connection
from midspan.sources.live.blocks import Block, parse
from midspan.sources.live.instants import Ended, SourceFault
from midspan.sources.live.radar import profiles
from midspan.sources.live.serial_line import blocks
from midspan.sources.thermal.temperatures import ThermalRequest, celsius_of, count_scale

# Stamps that far ahead of this machine's clock are refused, s: twice the clock offset that a calibration looks for.
# What is kept is in the order of stamps: a record of the future would shut out those that come until then.
AHEAD_S = 1.0
# Recordings that are replayed begin so long after the site does, s: the processes of cameras take a while to start.
REPLAY_AFTER_S = 5.0
MQTT, SERIAL, REPLAY, UDP = "mqtt:", "serial:", "replay:", "udp:"

Tell = Callable[[Running, str, str], None]
"""Takes a point, the kind of an event and its text."""
Users = list[tuple[Running, str]]
"""Points that a source brings records to, each with the name of its sensor."""

Reader = CameraProcess | ReadingThread | asyncio.Task[None]
"""What brings the records of a source."""


@dataclass(slots=True)
class Source:
    """One source, opened once, and who uses it now."""

    users: Users = field(default_factory=list)
    reader: Reader | None = None


class Intake:
    """taken: called after each record that a point was given; tell: takes events. folder: of the site's file."""

    def __init__(self, points: Sequence[Running], folder: Path, taken: Callable[[Running], None], tell: Tell) -> None:
        self._folder, self._taken, self._tell = folder, taken, tell
        # By what is opened: an address, of a recording with its sensor and its start.
        self._sources: dict[str, Source] = {}
        self.topics: dict[str, Users] = {}
        self.join(points)

    def join(self, points: Sequence[Running]) -> None:
        """Let points use the sources that they name; they get records from `begin` on, blocks of topics at once."""
        started_ns = time.time_ns() + round(REPLAY_AFTER_S * NANOSECONDS)
        for one in points:
            one.ended = False
            for name, address in one.live.plan.sources.items():
                at = connection(address)
                if address.startswith(REPLAY):
                    # A recording may have an acceleration, or a rotation, for each image axis.
                    axis = f":{one.live.plan.axis}" if LIVE[one.kind(name)].axes else ""
                    at = f"{REPLAY}{self._folder / address.removeprefix(REPLAY)}@{started_ns}#{name}{axis}"
                self._sources.setdefault(at, Source()).users.append((one, name))
        self._find_topics()

    def _find_topics(self) -> None:
        sources = self._sources.items()
        self.topics = {at.removeprefix(MQTT): source.users for at, source in sources if at.startswith(MQTT)}

    def start_cameras(self, points: Sequence[Running]) -> None:
        """Start the cameras' processes, which takes seconds; their frames wait until `begin`. Called in the loop."""
        for at, source in self._sources.items():
            for one, name in source.users:
                # A camera that runs already gives a point frames from `begin` on.
                if source.reader is None and one in points and one.kind(name) in CAMERAS:
                    source.reader = CameraProcess(at)
                    source.reader.start()
                    self._feed(source.reader, source.users)

    def _feed(self, camera: CameraProcess, users: Users) -> None:
        """Let those who get no frames of a camera yet have some."""
        for one, name in users:
            if name not in one.cameras:
                one.cameras[name] = camera.feed(self._handed(self._pictured, [(one, name)]))

    def begin(self, points: Sequence[Running]) -> list[asyncio.Task[None]]:
        """Let records come; returns the tasks that replay recordings. Called in the service's loop."""
        tasks = []
        for at, source in self._sources.items():
            if isinstance(source.reader, CameraProcess):
                self._feed(source.reader, source.users)
                source.reader.take()
            elif source.reader is None and at.startswith((SERIAL, UDP)):
                source.reader = self._thread(at, source.users)
                source.reader.start()
            elif source.reader is None and at.startswith(REPLAY):
                source.reader = asyncio.create_task(self._replayed(at, source.users))
                tasks.append(source.reader)
        for one in points:
            if one.live.opened is not None:
                self.cut(one, one.live.opened)
            one.beginning = False
            for name, stream in one.streams.items():
                if lost := stream.lost_to_say(time.time()):
                    text = f"{name}: the buffer was full while the point started; {lost} records were dropped."
                    self._tell(one, "lost_records", text)
            for _, take in one.early:
                take()
            one.early.clear()
        return tasks

    async def end(self, points: Sequence[Running]) -> None:
        """Give points nothing more; what nobody uses any more is stopped."""
        await self.stop(self.leave(points))

    def leave(self, points: Sequence[Running]) -> list[Reader]:
        """Give points nothing more; returns what nobody uses any more, to be stopped."""
        for one in points:
            one.ended = True
            for feed in one.cameras.values():
                feed.leave()
        for source in self._sources.values():
            source.users[:] = [(one, name) for one, name in source.users if one not in points]
        unused = [one.reader for one in self._sources.values() if not one.users and one.reader is not None]
        self._sources = {at: source for at, source in self._sources.items() if source.users}
        self._find_topics()
        return unused

    async def stop(self, unused: Sequence[Reader]) -> None:
        """End what `leave` returned, which takes seconds."""
        for reader in unused:
            if isinstance(reader, asyncio.Task):
                reader.cancel()
        readers = [one for one in unused if not isinstance(one, asyncio.Task)]
        # At the same time: each waits for its own end.
        await asyncio.gather(*(asyncio.to_thread(one.stop) for one in readers))

    def cut(self, one: Running, *found: Opened) -> None:
        """Let only the regions and what is around them leave the cameras' processes."""
        for name, camera in one.cameras.items():
            regions = [opened.regions[name] for opened in found if name in opened.regions]
            if regions:
                camera.cut(wider(around(regions)))

    def payload(self, topic: str, payload: bytes) -> None:
        """A message of one of `topics`."""
        for one, name in self.topics.get(topic, ()):
            try:
                block = parse(payload, LIVE[one.kind(name)].block)
            except SourceFault as fault:
                self._refused(one, name, fault)
            else:
                self._give(self._block, one, name, block)

    def _give(self, take: Callable[[Running, str, Any], None], one: Running, name: str, item: Any) -> None:
        """Let a point take what came of a sensor; one that is being begun, while others run, does so then."""
        if one.beginning:
            if not isinstance(item, SourceFault):
                one.streams[name].heard_s = time.time()
            one.wait(name, partial(take, one, name, item))
        elif not one.ended:
            take(one, name, item)

    def _block(self, one: Running, name: str, block: Block) -> None:
        """A block of values, unless it was there before; lost ones are an event."""
        stream = one.streams[name]
        if stream.paused:
            return
        if self._is_ahead(one, name, block.t0_ns + block.dt_ns * max(len(block.values) - 1, 0)):
            return
        if stream.sequence is None and one.live.opened is not None and len(block.values):
            # The broker brings again what was not acknowledged: the point that goes on may have it already.
            newest_ns = one.live.opened.newest_ns.get(name, 0)
            if newest_ns - SESSION_S * NANOSECONDS < int(block.time_ns[-1]) <= newest_ns:
                return
        if not stream.is_new(block):
            return
        if lost := stream.lost_to_say(time.time()):
            self._tell(one, "lost_records", f"{name}: blocks lost in transmission: {lost}.")
        if len(block.values) and not np.isfinite(block.values).any():
            self._refused(one, name, SourceFault("no_values", sentence("no_values")))
        elif stream.dt_ns and block.dt_ns != stream.dt_ns:
            text = f"{name}: the sample interval is now {block.dt_ns / 1e6:g} ms, before {stream.dt_ns / 1e6:g} ms."
            self._tell(one, "rate", text)
        stream.dt_ns = block.dt_ns
        value = in_si(block.values, one.factors[name])[:, None]
        self._heard(one, name, Arrival(name, 0, Readings(block.time_ns, value)))

    def _is_ahead(self, one: Running, name: str, newest_ns: int) -> bool:
        """Whether stamps are of the future, which is a fault."""
        ahead_s = (newest_ns - time.time_ns()) / NANOSECONDS
        if ahead_s > AHEAD_S:
            text = f"time stamps are {ahead_s:.6g} s ahead of this machine's clock; synchronise both by NTP"
            self._refused(one, name, SourceFault("clock_ahead", text))
        return ahead_s > AHEAD_S

    def _refused(self, one: Running, name: str, fault: SourceFault) -> None:
        """Why a source gives nothing that can be used; once an event. Of one that is paused nobody asks."""
        if one.streams[name].paused:
            return
        if one.streams[name].refused(fault.code, str(fault), time.time()):
            self._tell(one, fault.code, f"{name}: {fault}")

    def _pictured(self, one: Running, name: str, item: Delivered | SourceFault) -> None:
        stream = one.streams[name]
        if isinstance(item, SourceFault):
            stream.failed = True
            self._refused(one, name, item)
            return
        stream.skipped = item.skipped
        if stream.stamps not in ("", item.kind.value):
            # What a calibration took for the clock's offset changes by some hundredths of a second.
            text = (
                f"{name}: the time stamps of frames are now those of the {item.kind.value} (± "
                f"{1e3 * item.kind.std_s:g} ms), before of the {stream.stamps}."
            )
            self._tell(one, "stamps", text)
        stream.stamps = item.kind.value
        if one.sizes.setdefault(name, item.shape) != item.shape:
            self._refused(one, name, SourceFault("size_changed", sentence("size_changed")))
            return
        if self._is_ahead(one, name, item.time_ns):
            return
        frame = Frame(item.time_ns, whole_frame(item.part, item.place, item.shape), item.number)
        try:
            if one.kind(name) == "infrared" and frame.pixels.dtype == np.uint16:
                frame = self._in_degrees(one, name, frame)
        except MidspanError as error:
            self._refused(one, name, SourceFault("damaged", str(error)))
            return
        self._heard(one, name, Arrival(name, 0, frame))

    def _in_degrees(self, one: Running, name: str, frame: Frame) -> Frame:
        """An infrared camera's frame of counts in °C; their scale is what fits the first frame."""
        if name not in one.scales:
            one.scales[name] = count_scale(float(np.median(frame.pixels.astype(np.float64))), ThermalRequest(), name)
        return replace(frame, pixels=celsius_of(frame.pixels, *one.scales[name]))

    def _thread(self, address: str, users: Users) -> ReadingThread:
        """What reads a line or a radar's port."""
        # The settings see to it that all of them mean the same: the kind of a line's values, a radar's settings.
        one, name = users[0]
        if address.startswith(SERIAL):
            kind = LIVE[one.kind(name)].block
            read: Callable[[Ended], Iterable[Any]] = partial(blocks, address.removeprefix(SERIAL), kind)
        else:
            read = partial(profiles, address.removeprefix(UDP), one.layouts[name])
        return ReadingThread(address, read, self._handed(self._came, users))

    def _came(self, one: Running, name: str, item: Block | RangeFrame | SourceFault) -> None:
        """What a line or a radar gave."""
        if isinstance(item, SourceFault):
            # A line that is no block is one too, and closes nothing.
            one.streams[name].failed |= item.code != "payload"
            self._refused(one, name, item)
        elif isinstance(item, RangeFrame):
            if not self._is_ahead(one, name, item.time_ns):
                self._heard(one, name, Arrival(name, 0, item))
        else:
            self._block(one, name, item)

    def _handed(self, taken: Callable[[Running, str, Any], None], users: Users) -> Callable[[Any], None]:
        """`taken` for each user of then in the service's loop, to be called from another thread; nothing once that is
        closed.
        """
        loop = asyncio.get_running_loop()

        def each(item: Any) -> None:
            for one, name in users:
                self._give(taken, one, name, item)

        def hand(item: Any) -> None:
            with suppress(RuntimeError):
                loop.call_soon_threadsafe(each, item)

        return hand

    async def _replayed(self, at: str, users: Users) -> None:
        """The readings or range profiles of a recording as they come due."""
        one, name = users[0]
        own = range_frames if LIVE[one.kind(name)].brings is RangeFrame else readings
        try:
            for due_s, record in own(at):
                # What is overdue comes in turn with the other channels.
                await asyncio.sleep(max(due_s - time.time(), 0.0))
                for one, name in users:
                    self._give(self._heard, one, name, Arrival(name, 0, record))
            reason, text = "replay_ended", sentence("replay_ended")
        except MidspanError as error:
            reason, text = "damaged", str(error)
        for one, name in users:
            one.streams[name].reason, one.streams[name].text = reason, text

    def _heard(self, one: Running, name: str, arrival: Arrival) -> None:
        stream, record = one.streams[name], arrival.record
        if stream.paused:
            return
        stream.heard(time.time(), arrival.newest_ns, len(record.time_ns) if isinstance(record, Readings) else 1)
        if isinstance(record, RangeFrame):
            one.profiles[name] = record
        # A block without any value tells nothing of the sensor.
        if stream.reason and not (isinstance(record, Readings) and not np.isfinite(record.value).any()):
            if stream.reported:
                self._tell(one, "returned", f"{name}: records come again.")
            stream.reason, stream.text, stream.reported = "", "", False
        try:
            one.live.push(arrival)
        except MidspanError as error:
            # One sensor's record that cannot be used leaves the others and the other points alone.
            self._refused(one, name, SourceFault("damaged", str(error)))
        except OSError as error:
            # Of a capture that is cut off nothing can be used: the next one begins anew.
            one.live.close()
            text = f"{sentence('capture_failed')} {one.live.folder}: {error.strerror}."
            self._refused(one, name, SourceFault("capture_failed", text))
        self._taken(one)


def in_si(values: Floats, factor: float) -> Floats:
    """Values (n,) times a factor; those that a sender gives in float32 have as many digits afterwards, so that what is
    kept of them is half as large.
    """
    with np.errstate(over="ignore"):
        single = values.astype(np.float32)
        if not np.array_equal(single, values, equal_nan=True):
            return factor * values
        return np.asarray((factor * values).astype(np.float32), dtype=np.float64)
