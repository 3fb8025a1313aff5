"""Parquet tables, read with pyarrow."""

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from midspan.sources.accelerometer.channel import Channel, ChannelSet, Stored, Values, numbers
from midspan.sources.accelerometer.clock import texts_to_ns
from midspan.sources.accelerometer.dialect import named_unit
from midspan.sources.boundary import require_memory

if TYPE_CHECKING:
    import pandas as pd

# Bytes of a value: as it is stored there, as pyarrow gives it and as a channel has it.
_BYTES = 24


def read(path: Path) -> ChannelSet:
    """All numeric and time columns of a Parquet file; a column's unit from its field metadata `unit` or its heading.

    Columns of numbers are read when they are asked for.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    with pq.ParquetFile(path) as file:
        schema, count = file.schema_arrow, int(file.metadata.num_rows)
    channels: list[Channel] = []
    notes: list[str] = []
    for field in schema:
        kind = field.type
        name, unit = named_unit(field.name)
        stated = (field.metadata or {}).get(b"unit")
        unit = stated.decode() if stated else unit
        if pa.types.is_string(kind) or pa.types.is_large_string(kind):
            require_memory(path, _BYTES * count, f"column {field.name!r}")
            found = texts_to_ns(_column(path, field.name).to_pandas()) if count else None
            if found is not None:
                channels.append(Channel(name, found[0], "ns"))
                notes += found[1]
        elif pa.types.is_timestamp(kind):
            channels.append(Channel(name, Stored(count, _BYTES * count, partial(_stamps, path, field)), "ns"))
        elif pa.types.is_integer(kind) or pa.types.is_floating(kind) or pa.types.is_boolean(kind):
            channels.append(Channel(name, Stored(count, _BYTES * count, partial(_numbers, path, field)), unit))
    return ChannelSet(tuple(channels), tuple(notes))


def _column(path: Path, name: str) -> Any:
    import pyarrow as pa
    import pyarrow.parquet as pq

    with pq.ParquetFile(path) as file:
        column = file.read(columns=[name]).column(name)
    # Decoding took several times as much, which the library would keep for the next time.
    pa.default_memory_pool().release_unused()
    return column


def _stamps(path: Path, field: Any) -> Values:
    import pyarrow as pa

    moments: pd.Series[Any] = _column(path, field.name).cast(pa.timestamp("ns", tz=field.type.tz)).to_pandas()
    return np.asarray(moments.astype("int64"), dtype=np.int64)


def _numbers(path: Path, field: Any) -> Values:
    import pyarrow as pa

    column = _column(path, field.name)
    if pa.types.is_boolean(field.type):
        # As they are, missing ones among them would become objects of Python.
        column = column.cast(pa.float64())
    values = numbers(column.to_numpy())
    if values is None:
        raise ValueError(f"column {field.name!r} holds no numbers")
    return values
