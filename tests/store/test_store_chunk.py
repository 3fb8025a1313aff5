"""Chunks: what is kept comes back bit for bit, whatever its clock and its numbers."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from midspan.errors import DataError
from midspan.store.chunk import Chunk, decode, encode, join
from midspan.store.numbers import decode_numbers, encode_numbers

BEGIN_NS = 1_790_000_000_000_000_000


def chunk(steps, columns=None):
    time_ns = BEGIN_NS + np.cumsum(np.asarray(steps, dtype=np.int64))
    return Chunk("p", "rows", time_ns, columns or {"x": np.arange(len(steps), dtype=np.float64)}, 3, "x")


@given(st.lists(st.integers(1, 10**12), min_size=1, max_size=50))
def test_any_stamps_come_back_exactly(steps):
    kept = chunk(steps)
    found = decode(encode(kept), "p", "rows", 3, "x")
    np.testing.assert_array_equal(found.time_ns, kept.time_ns)
    assert found.calibration == 3


@pytest.mark.parametrize("dtype", ["f8", "f4", "u1", "i8", "?"])
def test_columns_keep_their_type_and_every_bit(dtype):
    values = np.array([0, 1, 3], dtype=dtype)
    if dtype in ("f8", "f4"):
        values[1] = np.nan
    found = decode(encode(chunk([1, 1, 1], {"x": values})), "p", "rows")
    assert found.columns["x"].dtype == values.dtype
    np.testing.assert_array_equal(found.columns["x"], values)


@given(
    st.sampled_from(["f8", "f4", "i8", "u1", "i4", "?"]),
    st.binary(min_size=1, max_size=400),
    st.sampled_from(["bits", "steps", "constant", "single"]),
)
def test_any_numbers_come_back_bit_for_bit(dtype, data, kind):
    """NaN with their payload, infinities, zeros of both signs, denormal ones, the ends of the range."""
    dtype = np.dtype(dtype)
    values = np.frombuffer(data * dtype.itemsize, dtype="u1")
    values = (values & 1).view("?") if dtype.kind == "b" else values.view(dtype)
    with np.errstate(all="ignore"):
        if kind == "constant":
            values = np.full_like(values, values[0])
        elif dtype.kind == "f" and kind == "steps":
            values = (2.0**-30 * np.rint(np.nan_to_num(values % 8.0) * 1000)).astype(dtype)
        elif dtype == np.float64 and kind == "single":
            values = values.view("f4").astype("f8")
    found, end = decode_numbers(data := encode_numbers(values), 0, len(values), dtype)
    assert end == len(data)
    assert found.dtype == dtype
    np.testing.assert_array_equal(found.view("u1"), np.ascontiguousarray(values).view("u1"))


def test_columns_of_several_axes_and_of_phasors_come_back():
    rng = np.random.default_rng(0)
    two, phasors = rng.normal(size=(4, 2)), (rng.normal(size=(4, 6)) + 1j).astype(np.complex64)
    valid = rng.normal(size=(4, 3)) > 0
    found = decode(encode(chunk([1] * 4, {"two": two, "phasors": phasors, "valid": valid})), "p", "rows")
    for name, values in (("two", two), ("phasors", phasors), ("valid", valid)):
        np.testing.assert_array_equal(found.columns[name], values)


def test_limits_are_those_of_the_finite_values():
    assert chunk([1, 1, 1], {"x": np.array([2.0, np.nan, -1.0])}).limits == (-1.0, 2.0)
    assert chunk([1], {"x": np.array([np.nan])}).limits == (None, None)


def test_parts_by_slots_are_the_whole():
    kept = chunk([3 * 10**9] * 20)
    parts = kept.split(10.0)
    assert all(len(set((one.time_ns // 10**10).tolist())) == 1 for one in parts)
    np.testing.assert_array_equal(join(parts).time_ns, kept.time_ns)


def test_even_stamps_cost_next_to_nothing():
    # 1000 rows of one float: 8 kB of noise, and a head.
    values = np.random.default_rng(1).normal(size=1000)
    assert len(encode(chunk([10**7] * 1000, {"x": values}))) < 8000 + 1500


@pytest.mark.parametrize("cut", [0, 4, 10, -20])
def test_damaged_bytes_are_one_clear_error(cut):
    data = encode(chunk([1, 1]))
    with pytest.raises(DataError, match="damaged chunk of p, rows"):
        decode(data[:cut], "p", "rows")
