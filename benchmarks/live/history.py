"""How long a day and a year of one point take to look at, at 2000 buckets, in both kinds of stores; and their sizes."""

import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from benchmarks.live.servers import Postgres
from benchmarks.table import goal
from midspan.records import NANOSECONDS, Floats
from midspan.service.journal import STD_STEP, STEP, VELOCITY_STEP
from midspan.store.chunk import Chunk
from midspan.store.days import DAY_NS
from midspan.store.store import Batch, Store, open_store

FIRST_NS, DAYS = 20_000 * DAY_NS, 365
RATE_HZ, BUCKETS, ROUNDS = 100, 2000, 5
# Of the year one row stands for each of half a block's length, s: histories of a year read the pyramid above.
THIN_S = 160
GOAL_DAY_MS, GOAL_YEAR_MS = 50.0, 200.0


def rows(point: str, time_ns: np.ndarray, rng: np.random.Generator) -> Chunk:
    """Rows as a live point keeps them."""
    count = len(time_ns)
    value: Floats = 1e-3 * np.sin(time_ns / NANOSECONDS % 1000.0) + 1e-5 * rng.standard_normal(count)
    columns = {
        "displacement_m": STEP * np.rint(value / STEP),
        "std_m": STD_STEP * np.ceil((2e-5 + 1e-7 * rng.standard_normal(count)) / STD_STEP),
        "velocity_m_s": VELOCITY_STEP * np.rint(1e-2 * rng.standard_normal(count) / VELOCITY_STEP),
        "source": np.zeros(count, dtype=np.uint8),
        "status": np.zeros(count, dtype=np.uint8),
        "zero_std_m": np.full(count, 1e-5, dtype=np.float32),
    }
    return Chunk(point, "rows", time_ns, columns, 1, "displacement_m")


def fill(store: Store) -> None:
    """A day at the full rate, and a year of another point."""
    rng = np.random.default_rng(0)
    hour_ns = 3600 * NANOSECONDS
    for hour in range(24):
        time_ns = FIRST_NS + hour * hour_ns + np.arange(3600 * RATE_HZ) * (NANOSECONDS // RATE_HZ)
        store.write(Batch([rows("day", time_ns, rng)]))
    for day in range(DAYS):
        time_ns = FIRST_NS + day * DAY_NS + np.arange(0, DAY_NS, THIN_S * NANOSECONDS)
        store.write(Batch([rows("year", time_ns, rng)]))


def taken_ms(where: str, point: str, length_ns: int) -> float:
    """The best time of a look, the store freshly opened."""
    best = np.inf
    for _ in range(ROUNDS):
        store = open_store(where, read_only=True)
        begun_s = time.perf_counter()
        found = store.buckets(point, "rows", FIRST_NS, FIRST_NS + length_ns, BUCKETS)
        best = min(best, 1e3 * (time.perf_counter() - begun_s))
        store.close()
        assert np.isfinite(found.low).mean() > 0.95
    return best


def main() -> int:
    """Fill and look at both kinds."""
    with tempfile.TemporaryDirectory(prefix="midspan-history-") as name:
        places = {"SQLite": str(Path(name) / "store")}
        server = Postgres() if Postgres.programs() is not None else None
        if server is not None:
            server.start()
            places["PostgreSQL"] = server.database("history")
        try:
            for kind, where in places.items():
                store = open_store(where)
                begun_s = time.perf_counter()
                fill(store)
                store.close()
                print(f"{kind}: filled in {time.perf_counter() - begun_s:.0f} s")
                goal(f"{kind}: a day at {BUCKETS} buckets", taken_ms(where, "day", DAY_NS), GOAL_DAY_MS, unit="ms")
                goal(f"{kind}: a year", taken_ms(where, "year", DAYS * DAY_NS), GOAL_YEAR_MS, unit="ms")
                if kind == "SQLite":
                    first = Path(where) / "days"
                    file = min(first.glob("*.sqlite"))
                    print(f"        a day's rows at {RATE_HZ} Hz: {file.stat().st_size / 1e6:.0f} MB")
        finally:
            if server is not None:
                server.stop()
                server.remove()
    return 0


if __name__ == "__main__":
    sys.exit(main())
