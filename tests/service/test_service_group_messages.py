"""Messages of a group: read at once as they are read singly, and what is no block is counted."""

import json
import struct

import numpy as np
import pytest

from midspan.records import NANOSECONDS
from midspan.service.group_messages import Refusals, not_ahead, of_all, of_points
from midspan.sources.live.blocks import ACCELERATION, HEAD, Block, pack, parse
from midspan.sources.live.instants import SourceFault

BEGIN_NS = 1_790_000_000 * NANOSECONDS


def singly(point, payload):
    """A block as the plain reader has it."""
    block = parse(payload, ACCELERATION)
    return point, block.t0_ns, block.dt_ns, tuple(block.values)


def split(found):
    """Blocks one by one."""
    given = []
    for blocks in found:
        ends = np.cumsum(blocks.count)
        for j, end in enumerate(ends):
            values = blocks.values[end - blocks.count[j] : end]
            one = (int(blocks.point[j]), int(blocks.t0_ns[j]), int(blocks.dt_ns[j]), tuple(values.astype(np.float64)))
            given.append(one)
    return given


def test_messages_of_all_lengths_are_read_as_each_of_them_alone():
    rng = np.random.default_rng(0)
    payloads, points = [], []
    for k in range(200):
        count = int(rng.choice([1, 10, 100, 100, 100]))
        block = Block(ACCELERATION, k, BEGIN_NS + k, 10**7 + k, rng.normal(size=count))
        tree = {"sequence": k, "t0": BEGIN_NS + k, "dt_s": 0.01, "values": block.values.tolist()}
        payloads.append(json.dumps(tree).encode() if k % 7 == 0 else pack(block))
        points.append(int(rng.integers(0, 50)))
    refused = Refusals()
    found = split(of_points(ACCELERATION, points, payloads, refused))
    assert refused.count == 0
    assert sorted(found) == sorted(singly(*one) for one in zip(points, payloads, strict=True))


@pytest.mark.parametrize("of_one_length", [True, False])
def test_what_is_no_block_is_counted_and_leaves_the_others(of_one_length):
    good = pack(Block(ACCELERATION, 1, BEGIN_NS, 10**7, np.ones(10)))
    bad = [
        b"\x02" + good[1:],
        good[:1] + b"\x02" + good[2:],
        HEAD.pack(1, 1, 0, 1, 5, 10**7, 10) + good[HEAD.size :],
        HEAD.pack(1, 1, 0, 1, BEGIN_NS, 0, 10) + good[HEAD.size :],
        HEAD.pack(1, 1, 0, 1, BEGIN_NS, 10**7, 9) + good[HEAD.size :],
    ]
    bad += [] if of_one_length else [b"", b"x", b"{", good[:-1], b"\x00" * 30, b"[1]"]
    refused = Refusals()
    payloads = [*bad, good, good]
    found = of_points(ACCELERATION, list(range(len(payloads))), payloads, refused)
    assert refused.count == len(bad)
    assert [one[0] for one in split(found)] == [len(bad), len(bad) + 1]
    assert "must be as documented" in refused.texts["payload"]


def of_group(points, values, *, kind=4, n=None, t0_ns=BEGIN_NS, dt_ns=10**7):
    head = HEAD.pack(1, kind, 0, 3, t0_ns, dt_ns, values.shape[1] if n is None else n)
    return head + struct.pack("<I", points) + values.astype("<f4").tobytes()


def test_one_message_has_the_blocks_of_all_points_and_a_shard_takes_its_own():
    values = np.arange(60.0).reshape(6, 10)
    whole = of_all(4, 6, range(6), of_group(6, values))
    np.testing.assert_array_equal(whole.values.reshape(6, 10), values)
    assert whole.point.tolist() == list(range(6))
    part = of_all(4, 6, range(1, 6, 3), of_group(6, values))
    # By place in the shard's bank: points 1 and 4 of the group.
    assert part.point.tolist() == [0, 1]
    np.testing.assert_array_equal(part.values.reshape(2, 10), values[[1, 4]])
    assert part.t0_ns.tolist() == [BEGIN_NS] * 2
    assert of_all(4, 6, range(6), of_group(6, values[:, :0])) is None


@pytest.mark.parametrize(
    ("payload", "said"),
    [
        (b"", "0 bytes"),
        (of_group(5, np.ones((5, 2))), "5 points; the group has 6"),
        (of_group(6, np.ones((6, 2)), n=3), "bytes for 6 points and 3 values"),
        (of_group(6, np.ones((6, 2)), kind=1), "kind 1 where 4 is expected.*of all points.*{i}"),
        (
            b'{"sequence": 1, "t0": 5, "dt_s": 0.01, "values": [1.0]}',
            "JSON where messages of all points are binary and of kind 4",
        ),
        (of_group(6, np.ones((6, 2)), t0_ns=0), "outside the years"),
        (of_group(6, np.ones((6, 2)), dt_ns=0), "a microsecond"),
    ],
)
def test_what_is_no_message_of_all_points_is_refused(payload, said):
    with pytest.raises(SourceFault, match=said):
        of_all(4, 6, range(6), payload)


def test_a_message_of_all_points_on_the_topic_of_one_says_so():
    refused = Refusals()
    assert of_points(ACCELERATION, [3], [of_group(6, np.ones((6, 2)))], refused) == []
    assert refused.counts == {"payload": 1}
    assert "kind 4 where 1 is expected" in refused.texts["payload"]


def test_stamps_of_the_future_are_left_out_of_the_others():
    payloads = [pack(Block(ACCELERATION, 1, BEGIN_NS + k * 10**9, 10**7, np.full(10, float(k)))) for k in range(4)]
    refused = Refusals()
    (blocks,) = of_points(ACCELERATION, [0, 1, 2, 3], payloads, refused)
    kept = not_ahead(blocks, BEGIN_NS + 10**9, refused)
    assert kept.point.tolist() == [0, 1]
    assert kept.values.tolist() == [0.0] * 10 + [1.0] * 10
    assert refused.count == 2
    assert "ahead of this machine's clock" in refused.texts["clock_ahead"]
