"""Readings of a recording in blocks: every one comes once, in its order."""

import numpy as np
import pytest

from midspan.recording.run import Blocks, blocks_of
from midspan.records import NANOSECONDS, Readings


@pytest.mark.parametrize("block_s", [0.05, 0.7, 3.0, np.inf])
def test_every_reading_comes_once_however_they_are_cut(block_s):
    rng = np.random.default_rng(3)
    stamps = {name: np.arange(count) * (10 * NANOSECONDS // count) for name, count in (("a", 1000), ("d", 97))}
    stamps["a"][400:450] -= 2 * NANOSECONDS
    stamps["d"][30] = stamps["d"][29]
    readings = {name: Readings(own, rng.normal(size=(len(own), 1))) for name, own in stamps.items()}
    found = {name: [] for name in readings}
    begins = []
    for begin_ns, name, arrival in blocks_of(readings, {"a": 0, "d": -700_000_000}, block_s):
        begins.append(begin_ns)
        assert arrival.sequence == len(found[name])
        found[name].append(arrival.record)
    assert begins == sorted(begins)
    for name, own in readings.items():
        np.testing.assert_array_equal(np.concatenate([one.time_ns for one in found[name]]), own.time_ns)
        np.testing.assert_array_equal(np.concatenate([one.value for one in found[name]]), own.value)
    # A block holds what its span does; the sensor that begins 0.7 s before has its own.
    assert len(found["a"]) <= 11.0 / block_s + 1


@pytest.mark.parametrize("count", [0, 1, 511, 512, 513, 1600])
def test_blocks_that_are_joined_are_all_there_in_their_order(count):
    blocks = Blocks(lambda some: [number for one in some for number in one])
    for k in range(count):
        blocks.add([k])
    assert [number for one in blocks for number in one] == list(range(count))
    assert len(list(blocks)) <= count // 512 + 511
