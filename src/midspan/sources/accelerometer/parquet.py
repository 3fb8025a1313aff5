"""Parquet tables, read with pyarrow."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from midspan.sources.accelerometer.channel import Channel, ChannelSet, numbers
from midspan.sources.accelerometer.clock import texts_to_ns
from midspan.sources.accelerometer.dialect import named_unit

if TYPE_CHECKING:
    import pandas as pd


def read(path: Path) -> ChannelSet:
    """All numeric and time columns of a Parquet file; a column's unit from its field metadata `unit` or its heading."""
    import pyarrow.parquet as pq

    table = pq.read_table(path)
    channels: list[Channel] = []
    notes: list[str] = []
    for field in table.schema:
        name, heading_unit = named_unit(field.name)
        stated = (field.metadata or {}).get(b"unit")
        unit = stated.decode() if stated else heading_unit
        channel, said = _channel(name, unit, table.column(field.name))
        channels += [channel] if channel else []
        notes += said
    return ChannelSet(tuple(channels), tuple(notes))


def _channel(name: str, unit: str | None, column: Any) -> tuple[Channel | None, list[str]]:
    import pyarrow as pa

    kind = column.type
    if pa.types.is_timestamp(kind):
        moments: pd.Series[Any] = column.cast(pa.timestamp("ns", tz=kind.tz)).to_pandas()
        return Channel(name, np.asarray(moments.astype("int64"), dtype=np.int64), "ns"), []
    if pa.types.is_string(kind) or pa.types.is_large_string(kind):
        found = texts_to_ns(column.to_pandas()) if len(column) else None
        return (Channel(name, found[0], "ns"), list(found[1])) if found else (None, [])
    if not (pa.types.is_integer(kind) or pa.types.is_floating(kind) or pa.types.is_boolean(kind)):
        return None, []
    values = numbers(column.to_numpy())
    return (Channel(name, values, unit) if values is not None else None), []
