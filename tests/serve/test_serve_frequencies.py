"""The course of natural frequencies: of the right steps, of the right modes, and none computed twice."""

import asyncio
import time

import numpy as np
import pytest
import scene

from midspan.records import NANOSECONDS
from midspan.serve import frequencies, reading
from midspan.serve.problems import Problem
from midspan.serve.serving import Serving
from midspan.store.store import Batch, open_store

DAY_NS = 86_400 * NANOSECONDS


def mode(frequency_hz, rms_mm=1.0):
    return {"frequency_hz": frequency_hz, "frequency_std_hz": 0.001, "rms_mm": rms_mm}


def test_a_mode_is_followed_through_segments_in_which_it_is_missing_or_split():
    segments = [(0, [mode(2.00), mode(3.5)]), None, (1, [mode(2.1), mode(2.12, 0.1), mode(9.0)]), (2, [mode(3.4)]),
                (3, [mode(1.95), mode(3.6)])]  # fmt: skip
    found = frequencies.course(segments)
    assert found["time"] == [0, 1, 2, 3]
    # 9 Hz stands out once alone; of two peaks of a mode the stronger is it.
    assert [one["frequency_hz"] for one in found["modes"]] == [[2.0, 2.1, None, 1.95], [3.5, None, 3.4, 3.6]]
    assert "10 minutes" in frequencies.course([None])["reason"]
    assert "half" in frequencies.course([(k, [mode(1.3**k)]) for k in range(4)])["reason"]


def test_steps_are_the_shortest_of_which_sixty_are_enough():
    assert [frequencies.step_of(days * 86_400.0) for days in (0.01, 1, 7, 28, 365)] == [
        1800,
        1800,
        10_800,
        43_200,
        604_800,
    ]
    with pytest.raises(Problem, match="days"):
        frequencies.step_of(1e9)


@pytest.fixture(scope="module")
def store(tmp_path_factory):
    """A store of four days, with twenty minutes of rows each, whose first frequency falls by a per cent a day."""
    folder = tmp_path_factory.mktemp("frequencies") / "store"
    begin_ns = time.time_ns() // DAY_NS * DAY_NS - 5 * DAY_NS
    rng = np.random.default_rng(8)
    with_rows = open_store(folder)
    for day in range(4):
        count = scene.LENGTH_S * scene.RATE_HZ
        value_mm = scene.forced(rng, count, ((2.0 * 0.99**day, 0.3), (3.4, 0.1)))
        first_ns = begin_ns + day * DAY_NS + DAY_NS // 2
        time_ns = first_ns + np.arange(count, dtype=np.int64) * (NANOSECONDS // scene.RATE_HZ)
        with_rows.write(Batch(chunks=[scene.rows_of("p", time_ns, value_mm)]))
    with_rows.close()
    return folder, begin_ns


def test_a_frequency_that_falls_is_seen_to_fall(store):
    folder, begin_ns = store
    begins_ns = [begin_ns + day * DAY_NS for day in range(5)]
    length_ns = 1200 * NANOSECONDS
    found = [reading.segment_modes(str(folder), "p", at, at + DAY_NS, length_ns) for at in begins_ns]
    assert found[4] is None
    course = frequencies.course(found)
    assert course["time"] == [begin_ns + day * DAY_NS + DAY_NS // 2 for day in range(4)]
    first, second = course["modes"]
    std_hz = np.array(first["frequency_std_hz"])
    np.testing.assert_array_less(np.abs(np.array(first["frequency_hz"]) - 2.0 * 0.99 ** np.arange(4)), 5 * std_hz)
    assert std_hz.max() < 0.005
    np.testing.assert_allclose(second["frequency_hz"], 3.4, rtol=0.005)


def test_a_segment_of_the_past_is_computed_once(store, monkeypatch):
    folder, begin_ns = store
    computed = []

    async def run(work, *arguments):
        computed.append(arguments[2])
        return work(*arguments)

    async def twice():
        serving = Serving(str(folder))
        serving.long.run = run
        span = str(begin_ns), str(begin_ns + 4 * DAY_NS)
        monkeypatch.setattr(frequencies, "STEPS_S", (86_400,))
        monkeypatch.setattr(frequencies, "BUDGET_S", 0.0)
        answers = []
        while not answers or not answers[-1]["complete"]:
            answers.append(await frequencies.frequencies("p", serving, *span))
        serving.close()
        return answers

    answers = asyncio.run(twice())
    assert computed == [begin_ns + day * DAY_NS for day in range(4)]
    # A call gives what there is so far.
    assert [len(one["time"]) for one in answers] == [1, 2, 3, 4]


def test_a_segment_without_rows_is_looked_at_again_until_rows_after_it_are_stored(tmp_path):
    """The store was away for hours: what waits comes late."""
    step_ns = 1800 * NANOSECONDS
    step = time.time_ns() // step_ns - 20
    store = open_store(tmp_path / "store", points=["p"])

    def write(first_ns):
        rng, count = np.random.default_rng(8), scene.LENGTH_S * scene.RATE_HZ
        time_ns = first_ns + np.arange(count, dtype=np.int64) * (NANOSECONDS // scene.RATE_HZ)
        store.write(Batch([scene.rows_of("p", time_ns, scene.forced(rng, count, ((2.0, 0.3),)))]))

    async def looked_at():
        serving = Serving(str(tmp_path / "store"))
        try:
            found = [await frequencies.segment(serving, "p", step_ns, step)]
            write(step * step_ns)
            found.append(await frequencies.segment(serving, "p", step_ns, step))
            assert serving.segments == {}
            write((step + 1) * step_ns)
            found.append(await frequencies.segment(serving, "p", step_ns, step))
            assert list(serving.segments) == [("p", step_ns, step)]
        finally:
            serving.close()
        return found

    empty, first, kept = asyncio.run(looked_at())
    assert empty is None
    assert first == kept
    assert abs(first[1][0]["frequency_hz"] - 2.0) < 0.02
    store.close()
