"""MQTT 5 packets of many messages as one: a client makes each alone, which costs as much as the rows themselves.

https://docs.oasis-open.org/mqtt/mqtt/v5.0/mqtt-v5.0.html, 3.3 PUBLISH and 3.4 PUBACK.
"""

from collections.abc import Iterable, Iterator, Sequence

import numpy as np

PUBLISH, PUBACK = 0x30, 0x4002
# Packets are handed over in parts of about this many bytes: what a socket takes at once.
PART_BYTES = 65_536


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


def parts(packets: Iterable[bytes]) -> Iterator[bytes]:
    """Packets, one after another, in parts that a socket takes at once."""
    waiting, size = list[bytes](), 0
    for packet in packets:
        waiting.append(packet)
        size += len(packet)
        if size >= PART_BYTES:
            yield b"".join(waiting)
            waiting, size = [], 0
    if waiting:
        yield b"".join(waiting)
