"""Blocks of evenly timed values as they travel over MQTT: a binary form, and JSON, on the same topics."""

import json
import struct
from collections.abc import Callable
from dataclasses import dataclass
from datetime import datetime
from typing import TypeGuard

import numpy as np

from midspan.records import NANOSECONDS, Floats, Nanoseconds
from midspan.sources.live.instants import SourceFault

# Version, kind, reserved, sequence, stamp of the first value, interval (ns), count; little-endian.
HEAD = struct.Struct("<BBHIqqI")
VERSION = 1
ACCELERATION, DISPLACEMENT, RESULT = 1, 2, 3
# 4 and 5 are those of many points on one topic.
VELOCITY, ROTATION_RATE, ANGLE = 6, 7, 8
# A block lasts seconds: 250 000 values in binary are minutes of any sensor. A longer payload is refused before it is
# parsed, which would hold up the loop.
MAX_BYTES = 1_000_000
# From 2000 to 2200, ns: stamps outside are a clock that was never set.
FIRST_NS, LAST_NS = 946_684_800 * NANOSECONDS, 7_258_118_400 * NANOSECONDS
MIN_STEP_NS, MAX_STEP_NS = 1000, 3600 * NANOSECONDS
SEQUENCES = 2**32


Dated = Callable[[int, float, int], int]


@dataclass(frozen=True, slots=True)
class Block:
    """Values (n,) in the sender's unit at t0_ns (UTC) and every dt_ns after; std: their deviations (results only)."""

    kind: int
    sequence: int
    t0_ns: int
    dt_ns: int
    values: Floats
    std: Floats | None = None

    @property
    def time_ns(self) -> Nanoseconds:
        """Stamps (n,)."""
        return self.t0_ns + self.dt_ns * np.arange(len(self.values), dtype=np.int64)


def pack(block: Block) -> bytes:
    """The binary form: the head, the values as float32, then of a result their deviations as float32."""
    head = HEAD.pack(VERSION, block.kind, 0, block.sequence % SEQUENCES, block.t0_ns, block.dt_ns, len(block.values))
    values = np.asarray(block.values, dtype="<f4").tobytes()
    return head + values + (b"" if block.std is None else np.asarray(block.std, dtype="<f4").tobytes())


def parse(payload: bytes, kind: int, dated: Dated | None = None) -> Block:
    """The block of a payload, of the kind that the topic is for; SourceFault with code `payload` for any other.

    dated: the first stamp (ns) of JSON without t0, from sequence, interval (s) and count of values; None: it needs t0.
    """
    if len(payload) > MAX_BYTES:
        raise _refuse(f"{len(payload)} bytes; at most {MAX_BYTES} are accepted")
    block = _of_json(payload, kind, dated) if payload[:1] in (b"{", b" ", b"\n") else _of_bytes(payload, kind)
    if not FIRST_NS <= block.t0_ns <= LAST_NS:
        raise _refuse(f"a first stamp of {block.t0_ns} ns, outside the years 2000 to 2200 (UTC)")
    # A result of one row has no interval.
    if not (1 if kind == RESULT else MIN_STEP_NS) <= block.dt_ns <= MAX_STEP_NS:
        raise _refuse(f"an interval of {block.dt_ns} ns; it must be at least a microsecond and at most an hour")
    return block


def _of_bytes(payload: bytes, expected: int) -> Block:
    if len(payload) < HEAD.size:
        raise _refuse(f"{len(payload)} bytes; the head alone has {HEAD.size}")
    version, kind, _, sequence, t0_ns, dt_ns, count = HEAD.unpack_from(payload)
    if version != VERSION:
        raise _refuse(f"version {version}; this program reads version {VERSION}")
    if kind != expected:
        raise _refuse(f"kind {kind} where {expected} is expected")
    columns = 2 if kind == RESULT else 1
    if len(payload) != HEAD.size + 4 * count * columns:
        raise _refuse(f"{len(payload)} bytes, but {count} values need {HEAD.size + 4 * count * columns}")
    # A signalling NaN is one like any other.
    with np.errstate(invalid="ignore"):
        numbers = np.frombuffer(payload, dtype="<f4", offset=HEAD.size).astype(np.float64)
    std = numbers[count:] if kind == RESULT else None
    return Block(kind, sequence, t0_ns, dt_ns, numbers[:count], std)


def _of_json(payload: bytes, kind: int, dated: Dated | None) -> Block:
    try:
        tree = json.loads(payload)
    except (ValueError, RecursionError):
        raise _refuse("text that is no JSON") from None
    if not isinstance(tree, dict):
        raise _refuse("JSON that is no object")
    sequence, step_s, values = tree.get("sequence"), tree.get("dt_s"), tree.get("values")
    if type(sequence) is not int or not 0 <= sequence < SEQUENCES:
        raise _refuse("a sequence that is no whole number from 0 to 2^32 - 1")
    if not _is_number(step_s):
        raise _refuse("a dt_s that is no number")
    if not isinstance(values, list) or not all(one is None or _is_number(one) for one in values):
        raise _refuse("values that are no list of numbers (null: missing)")
    numbers = np.array([np.nan if one is None else float(one) for one in values])
    step_ns = round(min(max(step_s, -1e9), 1e9) * NANOSECONDS)
    if dated is not None and "t0" not in tree:
        t0_ns = dated(sequence, step_ns / NANOSECONDS, len(numbers))
    else:
        t0_ns = _instant(tree.get("t0"))
    return Block(int(kind), sequence, t0_ns, step_ns, numbers)


def _is_number(value: object) -> TypeGuard[float]:
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < 1e300


def _instant(value: object) -> int:
    """An instant in ns of ISO 8601 with a zone, or of whole nanoseconds."""
    if type(value) is int and abs(value) < 2**63:
        return value
    try:
        found = datetime.fromisoformat(str(value))
    except ValueError:
        raise _refuse("a t0 that is neither ISO 8601 nor nanoseconds since 1970") from None
    if found.tzinfo is None:
        raise _refuse("a t0 without a zone; write it in UTC with Z")
    try:
        return round(found.replace(microsecond=0).timestamp()) * NANOSECONDS + found.microsecond * 1000
    except (OverflowError, ValueError):
        raise _refuse("a t0 outside the years 2000 to 2200 (UTC)") from None


def _refuse(received: str) -> SourceFault:
    return SourceFault("payload", f"a block must be as documented; received {received}")
