"""Days of a store as Parquet files: one for each stream of a point, while the store goes on being written."""

import shutil
from collections.abc import Iterator
from contextlib import ExitStack
from datetime import date, timedelta
from pathlib import Path
from typing import Any

import numpy as np

from midspan.records import NANOSECONDS
from midspan.store.chunk import Chunk, arrow_column
from midspan.store.days import DAY_NS
from midspan.store.store import Store

# Rows of this time stand together in a file, s: what a reader takes at a time.
GROUP_S = 3600.0
UNFINISHED = ".part"


def archive(store: Store, folder: Path, now_ns: int) -> Iterator[Path]:
    """Write every whole day before `now_ns` that is not there yet; yields each day's folder when it is whole.

    A day is FOLDER/POINT/YYYY-MM-DD/ with one file for each stream, in SI units, `time` in UTC. Raises StoreFault and
    OSError.
    """
    for point in store.points:
        for day in sorted({day for stream in store.streams(point) for day in store.days(point, stream)}):
            place = folder / point / str(date(1970, 1, 1) + timedelta(day))
            if day < now_ns // DAY_NS and not place.exists():
                _write(store, point, day, place)
                yield place


def _write(store: Store, point: str, day: int, place: Path) -> None:
    import pyarrow.parquet as pq

    part = place.with_name(place.name + UNFINISHED)
    shutil.rmtree(part, ignore_errors=True)
    part.mkdir(parents=True)
    for stream in store.streams(point):
        with ExitStack() as opened:
            writer: Any = None
            for table in _tables(store.chunks(point, stream, day * DAY_NS, (day + 1) * DAY_NS - 1)):
                if writer is None:
                    file = part / f"{stream.replace(':', '-')}.parquet"
                    writer = opened.enter_context(pq.ParquetWriter(file, table.schema))
                writer.write_table(table)
    part.rename(place)


def _tables(chunks: Iterator[Chunk]) -> Iterator[Any]:
    """Chunks of a stream as tables of about an hour."""
    import pyarrow as pa

    waiting: list[Any] = []
    first_ns = 0
    for chunk in chunks:
        if waiting and int(chunk.time_ns[0]) - first_ns >= GROUP_S * NANOSECONDS:
            yield pa.concat_tables(waiting, promote_options="default")
            waiting = []
        if not waiting:
            first_ns = int(chunk.time_ns[0])
        columns = {"time": pa.array(chunk.time_ns, type=pa.timestamp("ns", tz="UTC"))}
        columns |= {name: arrow_column(values) for name, values in chunk.columns.items()}
        columns["calibration"] = pa.array(np.full(len(chunk.time_ns), chunk.calibration, dtype=np.int32))
        waiting.append(pa.table(columns))
    if waiting:
        yield pa.concat_tables(waiting, promote_options="default")
