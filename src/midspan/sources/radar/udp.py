"""Live capture from a DCA1000 card: datagrams put in order by their count of bytes, holes of what never came."""

import queue
import socket
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from midspan.errors import DataError, UsageError
from midspan.radar.layout import Layout, unpack
from midspan.records import ChirpFrame

DATA_PORT = 4098
HEAD_BYTES = 10
LARGEST_DATAGRAM = 2048


@dataclass(frozen=True, slots=True)
class UdpSettings:
    """address, port: where the card sends to; timeout_s: of silence after which the capture ends with an error;
    waiting: frames that may wait to be taken before whole frames are dropped (and told); late_packets: how many packets
    are waited for one that is missing.
    """

    address: str = "0.0.0.0"
    port: int = DATA_PORT
    timeout_s: float = 5.0
    waiting: int = 256
    late_packets: int = 64
    first_time_ns: int | None = None


class PacketOrder:
    """Datagrams in any order in, whole frames out; pure, without a socket.

    A frame is given out when all its bytes are there, or when `late_packets` packets beyond its end have come.
    """

    def __init__(self, frame_bytes: int, late_packets: int = 64) -> None:
        self._size, self._late = frame_bytes, late_packets
        self._next = 0
        self._open: dict[int, tuple[bytearray, bytearray]] = {}
        self._beyond = 0
        self._highest = 0
        self.lost_bytes = 0
        self.stale_packets = 0

    def push(self, datagram: bytes) -> list[tuple[int, bytes, bytes]]:
        """Frames that are finished by this datagram: number, bytes, and which bytes are missing (1 each)."""
        if len(datagram) <= HEAD_BYTES:
            raise DataError(
                f"A datagram of {len(datagram)} bytes came; the card's have {HEAD_BYTES} of header and data."
            )
        start = int.from_bytes(datagram[4:HEAD_BYTES], "little")
        payload = datagram[HEAD_BYTES:]
        if start + len(payload) <= self._next * self._size:
            self.stale_packets += 1
            return []
        self._keep(start, payload)
        self._highest = max(self._highest, start + len(payload))
        return self._finished(self._late * max(len(payload), 1))

    def flush(self) -> list[tuple[int, bytes, bytes]]:
        """All frames that have begun, whole or not."""
        return self._finished(-1)

    def _keep(self, start: int, payload: bytes) -> None:
        at = 0
        while at < len(payload):
            frame, place = divmod(start + at, self._size)
            count = min(len(payload) - at, self._size - place)
            if frame >= self._next:
                data, missing = self._open.setdefault(frame, (bytearray(self._size), bytearray(b"\1" * self._size)))
                data[place : place + count] = payload[at : at + count]
                missing[place : place + count] = bytes(count)
            at += count

    def _finished(self, patience: int) -> list[tuple[int, bytes, bytes]]:
        out: list[tuple[int, bytes, bytes]] = []
        while True:
            data, missing = self._open.get(self._next, (None, None))
            end = (self._next + 1) * self._size
            whole = missing is not None and not any(missing)
            overdue = self._highest - end > patience if patience >= 0 else self._highest > self._next * self._size
            if not whole and not overdue:
                return out
            if data is None or missing is None:
                data, missing = bytearray(self._size), bytearray(b"\1" * self._size)
            self.lost_bytes += sum(missing)
            out.append((self._next, bytes(data), bytes(missing)))
            self._open.pop(self._next, None)
            self._next += 1


class LiveCapture:
    """Frames as they come. A thread empties the socket into a bounded queue, so a slow reader never blocks the card.

    Use as a context manager; `frames` ends with DataError after `timeout_s` of silence. `dropped_frames` counts what
    the reader was too slow for, `order` tells lost bytes and late packets.
    """

    def __init__(self, layout: Layout, settings: UdpSettings | None = None) -> None:
        self._layout, self._settings = layout, settings or UdpSettings()
        self.order = PacketOrder(layout.frame_bytes, self._settings.late_packets)
        self.dropped_frames = 0
        self._queue: queue.Queue[tuple[int, bytes, bytes]] = queue.Queue(maxsize=self._settings.waiting)
        self._stop = threading.Event()
        self._thread: threading.Thread | None = None
        self._socket: socket.socket | None = None
        self._first_ns = self._settings.first_time_ns
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
                f"Port {self._settings.port} of {self._settings.address} cannot be listened on: {error.strerror}. "
                "Close the other program or give another port."
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

    def frames(self, stop: int | None = None) -> Iterator[ChirpFrame]:
        """Frames in their order, with holes marked, up to `stop` of them.

        Raises DataError after `timeout_s` of silence. Stamps are evenly spaced from the arrival of the first packet.
        """
        given = 0
        while stop is None or given < stop:
            try:
                number, data, missing = self._queue.get(timeout=self._settings.timeout_s)
            except queue.Empty:
                if self._failure is not None:
                    raise self._failure from None
                raise DataError(
                    f"No frame came from the capture card for {self._settings.timeout_s:g} s on port {self.port}. "
                    "Check that the radar runs, its cable, and that the host has the address 192.168.33.30."
                ) from None
            yield self._frame(number, data, missing)
            given += 1

    def _frame(self, number: int, data: bytes, missing: bytes) -> ChirpFrame:
        layout, profile = self._layout, self._layout.profile
        cube = unpack(np.frombuffer(data, dtype="<i2"), layout)[0]
        lost = np.frombuffer(missing, dtype=np.uint8)
        if layout.lanes == 4:
            valid = np.repeat(~lost.reshape(profile.chirps, 1, -1).any(axis=2), profile.receivers, axis=1)
        else:
            valid = np.asarray(~lost.reshape(profile.chirps, layout.stored, -1).any(axis=2))
        stamp = (self._first_ns or 0) + round(1e9 * (number * profile.frame_period_s + profile.middle_s))
        return ChirpFrame(stamp, cube, valid, number)

    def _receive(self) -> None:
        assert self._socket is not None
        while not self._stop.is_set():
            try:
                datagram = self._socket.recv(LARGEST_DATAGRAM)
            except TimeoutError:
                continue
            except OSError as error:
                if not self._stop.is_set():
                    self._failure = DataError(
                        f"The capture on port {self._settings.port} of {self._settings.address} ended: "
                        f"{error.strerror or error}. Check the host's network adapter and begin again."
                    )
                return
            if self._first_ns is None:
                self._first_ns = time.time_ns()
            try:
                finished = self.order.push(datagram)
            except DataError as error:
                self._failure = error
                continue
            for item in finished:
                try:
                    self._queue.put_nowait(item)
                except queue.Full:
                    self.dropped_frames += 1
