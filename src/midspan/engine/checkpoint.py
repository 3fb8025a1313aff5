"""The state of any stage as bytes and back: a tree of plain values, the arrays behind it, and a check sum; no code.

Bytes: MAGIC, version and length of the tree (little-endian), SHA-256 of these two and all that follows, the tree as
JSON, the arrays' numbers one after another. In the tree None, truth values, whole numbers, finite floats and texts
stand for themselves; everything else is a list that begins with its tag.
"""

import hashlib
import json
import math
import struct
from dataclasses import fields
from enum import Enum
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from midspan import records
from midspan.engine.axis import AxisFigures, AxisMemory, Bridged
from midspan.engine.camera import CameraState
from midspan.engine.camera_target import TargetState
from midspan.engine.guard import GuardState, Stamps
from midspan.engine.merge import MergeState, StreamMemory
from midspan.engine.plain import EqualRun, PlainState
from midspan.engine.point import PointState
from midspan.engine.radar_target import FollowedState
from midspan.engine.sensors import CameraSensorState
from midspan.engine.switching import SwitchState
from midspan.engine.thermal_target import ThermalTargetState
from midspan.errors import DataError
from midspan.fusion.decisions import Decided, Telling, Undecided
from midspan.fusion.estimator import EstimatorState
from midspan.fusion.model import Beginning, Filter
from midspan.fusion.second_pass import LagState
from midspan.fusion.unmeasured import Integrated
from midspan.radar.range_gap import FirstFrames, RangeGap
from midspan.thermal.cleaning import CleaningState
from midspan.thermal.limits import LimitState
from midspan.thermal.pattern import FixedPattern
from midspan.thermal.shutter import ShutterState
from midspan.trees import TreeError, json_tree
from midspan.vision.bank import Plane
from midspan.vision.compression import Check, CodecState, Comparison
from midspan.vision.hybrid import PhaseState
from midspan.vision.learning import KeptSamples, Sample
from midspan.vision.light import LightState
from midspan.vision.phase_model import PhaseAxis, PhaseModel
from midspan.vision.picture_counts import AxisCounts, PictureCounts
from midspan.vision.picture_difference import Difference, Square
from midspan.vision.picture_quality import Lag, PictureState
from midspan.vision.reference.light import Mix
from midspan.vision.reference.pictures import Pictures
from midspan.vision.reference.records import Chain, KeyFrame
from midspan.vision.reference.state import Appearance, KeyFrameState, Overlap
from midspan.vision.reference.updating import Reference, UpdatingState
from midspan.vision.registration import Learnt, RegistrationState
from midspan.vision.target import Motion
from midspan.vision.template import TemplateState

MAGIC, VERSION = b"midspan\0", 1
# Version, length of the tree; the digest stands between them and the tree.
HEAD = struct.Struct("<IQ")
DIGEST_BYTES = hashlib.sha256().digest_size
# A record takes three levels of brackets, of which a tree may have 64.
MAX_DEPTH = 20
TUPLE, RECORD, ENUM, ARRAY, SCALAR, NOT_FINITE, COMPLEX = "t", "r", "e", "a", "n", "f", "c"
# The numbers that arrays may hold, always little-endian.
DTYPES = frozenset(
    ("|b1", "|i1", "|u1", "<i2", "<u2", "<i4", "<u4", "<i8", "<u8", "<f2", "<f4", "<f8", "<c8", "<c16"),
)
# The records that a state may consist of; a stage with a new one has a row here.
RECORDS: tuple[type, ...] = (
    records.Acceleration,
    records.Arrival,
    records.Channel,
    records.ChirpFrame,
    records.ClockOffset,
    records.Displacement,
    records.Estimate,
    records.Event,
    records.Frame,
    records.Health,
    records.Innovation,
    records.Measured,
    records.PixelTrack,
    records.PixelTranslation,
    records.Prediction,
    records.RangeFrame,
    records.RangeFrames,
    records.Readings,
    records.Region,
    records.Samples,
    records.ScaleFactor,
    records.Tick,
    records.TimeOffset,
    records.Tracked,
    Appearance,
    AxisCounts,
    AxisFigures,
    AxisMemory,
    Beginning,
    Bridged,
    CameraSensorState,
    CameraState,
    Chain,
    Check,
    CleaningState,
    CodecState,
    Comparison,
    Decided,
    Difference,
    EqualRun,
    EstimatorState,
    Filter,
    FirstFrames,
    FixedPattern,
    FollowedState,
    GuardState,
    Integrated,
    KeyFrame,
    KeyFrameState,
    KeptSamples,
    Lag,
    LagState,
    Learnt,
    LightState,
    LimitState,
    MergeState,
    Mix,
    Motion,
    Overlap,
    PhaseAxis,
    PhaseModel,
    PhaseState,
    PictureCounts,
    PictureState,
    Pictures,
    PlainState,
    Plane,
    PointState,
    SwitchState,
    Reference,
    RegistrationState,
    Sample,
    RangeGap,
    ShutterState,
    Square,
    Stamps,
    StreamMemory,
    TargetState,
    Telling,
    TemplateState,
    ThermalTargetState,
    Undecided,
    UpdatingState,
)
ENUMS: tuple[type[Enum], ...] = (records.SampleKind, records.Source, records.Status, records.StreamState)
_RECORDS = {record.__name__: record for record in RECORDS}
_ENUMS = {enum.__name__: enum for enum in ENUMS}
_FLOATS = {"nan": math.nan, "inf": math.inf, "-inf": -math.inf}
State = TypeVar("State")


def to_bytes(state: object) -> bytes:
    """A state as bytes; equal states give equal bytes.

    Raises DataError for what no state may hold: a type that is not in the tables, whole numbers of more than 64 bits.
    """
    arrays: list[NDArray[Any]] = []
    tree = _tree(state, arrays, 0)
    kinds = [[array.dtype.str, list(array.shape), _order(array)] for array in arrays]
    try:
        text = json.dumps({"tree": tree, "arrays": kinds}, allow_nan=False).encode("ascii")
        json_tree(text)
    except (TreeError, RecursionError) as error:
        raise DataError(f"The state cannot be kept: it {error}.") from None
    numbers = b"".join(array.tobytes(order=_order(array)) for array in arrays)
    head = HEAD.pack(VERSION, len(text))
    return b"".join((MAGIC, head, _digest(head, text + numbers), text, numbers))


def from_bytes(data: bytes, kind: type[State]) -> State:
    """The state of type `kind` that `to_bytes` made `data` of.

    Raises DataError for anything else: cut or changed bytes, another version, a type that is not in the tables.
    """
    start = len(MAGIC) + HEAD.size + DIGEST_BYTES
    if len(data) < start or not data.startswith(MAGIC):
        raise _refuse(f"{len(data)} bytes that do not begin as one")
    head = data[len(MAGIC) : len(MAGIC) + HEAD.size]
    version, length = HEAD.unpack(head)
    if version != VERSION:
        raise _refuse(f"version {version}; this program reads version {VERSION}")
    if _digest(head, data[start:]) != data[start - DIGEST_BYTES : start]:
        raise _refuse("bytes that are cut or changed")
    if length > len(data) - start:
        raise _refuse("a tree that is cut")
    state = _parsed(data[start : start + length], data[start + length :])
    if type(state) is not kind:
        raise _refuse(f"one of type {type(state).__name__} instead of {kind.__name__}")
    return state


def _digest(head: bytes, rest: bytes) -> bytes:
    return hashlib.sha256(head + rest).digest()


def _refuse(received: str) -> DataError:
    return DataError(f"A checkpoint must be a whole one of this program; received {received}. Start without it.")


def _order(array: NDArray[Any]) -> Any:
    """The order of an array's numbers in memory: sums follow it, and so do their last bits."""
    return "F" if array.flags.f_contiguous and not array.flags.c_contiguous else "C"


def _tree(value: object, arrays: list[NDArray[Any]], depth: int) -> object:
    """`value` as JSON has it; its arrays are added to `arrays`."""
    if depth > MAX_DEPTH:
        raise DataError(f"The state cannot be kept: it must have at most {MAX_DEPTH} levels of records and tuples.")
    if isinstance(value, np.ndarray | np.generic):
        return [ARRAY if isinstance(value, np.ndarray) else SCALAR, _kept(np.asarray(value), arrays)]
    if isinstance(value, Enum) and _ENUMS.get(type(value).__name__) is type(value):
        return [ENUM, type(value).__name__, value.value]
    if value is None or type(value) in (bool, int, str):
        return value
    if type(value) is float:
        return value if math.isfinite(value) else [NOT_FINITE, str(value)]
    if type(value) is complex:
        return [COMPLEX, _tree(value.real, arrays, depth), _tree(value.imag, arrays, depth)]
    if type(value) is tuple:
        return [TUPLE, *(_tree(item, arrays, depth + 1) for item in value)]
    if _RECORDS.get(type(value).__name__) is type(value):
        names = [item.name for item in fields(value)]  # type: ignore[arg-type]
        return [RECORD, type(value).__name__, {name: _tree(getattr(value, name), arrays, depth + 1) for name in names}]
    raise DataError(f"The state cannot be kept: {type(value).__name__} is not in the table of records.")


def _kept(array: NDArray[Any], arrays: list[NDArray[Any]]) -> int:
    """The number of an array among those kept."""
    plain = array.astype(array.dtype.newbyteorder("<"), copy=False)
    if plain.dtype.str not in DTYPES:
        raise DataError(f"The state cannot be kept: an array of {array.dtype} is none of numbers.")
    arrays.append(plain)
    return len(arrays) - 1


def _parsed(text: bytes, numbers: bytes) -> object:
    """The state of a tree and its arrays. Raises DataError."""
    try:
        whole = json_tree(text)
    except TreeError as error:
        raise _refuse(f"a tree that {error}") from None
    if not isinstance(whole, dict) or set(whole) != {"tree", "arrays"} or not isinstance(whole["arrays"], list):
        raise _refuse("a tree of another form")
    arrays, at = [], 0
    for kind in whole["arrays"]:
        array, at = _array(kind, numbers, at)
        arrays.append(array)
    if at != len(numbers):
        raise _refuse(f"{len(numbers) - at} bytes too many")
    return _value(whole["tree"], arrays)


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


def _value(tree: object, arrays: list[NDArray[Any]]) -> object:
    """The value that `_tree` wrote. Raises DataError."""
    match tree:
        case None | bool() | int() | float() | str():
            return tree
        case ["a", int(number)] if 0 <= number < len(arrays):
            return arrays[number]
        case ["n", int(number)] if 0 <= number < len(arrays) and arrays[number].ndim == 0:
            return arrays[number][()]
        case ["f", str(word)] if word in _FLOATS:
            return _FLOATS[word]
        case ["c", real, imaginary]:
            one, other = _value(real, arrays), _value(imaginary, arrays)
            if isinstance(one, float) and isinstance(other, float):
                return complex(one, other)
        case ["t", *items]:
            return tuple(_value(item, arrays) for item in items)
        case ["e", str(name), value] if name in _ENUMS:
            try:
                return _ENUMS[name](value)
            except (ValueError, TypeError):
                raise _refuse(f"no {name}: {str(value)[:80]}") from None
        case ["r", str(name), dict(values)] if name in _RECORDS:
            return _record(_RECORDS[name], {key: _value(item, arrays) for key, item in values.items()})
    raise _refuse(f"an unknown part {str(tree)[:80]}")


def _record(kind: type, values: dict[str, object]) -> object:
    names = {item.name for item in fields(kind)}
    if set(values) != names:
        other = sorted(names.symmetric_difference(values))
        raise _refuse(f"a {kind.__name__} of another version, which differs in {', '.join(other)}")
    return kind(**values)
