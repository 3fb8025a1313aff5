"""Parquet with the metadata in the schema."""

from collections.abc import Iterator

from midspan.sinks.csv import word_column
from midspan.sinks.table import ResultTable, codes, metadata_json, unit_of, words_or_numbers


def encode(table: ResultTable) -> Iterator[bytes]:
    """One column each, its unit in the field's metadata `unit`; the table's metadata as JSON under key `midspan`."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    arrays = {}
    for name, values in table.columns.items():
        coded, array = codes(name, values), words_or_numbers(name, values)
        plain = array.tolist() if array.dtype.kind == "U" else array
        arrays[name] = pa.array(plain) if coded is None else word_column(name, coded)
    fields = [
        pa.field(name, array.type, metadata={b"unit": unit.encode()} if (unit := unit_of(name)) else None)
        for name, array in arrays.items()
    ]
    schema = pa.schema(fields, metadata={b"midspan": metadata_json(table).encode()})
    stream = pa.BufferOutputStream()
    pq.write_table(pa.Table.from_arrays(list(arrays.values()), schema=schema), stream)
    yield stream.getvalue().to_pybytes()
