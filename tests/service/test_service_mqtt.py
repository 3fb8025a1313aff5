"""What is published: blocks whose stamps are those of the rows, whatever is missing between them."""

import numpy as np
import pytest

from midspan.records import NANOSECONDS
from midspan.service.mqtt import even_parts, result_payload
from midspan.sources.live.blocks import RESULT, parse
from midspan.store.chunk import Chunk

BEGIN_NS = 1_790_000_000 * NANOSECONDS


@pytest.mark.parametrize("missing", [[], [5], [0], list(range(10, 30)), [3, 4, 50], [98]])
def test_blocks_end_where_stamps_do_not_go_on_evenly(missing):
    rng = np.random.default_rng(0)
    number = np.delete(np.arange(100), missing)
    # The accelerometer's stamps shiver by a tenth of a step.
    time_ns = BEGIN_NS + 10**7 * number + rng.integers(-(10**6), 10**6, len(number))
    value = rng.normal(0.0, 1e-3, len(number))
    columns = {"displacement_m": value, "std_m": np.full(len(number), 2e-5)}
    rows = Chunk("p", "rows", time_ns, columns, 1)
    blocks = [parse(result_payload(part, k), RESULT) for k, part in enumerate(even_parts(rows))]
    np.testing.assert_allclose(np.concatenate([one.values for one in blocks]), 1e3 * value, rtol=1e-6)
    np.testing.assert_allclose(np.concatenate([one.std for one in blocks]), 0.02, rtol=1e-6)
    assert np.abs(np.concatenate([one.time_ns for one in blocks]) - time_ns).max() < 5 * 10**6


def test_a_single_row_is_a_block():
    rows = Chunk("p", "rows", np.array([BEGIN_NS]), {"displacement_m": np.zeros(1), "std_m": np.ones(1)}, 1)
    (part,) = even_parts(rows)
    assert parse(result_payload(part, 0), RESULT).time_ns.tolist() == [BEGIN_NS]
