"""What a store has of whom: which days there are of each stream, and the points of each group."""

from collections.abc import Iterable
from contextlib import AbstractContextManager

import numpy as np
from numpy.typing import NDArray

from midspan.records import member_of
from midspan.store.database import Database
from midspan.store.days import DAY_NS, Day, Days
from midspan.store.group_rows import GROUP, MAGIC, ROWS, grown, member_names
from midspan.store.pieces import Pieces

Place = tuple[str, str, int]

TABLES = (
    # Which days there are of each stream, so that nobody has to open all of them for that; of a group once for all.
    "CREATE TABLE IF NOT EXISTS kept (point TEXT NOT NULL, stream TEXT NOT NULL, day BIGINT NOT NULL, "
    "PRIMARY KEY (point, stream, day))",
    # The points of which a group has rows: bit k of byte n is point 8 n + k. part: of a site in shards, which.
    "CREATE TABLE IF NOT EXISTS grouped (name TEXT NOT NULL, part TEXT NOT NULL, members {blob} NOT NULL, "
    "PRIMARY KEY (name, part))",
)
NOTE = "INSERT INTO kept VALUES (?, ?, ?) ON CONFLICT DO NOTHING"


class Kept:
    """What is kept in days and pieces."""

    def __init__(self, site: Database, days: Days, pieces: Pieces) -> None:
        self._site, self._days, self._pieces = site, days, pieces

    def transaction(self) -> AbstractContextManager[None]:
        """A block whose statements take effect together, or not at all."""
        return self._site.transaction()

    def note(self, places: Iterable[Place]) -> None:
        """Keep that there are days of streams."""
        self._site.execute_many(NOTE, sorted(places))

    def note_days(self) -> list[Place]:
        """Keep what all days have, of the points of a group once for all, and which points these are. What the days
        have, by point.
        """
        found, noted, numbers = set[Place](), set[Place](), dict[str, list[int]]()
        for day in self._days.all():
            for point, stream, number in day.streams():
                found.add((point, stream, number))
                member = member_of(point) if _is_of_a_group(day, point, stream) else None
                noted.add((point, stream, number) if member is None else (member[0], GROUP, number))
                if member is not None:
                    numbers.setdefault(member[0], []).append(member[1])
        self.note(noted)
        for name, own in numbers.items():
            members = grown(self.members(name), np.array(own, dtype=np.uint32), 0)
            if not members[own].all():
                members[own] = True
                self.note_members(name, "", members)
        return sorted(found)

    def note_members(self, name: str, part: str, members: NDArray[np.bool_]) -> None:
        """Keep which points of a group there are: members (m,), by their number."""
        sql = "INSERT INTO grouped VALUES (?, ?, ?) ON CONFLICT (name, part) DO UPDATE SET members = excluded.members"
        self._site.execute(sql, (name, part, np.packbits(members, bitorder="little").tobytes()))

    def members(self, name: str, part: str | None = None) -> NDArray[np.bool_]:
        """Which points of a group there are, by their number; part: in one shard, None: in all."""
        found = np.zeros(0, dtype=np.bool_)
        if not self._site.has_table("grouped"):
            return found
        for one, body in self._site.execute("SELECT part, members FROM grouped WHERE name = ?", (name,)):
            if part in (None, str(one)):
                more = np.unpackbits(np.frombuffer(body, dtype=np.uint8), bitorder="little").astype(np.bool_)
                longer, shorter = (more, found) if len(more) > len(found) else (found, more)
                longer[: len(shorter)] |= shorter
                found = longer
        return found

    @property
    def groups(self) -> list[str]:
        """The names of the groups of which rows are kept, sorted."""
        if not self._site.has_table("grouped"):
            return []
        return sorted({str(row[0]) for row in self._site.execute("SELECT DISTINCT name FROM grouped")})

    def group_of(self, point: str) -> str | None:
        """The group that a point is of; None: of none."""
        member = member_of(point)
        if member is None:
            return None
        name, number = member
        members = self.members(name)
        return name if number < len(members) and members[number] else None

    @property
    def points(self) -> set[str]:
        """The points of which there are days or pieces."""
        found = {point for point, stream, _ in self._pieces.streams() if stream != GROUP}
        for name in self.groups:
            found |= set(member_names(name, self.members(name)))
        if not self._site.has_table("kept"):
            return found | {point for point, _, _ in self._of_days()}
        sql = "SELECT DISTINCT point FROM kept WHERE stream <> ?"
        return found | {str(row[0]) for row in self._site.execute(sql, (GROUP,))}

    def streams(self, point: str) -> list[str]:
        """The names of a point's streams, sorted."""
        found = {stream for one, stream, _ in self._pieces.streams() if one == point and stream != GROUP}
        if self.group_of(point) is not None:
            found.add(ROWS)
        if not self._site.has_table("kept"):
            return sorted(found | {stream for one, stream, _ in self._of_days() if one == point})
        sql = "SELECT DISTINCT stream FROM kept WHERE point = ? AND stream <> ?"
        return sorted(found | {str(row[0]) for row in self._site.execute(sql, (point, GROUP))})

    def days(self, point: str, stream: str) -> list[int]:
        """The days (since 1970, UTC) of which a stream has rows, sorted."""
        places = [(point, stream)]
        if stream == ROWS and (name := self.group_of(point)) is not None:
            places.append((name, GROUP))
        found = {t0_ns // DAY_NS for *place, t0_ns in self._pieces.streams() if tuple(place) in places}
        if not self._site.has_table("kept"):
            return sorted(found | {day for *place, day in self._of_days() if tuple(place) in places})
        for place in places:
            rows = self._site.execute("SELECT day FROM kept WHERE point = ? AND stream = ?", place)
            found |= {int(row[0]) for row in rows}
        return sorted(found)

    def days_of_group(self, name: str) -> list[int]:
        """The days of which a group has blocks, sorted."""
        if not self._site.has_table("kept"):
            return []
        rows = self._site.execute("SELECT day FROM kept WHERE point = ? AND stream = ?", (name, GROUP))
        return sorted(int(row[0]) for row in rows)

    def _of_days(self) -> set[Place]:
        """Point, stream and day of a store of schema 1 that is only read, from its days."""
        return set().union(*(day.streams() for day in self._days.all()))


def _is_of_a_group(day: Day, point: str, stream: str) -> bool:
    """Whether the blocks of a stream are those of a point of a group."""
    if stream != ROWS or member_of(point) is None:
        return False
    head = day.head(point, stream, day.begins(point, stream)[-1], len(MAGIC))
    return head is not None and head[1] == MAGIC
