"""Parquet with the metadata in the schema."""

from collections.abc import Iterator
from typing import Any

from midspan.sinks.csv import word_column
from midspan.sinks.table import Column, ResultTable, codes, metadata_json, unit_of, words_or_numbers

# Rows of a row group, pyarrow's own number; a long record is written one after another.
GROUP = 1 << 20


class Written:
    """What a writer takes for a file: its bytes, to be handed on."""

    def __init__(self) -> None:
        self.closed, self._written, self._taken = False, list[bytes](), 0

    def write(self, content: bytes) -> int:
        """Append bytes."""
        self._written.append(bytes(content))
        return len(content)

    def tell(self) -> int:
        """How many there are."""
        return self._taken + sum(map(len, self._written))

    def flush(self) -> None:
        """Nothing is held back."""

    def close(self) -> None:
        """No more will come."""
        self.closed = True

    def take(self) -> bytes:
        """What came since the last time."""
        content = b"".join(self._written)
        self._written.clear()
        self._taken += len(content)
        return content


def encode(table: ResultTable) -> Iterator[bytes]:
    """One column each, its unit in the field's metadata `unit`; the table's metadata as JSON under key `midspan`."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    def group(begin: int, end: int) -> dict[str, Any]:
        return {name: _array(name, values[begin:end]) for name, values in table.columns.items()}

    fields = [
        pa.field(name, array.type, metadata={b"unit": unit.encode()} if (unit := unit_of(name)) else None)
        for name, array in group(0, 1).items()
    ]
    schema = pa.schema(fields, metadata={b"midspan": metadata_json(table).encode()})
    written = Written()
    with pq.ParquetWriter(pa.PythonFile(written, mode="w"), schema) as writer:
        for begin in range(0, max(len(table.time_ns), 1), GROUP):
            arrays = list(group(begin, begin + GROUP).values())
            writer.write_table(pa.Table.from_arrays(arrays, schema=schema))
            yield written.take()
    yield written.take()


def _array(name: str, values: Column) -> Any:
    import pyarrow as pa

    coded = codes(name, values)
    if coded is not None:
        return word_column(name, coded)
    array = words_or_numbers(name, values)
    return pa.array(array.tolist() if array.dtype.kind == "U" else array)
