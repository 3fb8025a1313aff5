"""Blocks of values from a serial line: one JSON object a line, as over MQTT, with an optional check sum.

A line is `{"sequence": 7, "t0": "2026-11-22T10:00:00.000Z", "dt_s": 0.01, "values": [...]}`, then optionally `*HH`:
the exclusive or of all bytes before the asterisk, in hexadecimal, as in NMEA 0183. A sender without a clock leaves
`t0` out: its blocks are dated by their arrivals.
"""

import errno
import time
from collections.abc import Iterator
from functools import reduce
from operator import xor

from midspan.records import NANOSECONDS
from midspan.sources.live.blocks import MAX_BYTES, SEQUENCES, Block, parse
from midspan.sources.live.instants import LOOK_S, ArrivalEnvelope, Ended, SourceFault, never

DEFAULT_BAUD = 115_200
# More values than that are not lost on a line, which needs minutes for them: the sender was started again.
MAX_LOST_VALUES = 1_000_000
# Nothing for so long ends the reading, s.
SILENT_S = 10.0


def device_and_baud(address: str) -> tuple[str, int]:
    """The device and the speed of `/dev/ttyUSB0` or `/dev/ttyUSB0@9600`. Raises ValueError."""
    device, at, baud = address.partition("@")
    if not device or (at and not baud.isdecimal()) or (at and not 300 <= int(baud) <= 4_000_000):
        raise ValueError("must be a device, with a speed of 300 to 4000000 if need be: /dev/ttyUSB0@9600")
    return device, int(baud) if at else DEFAULT_BAUD


class Dating:
    """Instants of blocks without stamps: values are counted, and the least delay of arrival that was seen is none."""

    def __init__(self) -> None:
        self._envelope = ArrivalEnvelope()
        self._next: int | None = None
        self._stream_s = 0.0

    def t0_ns(self, sequence: int, dt_s: float, count: int, arrived_ns: int) -> int:
        """The stamp of a block's first value; arrived_ns: when its last byte came."""
        lost = 0 if self._next is None else (sequence - self._next) % SEQUENCES
        if lost > SEQUENCES // 2 or lost * count > MAX_LOST_VALUES:
            self._envelope, self._stream_s, lost = ArrivalEnvelope(), 0.0, 0
        self._stream_s += (lost + 1) * count * dt_s
        self._next = (sequence + 1) % SEQUENCES
        return self._envelope.instant_ns(self._stream_s, arrived_ns) - round(count * dt_s * NANOSECONDS)


def block_of(line: bytes, kind: int, dating: Dating, arrived_ns: int) -> Block:
    """The block of one line; SourceFault with code `payload` for any other."""
    text = line.strip()
    body, star, given = text.rpartition(b"*")
    if star and b"}" not in given:
        if given.upper() != b"%02X" % reduce(xor, body, 0):
            raise SourceFault("payload", "a line whose check sum is wrong")
        text = body
    if not text.startswith(b"{"):
        raise SourceFault("payload", f"a line must be one block as JSON, {{…}}; received one that begins {text[:16]!r}")
    return parse(text, kind, lambda sequence, dt_s, count: dating.t0_ns(sequence, dt_s, count, arrived_ns))


def blocks(address: str, kind: int, ended: Ended = never) -> Iterator[Block | SourceFault]:
    """The blocks of a line, and a fault for each line that is none, until it fails or `ended` is true.

    Raises SourceFault with one of the codes not_found, unauthorized, no_answer, stopped.
    """
    import serial

    device, baud = device_and_baud(address)
    try:
        line = serial.Serial(device, baud, timeout=LOOK_S)
    except serial.SerialException as error:
        if error.errno in (errno.EACCES, errno.EPERM):
            raise SourceFault("unauthorized", f"this user has no permission to open {device}") from None
        raise SourceFault("not_found", f"{device} cannot be opened ({error.strerror or error})") from None
    dating, heard, received, ended_s = Dating(), False, b"", time.monotonic()
    with line:
        while not ended():
            try:
                received += line.read_until(b"\n", MAX_BYTES - len(received))
            except (serial.SerialException, OSError) as error:
                raise SourceFault("stopped", f"{device} cannot be read ({error})") from None
            arrived_ns = time.time_ns()
            if not received.endswith(b"\n") and len(received) < MAX_BYTES:
                if time.monotonic() - ended_s > SILENT_S:
                    code = "stopped" if heard else "no_answer"
                    raise SourceFault(code, f"{device}: no line for {SILENT_S:g} s")
                continue
            text, received, ended_s = received, b"", time.monotonic()
            if not text.endswith(b"\n"):
                yield SourceFault("payload", f"a line of more than {MAX_BYTES} bytes")
                continue
            if not heard:
                # The first line may have begun before the port was opened.
                heard = True
                if not text.lstrip().startswith(b"{"):
                    continue
            if text.strip():
                try:
                    yield block_of(text, kind, dating, arrived_ns)
                except SourceFault as fault:
                    yield fault
