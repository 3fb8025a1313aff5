"""MQTT 5 packets of many messages as one: a client makes each alone, which costs as much as the rows themselves.

https://docs.oasis-open.org/mqtt/mqtt/v5.0/mqtt-v5.0.html, 3.3 PUBLISH and 3.4 PUBACK.
"""

import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np

PUBLISH, PUBACK = 0x30, 0x4002
# Packets are handed over in parts of about this many bytes: what a socket takes at once.
PART_BYTES = 65_536
# Bytes of results that the client has at most, and that wait for it: a minute of 1000 points at 100 Hz.
MAX_HANDED_BYTES, MAX_WAITING_BYTES = 1_000_000, 64_000_000


class Receipt(NamedTuple):
    """What a message is acknowledged with: the connection that it came by, and its number there, 0 of quality of
    service 0.
    """

    connection: int
    number: int


class Part(NamedTuple):
    """Packets, one after another, and how many messages they are."""

    packets: bytes
    messages: int


def publication(topic: str, payload: bytes) -> bytes:
    """A message with quality of service 0, not retained, without properties."""
    name = topic.encode()
    length = 2 + len(name) + 1 + len(payload)
    head = bytearray((PUBLISH,))
    while length > 127:
        head.append(length % 128 + 128)
        length //= 128
    head.append(length)
    return b"".join((head, len(name).to_bytes(2, "big"), name, b"\0", payload))


def acknowledgements(numbers: Sequence[int]) -> bytes:
    """What acknowledges messages of quality of service 1 by their numbers."""
    table = np.empty((len(numbers), 2), dtype=">u2")
    table[:, 0], table[:, 1] = PUBACK, numbers
    return table.tobytes()


def parts(packets: Iterable[bytes]) -> Iterator[Part]:
    """Packets, one after another, in parts that a socket takes at once."""
    waiting, size = list[bytes](), 0
    for packet in packets:
        waiting.append(packet)
        size += len(packet)
        if size >= PART_BYTES:
            yield Part(b"".join(waiting), len(waiting))
            waiting, size = [], 0
    if waiting:
        yield Part(b"".join(waiting), len(waiting))


class Outgoing:
    """Results on their way to a broker: a slow one leaves up to MAX_WAITING_BYTES of them here, and of more the oldest
    are dropped and counted. Used in any thread. client: of the broker; it has no function that sends packets as they
    are, and takes any bytes as a packet.
    """

    def __init__(self, client: Any) -> None:
        self._client, self._is_open, self._lock = client, False, threading.RLock()
        self._waiting = deque[Part]()
        self._waiting_bytes = self._handed_bytes = 0
        # Messages that were dropped.
        self.dropped = 0

    def open(self) -> None:
        """The connection is there."""
        with self._lock:
            self._is_open = True

    def close(self) -> None:
        """The connection is lost, and with it what waits for it."""
        with self._lock:
            self._is_open, self._waiting_bytes = False, 0
            self._waiting.clear()

    def put(self, packets: Iterable[bytes]) -> None:
        """Send packets; without a connection none waits."""
        new = list(parts(packets))
        with self._lock:
            if not self._is_open:
                return
            self._waiting += new
            self._waiting_bytes += sum(len(part.packets) for part in new)
            self._hand_over()
            while self._waiting_bytes > MAX_WAITING_BYTES:
                self.dropped += self._next().messages

    def _next(self) -> Part:
        part = self._waiting.popleft()
        self._waiting_bytes -= len(part.packets)
        return part

    def _hand_over(self) -> None:
        while self._waiting and self._handed_bytes < MAX_HANDED_BYTES:
            packets = self._next().packets
            self._handed_bytes += len(packets)
            self._client._packet_queue(PUBLISH, packets, 0, 0, Handed(len(packets), self._sent))

    def _sent(self, size: int) -> None:
        with self._lock:
            self._handed_bytes -= size
            # While it connects again the client goes through what it had: nothing may be added then.
            if self._is_open:
                self._hand_over()


class Handed:
    """A part that the client has; sent: takes its bytes once they are sent, or lost with their connection."""

    def __init__(self, size: int, sent: Callable[[int], None]) -> None:
        self._size, self._sent = size, sent
        self.rc = 0

    def _set_as_published(self) -> None:
        """As the client calls it for a message of its own."""
        self._sent(self._size)
