"""Columns of one stream over some seconds, and the bytes that the store keeps them as."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from midspan.errors import DataError
from midspan.records import NANOSECONDS, Floats, Nanoseconds, Status

Columns = dict[str, NDArray[Any]]

# Stamps are kept as what they are off an even series by: zeros, which compress to nothing.
LATE_COLUMN = "late_ns"


@dataclass(frozen=True, slots=True)
class Chunk:
    """A block of one stream: time_ns (n,) UTC, increasing, and `columns` name → values (n,) or (n, k).

    shown: the column that histories draw; its least and largest value stand with the chunk.
    """

    point: str
    stream: str
    time_ns: Nanoseconds
    columns: Columns
    calibration: int = 0
    shown: str = ""

    @property
    def limits(self) -> tuple[float | None, float | None]:
        """Least and largest finite value of the column that is drawn, rows that are lost left out; None without one."""
        if not self.shown:
            return None, None
        finite = self.drawn(self.shown)[1]
        return (float(finite.min()), float(finite.max())) if len(finite) else (None, None)

    def drawn(self, name: str) -> tuple[Nanoseconds, Floats]:
        """Stamps and finite values of a column, rows that are lost left out: they would rule every history."""
        values = np.asarray(self.columns[name], dtype=np.float64)
        good = np.isfinite(values)
        if "status" in self.columns:
            good &= self.columns["status"] != Status.LOST
        return self.time_ns[good], values[good]

    def rows(self, which: slice | NDArray[np.bool_]) -> "Chunk":
        """Some of its rows."""
        columns = {name: values[which] for name, values in self.columns.items()}
        return Chunk(self.point, self.stream, self.time_ns[which], columns, self.calibration, self.shown)

    def split(self, length_s: float) -> list["Chunk"]:
        """Its parts by slots of this length, which begin at whole multiples of it."""
        slots = self.time_ns // round(length_s * NANOSECONDS)
        begins = [0, *(1 + np.flatnonzero(np.diff(slots))).tolist(), len(slots)]
        return [self.rows(slice(a, b)) for a, b in pairwise(begins) if b > a]


def join(chunks: Sequence[Chunk]) -> Chunk:
    """Chunks of one stream and calibration, in the order of time, as one."""
    first = chunks[0]
    columns = {name: np.concatenate([one.columns[name] for one in chunks]) for name in first.columns}
    time_ns = np.concatenate([one.time_ns for one in chunks])
    return Chunk(first.point, first.stream, time_ns, columns, first.calibration, first.shown)


def encode(chunk: Chunk) -> bytes:
    """The chunk's stamps and columns as an Arrow stream, compressed."""
    import pyarrow as pa

    # The even series that the stamps are near.
    count, begin_ns = len(chunk.time_ns), int(chunk.time_ns[0])
    step_ns = round(int(chunk.time_ns[-1] - chunk.time_ns[0]) / (count - 1)) if count > 1 else 0
    late_ns = chunk.time_ns - (begin_ns + step_ns * np.arange(count))
    arrays = {LATE_COLUMN: pa.array(late_ns)}
    arrays |= {name: arrow_column(values) for name, values in chunk.columns.items()}
    metadata = {b"begin_ns": str(begin_ns).encode(), b"step_ns": str(step_ns).encode()}
    table = pa.record_batch(arrays).replace_schema_metadata(metadata)
    sink = pa.BufferOutputStream()
    with pa.ipc.new_stream(sink, table.schema, options=pa.ipc.IpcWriteOptions(compression="zstd")) as writer:
        writer.write_batch(table)
    return bytes(sink.getvalue().to_pybytes())


def decode(data: bytes, point: str, stream: str, calibration: int = 0, shown: str = "") -> Chunk:
    """The chunk that `encode` made `data` of; DataError for other bytes."""
    import pyarrow as pa

    try:
        batch = pa.ipc.open_stream(data).read_next_batch()
        begin_ns, step_ns = (int(batch.schema.metadata[key]) for key in (b"begin_ns", b"step_ns"))
    except (pa.ArrowException, OSError, StopIteration, KeyError, TypeError, ValueError) as error:
        raise DataError(f"The store holds a damaged chunk of {point}, {stream} ({error}).") from None
    columns = {name: _numbers(batch.column(name)) for name in batch.schema.names}
    late_ns = columns.pop(LATE_COLUMN).astype(np.int64)
    time_ns = begin_ns + step_ns * np.arange(len(late_ns)) + late_ns
    return Chunk(point, stream, time_ns, columns, calibration, shown)


def arrow_column(values: NDArray[Any]) -> Any:
    """Values (n,) or (n, k) as an Arrow array."""
    import pyarrow as pa

    if values.ndim == 1 and values.dtype.kind != "c":
        return pa.array(values)
    # Complex numbers as pairs, further axes as lists of fixed length; the pair says so by its own field's name.
    real = values.view(values.real.dtype) if values.dtype.kind == "c" else values
    flat = np.ascontiguousarray(real).reshape(len(values), -1)
    name = "complex" if values.dtype.kind == "c" else "item"
    kind = pa.list_(pa.field(name, pa.from_numpy_dtype(flat.dtype)), flat.shape[1])
    return pa.FixedSizeListArray.from_arrays(pa.array(flat.reshape(-1)), type=kind)


def _numbers(column: Any) -> NDArray[Any]:
    import pyarrow as pa

    if not pa.types.is_fixed_size_list(column.type):
        return np.asarray(column.to_numpy(zero_copy_only=False))
    width, name = column.type.list_size, column.type.value_field.name
    flat = np.asarray(column.flatten().to_numpy(zero_copy_only=False)).reshape(-1, width)
    if name != "complex":
        return flat
    return flat.view(np.complex64 if flat.dtype == np.float32 else np.complex128)
