"""Frames of a radar whose capture card (DCA1000) sends its raw samples by UDP: datagrams put in order by their count of
bytes, holes of what never came, range profiles with their instants in UTC.
"""

import math
import queue
import socket
import threading
import time
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from midspan.errors import DataError, UsageError
from midspan.radar.chirp import RadarInfo
from midspan.radar.interference import probed_bins
from midspan.radar.layout import PACKET_BYTES, Layout, unpack
from midspan.radar.range_profile import averaged, range_profile, whole_channels
from midspan.records import NANOSECONDS, ChirpFrame, Event, RangeFrame, RangeFrames
from midspan.sources.live.instants import LOOK_S, Ended, SourceFault, never
from midspan.sources.radar.radar_source import without_interference

DATA_PORT = 4098
HEAD_BYTES = 10
LARGEST_DATAGRAM = 2048
# The card's own address and the one that it sends to, as TI delivers it (DCA1000EVM user's guide, SPRUIJ4).
CARD_ADDRESS = "192.168.33.180"
HOST_ADDRESS = "192.168.33.30"
LOOPBACK = "127.0.0.1"
# A count this far ahead of the last one is no gap: that is twice the silence after which a capture ends by default.
MAX_GAP_S = 10.0
# This many packets that follow each other make a position of the stream; damage hits single packets.
CONFIRMING_PACKETS = 4
MAX_EVENTS = 1000


@dataclass(frozen=True, slots=True)
class UdpSettings:
    """Where the card sends to, and what is waited for.

    address, port: of this host, that the card sends to; senders: addresses that packets are taken from, None for all;
    timeout_s: of silence after which the capture ends with an error; waiting: frames that may wait to be taken before
    whole frames are dropped (and counted); late_packets: how many packets are waited for one that is missing;
    first_time_ns: of the first packet, left out: the time of its arrival.
    """

    address: str = HOST_ADDRESS
    port: int = DATA_PORT
    timeout_s: float = 5.0
    waiting: int = 256
    late_packets: int = 64
    first_time_ns: int | None = None
    senders: tuple[str, ...] | None = (CARD_ADDRESS, LOOPBACK)


class PacketOrder:
    """Datagrams in any order in, whole frames out; pure, without a socket, in bounded memory.

    A frame is given out when all its bytes are there, or when `late_packets` packets beyond its end have come. A packet
    whose count of bytes is farther from the last one than that waits until others follow it from there: alone it is a
    stray, which is counted and makes no frames. Together they are a gap, filled with holes up to `gap_frames`, or
    else, farther ahead or behind (the card was restarted), a new position: frames count on from the last one, the
    first of them `position_frame`.
    """

    def __init__(self, frame_bytes: int, late_packets: int = 64, gap_frames: int = 1000) -> None:
        self._size, self._reach, self._gap_bytes = frame_bytes, late_packets * PACKET_BYTES, gap_frames * frame_bytes
        # The frame that is next, by the card's count; what its number among the frames given out is above that.
        self._next, self._shift = 0, 0
        self._open: dict[int, tuple[bytearray, bytearray]] = {}
        self._far: list[tuple[int, bytes]] = []
        self._highest = 0
        # One of each for all frames that are lost wholly, however many.
        self._nothing = bytes(frame_bytes), b"\1" * frame_bytes
        self.begun = False
        self.lost_bytes = self.stale_packets = self.stray_packets = self.positions = self.position_frame = 0

    def push(self, datagram: bytes) -> list[tuple[int, bytes, bytes]]:
        """Frames that are finished by this datagram: number, bytes, and which bytes are missing (1 each)."""
        if len(datagram) <= HEAD_BYTES:
            self.stray_packets += 1
            return []
        start = int.from_bytes(datagram[4:HEAD_BYTES], "little")
        payload = datagram[HEAD_BYTES:]
        behind = self._next * self._size - (start + len(payload))
        if behind > self._reach or start - self._highest > self._reach:
            return self._push_far(start, payload)
        if behind >= 0:
            self.stale_packets += 1
            return []
        self._leave_far()
        self._keep(start, payload)
        return self._finished(self._reach)

    def flush(self) -> list[tuple[int, bytes, bytes]]:
        """All frames that have begun, whole or not."""
        self._leave_far()
        return self._finished(-1)

    def _push_far(self, start: int, payload: bytes) -> list[tuple[int, bytes, bytes]]:
        """Wait for more packets from there; with enough of them the stream goes on there."""
        if self._far and not 0 < start - self._far[-1][0] <= self._reach:
            self._leave_far()
        self._far.append((start, payload))
        if len(self._far) < CONFIRMING_PACKETS:
            return []
        out: list[tuple[int, bytes, bytes]] = []
        begin = self._far[0][0]
        if not self.begun or not 0 < begin - self._highest <= self._gap_bytes:
            # Go on with the first frame that begins there or after; what had begun before is given out.
            out, first = self._finished(-1), -(-begin // self._size)
            self._shift += self._next - first
            self._next, self._highest, self.position_frame = first, begin, first + self._shift
            self.positions += self.begun
        for far_start, far_payload in self._far:
            self._keep(far_start, far_payload)
        self._far = []
        return out + self._finished(self._reach)

    def _leave_far(self) -> None:
        self.stray_packets += len(self._far)
        self._far = []

    def _keep(self, start: int, payload: bytes) -> None:
        self.begun = True
        self._highest = max(self._highest, start + len(payload))
        at = 0
        while at < len(payload):
            frame, place = divmod(start + at, self._size)
            count = min(len(payload) - at, self._size - place)
            if frame >= self._next:
                data, missing = self._open.setdefault(frame, (bytearray(self._size), bytearray(self._nothing[1])))
                data[place : place + count] = payload[at : at + count]
                missing[place : place + count] = bytes(count)
            at += count

    def _finished(self, patience: int) -> list[tuple[int, bytes, bytes]]:
        """The frames, in their order, that are whole or whose end is more than `patience` bytes past; -1: all begun."""
        out: list[tuple[int, bytes, bytes]] = []
        while True:
            data, missing = self._open.get(self._next, (None, None))
            end = (self._next + 1) * self._size
            whole = missing is not None and 1 not in missing
            overdue = self._highest - end > patience if patience >= 0 else self._highest > self._next * self._size
            if not whole and not overdue:
                return out
            frame = self._nothing if data is None or missing is None else (bytes(data), bytes(missing))
            self.lost_bytes += frame[1].count(1)
            out.append((self._next + self._shift, *frame))
            self._open.pop(self._next, None)
            self._next += 1


class LiveCapture:
    """Frames as they come. A thread empties the socket into a bounded queue, so a slow reader never blocks the card.

    Use as a context manager; `frames` ends with DataError after `timeout_s` of silence. `dropped_frames` counts what
    the reader was too slow for, `foreign_packets` what other senders sent, `order` lost bytes, late and stray packets;
    `events` has the latest new positions of the stream.
    """

    def __init__(self, layout: Layout, settings: UdpSettings | None = None) -> None:
        self._layout, self._settings = layout, settings or UdpSettings()
        gap_frames = math.ceil(MAX_GAP_S / layout.profile.frame_period_s)
        self.order = PacketOrder(layout.frame_bytes, self._settings.late_packets, gap_frames)
        self.dropped_frames = self.foreign_packets = 0
        self.events: deque[Event] = deque(maxlen=MAX_EVENTS)
        self._queue: queue.Queue[tuple[int, int, bytes, bytes]] = queue.Queue(maxsize=self._settings.waiting)
        self._stop = threading.Event()
        self._thread: threading.Thread | None = None
        self._socket: socket.socket | None = None
        # A frame and its time that those after it are counted from; monotonic time minus the stamps' clock.
        self._origin: tuple[int, int] | None = None
        self._clock_ns = 0
        self._failure: DataError | None = None

    @property
    def port(self) -> int:
        """The port that is listened on."""
        if self._socket is None:
            raise UsageError("The capture is not open. Use it as a context manager.")
        return int(self._socket.getsockname()[1])

    def __enter__(self) -> "LiveCapture":
        listening = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            listening.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 8 << 20)
            listening.bind((self._settings.address, self._settings.port))
        except OSError as error:
            listening.close()
            raise UsageError(
                f"Cannot listen on port {self._settings.port} of {self._settings.address}: {error.strerror}. The host "
                "must have this address and no other program may use the port; else give others."
            ) from error
        listening.settimeout(0.05)
        self._socket = listening
        self._thread = threading.Thread(target=self._receive, name="radar capture", daemon=True)
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        if self._thread is not None:
            self._thread.join(timeout=2.0)
        if self._socket is not None:
            self._socket.close()

    def frames(self, stop: int | None = None, ended: Ended = never) -> Iterator[ChirpFrame]:
        """Frames in their order, with holes marked, up to `stop` of them, or until `ended` is true.

        Raises DataError after `timeout_s` of silence. Stamps are evenly spaced from the arrival of the first packet and
        of the first one of each new position.
        """
        given, until_s = 0, time.monotonic() + self._settings.timeout_s
        while (stop is None or given < stop) and not ended():
            left_s = max(until_s - time.monotonic(), 0.0)
            try:
                item = self._queue.get(timeout=min(LOOK_S, left_s))
            except queue.Empty:
                if left_s > LOOK_S and self._failure is None:
                    continue
                if self._failure is not None:
                    raise self._failure from None
                senders = " and ".join(self._settings.senders or ("anybody",))
                raise DataError(
                    f"No frame came from the capture card for {self._settings.timeout_s:g} s on port {self.port}; "
                    f"{self.foreign_packets} packets came from senders other than {senders}, "
                    f"{self.order.stray_packets} did not belong to the stream. Check that the radar runs, its cable, "
                    f"and that the host has the address {HOST_ADDRESS}."
                ) from None
            yield self._frame(*item)
            given, until_s = given + 1, time.monotonic() + self._settings.timeout_s

    def _frame(self, number: int, begin_ns: int, data: bytes, missing: bytes) -> ChirpFrame:
        layout, profile = self._layout, self._layout.profile
        cube = unpack(np.frombuffer(data, dtype="<i2"), layout)[0]
        lost = np.frombuffer(missing, dtype=np.uint8)
        if layout.lanes == 4:
            valid = np.repeat(~lost.reshape(profile.chirps, 1, -1).any(axis=2), profile.receivers, axis=1)
        else:
            valid = np.asarray(~lost.reshape(profile.chirps, layout.stored, -1).any(axis=2))
        return ChirpFrame(begin_ns + round(NANOSECONDS * profile.middle_s), cube, valid, number)

    def _receive(self) -> None:
        assert self._socket is not None
        while not self._stop.is_set():
            try:
                datagram, sender = self._socket.recvfrom(LARGEST_DATAGRAM)
            except TimeoutError:
                continue
            except OSError as error:
                if not self._stop.is_set():
                    self._failure = DataError(
                        f"The capture on port {self._settings.port} of {self._settings.address} ended: "
                        f"{error.strerror or error}. Check the host's network adapter and start again."
                    )
                return
            if self._settings.senders is None or sender[0] in self._settings.senders:
                self._take(datagram)
            else:
                self.foreign_packets += 1

    def _take(self, datagram: bytes) -> None:
        """Hand the frames that a datagram finishes to the reader, with the times at which they begin."""
        positions = self.order.positions
        finished = self.order.push(datagram)
        if self._origin is None and self.order.begun:
            first_ns = self._settings.first_time_ns
            first_ns = time.time_ns() if first_ns is None else first_ns
            self._origin, self._clock_ns = (0, first_ns), time.monotonic_ns() - first_ns
        if self.order.positions == positions:
            self._hand_over(finished)
            return
        moved = self.order.position_frame
        self._hand_over([item for item in finished if item[0] < moved])
        self._begin_position(moved)
        self._hand_over([item for item in finished if item[0] >= moved])

    def _hand_over(self, finished: list[tuple[int, bytes, bytes]]) -> None:
        for number, data, missing in finished:
            try:
                self._queue.put_nowait((number, self._begin_ns(number), data, missing))
            except queue.Full:
                self.dropped_frames += 1

    def _begin_position(self, number: int) -> None:
        """Date frame `number` by its arrival: the card's count says nothing of the time since the frame before it."""
        # Never before what the frames given out have reached.
        at_ns = max(time.monotonic_ns() - self._clock_ns, self._begin_ns(number))
        after_s = (at_ns - self._begin_ns(number - 1)) / NANOSECONDS
        self._origin = number, at_ns
        self.events.append(
            Event(at_ns, "gap", f"the card's byte counter jumped; the next frame is {after_s:.3g} s later")
        )

    def _begin_ns(self, number: int) -> int:
        """The time at which a frame begins."""
        first, first_ns = self._origin or (0, 0)
        return first_ns + round(NANOSECONDS * (number - first) * self._layout.profile.frame_period_s)


# Nothing for so long ends the reading, s.
SILENT_S = 5.0


def host_and_port(address: str) -> tuple[str, int]:
    """Where to listen, of `4098` (any address of this machine) or `192.168.33.30:4098`. Raises ValueError."""
    host, _, port = address.rpartition(":")
    if not port.isdecimal() or not 0 < int(port) < 65536:
        raise ValueError("must be a port, or a host and a port: udp:4098 or udp:192.168.33.30:4098")
    return host, int(port)


def live_info(layout: Layout) -> RadarInfo:
    """What a recording of the profiles would know of its source."""
    profile = layout.profile
    return RadarInfo(
        kind="slow-time I/Q",
        carrier_hz=profile.carrier_hz,
        frame_rate_hz=profile.frame_rate_hz,
        frame_count=None,
        channels=profile.receivers * len(set(profile.transmitters)),
        range_m=profile.axis.range_m,
        profile=profile,
    )


def profiles(address: str, layout: Layout, ended: Ended = never) -> Iterator[RangeFrame]:
    """Range profiles as they come, until the card is silent or `ended` is true.

    Raises SourceFault: not_found, no_answer, stopped.
    """
    host, port = host_and_port(address)
    heard, probed = False, probed_bins(layout.profile.bins).astype(np.int64)
    try:
        with LiveCapture(layout, UdpSettings(address=host, port=port, timeout_s=SILENT_S)) as capture:
            for block in without_interference(_blocks(capture, layout, ended), probed, keep=True):
                heard = True
                yield RangeFrame(int(block.time_ns[0]), block.phasors[0], block.valid[0])
    except UsageError as error:
        raise SourceFault("not_found", str(error)) from None
    except DataError as error:
        raise SourceFault("stopped" if heard else "no_answer", str(error)) from None


def _blocks(capture: LiveCapture, layout: Layout, ended: Ended) -> Iterator[RangeFrames]:
    for frame in capture.frames(ended=ended):
        cube = averaged(range_profile(frame.samples[None], layout.profile), layout.profile)
        yield RangeFrames(np.array([frame.time_ns]), cube, whole_channels(frame.valid[None], layout.profile))
