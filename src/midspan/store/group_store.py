"""What a store writes of groups: a pack a second, with it the state that it leads to; and blocks by point of these."""

from collections.abc import Iterator, Sequence
from itertools import groupby

import numpy as np
from numpy.typing import NDArray

from midspan import _core
from midspan.errors import DataError
from midspan.records import NANOSECONDS, Nanoseconds, member_name
from midspan.store import summary
from midspan.store.database import Database
from midspan.store.days import BLOCK_S, DAY_NS, Day, Days
from midspan.store.group_rows import (
    GROUP,
    ROWS,
    GroupChunk,
    end_ns,
    grown,
    in_slots,
    length_ns,
    newer,
    newest_of,
    packed,
    stride,
)  # fmt: skip
from midspan.store.group_state import NO_ROWS_NS, GroupState, StateFiles
from midspan.store.kept import Kept
from midspan.store.parts import keep_checkpoint, kept_checkpoint
from midspan.store.pieces import SYNC_S, Piece, Pieces, pack_piece
from midspan.store.pyramid import Pyramid

SLOT_NS = length_ns(BLOCK_S)
# Rows come again within a broker's session: where the newest row of a silent point is, nobody looks further back.
LOOK_BACK_DAYS = 8


class StateTable:
    """The states of groups among the checkpoints of a database."""

    def __init__(self, database: Database) -> None:
        self._database = database

    def put(self, key: str, state: GroupState, *, lasting: bool = True) -> None:
        """Keep a state: the server has the rows that it rests on. Raises StoreFault."""
        with self._database.transaction():
            keep_checkpoint(self._database, key, state.time_ns, [state.body])

    def get(self, key: str) -> list[GroupState]:
        """The newest state, where there is one. Raises DataError for a damaged one."""
        kept = kept_checkpoint(self._database, key) if self._database.has_table("checkpoint") else None
        return [] if kept is None else [GroupState(*kept)]

    def close(self) -> None:
        """The connection is the site's."""


class Groups:
    """The groups of a store."""

    def __init__(
        self, kept: Kept, pyramid: Pyramid, days: Days, pieces: Pieces, states: StateFiles | StateTable
    ) -> None:
        self._kept, self._pyramid, self._days, self._pieces, self.states = kept, pyramid, days, pieces, states
        # By the key of the group.
        self._newest: dict[str, Nanoseconds] = {}
        self._members: dict[str, NDArray[np.bool_]] = {}
        # The instant of the newest lasting state.
        self._lasting_ns: dict[str, int] = {}

    def new_packs(self, chunk: GroupChunk) -> list[Piece]:
        """The rows that are not kept yet as packs, none of which reaches over the end of a block.

        Raises ValueError where the runs of a point overlap.
        """
        if chunk.key not in self._newest:
            self._newest[chunk.key] = self._newest_kept(chunk.name, chunk.part)
        newest_ns = grown(self._newest[chunk.key], chunk.rows.point, NO_ROWS_NS)
        rows = newer(chunk.rows, newest_ns)
        packs = [
            pack_piece(chunk.name, chunk.part, (int(part.t0_ns.min()), int(end_ns(part).max())), packed(part))
            for part in in_slots(rows, SLOT_NS)
        ]
        if packs:
            self._note(chunk, rows.point)
            np.maximum.at(newest_ns, rows.point, end_ns(rows))
        self._newest[chunk.key] = newest_ns
        return packs

    def is_due(self, chunk: GroupChunk) -> bool:
        """Whether the state that a chunk leads to should last: it is the first one, or the last such is old."""
        lasting_ns = self._lasting_ns.get(chunk.key)
        return chunk.checkpoint is not None and (
            lasting_ns is None or abs(chunk.checkpoint[0] - lasting_ns) >= SYNC_S * NANOSECONDS
        )

    def put_state(self, chunk: GroupChunk, *, lasting: bool) -> None:
        """Keep the state that a chunk leads to, after its rows; lasting: these are on the disk. Raises StoreFault."""
        if chunk.checkpoint is not None:
            rows_ns = int(self._newest[chunk.key].max(initial=NO_ROWS_NS))
            self.states.put(chunk.key, GroupState(*chunk.checkpoint, rows_ns), lasting=lasting)
            if lasting:
                self._lasting_ns[chunk.key] = chunk.checkpoint[0]

    def checkpoint(self, key: str) -> tuple[int, bytes] | None:
        """The newest state and its instant (ns) of those whose rows are kept: a power cut may have taken the rows of a
        newer one. Raises DataError where all are damaged.
        """
        name, _, part = key.partition(" ")
        whole = (one for one in self.states.get(key) if self._has_rows(name, part, one.rows_ns))
        return next(((one.time_ns, one.body) for one in whole), None)

    def _has_rows(self, name: str, part: str, until_ns: int) -> bool:
        """Whether rows of a part of a group are kept up to an instant."""
        if until_ns == NO_ROWS_NS or any(
            one.shown == part and one.t1_ns >= until_ns for one in self._pieces.packs(name)
        ):
            return True
        numbers = np.flatnonzero(self._members_of(name, part))
        for number in reversed(self._kept.days_of_group(name)):
            for day in self._days.between(number, number):
                if newest := [newest_ns for _, newest_ns in _newest_in(day, name, numbers)]:
                    return max(newest) >= until_ns
        return False

    def forget_newest(self) -> None:
        """What was thought to be kept may not be."""
        self._newest.clear()

    def make_blocks(self, packs: Sequence[Piece]) -> None:
        """Make blocks of packs in the order of their writing; those that are blocks already are left out. Each slot's
        are in one transaction, after what the site's file says of them, so that it may be done again after a kill in
        the middle.
        """
        for name in sorted({one.point for one in packs}):
            own = [one for one in packs if one.point == name]
            for slot, of_slot in groupby(sorted(own, key=_slot), key=_slot):
                self._make_slot(name, slot * SLOT_NS // DAY_NS, list(of_slot))

    def _make_slot(self, name: str, number: int, packs: Sequence[Piece]) -> None:
        day = self._days.of(number)
        points = newest_of([one.body for one in packs], 0, NO_ROWS_NS) > NO_ROWS_NS
        after_ns = np.full(len(points), NO_ROWS_NS, dtype=np.int64)
        for point, newest_ns in _newest_in(day, name, np.flatnonzero(points)):
            after_ns[point] = newest_ns
        try:
            found = _core.pack_blocks(_core.join_packs([one.body for one in packs], after_ns))
        except ValueError as error:
            raise DataError(f"The store's log holds damaged rows of the group {name} ({error}).") from None
        rows = [
            (member_name(name, point), ROWS, t0_ns, t1_ns, count, low, high, summary.packed(seconds), pack)
            for point, t0_ns, t1_ns, count, low, high, seconds, pack in found
        ]
        limits = [
            (member_name(name, point), t0_ns, low, high)
            for point, t0_ns, _, _, low, high, *_ in found
            if low is not None and high is not None
        ]
        # First, as this may be done again: of packs that are blocks already the next time gives no limits.
        with self._kept.transaction():
            self._kept.note([(name, GROUP, number)])
            self._pyramid.widen(ROWS, limits)
        with day.database.transaction():
            day.insert_blocks(number, rows)

    def _note(self, chunk: GroupChunk, point: NDArray[np.uint32]) -> None:
        """Keep which points there are, before anything of new ones is."""
        if chunk.key not in self._members:
            self._members[chunk.key] = self._kept.members(chunk.name, chunk.part)
        members = grown(self._members[chunk.key], point, 0)
        if not members[point].all():
            members = members.copy()
            members[point] = True
            self._kept.note_members(chunk.name, chunk.part, members)
            self._members[chunk.key] = members

    def _members_of(self, name: str, part: str) -> NDArray[np.bool_]:
        """Which points of a part there are, by their number, whoever wrote them."""
        first, step = stride(part)
        members = self._kept.members(name)
        members[np.arange(len(members)) % step != first] = False
        return members

    def _newest_kept(self, name: str, part: str) -> Nanoseconds:
        """The stamp of the newest row of each point of a part, by its number, whoever wrote it: another number of
        shards has other parts.
        """
        members, (first, step) = self._members_of(name, part), stride(part)
        packs = self._pieces.packs(name)
        newest_ns = newest_of((one.body for one in packs if one.shown == part), len(members), NO_ROWS_NS)
        looked: list[Day] = []
        for number in self._kept.days_of_group(name)[: -LOOK_BACK_DAYS - 1 : -1]:
            missing = np.flatnonzero(members & (newest_ns[: len(members)] == NO_ROWS_NS))
            for day in self._days.between(number, number) if len(missing) else ():
                if day not in looked:
                    looked.append(day)
                    for one, one_ns in _newest_in(day, name, missing):
                        newest_ns[one] = one_ns
        others = newest_of((one.body for one in packs if stride(one.shown)[1] != step), len(newest_ns), NO_ROWS_NS)
        others[: len(newest_ns)] = np.maximum(others[: len(newest_ns)], newest_ns)
        others[np.arange(len(others)) % step != first] = NO_ROWS_NS
        return others


def _slot(piece: Piece) -> int:
    return piece.t0_ns // SLOT_NS


def _newest_in(day: Day, name: str, numbers: NDArray[np.intp]) -> Iterator[tuple[int, int]]:
    """Number and newest stamp of the points of a group that a day has blocks of."""
    by_name = {member_name(name, number): number for number in numbers.tolist()}
    for point, newest_ns in day.newest_of(list(by_name), ROWS):
        yield by_name[point], newest_ns
