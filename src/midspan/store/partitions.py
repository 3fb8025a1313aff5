"""The blocks of a group's points in PostgreSQL: a table in parts, one a day (UTC), filled by COPY; an old day is a part
that is dropped.
"""

from collections.abc import Sequence
from datetime import date, timedelta
from typing import Any

from midspan.records import NANOSECONDS
from midspan.store.database import PostgresDatabase

TABLE = "group_block"
TABLES = (
    f"CREATE TABLE IF NOT EXISTS {TABLE} (point TEXT NOT NULL, stream TEXT NOT NULL, t0_ns BIGINT NOT NULL, "
    "t1_ns BIGINT NOT NULL, n BIGINT NOT NULL, low DOUBLE PRECISION, high DOUBLE PRECISION, seconds {blob}, "
    "body {blob} NOT NULL) PARTITION BY RANGE (t0_ns)",
    f"CREATE INDEX IF NOT EXISTS {TABLE}_place ON {TABLE} (point, stream, t0_ns)",
    "CREATE TABLE IF NOT EXISTS group_piece (name TEXT NOT NULL, part TEXT NOT NULL, number BIGINT NOT NULL, "
    "first_ns BIGINT NOT NULL, last_ns BIGINT NOT NULL, body {blob} NOT NULL, PRIMARY KEY (name, part, number))",
)
TYPES = ("text", "text", "int8", "int8", "int8", "float8", "float8", "bytea", "bytea")
# Shards that begin a day at once make its part one after another.
LOCK = "SELECT pg_advisory_xact_lock(7016482239)"
DAY_NS = 86_400 * NANOSECONDS


def insert(database: PostgresDatabase, day: int, rows: Sequence[Sequence[Any]]) -> None:
    """Add blocks of a day (since 1970), within a transaction."""
    if not database.has_table(_part(day)):
        database.execute(LOCK)
        database.execute(
            f"CREATE TABLE IF NOT EXISTS {_part(day)} PARTITION OF {TABLE} "
            f"FOR VALUES FROM ({day * DAY_NS}) TO ({(day + 1) * DAY_NS})"
        )
    database.copy(_part(day), TYPES, rows)


def drop_before(database: PostgresDatabase, day: int) -> None:
    """Remove the parts of the days before."""
    sql = "SELECT relid::regclass::text FROM pg_partition_tree(?) WHERE isleaf"
    if not database.has_table(TABLE):
        return
    for (name,) in database.execute(sql, (TABLE,)):
        if str(name) < _part(day):
            database.execute(f"DROP TABLE IF EXISTS {name}")


def _part(day: int) -> str:
    return f"{TABLE}_{date(1970, 1, 1) + timedelta(day):%Y_%m_%d}"
