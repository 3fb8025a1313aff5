"""MQTT payloads: both forms say the same, and nothing else gets in."""

import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from midspan.sources.live.blocks import ACCELERATION, DISPLACEMENT, HEAD, RESULT, Block, pack, parse
from midspan.sources.live.instants import SourceFault

T0_NS = 1_790_000_000_000_000_000


def block(kind=ACCELERATION, count=5):
    return Block(kind, 7, T0_NS, 10_000_000, np.arange(count, dtype=np.float64))


def test_the_binary_form_is_as_documented_and_comes_back():
    data = pack(block())
    # version, kind, two reserved bytes, sequence, stamp, interval, count: 28 bytes, then float32, little-endian.
    assert data[:8] == bytes([1, 1, 0, 0, 7, 0, 0, 0])
    assert int.from_bytes(data[8:16], "little") == T0_NS
    assert int.from_bytes(data[24:28], "little") == 5
    assert len(data) == 28 + 20
    found = parse(data, ACCELERATION)
    assert (found.sequence, found.t0_ns, found.dt_ns) == (7, T0_NS, 10_000_000)
    np.testing.assert_array_equal(found.values, np.arange(5))
    np.testing.assert_array_equal(found.time_ns, T0_NS + 10_000_000 * np.arange(5))


def test_a_result_carries_its_deviations():
    found = parse(pack(Block(RESULT, 1, T0_NS, 1, np.array([1.0, 2.0]), np.array([0.5, 0.25]))), RESULT)
    np.testing.assert_array_equal(found.values, [1.0, 2.0])
    np.testing.assert_array_equal(found.std, [0.5, 0.25])


@pytest.mark.parametrize("t0", [T0_NS, "2026-09-21T14:13:20.000Z", "2026-09-21T16:13:20+02:00"])
def test_json_says_the_same(t0):
    tree = {"sequence": 7, "t0": t0, "dt_s": 0.01, "values": [0, 1, None, 3, 4]}
    found = parse(json.dumps(tree).encode(), DISPLACEMENT)
    assert (found.sequence, found.t0_ns, found.dt_ns) == (7, T0_NS, 10_000_000)
    np.testing.assert_array_equal(found.values, [0, 1, np.nan, 3, 4])


@pytest.mark.parametrize(
    ("payload", "words"),
    [
        (b"", "0 bytes"),
        (pack(block())[:-1], "47 bytes, but 5 values need 48"),
        (b"\x02" + pack(block())[1:], "version 2"),
        (pack(block(DISPLACEMENT)), "kind 2 where 1 is expected"),
        (HEAD.pack(1, 1, 0, 1, 5, 10, 0), "outside the years 2000 to 2200"),
        (HEAD.pack(1, 1, 0, 1, T0_NS, 0, 0), "an interval of 0 ns"),
        (b"{", "no JSON"),
        (b'{"sequence": -1}', "a sequence"),
        (b'{"sequence": 1, "t0": 1, "dt_s": true, "values": []}', "a dt_s"),
        (b'{"sequence": 1, "t0": 1, "dt_s": 1, "values": ["a"]}', "values that are no list of numbers"),
        (b'{"sequence": 1, "t0": "2026-09-21T14:13:20", "dt_s": 1, "values": [1]}', "without a zone"),
        (b'{"sequence": 1, "t0": "yesterday", "dt_s": 1, "values": [1]}', "neither ISO 8601"),
    ],
)
def test_anything_else_is_one_clear_fault(payload, words):
    with pytest.raises(SourceFault, match=words) as fault:
        parse(payload, ACCELERATION)
    assert fault.value.code == "payload"


@given(st.binary(max_size=200) | st.binary(max_size=60).map(lambda rest: b"{" + rest))
@settings(max_examples=500, deadline=None)
def test_any_bytes_are_a_block_or_a_fault(payload):
    try:
        found = parse(payload, ACCELERATION)
    except SourceFault:
        return
    assert found.time_ns.shape == found.values.shape


@given(st.data())
@settings(max_examples=500, deadline=None)
def test_a_changed_byte_is_a_block_or_a_fault(data):
    changed = bytearray(pack(block()))
    changed[data.draw(st.integers(0, len(changed) - 1))] = data.draw(st.integers(0, 255))
    try:
        found = parse(bytes(changed), ACCELERATION)
    except SourceFault:
        return
    assert len(found.values) == 5
