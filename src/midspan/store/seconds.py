"""Seconds of rows as a table of PostgreSQL that others read with SQL: Grafana, psql, a spreadsheet.

The blocks are made for midspan itself, compressed. A second may come in two chunks: the later one is merged into what
the table has, but for the rounding of its means (REAL): no row is ever given twice.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from midspan.records import NANOSECONDS
from midspan.store.chunk import Chunk
from midspan.store.database import Database, PostgresDatabase
from midspan.store.summary import entries

# Names and units are those of `series` of the interface; of rows that are lost there is a status alone.
SECOND_TABLE = (
    "CREATE TABLE IF NOT EXISTS displacement_1s (point TEXT NOT NULL, stream TEXT NOT NULL, "
    "time TIMESTAMPTZ NOT NULL, rows INTEGER NOT NULL, displacement_mm_min REAL, displacement_mm_max REAL, "
    "displacement_mm_mean REAL, displacement_std_mm REAL, status SMALLINT NOT NULL, "
    "PRIMARY KEY (point, stream, time))"
)
MERGE = (
    "INSERT INTO displacement_1s AS old SELECT ?, ?, to_timestamp(t), n, low, high, mean, std, status FROM "
    "unnest(?::bigint[], ?::int[], ?::real[], ?::real[], ?::real[], ?::real[], ?::smallint[]) "
    "AS new (t, n, low, high, mean, std, status) ON CONFLICT (point, stream, time) DO UPDATE SET "
    "rows = old.rows + excluded.rows, "
    "displacement_mm_min = LEAST(old.displacement_mm_min, excluded.displacement_mm_min), "
    "displacement_mm_max = GREATEST(old.displacement_mm_max, excluded.displacement_mm_max), "
    "displacement_mm_mean = (COALESCE(old.displacement_mm_mean * old.rows, 0) + "
    "COALESCE(excluded.displacement_mm_mean * excluded.rows, 0)) / NULLIF(old.rows + excluded.rows, 0), "
    "displacement_std_mm = GREATEST(old.displacement_std_mm, excluded.displacement_std_mm), "
    "status = GREATEST(old.status, excluded.status)"
)
MM_PER_M = 1e3


def merge(database: Database, chunk: Chunk) -> None:
    """Add the seconds of a chunk, in the transaction that keeps its rows. Raises StoreFault."""
    made = entries(chunk)
    first_s = int(chunk.time_ns[0]) // NANOSECONDS
    figures = (_or_null(MM_PER_M * made[name], made["n"] > 0) for name in ("low", "high", "mean", "std"))
    times = (first_s + made["second"].astype(np.int64)).tolist()
    values = (chunk.point, chunk.stream, times, made["n"].tolist(), *figures, made["status"].tolist())
    database.execute(MERGE, values)


def forget_before(database: PostgresDatabase, time_ns: int) -> None:
    """Remove the seconds before a time."""
    database.delete("displacement_1s", "time < to_timestamp(?)", (time_ns // NANOSECONDS,))


def forget_since(database: Database, point: str, time_ns: int) -> list[str]:
    """Remove a point's seconds from the one on that a time is in; returns the streams that have any."""
    streams = database.execute("SELECT DISTINCT stream FROM displacement_1s WHERE point = ?", (point,))
    sql = "DELETE FROM displacement_1s WHERE point = ? AND time >= to_timestamp(?)"
    database.execute(sql, (point, time_ns // NANOSECONDS))
    return [str(stream) for (stream,) in streams]


def _or_null(values: NDArray[Any], known: NDArray[np.bool_]) -> list[float | None]:
    return [float(value) if good else None for value, good in zip(values, known & np.isfinite(values), strict=True)]
