"""Columns of numbers as few bytes, every bit of them kept: whole numbers, differences, planes of bytes, zstd.

A smooth series of fine steps has small differences, of which the upper bytes are nearly always the same: written plane
by plane (all lowest bytes, then all second ones …) they compress to what they tell. Noise stays as large as it is.
Differences of several orders are FLAC's fixed predictors (RFC 9639), planes of bytes HDF5's shuffle filter.
"""

import math
import struct
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from midspan.errors import DataError

Whole = NDArray[np.uint64]

# Floats that are all multiples of this are kept as whole numbers of it. A row's numbers are: 0.12 nm, or nm/s, which is
# the resolution of float32 at 1 mm.
STEP = 2.0**-33
# Whole numbers that a double holds exactly.
MAX_WHOLE = 2.0**53
# A cubic course has third differences that are constant; noise grows with each difference.
MAX_ORDER = 3
# How the values became whole numbers: bits of an integer, multiples of STEP, bits of a float in the order of its
# values, bits of the float32 that the double is.
INTEGERS, STEPS, FLOATS, SINGLES = range(4)
# A plane of bytes: one value, as it is, compressed, its lowest bits alone.
CONSTANT, PLAIN, PACKED, BITS = range(4)
# A column: kind, bits that are zero in all whole numbers and left out, order of the differences, planes.
COLUMN = struct.Struct("<BBBB")
LENGTH = struct.Struct("<I")
# Of fewer bytes zstd's own tables are as large as what they save.
MIN_PACKED = 512


def encode_numbers(values: NDArray[Any]) -> bytes:
    """Values (n,) of one real type as bytes, from which `decode_numbers` makes each of them again, NaN as well."""
    kind, whole = _whole(np.ascontiguousarray(values))
    zeros = _zero_bits(whole) if kind == STEPS else 0
    whole = (whole.view(np.int64) >> zeros).view(np.uint64)
    order, differences = _smallest(whole)
    zigzag = _zigzag(differences)
    planes = zigzag.view(np.uint8).reshape(-1, 8).T if len(zigzag) else np.empty((8, 0), np.uint8)
    count = (int(zigzag.max()).bit_length() + 7) // 8 if len(zigzag) else 0
    heads = whole[:order].tobytes()
    return b"".join((COLUMN.pack(kind, zeros, order, count), heads, *(_packed(planes[k]) for k in range(count))))


def decode_numbers(
    data: bytes, at: int, count: int, dtype: np.dtype[Any], *, skip: bool = False
) -> tuple[NDArray[Any], int]:
    """Values (count,) of a type, of the bytes from `at` on, and where these end; skip: no values. Raises DataError."""
    try:
        kind, zeros, order, planes = COLUMN.unpack_from(data, at)
        at += COLUMN.size
        if order > MAX_ORDER or planes > 8 or kind > SINGLES or zeros > 63:
            raise DataError("The bytes are no column of numbers.")
        heads = np.frombuffer(data, dtype="<u8", count=min(order, count), offset=at)
        at += heads.nbytes
        if skip:
            for _ in range(planes):
                at = _end_of_plane(data, at, max(count - order, 0))
            return np.empty(0, dtype=dtype), at
        if order == 1 and not planes:
            whole = np.full(count, heads[:1])
        else:
            rest = np.zeros((max(count - order, 0), 8), dtype=np.uint8)
            for k in range(planes):
                rest[:, k], at = _unpacked(data, at, len(rest))
            whole = _summed(heads, _unzigzag(rest.reshape(-1).view(np.uint64)))
    except (struct.error, ValueError, OSError, IndexError) as error:
        raise DataError(f"The bytes are no column of numbers ({error}).") from None
    return _values(kind, (whole.view(np.int64) << zeros).view(np.uint64), dtype), at


def _whole(values: NDArray[Any]) -> tuple[int, Whole]:
    """Values as whole numbers, and how."""
    if values.dtype.kind != "f":
        return INTEGERS, values.astype(np.int64).view(np.uint64)
    with np.errstate(over="ignore", invalid="ignore"):
        steps = np.asarray(values, dtype=np.float64) / STEP
        if np.all(np.abs(steps) < MAX_WHOLE) and np.all(steps == np.rint(steps)) and not np.any(_minus_zero(values)):
            return STEPS, steps.astype(np.int64).view(np.uint64)
        if values.dtype == np.float64 and np.array_equal(_bits(values), _bits(values.astype("f4").astype("f8"))):
            return SINGLES, _in_order(values.astype(np.float32))
    return FLOATS, _in_order(values)


def _zero_bits(whole: Whole) -> int:
    """How many of the lowest bits are zero in all of them."""
    used = int(np.bitwise_or.reduce(whole)) if len(whole) else 0
    return (used & -used).bit_length() - 1 if used else 0


def _values(kind: int, whole: Whole, dtype: np.dtype[Any]) -> NDArray[Any]:
    if kind == INTEGERS:
        return whole.view(np.int64).astype(dtype)
    if kind == STEPS:
        return (whole.view(np.int64) * STEP).astype(dtype)
    return _out_of_order(whole, np.dtype(np.float32) if kind == SINGLES else dtype).astype(dtype, copy=False)


def _minus_zero(values: NDArray[Any]) -> NDArray[np.bool_]:
    return np.asarray((values == 0.0) & np.signbit(values))


def _bits(values: NDArray[Any]) -> NDArray[Any]:
    return values.view(f"u{values.dtype.itemsize}")


def _in_order(values: NDArray[Any]) -> Whole:
    """The bits of floats as whole numbers that grow with the value: neighbours have small differences."""
    bits = _bits(values)
    top = bits.dtype.type(1) << bits.dtype.type(8 * bits.dtype.itemsize - 1)
    return np.where(bits & top, ~bits, bits | top).astype(np.uint64)


def _out_of_order(whole: Whole, dtype: np.dtype[Any]) -> NDArray[Any]:
    bits = whole.astype(f"u{dtype.itemsize}")
    top = bits.dtype.type(1) << bits.dtype.type(8 * bits.dtype.itemsize - 1)
    return np.where(bits & top, bits & ~top, ~bits).view(dtype)


def _smallest(whole: Whole) -> tuple[int, Whole]:
    """The order of the differences (modulo 2^64) that take the fewest bits, and these."""
    if len(whole) and np.all(whole == whole[0]):
        return 1, np.zeros(len(whole) - 1, np.uint64)
    best, bits, one = (0, whole), math.inf, whole
    for order in range(min(MAX_ORDER, len(whole) - 1) + 1):
        one = one if order == 0 else one[1:] - one[:-1]
        # A head of 64 bits is kept for each order.
        needed = _bits_of(_zigzag(one)) + 64.0 * order
        if needed < bits:
            best, bits = (order, one), needed
    return best


def _bits_of(zigzag: Whole) -> float:
    """About how many bits numbers take; short columns are not compressed, so that the largest one rules."""
    if len(zigzag) < MIN_PACKED:
        return len(zigzag) * float(int(zigzag.max()).bit_length())
    return float(np.sum(np.log2(1.0 + zigzag)))


def _zigzag(differences: Whole) -> Whole:
    """Small numbers of both signs as small ones (zigzag)."""
    signed = differences.view(np.int64)
    return ((signed << 1) ^ (signed >> 63)).view(np.uint64)


def _unzigzag(zigzag: Whole) -> Whole:
    return (zigzag >> np.uint64(1)) ^ (np.uint64(0) - (zigzag & np.uint64(1)))


def _summed(heads: Whole, differences: Whole) -> Whole:
    """What has these first values and differences of the order of their number."""
    firsts, left = list[int](), [int(one) for one in heads]
    while left:
        firsts.append(left[0])
        left = [(after - before) % 2**64 for before, after in pairwise(left)]
    found = differences
    for first in reversed(firsts):
        longer = np.empty(len(found) + 1, np.uint64)
        longer[0], longer[1:] = first, found
        found = np.cumsum(longer, dtype=np.uint64)
    return found


def _packed(plane: NDArray[np.uint8]) -> bytes:
    """A plane in the fewest bytes."""
    import pyarrow as pa

    if np.all(plane == plane[0]):
        return bytes((CONSTANT, int(plane[0])))
    width = int(plane.max()).bit_length()
    found = bytes((PLAIN,)) + plane.tobytes()
    if width < 8:
        found = bytes((BITS, width)) + np.packbits(np.unpackbits(plane[:, None], axis=1)[:, 8 - width :]).tobytes()
    if len(plane) >= MIN_PACKED:
        small = bytes(pa.Codec("zstd").compress(plane.tobytes(), asbytes=True))
        if len(small) + LENGTH.size < len(found):
            return bytes((PACKED,)) + LENGTH.pack(len(small)) + small
    return found


def _end_of_plane(data: bytes, at: int, count: int) -> int:
    """Where a plane that begins at a place ends."""
    match data[at]:
        case 0:  # CONSTANT
            return at + 2
        case 1:  # PLAIN
            return at + 1 + count
        case 3:  # BITS
            return at + 2 + (count * data[at + 1] + 7) // 8
        case _:
            return at + 1 + LENGTH.size + int(LENGTH.unpack_from(data, at + 1)[0])


def _unpacked(data: bytes, at: int, count: int) -> tuple[NDArray[np.uint8], int]:
    import pyarrow as pa

    kind, at = data[at : at + 1], at + 1
    if kind == bytes((CONSTANT,)):
        return np.full(count, data[at], dtype=np.uint8), at + 1
    if kind == bytes((PLAIN,)):
        return np.frombuffer(data, dtype=np.uint8, count=count, offset=at), at + count
    if kind == bytes((BITS,)):
        width, at = data[at], at + 1
        size = (count * width + 7) // 8
        bits = np.unpackbits(np.frombuffer(data, dtype=np.uint8, count=size, offset=at), count=count * width)
        whole = np.zeros((count, 8), dtype=np.uint8)
        whole[:, 8 - width :] = bits.reshape(count, width)
        return np.packbits(whole, axis=1)[:, 0], at + size
    (length,) = LENGTH.unpack_from(data, at)
    at += LENGTH.size
    plain = pa.Codec("zstd").decompress(data[at : at + length], decompressed_size=count, asbytes=True)
    return np.frombuffer(plain, dtype=np.uint8, count=count), at + length
