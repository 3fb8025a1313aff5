"""States as bytes: whatever is kept comes back the same, and what is damaged is refused in words."""

import contextlib
import hashlib
import json
import struct
from dataclasses import dataclass, fields, is_dataclass
from enum import Enum
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from midspan.engine import checkpoint
from midspan.engine.axis import AxisFigures
from midspan.engine.camera import CameraChain, CameraState, Target
from midspan.engine.checkpoint import DTYPES, from_bytes, to_bytes, types_in
from midspan.engine.guard import Guard, GuardSettings, GuardState
from midspan.engine.merge import Merge, MergeState
from midspan.engine.point import PointState
from midspan.engine.target_opening import Opening
from midspan.errors import DataError
from midspan.records import Arrival, Event, Frame, Readings, Region, Tick
from midspan.simulate.scene.camera import Camera
from midspan.simulate.scene.texture import textured_scene
from midspan.vision.tracker import TRACKERS


@dataclass(frozen=True)
class Whole:
    """Any state at all."""

    tree: PointState | Any


TYPES = [kind for kind in types_in(Whole).values() if kind is not Whole]
RECORDS, ENUMS = ([kind for kind in TYPES if issubclass(kind, Enum) == wanted] for wanted in (False, True))
KINDS = st.sampled_from(sorted(DTYPES)).map(np.dtype)
ARRAYS = KINDS.flatmap(
    lambda kind: arrays.arrays(kind, arrays.array_shapes(min_dims=0, max_dims=3, min_side=0, max_side=4))
)
LEAVES = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(-(2**63), 2**63 - 1),
    st.floats(),
    st.complex_numbers(),
    st.text(st.characters(), max_size=8),
    st.sampled_from([member for enum in ENUMS for member in enum]),
    ARRAYS,
    ARRAYS.map(np.asfortranarray),
    st.floats().map(np.float64),
    st.integers(0, 255).map(np.uint8),
    st.builds(Region, *[st.integers(-5, 5)] * 4),
)


def record_of(inner):
    return st.sampled_from(RECORDS).flatmap(
        lambda kind: st.builds(lambda *values: kind(*values), *[inner] * len(fields(kind)))
    )


TREES = st.recursive(
    LEAVES, lambda inner: st.one_of(st.lists(inner, max_size=4).map(tuple), record_of(inner)), max_leaves=8
)


def same(first, second):
    """Whether two states are the same to the last bit, types included."""
    if type(first) is not type(second):
        return False
    if isinstance(first, np.ndarray | np.generic):
        a, b = np.asarray(first), np.asarray(second)
        order = a.flags.c_contiguous == b.flags.c_contiguous and a.flags.f_contiguous == b.flags.f_contiguous
        return a.dtype == b.dtype and a.shape == b.shape and order and a.tobytes("A") == b.tobytes("A")
    if is_dataclass(first):
        return all(same(getattr(first, item.name), getattr(second, item.name)) for item in fields(first))
    if isinstance(first, tuple):
        return len(first) == len(second) and all(map(same, first, second))
    if isinstance(first, complex):
        return same(first.real, second.real) and same(first.imag, second.imag)
    if isinstance(first, float):
        return struct.pack("d", first) == struct.pack("d", second) or (first != first and second != second)
    return first == second


@given(TREES)
@settings(max_examples=200, deadline=None)
def test_every_tree_comes_back_the_same(tree):
    data = to_bytes(Whole(tree))
    assert same(from_bytes(data, Whole), Whole(tree))
    assert to_bytes(from_bytes(data, Whole)) == data


def a_state():
    merge = Merge(("accel", "camera"))
    merge.push(Tick(0))
    merge.push(Arrival("camera", 0, Frame(5, np.arange(12, dtype=np.uint8).reshape(3, 4))))
    merge.push(Arrival("accel", 0, Readings(np.array([1, 2, 2, 9]), np.array([[1.0], [np.nan], [3.0], [4.0]]))))
    return merge.state


def test_the_state_of_a_stage_comes_back_and_goes_on():
    figures = AxisFigures(0.0, 1.0, 3.0, noise_density=1e-8, name="a")
    guard, other = (Guard(GuardSettings(100.0, (figures,))) for _ in range(2))
    value = np.sin(np.arange(50.0))[:, None]
    value[40:45] = np.nan
    time_ns = np.arange(50) * 10_000_000
    guard.push(Readings(time_ns[:43], value[:43]))
    other.restore(from_bytes(to_bytes(guard.state), GuardState))
    rest = Readings(time_ns[43:], value[43:])
    for first, second in zip(guard.push(rest), other.push(rest), strict=True):
        assert same(first, second) if not isinstance(first, Event) else first == second


def test_cut_bytes_are_refused():
    data = to_bytes(a_state())
    for length in range(len(data)):
        with pytest.raises(DataError):
            from_bytes(data[:length], MergeState)
    with pytest.raises(DataError):
        from_bytes(data + b"\0", MergeState)


def test_changed_bytes_are_refused():
    data = to_bytes(a_state())
    rng = np.random.default_rng(0)
    for at in range(len(data)):
        changed = bytearray(data)
        changed[at] ^= int(rng.integers(1, 256))
        with pytest.raises(DataError):
            from_bytes(bytes(changed), MergeState)


def sealed(text, numbers=b"", version=checkpoint.VERSION, length=None):
    """A checkpoint with a right check sum around any tree."""
    head = checkpoint.HEAD.pack(version, len(text) if length is None else length)
    digest = hashlib.sha256(head + text + numbers).digest()
    return checkpoint.MAGIC + head + digest + text + numbers


def test_a_damaged_tree_with_a_right_check_sum_is_a_clear_error_too():
    data = to_bytes(a_state())
    start = len(checkpoint.MAGIC) + checkpoint.HEAD.size + checkpoint.DIGEST_BYTES
    length = checkpoint.HEAD.unpack(data[len(checkpoint.MAGIC) :][: checkpoint.HEAD.size])[1]
    text, numbers = data[start : start + length], data[start + length :]
    assert same(from_bytes(sealed(text, numbers), MergeState), a_state())
    rng = np.random.default_rng(1)
    for _ in range(3000):
        changed = bytearray(text)
        for at in rng.integers(0, len(text), rng.integers(1, 4)):
            changed[at] = rng.choice(np.frombuffer(b'[]{},":0123456789-.eatrnf\xff ', dtype=np.uint8))
        # A changed digit may give another state; what gives none is a DataError, never another.
        with contextlib.suppress(DataError):
            from_bytes(sealed(bytes(changed), numbers), MergeState)


@pytest.mark.parametrize(
    ("tree", "words"),
    [
        (["r", "Popen", {}], "unknown part"),
        (["r", "midspan.records.Frame", {"index": 1}], "another version, which differs in covered, pixels, time_ns"),
        (["r", "midspan.records.Status", {}], "unknown part"),
        (["r", "midspan.records.Region", {"x": 0, "y": 0, "width": 1, "height": 1}], "unknown part"),
        (["e", "midspan.records.Status", 99], "no midspan.records.Status"),
        (["e", "midspan.records.Status", []], "no midspan.records.Status"),
        (["e", "midspan.records.Frame", 1], "unknown part"),
        (["a", 0], "unknown part"),
        (["f", "1e400"], "unknown part"),
        ({}, "unknown part"),
        (["e", "midspan.records.Status", 1], "Status instead of MergeState"),
    ],
)
def test_what_no_field_declares_is_named(tree, words):
    text = json.dumps({"tree": tree, "arrays": []}).encode()
    with pytest.raises(DataError, match=words):
        from_bytes(sealed(text), MergeState)


@pytest.mark.parametrize(
    ("kind", "words"),
    [
        (["|O", [1], "C"], "unknown kind"),
        (["<f8", [2**40, 2**40], "C"], "too few"),
        (["<f8", [-1], "C"], "shape"),
        (["<f8", [1], "K"], "unknown kind"),
        (["<f8", [0, 2**62], "C"], "shape"),
    ],
)
def test_impossible_arrays_are_refused(kind, words):
    text = json.dumps({"tree": ["t"], "arrays": [kind]}).encode()
    with pytest.raises(DataError, match=words):
        from_bytes(sealed(text), tuple)


def test_another_version_and_a_wrong_form_are_refused():
    with pytest.raises(DataError, match="version 2"):
        from_bytes(sealed(b"{}", version=2), tuple)
    with pytest.raises(DataError, match="another form"):
        from_bytes(sealed(b"{}"), tuple)
    with pytest.raises(DataError, match="tree that is cut"):
        from_bytes(sealed(b"{}", length=2**40), tuple)


@dataclass(frozen=True)
class Foreign:
    x: int


@pytest.mark.parametrize(
    "wrong",
    [
        Foreign(1),
        {"a": 1},
        [1],
        b"bytes",
        object(),
        2**64,
        np.array([None]),
        np.array(["text"]),
        np.datetime64("2020"),
    ],
)
def test_what_no_state_may_hold_is_refused_when_it_is_written(wrong):
    with pytest.raises(DataError, match="cannot be kept"):
        to_bytes((wrong,))


def test_too_many_levels_are_refused_when_they_are_written():
    deep = 1.5
    for _ in range(100):
        deep = (deep,)
    with pytest.raises(DataError, match="levels"):
        to_bytes(deep)


@pytest.mark.parametrize("reference", ["first", "key-frames", "updating"])
@pytest.mark.parametrize("tracker", TRACKERS)
def test_the_state_of_every_tracker_comes_back_and_goes_on(tracker, reference):
    scene = textured_scene("natural", (96, 96), rng=np.random.default_rng(2), lens_px=0.6)
    path = 0.8 * np.sin(0.4 * np.arange(70))
    film = [
        Frame(10**8 * k, Camera().expose(scene.render(0.0, y), rng=np.random.default_rng(k)))
        for k, y in enumerate(path)
    ]
    made = Opening(tracker, reference=reference)
    chain, other = (CameraChain(film[0], (Target(Region(20, 20, 56, 56)),), made) for _ in range(2))
    for frame in film[:60]:
        chain.push(frame)
    data = to_bytes(chain.state)
    other.restore(from_bytes(data, CameraState))
    assert to_bytes(other.state) == data
    for frame in film[60:]:
        assert same(other.push(frame), chain.push(frame))


def test_its_parts_are_the_whole_and_large_arrays_stand_alone():
    rng = np.random.default_rng(0)
    template, changing = rng.normal(size=(40, 40)).astype(np.float32), rng.normal(size=2000)
    first = to_bytes(Whole((template, np.arange(5), changing, "text")))
    later = to_bytes(Whole((template, np.arange(7), changing + 1.0, "another text")))
    for whole in (first, later):
        assert b"".join(checkpoint.parts_of(whole)) == whole
    # What stays is one of the parts of both, though all that is before it moved.
    assert set(checkpoint.parts_of(first)) & set(checkpoint.parts_of(later)) == {template.tobytes()}
    small = to_bytes(Whole((np.arange(5),)))
    assert checkpoint.parts_of(small) == [small]
