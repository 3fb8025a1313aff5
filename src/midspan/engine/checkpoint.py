"""The state of any stage as bytes and back: a tree of plain values, the arrays behind it, and a check sum; no code.

Bytes: MAGIC, version and length of the tree (little-endian), SHA-256 of these two and all that follows, the tree as
JSON, the arrays' numbers one after another. In the tree None, truth values, whole numbers, finite floats and texts
stand for themselves; everything else is a list that begins with its tag. A record or an enum stands there by name;
which names there are follows from the types of the expected record's fields, and nothing is imported by a name.
"""

import hashlib
import json
import math
import struct
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from enum import Enum
from itertools import pairwise
from typing import Any, TypeVar, get_args, get_origin, get_type_hints

import numpy as np
from numpy.typing import NDArray

from midspan.engine.target_opening import tracker_states
from midspan.errors import DataError
from midspan.trees import TreeError, json_tree

MAGIC, VERSION = b"midspan\0", 1
# Version, length of the tree; the digest stands between them and the tree.
HEAD = struct.Struct("<IQ")
DIGEST_BYTES = hashlib.sha256().digest_size
# A part of its own is worth its own row in a database from a page of it on.
MIN_PART_BYTES = 4096
# A record takes three levels of brackets, of which a tree may have 64.
MAX_DEPTH = 20
TUPLE, RECORD, ENUM, ARRAY, SCALAR, NOT_FINITE, COMPLEX = "t", "r", "e", "a", "n", "f", "c"
# The numbers that arrays may hold, always little-endian.
DTYPES = frozenset(("|b1", "|i1", "|u1", "<i2", "<u2", "<i4", "<u4", "<i8", "<u8", "<f2", "<f4", "<f8", "<c8", "<c16"))
FLOATS = {"nan": math.nan, "inf": math.inf, "-inf": -math.inf}
State = TypeVar("State")
Types = Mapping[str, type]


def types_in(kind: type) -> dict[str, type]:
    """The records and enums that a `kind` may consist of, by their names; a field of type Any has a tracker's state."""
    seen: set[Any] = set()
    left: list[Any] = [kind]
    while left:
        one = left.pop()
        if one in seen or get_origin(one) is np.ndarray:
            continue
        seen.add(one)
        left += get_args(one)
        if one is Any:
            left += tracker_states()
        elif is_dataclass(one):
            left += get_type_hints(one).values()
    return {_name(one): one for one in seen if isinstance(one, type) and (is_dataclass(one) or issubclass(one, Enum))}


def _name(kind: type) -> str:
    return f"{kind.__module__}.{kind.__qualname__}"


def to_bytes(state: object) -> bytes:
    """A state as bytes; equal states give equal bytes.

    Raises DataError for what no state may hold: a type that no field declares, whole numbers of more than 64 bits.
    """
    writer = _Writer(types_in(type(state)))
    tree, arrays = writer.tree(state), writer.arrays
    kinds = [[array.dtype.str, list(array.shape), _order(array)] for array in arrays]
    try:
        text = json.dumps({"tree": tree, "arrays": kinds}, allow_nan=False).encode("ascii")
        json_tree(text)
    except (TreeError, RecursionError) as error:
        raise DataError(f"The state cannot be kept: it {error}.") from None
    numbers = b"".join(array.tobytes(order=_order(array)) for array in arrays)
    head = HEAD.pack(VERSION, len(text))
    return b"".join((MAGIC, head, _digest(head, text + numbers), text, numbers))


def parts_of(data: bytes) -> list[bytes]:
    """What `to_bytes` gave, cut where its large arrays begin and end: those that do not change stay the same bytes."""
    start = len(MAGIC) + HEAD.size + DIGEST_BYTES
    at = start + HEAD.unpack_from(data, len(MAGIC))[1]
    cuts = [0]
    for dtype, shape, _ in json.loads(data[start:at])["arrays"]:
        end = at + math.prod(shape) * np.dtype(dtype).itemsize
        cuts += [at, end] if end - at >= MIN_PART_BYTES else []
        at = end
    edges = sorted({*cuts, len(data)})
    return [data[a:b] for a, b in pairwise(edges)]


def from_bytes(data: bytes, kind: type[State]) -> State:
    """The state of type `kind` that `to_bytes` made `data` of.

    Raises DataError for anything else: cut or changed bytes, another version, a type that no field declares.
    """
    start = len(MAGIC) + HEAD.size + DIGEST_BYTES
    if len(data) < start or not data.startswith(MAGIC):
        raise _refuse(f"{len(data)} bytes without the header of a checkpoint")
    head = data[len(MAGIC) : len(MAGIC) + HEAD.size]
    version, length = HEAD.unpack(head)
    if version != VERSION:
        raise _refuse(f"version {version}; this program reads version {VERSION}")
    if _digest(head, data[start:]) != data[start - DIGEST_BYTES : start]:
        raise _refuse("bytes that are cut or changed")
    if length > len(data) - start:
        raise _refuse("a tree that is cut")
    try:
        whole = json_tree(data[start : start + length])
    except TreeError as error:
        raise _refuse(f"a tree that {error}") from None
    if not isinstance(whole, dict) or set(whole) != {"tree", "arrays"} or not isinstance(whole["arrays"], list):
        raise _refuse("a tree of another form")
    arrays, numbers, at = [], data[start + length :], 0
    for one in whole["arrays"]:
        array, at = _array(one, numbers, at)
        arrays.append(array)
    if at != len(numbers):
        raise _refuse(f"{len(numbers) - at} bytes too many")
    state = _value(whole["tree"], arrays, types_in(kind))
    if type(state) is not kind:
        raise _refuse(f"one of type {type(state).__name__} instead of {kind.__name__}")
    return state


def _digest(head: bytes, rest: bytes) -> bytes:
    return hashlib.sha256(head + rest).digest()


def _refuse(received: str) -> DataError:
    return DataError(
        f"A checkpoint must be complete and come from this version of midspan; received {received}. Start without it."
    )


def _order(array: NDArray[Any]) -> Any:
    """The order of an array's numbers in memory: sums follow it, and so do their last bits."""
    return "F" if array.flags.f_contiguous and not array.flags.c_contiguous else "C"


class _Writer:
    """Makes a tree of a state whose records are of `types`, and collects its arrays."""

    def __init__(self, types: Types) -> None:
        self.types = types
        self.arrays: list[NDArray[Any]] = []

    def tree(self, value: object, depth: int = 0) -> object:
        """`value` as JSON has it."""
        if depth > MAX_DEPTH:
            raise DataError(f"The state cannot be kept: it must have at most {MAX_DEPTH} levels of records and tuples.")
        if value is None or type(value) in (bool, int, str):
            return value
        if type(value) is float:
            return value if math.isfinite(value) else [NOT_FINITE, str(value)]
        if type(value) is complex:
            return [COMPLEX, self.tree(value.real), self.tree(value.imag)]
        if isinstance(value, np.ndarray | np.generic):
            return [ARRAY if isinstance(value, np.ndarray) else SCALAR, self._kept(np.asarray(value))]
        if type(value) is tuple:
            return [TUPLE, *(self.tree(item, depth + 1) for item in value)]
        name = _name(type(value))
        if self.types.get(name) is not type(value):
            raise DataError(f"The state cannot be kept: no field's type declares the {name} in it.")
        if isinstance(value, Enum):
            return [ENUM, name, value.value]
        names = [item.name for item in fields(value)]  # type: ignore[arg-type]
        return [RECORD, name, {key: self.tree(getattr(value, key), depth + 1) for key in names}]

    def _kept(self, array: NDArray[Any]) -> int:
        """The number of an array among those kept."""
        plain = array.astype(array.dtype.newbyteorder("<"), copy=False)
        if plain.dtype.str not in DTYPES:
            raise DataError(f"The state cannot be kept: an array of {array.dtype} is none of numbers.")
        self.arrays.append(plain)
        return len(self.arrays) - 1


def _array(kind: object, numbers: bytes, at: int) -> tuple[NDArray[Any], int]:
    """The array of a kind [dtype, shape, order] whose bytes begin at `at`, and where they end."""
    match kind:
        case [str(dtype), list(shape), "C" | "F" as order] if dtype in DTYPES:
            pass
        case _:
            raise _refuse(f"an array of unknown kind {str(kind)[:80]}")
    if len(shape) > 32 or not all(type(size) is int and size >= 0 for size in shape):
        raise _refuse(f"an array of shape {str(shape)[:80]}")
    count = math.prod(shape)
    end = at + count * np.dtype(dtype).itemsize
    if end > len(numbers):
        raise _refuse("too few numbers")
    flat = np.frombuffer(numbers, dtype=dtype, count=count, offset=at) if count else np.empty(0, dtype=dtype)
    try:
        array = flat.reshape(shape, order="F" if order == "F" else "C")
    except ValueError:
        # An empty array with sides that no array can have.
        raise _refuse(f"an array of shape {str(shape)[:80]}") from None
    return array.copy(order="K"), end


def _value(tree: object, arrays: list[NDArray[Any]], types: Types) -> object:
    """The value that a `_Writer` made the tree of. Raises DataError."""
    match tree:
        case None | bool() | int() | float() | str():
            return tree
        case ["a", int(number)] if 0 <= number < len(arrays):
            return arrays[number]
        case ["n", int(number)] if 0 <= number < len(arrays) and arrays[number].ndim == 0:
            return arrays[number][()]
        case ["f", str(word)] if word in FLOATS:
            return FLOATS[word]
        case ["c", real, imaginary]:
            one, other = _value(real, arrays, types), _value(imaginary, arrays, types)
            if isinstance(one, float) and isinstance(other, float):
                return complex(one, other)
        case ["t", *items]:
            return tuple(_value(item, arrays, types) for item in items)
        case ["e", str(name), value] if name in types and issubclass(types[name], Enum):
            try:
                return types[name](value)
            except (ValueError, TypeError):
                raise _refuse(f"no {name}: {str(value)[:80]}") from None
        case ["r", str(name), dict(values)] if name in types and is_dataclass(types[name]):
            kind, names = types[name], {item.name for item in fields(types[name])}
            if set(values) != names:
                other = ", ".join(sorted(names.symmetric_difference(values)))
                raise _refuse(f"a {kind.__name__} of another version, which differs in {other}")
            return kind(**{key: _value(item, arrays, types) for key, item in values.items()})
    raise _refuse(f"an unknown part {str(tree)[:80]}")
