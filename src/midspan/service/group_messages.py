"""Messages of a group's sensors as blocks of many points: those of one length are read at once, as one table."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from midspan.records import NANOSECONDS, Nanoseconds
from midspan.sources.live.blocks import FIRST_NS, HEAD, LAST_NS, MAX_STEP_NS, MIN_STEP_NS, VERSION, Block, parse
from midspan.sources.live.instants import SourceFault

# Stamps that far ahead of this machine's clock are refused, s.
AHEAD_S = 1.0
# The kinds of blocks that carry all points of a group: of accelerations and displacements.
OF_ALL = {1: 4, 2: 5}
FIELDS = [
    ("version", "u1"), ("kind", "u1"), ("reserved", "<u2"), ("sequence", "<u4"), ("t0_ns", "<i8"), ("dt_ns", "<i8"),
    ("n", "<u4"),
]  # fmt: skip
# What JSON begins with, as `blocks.parse` has it.
TEXT = np.frombuffer(b"{ \n", dtype=np.uint8)


@dataclass(frozen=True, slots=True)
class PointBlocks:
    """Blocks (m,) of points by their place in the bank: values at t0_ns (UTC) and every dt_ns after, one block after
    another, in the sender's unit.
    """

    point: NDArray[np.uint32]
    t0_ns: Nanoseconds
    dt_ns: Nanoseconds
    count: NDArray[np.uint32]
    values: NDArray[np.float32] | NDArray[np.float64]

    @property
    def end_ns(self) -> Nanoseconds:
        """Stamps (m,) of the last values."""
        return self.t0_ns + self.dt_ns * (self.count.astype(np.int64) - 1)

    def part(self, wanted: NDArray[np.bool_]) -> "PointBlocks":
        """Those blocks (m,) that are wanted."""
        values = self.values[np.repeat(wanted, self.count)]
        return PointBlocks(self.point[wanted], self.t0_ns[wanted], self.dt_ns[wanted], self.count[wanted], values)


@dataclass(slots=True)
class Refusals:
    """How many blocks could not be used, by code, and why the newest of each."""

    counts: dict[str, int] = field(default_factory=dict)
    texts: dict[str, str] = field(default_factory=dict)

    @property
    def count(self) -> int:
        """How many of all codes."""
        return sum(self.counts.values())

    def add(self, fault: SourceFault, count: int = 1) -> None:
        """Count messages with one fault."""
        self.counts[fault.code] = self.counts.get(fault.code, 0) + count
        self.texts[fault.code] = str(fault)


def of_points(kind: int, points: Sequence[int], payloads: Sequence[bytes], refused: Refusals) -> list[PointBlocks]:
    """Messages of single points, each with its point's place, of a kind (1 or 2)."""
    by_length: dict[int, list[int]] = {}
    for place, payload in enumerate(payloads):
        by_length.setdefault(len(payload), []).append(place)
    found = list[PointBlocks]()
    for length, places in by_length.items():
        of_length = [payloads[place] for place in places] if len(by_length) > 1 else payloads
        number = np.array([points[place] for place in places], dtype=np.uint32)
        even = length >= HEAD.size and (length - HEAD.size) % 4 == 0
        taken = _table(kind, length, number, of_length, found) if even else np.zeros(len(places), dtype=np.bool_)
        _read_singly(
            kind, number[~taken], [of_length[place] for place in np.flatnonzero(~taken).tolist()], found, refused
        )
    return found


def _table(
    kind: int, length: int, point: NDArray[np.uint32], payloads: Sequence[bytes], found: list[PointBlocks]
) -> NDArray[np.bool_]:
    """Read payloads of one length into `found`; which of them (m,) were blocks as documented."""
    count = (length - HEAD.size) // 4
    table = np.frombuffer(b"".join(payloads), dtype=np.dtype([*FIELDS, ("values", "<f4", (count,))]))
    good: NDArray[np.bool_] = (table["version"] == VERSION) & (table["kind"] == kind) & (table["n"] == count)
    good &= (table["t0_ns"] >= FIRST_NS) & (table["t0_ns"] <= LAST_NS)
    good &= (table["dt_ns"] >= MIN_STEP_NS) & (table["dt_ns"] <= MAX_STEP_NS)
    if count and good.any():
        own = table if good.all() else table[good]
        counts = np.full(len(own), count, dtype=np.uint32)
        values = np.ascontiguousarray(own["values"]).reshape(-1)
        found.append(PointBlocks(point[good], own["t0_ns"].copy(), own["dt_ns"].copy(), counts, values))
    return good


def _read_singly(
    kind: int, point: NDArray[np.uint32], payloads: Sequence[bytes], found: list[PointBlocks], refused: Refusals
) -> None:
    """JSON, and what is no block: of the latter the first says why, the others are counted."""
    blocks, places = list[Block](), list[int]()
    wrong = 0
    for place, payload in enumerate(payloads):
        if payload[:1] and payload[0] not in TEXT and wrong:
            wrong += 1
            continue
        try:
            block = parse(payload, kind)
        except SourceFault as fault:
            wrong += payload[:1] == b"" or payload[0] not in TEXT
            refused.add(fault, 1)
        else:
            if len(block.values):
                blocks.append(block)
                places.append(place)
    if wrong > 1:
        refused.counts["payload"] += wrong - 1
    if blocks:
        found.append(
            PointBlocks(
                point[places],
                np.array([one.t0_ns for one in blocks], dtype=np.int64),
                np.array([one.dt_ns for one in blocks], dtype=np.int64),
                np.array([len(one.values) for one in blocks], dtype=np.uint32),
                np.concatenate([one.values for one in blocks]),
            )
        )


def of_all(kind: int, points: int, numbers: range, payload: bytes) -> PointBlocks | None:
    """A message with the blocks of all points of a group, of a kind (4 or 5), those of `numbers` alone; None without
    values. Raises SourceFault for anything else.
    """
    size = HEAD.size + 4
    as_documented = f"messages of all points are binary and of kind {kind}; a topic with {{i}} is that of one point"
    if payload[:1] and payload[0] in TEXT:
        raise SourceFault("payload", f"a block must be as documented; received JSON where {as_documented}")
    if len(payload) < size:
        raise SourceFault("payload", f"a block must be as documented; received {len(payload)} bytes, fewer than a head")
    version, of_kind, _, _, t0_ns, dt_ns, count = HEAD.unpack_from(payload)
    in_it = int.from_bytes(payload[HEAD.size : size], "little")
    rules = (
        (version == VERSION, f"version {version}; this program reads version {VERSION}"),
        (of_kind == kind, f"kind {of_kind} where {kind} is expected: {as_documented}"),
        (in_it == points, f"{in_it} points; the group has {points}"),
        (len(payload) == size + 4 * points * count, f"{len(payload)} bytes for {points} points and {count} values"),
        (FIRST_NS <= t0_ns <= LAST_NS, f"a first stamp of {t0_ns} ns, outside the years 2000 to 2200 (UTC)"),
        (MIN_STEP_NS <= dt_ns <= MAX_STEP_NS, f"an interval of {dt_ns} ns; it must be a microsecond to an hour"),
    )
    if (wrong := next((text for holds, text in rules if not holds), None)) is not None:
        raise SourceFault("payload", f"a block must be as documented; received {wrong}")
    if not count:
        return None
    values = np.frombuffer(payload, dtype="<f4", offset=size).reshape(points, count)[numbers.start :: numbers.step]
    own = len(numbers)
    return PointBlocks(
        np.arange(own, dtype=np.uint32), np.full(own, t0_ns), np.full(own, dt_ns), np.full(own, count, dtype=np.uint32),
        np.ascontiguousarray(values).reshape(-1),
    )  # fmt: skip


def not_ahead(blocks: PointBlocks, now_ns: int, refused: Refusals) -> PointBlocks | None:
    """The blocks without stamps of the future, which are counted; None where none is left."""
    ahead_s = (int(blocks.end_ns.max()) - now_ns) / NANOSECONDS
    if ahead_s <= AHEAD_S:
        return blocks
    good = blocks.end_ns <= now_ns + round(AHEAD_S * NANOSECONDS)
    text = f"time stamps are {ahead_s:.6g} s ahead of this machine's clock; synchronise both by NTP"
    refused.add(SourceFault("clock_ahead", text), int(np.count_nonzero(~good)))
    return blocks.part(good) if good.any() else None
