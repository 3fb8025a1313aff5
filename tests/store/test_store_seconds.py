"""The seconds that others read with SQL in a PostgreSQL store, and the dashboard of the documentation that does."""

import json
import re
from datetime import UTC, datetime
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from midspan.records import NANOSECONDS, Event
from midspan.store.chunk import Chunk
from midspan.store.days import DAY_NS
from midspan.store.store import Batch, open_store

DASHBOARD = Path(__file__).parents[2] / "docs" / "grafana-dashboard.json"
BEGIN_NS, SECONDS, RATE_HZ = 20_700 * DAY_NS, 20, 20
STD_M = 2e-5
# What is written each time, s: seconds are cut in other places than at their ends.
PIECE_S = 0.7


def rows(first, last):
    """Rows of a point from a row to before another one; those of the third second are lost."""
    number = np.arange(first, last)
    status = np.where(number // RATE_HZ == 3, 2, number % 2).astype(np.uint8)
    columns = {
        "displacement_m": 1e-3 * np.sin(0.3 * number),
        "std_m": np.full(len(number), STD_M, np.float32),
        "status": status,
    }
    return Chunk("p", "rows", BEGIN_NS + number * (NANOSECONDS // RATE_HZ), columns, 1, "displacement_m")


@pytest.fixture
def where(postgres, store_name):
    """A store whose seconds came in parts, some of them twice."""
    where = postgres.database(store_name)
    store = open_store(where)
    edges = np.append(np.arange(0, SECONDS * RATE_HZ, round(PIECE_S * RATE_HZ)), SECONDS * RATE_HZ)
    for a, b in pairwise(edges):
        # Ten rows come again, as after a start: they are dropped.
        store.write(Batch([rows(max(a - 10, 0), b)]))
    store.write(Batch(events=[("p", Event(BEGIN_NS + 5 * NANOSECONDS, "gap", "A gap of 2 s."))]))
    store.close()
    return where


def asked(where, sql, values=()):
    import psycopg

    with psycopg.connect(where) as connection, connection.cursor(row_factory=psycopg.rows.dict_row) as cursor:
        cursor.execute(sql, values)
        return cursor.fetchall()


def expected(first, last):
    """The figures of rows that are not lost, mm."""
    value, status = (rows(first, last).columns[name] for name in ("displacement_m", "status"))
    good = 1e3 * value[status < 2]
    return good.min(), good.max(), good.mean()


def figures(row):
    return [row[f"displacement_mm_{name}"] for name in ("min", "max", "mean")]


def test_seconds_are_those_of_the_rows_however_they_were_cut(where):
    found = asked(where, "SELECT * FROM displacement_1s ORDER BY time")
    assert [row["time"] for row in found] == [
        datetime.fromtimestamp(BEGIN_NS // NANOSECONDS + k, UTC) for k in range(SECONDS)
    ]
    for k, row in enumerate(found):
        if k == 3:
            assert (row["rows"], row["status"], row["displacement_mm_min"], row["displacement_std_mm"]) == (
                0, 2, None, None,
            )  # fmt: skip
            continue
        assert (row["point"], row["stream"], row["rows"], row["status"]) == ("p", "rows", RATE_HZ, 1)
        # Of float32, of 1 mm.
        np.testing.assert_allclose(figures(row), expected(k * RATE_HZ, (k + 1) * RATE_HZ), atol=2e-7)
        assert row["displacement_std_mm"] == pytest.approx(1e3 * STD_M, rel=1e-6)


def test_what_is_removed_from_the_rows_is_removed_from_the_seconds(where):
    store = open_store(where)
    # In the middle of a second, of which the rows before stay.
    store.forget_since("p", BEGIN_NS + round(7.5 * NANOSECONDS), 1)
    last = asked(where, "SELECT * FROM displacement_1s ORDER BY time DESC LIMIT 1")[0]
    assert last["rows"] == RATE_HZ // 2
    np.testing.assert_allclose(figures(last), expected(7 * RATE_HZ, round(7.5 * RATE_HZ)), atol=2e-7)
    # And the rows that come in its place are merged into it.
    store.write(Batch([rows(round(7.5 * RATE_HZ), 9 * RATE_HZ)]))
    found = asked(where, "SELECT * FROM displacement_1s ORDER BY time")
    assert [row["rows"] for row in found[7:]] == [RATE_HZ, RATE_HZ]
    np.testing.assert_allclose(figures(found[7]), expected(7 * RATE_HZ, 8 * RATE_HZ), atol=2e-7)
    store.forget_before(BEGIN_NS + 5 * DAY_NS)
    assert asked(where, "SELECT * FROM displacement_1s") == []
    store.close()


def test_a_store_of_before_gets_the_table_from_its_next_start_on(where):
    import psycopg

    with psycopg.connect(where) as connection:
        connection.execute("DROP TABLE displacement_1s")
    store = open_store(where)
    store.write(Batch([rows(SECONDS * RATE_HZ, (SECONDS + 2) * RATE_HZ)]))
    assert len(asked(where, "SELECT * FROM displacement_1s")) == 2
    assert store.newest_ns("p", "rows") == int(rows(0, (SECONDS + 2) * RATE_HZ).time_ns[-1])
    store.close()


def interpolated(sql, first_ns, last_ns, interval_s, point="p"):
    """A query of a dashboard as Grafana's PostgreSQL source sends it: its macros and variables."""
    begin, end = (datetime.fromtimestamp(at / 1e9, UTC).isoformat() for at in (first_ns, last_ns))
    sql = sql.replace("$__interval", f"{interval_s}s").replace("${point:sqlstring}", f"'{point}'")
    sql = re.sub(r"\$__timeFilter\(([^)]*)\)", rf"\1 BETWEEN '{begin}' AND '{end}'", sql)
    sql = re.sub(r"\$__unixEpochNanoFilter\(([^)]*)\)", rf"\1 >= {first_ns} AND \1 <= {last_ns}", sql)
    sql = re.sub(r"\$__timeGroupAlias\(([^,)]*), *(\d+)s\)", r'floor(extract(epoch from \1)/\2)*\2 AS "time"', sql)
    assert "$" not in sql
    return sql


def queries():
    """The SQL of the dashboard by title, with that of its variable and annotations."""
    tree = json.loads(DASHBOARD.read_text())
    found = {one["name"]: one["query"] for one in tree["templating"]["list"] if one["type"] == "query"}
    found |= {one["name"]: one["target"]["rawSql"] for one in tree["annotations"]["list"] if "target" in one}
    for panel in tree["panels"]:
        for target in panel.get("targets", []):
            if "rawSql" in target:
                found[panel["title"]] = target["rawSql"]
    return found


def test_the_dashboard_shows_what_the_store_holds(where):
    span = (BEGIN_NS, BEGIN_NS + SECONDS * NANOSECONDS)
    sql = {name: interpolated(text, *span, 5) for name, text in queries().items()}
    assert [row["point"] for row in asked(where, sql["point"])] == ["p"]
    found = asked(where, sql["Displacement"])
    assert [float(row["time"]) for row in found] == [BEGIN_NS / NANOSECONDS + 5 * k for k in range(SECONDS // 5)]
    for k, row in enumerate(found):
        least, largest, mean = expected(5 * k * RATE_HZ, 5 * (k + 1) * RATE_HZ)
        np.testing.assert_allclose((row["least"], row["largest"], row["mean"]), (least, largest, mean), atol=1e-6)
        # The 95 % band about the extremes: no row of the bucket has a band beyond it.
        np.testing.assert_allclose(row["lower"], least - 1.96e3 * STD_M, atol=1e-6)
        np.testing.assert_allclose(row["upper"], largest + 1.96e3 * STD_M, atol=1e-6)
    assert [row["status"] for row in asked(where, sql["Status"])] == [2, 1, 1, 1]
    (event,) = asked(where, sql["Events"])
    assert (event["text"], event["tags"]) == ("A gap of 2 s.", "gap,p")
    assert event["time"] * 1e6 == BEGIN_NS + 5 * NANOSECONDS
    (newest,) = asked(where, sql["Standard deviation"])[-1:]
    assert newest["standard deviation"] == pytest.approx(1e3 * STD_M, rel=1e-6)


def test_whoever_only_looks_may_read_the_tables_of_the_recipe_alone(where):
    import psycopg

    text = (DASHBOARD.parent / "live.md").read_text()
    grants = re.search(r"```sql\n(.*?)```", text, re.DOTALL)[1].replace("grafana", "looks")
    with psycopg.connect(where, autocommit=True) as owner:
        owner.execute(grants)
        owner.execute("SET ROLE looks")
        assert owner.execute("SELECT count(*) FROM displacement_1s").fetchone() == (SECONDS,)
        assert owner.execute("SELECT count(*) FROM event").fetchone() == (1,)
        for sql in ("SELECT * FROM block", "DELETE FROM event"):
            with pytest.raises(psycopg.errors.InsufficientPrivilege):
                owner.execute(sql)
