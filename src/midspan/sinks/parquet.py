"""Parquet with the metadata in the schema."""

from pathlib import Path

from midspan.sinks.arrow import arrow_column
from midspan.sinks.table import ResultTable, metadata_json, unit_of


def write(path: Path, table: ResultTable) -> None:
    """One column each, its unit in the field's metadata `unit`; the table's metadata as JSON under key `midspan`."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    arrays = {name: arrow_column(name, values) for name, values in table.columns.items()}
    fields = [
        pa.field(name, array.type, metadata={b"unit": unit.encode()} if (unit := unit_of(name)) else None)
        for name, array in arrays.items()
    ]
    schema = pa.schema(fields, metadata={b"midspan": metadata_json(table).encode()})
    pq.write_table(pa.Table.from_arrays(list(arrays.values()), schema=schema), path)
