"""Sources that are opened again when they fail: lines and radars in threads, each camera in a process of its own.

A camera's process decodes and stamps each frame once, and cuts out of it what each point needs; the engine's process
takes what it can. Frames wait in the camera's process, a few at most: where the engine does not keep up the oldest is
skipped and counted.
"""

import itertools
import math
import multiprocessing
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection
from typing import Any

import numpy as np
from numpy.typing import NDArray

from midspan.errors import MidspanError
from midspan.records import Frame, Region
from midspan.service.cutting import part_of
from midspan.sources.live.camera import Stamped, StampKind, frames
from midspan.sources.live.instants import Ended, SourceFault

# The shortest and the longest pause, s.
SHORTEST_S, LONGEST_S = 1.0, 30.0
# A pause is this part of the time that the source has been away: one that is back is opened soon after a short
# absence, and seldom asked for in a long one.
PART = 0.25
# A thread that ends is waited for so long, s: it looks each quarter of a second whether it is to end.
STOP_S = 5.0


class Pauses:
    """`worked` whenever the source gave something, `next_s` after each failure."""

    def __init__(self) -> None:
        self._away_s: float | None = None

    def worked(self) -> None:
        """The source gave something."""
        self._away_s = None

    def next_s(self) -> float:
        """How long to wait now, s."""
        now_s = time.monotonic()
        if self._away_s is None:
            self._away_s = now_s
        return min(max(PART * (now_s - self._away_s), SHORTEST_S), LONGEST_S)


class ReadingThread:
    """read: opens the source and gives what it brings, until it raises SourceFault or the function that it is given is
    true, at which it looks several times a second.

    taken: called from the thread for each thing that it brings, and for each fault.
    """

    def __init__(self, name: str, read: Callable[[Ended], Iterable[Any]], taken: Callable[[Any], None]) -> None:
        self._read, self._taken = read, taken
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._reading, daemon=True, name=name)

    def start(self) -> None:
        """Begin."""
        self._thread.start()

    def stop(self) -> None:
        """End, and leave the source to whoever opens it next; called once it was started."""
        self._ending.set()
        self._thread.join(timeout=STOP_S)

    def _reading(self) -> None:
        pauses = Pauses()
        while not self._ending.is_set():
            try:
                for item in self._read(self._ending.is_set):
                    if self._ending.is_set():
                        return
                    pauses.worked()
                    self._taken(item)
            except SourceFault as fault:
                self._taken(fault)
            self._ending.wait(pauses.next_s())


# A process that sends nothing for so long, not even why, hangs: it is ended and started again, s.
HUNG_S = 60.0
# Those who wait for a picture at most.
MAX_LOOKING = 32
# Frames that wait for the engine; 30 are a second of a usual camera.
MAX_WAITING = 30


@dataclass(frozen=True, slots=True)
class Delivered:
    """A frame as one point gets it out of a camera's process: whole, or the part at (x, y) of a frame of `shape`."""

    time_ns: int
    kind: StampKind
    shape: tuple[int, int]
    place: tuple[int, int]
    part: np.ndarray
    number: int
    skipped: int


@dataclass(frozen=True, slots=True)
class Picture:
    """A whole frame as JPEG, for people: what does not fit into 8 bits is scaled to its own range.

    low, high: what black and white stand for, °C or counts of an infrared camera; None: grey levels as they came.
    """

    time_ns: int
    shape: tuple[int, int]
    jpeg: bytes
    low: float | None = None
    high: float | None = None
    is_counts: bool = False


# Of JPEG (0 to 100): the sharpness of edges that a region is drawn by, at a tenth of the bytes.
QUALITY = 85
PICTURE = "picture"


def pictured(frame: Frame) -> Picture:
    """A frame as a picture."""
    import cv2

    pixels: NDArray[Any] = frame.pixels
    low = high = None
    if pixels.dtype != np.uint8:
        values = pixels.astype(np.float32)
        low, high = (float(one) for one in np.nanpercentile(values, (1.0, 99.0)))
        values = np.nan_to_num(values, nan=low)
        pixels = np.clip((values - low) * (255.0 / max(high - low, 1e-9)), 0.0, 255.0).astype(np.uint8)
    _, jpeg = cv2.imencode(".jpg", pixels, [cv2.IMWRITE_JPEG_QUALITY, QUALITY])
    rows, columns = pixels.shape[:2]
    is_counts = frame.pixels.dtype == np.uint16
    return Picture(frame.time_ns, (rows, columns), jpeg.tobytes(), low, high, is_counts)


class CameraProcess:
    """Runs a camera's process and hands on what it gives; a process that dies is started again.

    It serves any number of points, each by a `CameraFeed`.
    """

    def __init__(self, address: str) -> None:
        self.address = address
        self._context = multiprocessing.get_context("spawn")
        # Of each feed, by its number, which is never used again: who takes its frames, and the part that is needed.
        self._numbers = itertools.count()
        self._takers: dict[int, Callable[[Delivered | SourceFault], None]] = {}
        self._regions: dict[int, Region | None] = {}
        # How the newest frame was dated: the next process need not find out again.
        self._stamps: StampKind | None = None
        self._ending, self._taking, self._pauses = threading.Event(), threading.Event(), Pauses()
        self._process: Any = None
        self._pipe: Connection | None = None
        # Who waits for the next picture.
        self._looking: list[Callable[[Picture], None]] = []
        self._thread = threading.Thread(target=self._watch, daemon=True, name=f"camera {address.partition(':')[0]}")

    def feed(self, taken: Callable[[Delivered | SourceFault], None]) -> "CameraFeed":
        """Whole frames for one more point. taken: called from a thread for each of them and each fault."""
        number = next(self._numbers)
        # Replaced, not changed: the thread may be going through it.
        self._takers = {**self._takers, number: taken}
        self.cut(number, None)
        return CameraFeed(self, number)

    def leave(self, number: int) -> None:
        """A feed's point needs no more frames."""
        self._takers = {one: taken for one, taken in self._takers.items() if one != number}
        self._regions = {one: region for one, region in self._regions.items() if one != number}
        self._send(self._regions)

    def start(self) -> None:
        """Start the process; what it gives waits there until `take`."""
        self._thread.start()

    def take(self) -> None:
        """From now on hand on what it gives."""
        self._taking.set()

    def cut(self, number: int, region: Region | None) -> None:
        """From now on a feed needs only this part of each frame; None: whole frames."""
        self._regions = {**self._regions, number: region}
        self._send(self._regions)

    def ask_picture(self, came: Callable[[Picture], None]) -> None:
        """Give the next frame as a picture to `came`, called from a thread; all who ask meanwhile get the same."""
        self._looking = [*self._looking[1 - MAX_LOOKING :], came]
        self._send(PICTURE)

    def stop(self) -> None:
        """End the process, by force after a second."""
        self._ending.set()
        self._taking.set()
        self._send("end")
        self._thread.join(timeout=5.0)

    @property
    def pid(self) -> int | None:
        """The process's number."""
        return None if self._process is None else self._process.pid

    def _send(self, message: dict[int, Region | None] | str) -> None:
        if self._pipe is not None:
            with suppress(OSError):
                self._pipe.send(message)

    def _watch(self) -> None:
        while not self._ending.is_set():
            self._run_once()
            if self._ending.is_set():
                return
            self._failed(SourceFault("process_ended", "the camera's process ended and is restarted"))
            self._ending.wait(self._pauses.next_s())

    def _failed(self, fault: SourceFault) -> None:
        """Report to every point why there are no frames."""
        for taken in self._takers.values():
            taken(fault)

    def _run_once(self) -> None:
        """One life of the process."""
        self._pipe, child = self._context.Pipe()
        asked = (self.address, child, self._regions, self._stamps)
        self._process = self._context.Process(target=serve, args=asked, daemon=True)
        self._process.start()
        child.close()
        self._taking.wait()
        heard_s = time.monotonic()
        try:
            while not self._ending.is_set():
                if self._pipe.poll(0.5):
                    item = self._pipe.recv()
                    self._hand_on(item)
                    if not isinstance(item, Picture):
                        self._pauses.worked()
                        heard_s = time.monotonic()
                    if isinstance(item, SourceFault) and item.code == "replay_ended":
                        # Nothing brings a recording back that has been replayed.
                        self._ending.wait()
                elif not self._process.is_alive() or time.monotonic() - heard_s > HUNG_S:
                    return
        except (EOFError, OSError):
            return
        finally:
            self._process.join(timeout=1.0)
            if self._process.is_alive():
                self._process.kill()
                self._process.join(timeout=1.0)
            self._pipe.close()

    def _hand_on(self, item: "dict[int, Delivered] | Picture | SourceFault") -> None:
        """What came out of the process, to whom it concerns."""
        if isinstance(item, Picture):
            looking, self._looking = self._looking, []
            for came in looking:
                came(item)
        elif isinstance(item, SourceFault):
            self._failed(item)
        else:
            for number, delivered in item.items():
                self._stamps = delivered.kind
                taken = self._takers.get(number)
                # One that has just left has none any more.
                if taken is not None:
                    taken(delivered)


@dataclass(frozen=True, slots=True)
class CameraFeed:
    """The part of a camera's frames that one point gets."""

    camera: CameraProcess
    number: int

    def cut(self, region: Region | None) -> None:
        """From now on only this part of each frame is needed; None: whole frames. The other points' are as before."""
        self.camera.cut(self.number, region)

    def leave(self) -> None:
        """The point needs no more frames."""
        self.camera.leave(self.number)


def serve(
    address: str, pipe: Connection, regions: Mapping[int, Region | None], stamps: StampKind | None = None
) -> None:
    """The camera's process: read, cut, stamp and send, and open again what failed, until the end is asked for.

    regions: that are needed at first, by the numbers of the feeds; stamps: how the frames of an earlier process were
    dated.
    """
    sender, pauses, replayed = _Sender(pipe, regions), Pauses(), address.startswith("replay:")
    if replayed:
        # What reads recordings is imported where one is replayed alone.
        from midspan.service.replayed import film
    while not sender.ended:
        try:
            for stamped in film(address) if replayed else frames(address, earlier=stamps):
                if sender.ended:
                    return
                sender.give(stamped)
                stamps = stamped.kind
                pauses.worked()
        except SourceFault as fault:
            sender.say(fault)
            if fault.code == "replay_ended":
                sender.wait(math.inf)
        except MidspanError as error:
            sender.say(SourceFault("damaged", str(error)))
        sender.wait(pauses.next_s())


class _Sender:
    """Sends what waits from a thread of its own, and takes commands."""

    def __init__(self, pipe: Connection, regions: Mapping[int, Region | None]) -> None:
        self._pipe, self._regions, self.ended = pipe, regions, False
        self._wanted = False
        self._waiting: deque[Any] = deque()
        self._some = threading.Condition()
        self._count = self._skipped = 0
        threading.Thread(target=self._sending, daemon=True).start()
        threading.Thread(target=self._listening, daemon=True).start()

    def give(self, stamped: Stamped) -> None:
        """Queue a frame; where too many wait the oldest is skipped."""
        if self._wanted:
            self._wanted = False
            picture = pictured(stamped.frame)
            with self._some:
                self._waiting.append(picture)
                self._some.notify()
        with self._some:
            frames = [one for one in self._waiting if isinstance(one, dict)]
            if len(frames) >= MAX_WAITING:
                self._waiting.remove(frames[0])
                self._skipped += 1
            self._waiting.append(self._delivered(stamped))
            self._count += 1
            self._some.notify()

    def _delivered(self, stamped: Stamped) -> dict[int, Delivered]:
        """A frame for each feed."""
        pixels, regions = stamped.frame.pixels, self._regions
        rows, columns = pixels.shape
        # One array for feeds that need the same part: it goes through the pipe once.
        parts = {region: part_of(pixels, region) for region in set(regions.values())}
        time_ns, kind, count, skipped = stamped.frame.time_ns, stamped.kind, self._count, self._skipped
        return {
            number: Delivered(time_ns, kind, (rows, columns), place, part, count, skipped)
            for number, (part, place) in ((number, parts[region]) for number, region in regions.items())
        }

    def say(self, fault: SourceFault) -> None:
        """Queue why there are no frames."""
        with self._some:
            self._waiting.append(fault)
            self._some.notify()

    def wait(self, pause_s: float) -> None:
        """Wait, unless the end is asked for."""
        until_s = time.monotonic() + pause_s
        while not self.ended and time.monotonic() < until_s:
            time.sleep(0.1)

    def _sending(self) -> None:
        while True:
            with self._some:
                while not self._waiting:
                    self._some.wait()
                item = self._waiting.popleft()
            try:
                self._pipe.send(item)
            except OSError:
                self.ended = True
                return

    def _listening(self) -> None:
        with suppress(EOFError, OSError):
            while True:
                found = self._pipe.recv()
                if found == "end":
                    break
                if found == PICTURE:
                    self._wanted = True
                else:
                    self._regions = found
        # The end is asked for, or the service is gone.
        self.ended = True
