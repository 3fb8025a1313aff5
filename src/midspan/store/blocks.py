"""Pieces of seconds joined to the blocks that the days keep."""

from collections.abc import Sequence

from midspan.records import NANOSECONDS
from midspan.store.chunk import Chunk, join, layout_of
from midspan.store.days import BLOCK_S, DAY_NS, REACH_NS
from midspan.store.pieces import Piece


def joined(chunks: Sequence[Chunk]) -> list[Chunk]:
    """Chunks, those of each stream in the order of time: as one what follows one another with one calibration, layout
    and day.
    """
    found: list[list[Chunk]] = []
    newest: dict[tuple[str, str], tuple[object, list[Chunk]]] = {}
    for one in chunks:
        kind = (one.time_ns[0] // DAY_NS, one.calibration, layout_of(one))
        before, parts = newest.get((one.point, one.stream), (None, []))
        if before != kind:
            parts = []
            found.append(parts)
        parts.append(one)
        newest[one.point, one.stream] = (kind, parts)
    return [join(parts) for parts in found]


def blocks_of(pieces: Sequence[Piece]) -> list[Chunk]:
    """Pieces as blocks."""
    whole = joined([piece.chunk() for piece in sorted(pieces, key=lambda one: (one.point, one.stream, one.t0_ns))])
    return [part for one in whole for part in ([one] if _length_ns(one) <= REACH_NS else one.split(BLOCK_S))]


def _length_ns(chunk: Chunk) -> int:
    return int(chunk.time_ns[-1] - chunk.time_ns[0])


def floor_ns(time_ns: int, length_s: float) -> int:
    """The begin of the span of a length that an instant is in."""
    length_ns = round(length_s * NANOSECONDS)
    return time_ns - time_ns % length_ns
