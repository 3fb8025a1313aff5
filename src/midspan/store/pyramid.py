"""The pyramid of a store: least and largest values of spans that are longer than a block, in the site's database."""

from collections.abc import Iterable

import numpy as np

from midspan.records import NANOSECONDS, Floats, Nanoseconds
from midspan.store.blocks import floor_ns
from midspan.store.database import Database
from midspan.store.days import DAY_NS, Days

# The pyramid's levels and the lengths of their spans, s (43 min, 11.4 h). Schema 1 has one of 160 s below.
LEVELS_S = {1: 2560.0, 2: 40960.0}
TABLE = (
    "CREATE TABLE IF NOT EXISTS pyramid (point TEXT NOT NULL, stream TEXT NOT NULL, level BIGINT NOT NULL, "
    "t0_ns BIGINT NOT NULL, n BIGINT NOT NULL, low DOUBLE PRECISION, high DOUBLE PRECISION, "
    "PRIMARY KEY (point, stream, level, t0_ns))"
)
PUT = (
    "INSERT INTO pyramid VALUES (?, ?, ?, ?, 0, ?, ?) ON CONFLICT (point, stream, level, t0_ns) "
    "DO UPDATE SET low = excluded.low, high = excluded.high"
)
WIDEN = (
    "INSERT INTO pyramid AS old VALUES (?, ?, ?, ?, 0, ?, ?) ON CONFLICT (point, stream, level, t0_ns) DO UPDATE SET "
    "low = CASE WHEN excluded.low < old.low THEN excluded.low ELSE old.low END, "
    "high = CASE WHEN excluded.high > old.high THEN excluded.high ELSE old.high END"
)
Values = tuple[Nanoseconds, Floats, Floats]


class Pyramid:
    """Spans above the blocks of days."""

    def __init__(self, site: Database, days: Days) -> None:
        self._site, self._days = site, days

    def build(self, places: set[tuple[str, str, int]]) -> None:
        """Make the spans above some places anew, from what is below each: right however often it is done."""
        for level, length_s in LEVELS_S.items():
            length_ns = round(length_s * NANOSECONDS)
            for point, stream, begin_ns in sorted({(p, s, floor_ns(t, length_s)) for p, s, t in places}):
                span = (point, stream, begin_ns, begin_ns + length_ns)
                low, high = (self.spans(*span, level - 1) if level - 1 in LEVELS_S else self.limits(*span))[1:]
                if len(low):
                    values = (point, stream, level, begin_ns, float(low.min()), float(high.max()))
                    self._site.execute(PUT, values)

    def widen(self, stream: str, blocks: Iterable[tuple[str, int, float, float]]) -> None:
        """Take in blocks of points of a group: each with its point, begin, least and largest value."""
        rows = [
            (point, stream, level, floor_ns(t0_ns, length_s), low, high)
            for point, t0_ns, low, high in blocks
            for level, length_s in LEVELS_S.items()
        ]
        self._site.execute_many(WIDEN, rows)

    def forget_since(self, point: str, time_ns: int) -> None:
        """Remove the spans of a point from the one on that an instant is in."""
        for level, length_s in LEVELS_S.items():
            sql = "DELETE FROM pyramid WHERE point = ? AND level = ? AND t0_ns >= ?"
            self._site.execute(sql, (point, level, floor_ns(time_ns, length_s)))

    def spans(self, point: str, stream: str, first_ns: int, last_ns: int, level: int) -> Values:
        """Begins, least and largest values of the spans of a level."""
        where = "WHERE point = ? AND stream = ? AND t0_ns >= ? AND t0_ns < ? AND low IS NOT NULL AND level = ?"
        place = (point, stream, first_ns, last_ns, level)
        rows = self._site.execute(f"SELECT t0_ns, low, high FROM pyramid {where} ORDER BY t0_ns", place)
        found = np.array(rows, dtype=np.float64).reshape(-1, 3)
        return np.array([row[0] for row in rows], dtype=np.int64), found[:, 1], found[:, 2]

    def limits(self, point: str, stream: str, first_ns: int, last_ns: int) -> Values:
        """Begins, least and largest values of blocks."""
        days = self._days.between(first_ns // DAY_NS, last_ns // DAY_NS)
        found = [day.limits(point, stream, first_ns, last_ns) for day in days]
        nothing = (np.empty(0, np.int64), np.empty(0), np.empty(0))
        begins, low, high = (np.concatenate(parts) for parts in zip(nothing, *found, strict=True))
        return begins, low, high

    @property
    def points(self) -> list[str]:
        """The points that have any, by one search of the index each."""
        sql = (
            "WITH RECURSIVE named (point) AS (SELECT MIN(point) FROM pyramid UNION ALL "
            "SELECT (SELECT MIN(pyramid.point) FROM pyramid WHERE pyramid.point > named.point) FROM named "
            "WHERE named.point IS NOT NULL) SELECT point FROM named WHERE point IS NOT NULL"
        )
        return [str(row[0]) for row in self._site.execute(sql)]
