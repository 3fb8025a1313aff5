"""Columns of one stream over some seconds, and the bytes that the store keeps them as."""

import json
import math
import struct
import zlib
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from midspan.errors import DataError
from midspan.records import NANOSECONDS, Floats, Nanoseconds, Status
from midspan.store.numbers import decode_numbers, encode_numbers

Columns = dict[str, NDArray[Any]]

# Of each column its name, its type as NumPy writes it, and the length of its further axes together, 0 without any.
Layout = tuple[tuple[str, str, int], ...]
MAGIC = b"mc\x02\0"
# Check sum of all that follows, length of the layout.
HEAD = struct.Struct("<II")
# Number of rows, first and last stamp, calibration.
BODY = struct.Struct("<Iqqi")


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


def body_of(chunk: Chunk) -> bytes:
    """The chunk's calibration, stamps and columns as bytes; `layout_of` says what they are."""
    first_ns, last_ns = int(chunk.time_ns[0]), int(chunk.time_ns[-1])
    late_ns = chunk.time_ns - _even(first_ns, last_ns, len(chunk.time_ns))
    head = BODY.pack(len(chunk.time_ns), first_ns, last_ns, chunk.calibration)
    flat = (_plain(values).reshape(-1, order="F") for values in chunk.columns.values())
    return b"".join((head, encode_numbers(late_ns), *(encode_numbers(values) for values in flat)))


def layout_of(chunk: Chunk) -> Layout:
    """The name, type and width of each column; width 0: a column without further axes."""
    return tuple(
        (name, values.dtype.str, math.prod(values.shape[1:]) if values.ndim > 1 else 0)
        for name, values in chunk.columns.items()
    )


def span_of(body: bytes, at: int = 0) -> tuple[int, int]:
    """First and last stamp of the body that begins at a place."""
    _, first_ns, last_ns, _ = BODY.unpack_from(body, at)
    return first_ns, last_ns


def chunk_of(
    layout: Layout, body: bytes, point: str, stream: str, shown: str = "", names: Collection[str] | None = None
) -> Chunk:
    """The chunk that `body_of` made bytes of; names: of the columns that are wanted, None: of all. Raises DataError for
    other bytes.
    """
    try:
        count, first_ns, last_ns, calibration = BODY.unpack_from(body)
        late_ns, at = decode_numbers(body, BODY.size, count, np.dtype(np.int64))
        columns: Columns = {}
        for name, kind, width in layout:
            dtype = np.dtype(kind)
            pair = 2 if dtype.kind == "c" else 1
            real = np.empty(0, dtype).real.dtype
            unwanted = names is not None and name not in names
            flat, at = decode_numbers(body, at, count * max(width, 1) * pair, real, skip=unwanted)
            if unwanted:
                continue
            values = np.ascontiguousarray(flat.reshape((count, max(width, 1) * pair), order="F")).view(dtype)
            columns[name] = values if width else values[:, 0]
    except (struct.error, ValueError, TypeError, DataError) as error:
        raise DataError(f"The store holds a damaged chunk of {point}, {stream} ({error}).") from None
    return Chunk(point, stream, _even(first_ns, last_ns, count) + late_ns, columns, calibration, shown)


def encode(chunk: Chunk) -> bytes:
    """The chunk's layout, stamps and columns as bytes, with a check sum."""
    layout, body = json.dumps(layout_of(chunk)).encode(), body_of(chunk)
    return b"".join((MAGIC, HEAD.pack(zlib.crc32(layout + body), len(layout)), layout, body))


def decode(
    data: bytes, point: str, stream: str, calibration: int = 0, shown: str = "", names: Collection[str] | None = None
) -> Chunk:
    """The chunk that `encode` made `data` of, now or in earlier versions (with a calibration); DataError for others."""
    if not data.startswith(MAGIC):
        return _decode_arrow(data, point, stream, calibration, shown)
    start = len(MAGIC) + HEAD.size
    try:
        check, length = HEAD.unpack_from(data, len(MAGIC))
        if zlib.crc32(data[start:]) != check:
            raise ValueError("its checksum is wrong")
        layout = tuple(
            (str(name), str(kind), int(width)) for name, kind, width in json.loads(data[start : start + length])
        )
    except (struct.error, ValueError, TypeError) as error:
        raise DataError(f"The store holds a damaged chunk of {point}, {stream} ({error}).") from None
    return chunk_of(layout, data[start + length :], point, stream, shown, names)


def _even(first_ns: int, last_ns: int, count: int) -> Nanoseconds:
    """The even series that stamps are near: what they are off it compresses to nothing."""
    step_ns = round((last_ns - first_ns) / (count - 1)) if count > 1 else 0
    return np.asarray(first_ns + step_ns * np.arange(count))


def _plain(values: NDArray[Any]) -> NDArray[Any]:
    """Values (n,) or (n, k) as real ones (n, j), complex numbers as pairs."""
    real = np.ascontiguousarray(values)
    real = real.view(real.real.dtype) if values.dtype.kind == "c" and values.ndim > 1 else real
    if values.dtype.kind == "c" and values.ndim == 1:
        real = real[:, None].view(real.real.dtype)
    return real.reshape(len(values), -1)


def _decode_arrow(data: bytes, point: str, stream: str, calibration: int, shown: str) -> Chunk:
    """A chunk of a store of schema 1: an Arrow stream."""
    import pyarrow as pa

    try:
        batch = pa.ipc.open_stream(data).read_next_batch()
        begin_ns, step_ns = (int(batch.schema.metadata[key]) for key in (b"begin_ns", b"step_ns"))
    except (pa.ArrowException, OSError, StopIteration, KeyError, TypeError, ValueError) as error:
        raise DataError(f"The store holds a damaged chunk of {point}, {stream} ({error}).") from None
    columns = {name: _numbers(batch.column(name)) for name in batch.schema.names}
    late_ns = columns.pop("late_ns").astype(np.int64)
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
