"""Which calibration made which rows, as the index of the store tells it."""

import numpy as np
import pytest

from midspan.records import NANOSECONDS
from midspan.store.chunk import Chunk
from midspan.store.days import DAY_NS, REACH_NS
from midspan.store.spans import _runs
from midspan.store.store import Batch, open_store

BEGIN_NS = 20_700 * DAY_NS - 1000 * NANOSECONDS


def rows(first_s, last_s, calibration):
    """A row a second."""
    time_ns = BEGIN_NS + np.arange(first_s, last_s) * NANOSECONDS
    return Chunk("p", "rows", time_ns, {"displacement_m": np.zeros(len(time_ns))}, calibration, "displacement_m")


def spans(store):
    found = [(one.calibration, one.first_ns - BEGIN_NS, one.last_ns - BEGIN_NS) for one in store.spans("p", "rows")]
    return [(number, first // NANOSECONDS, last // NANOSECONDS) for number, first, last in found]


def test_spans_are_those_of_what_was_written_across_days_gaps_and_changes(store_at):
    store = open_store(store_at)
    assert store.spans("p", "rows") == []
    written = [(0, 2000, 1), (2000, 3000, 2), (9000, 9500, 2), (9500, 9600, 1)]
    for first, last, number in written:
        for begin in range(first, last, 100):
            store.write(Batch([rows(begin, begin + 100, number)]))
    # The newest rows are no blocks yet.
    expected = [(1, 0, 1999), (2, 2000, 2999), (2, 9000, 9499), (1, 9500, 9599)]
    assert spans(store) == expected
    store.close()
    store = open_store(store_at, read_only=True)
    assert spans(store) == expected
    assert store.spans("q", "rows") == []
    store.close()


def test_of_a_year_few_blocks_are_looked_at():
    begin_ns = BEGIN_NS + 320 * NANOSECONDS * np.arange(365 * 270)
    begin_ns[50_000:] += 2 * REACH_NS
    looked = []

    def calibration(number):
        looked.append(number)
        return 1 + (number >= 12_345) + (number >= 77_777)

    runs = _runs(begin_ns, calibration)
    assert runs == [(0, 12_344, 1), (12_345, 49_999, 2), (50_000, 77_776, 2), (77_777, len(begin_ns) - 1, 3)]
    # Once a day, at the gap, and where it changes.
    assert len(looked) == len(set(looked)) < 400


@pytest.mark.parametrize("removed", [{0}, {0, 1, 2}])
def test_blocks_that_are_removed_meanwhile_have_no_span(store_at, removed):
    store = open_store(store_at)
    for number in range(3):
        store.write(Batch([rows(2000 * number, 2000 * number + 100, number + 1)]))
        store.flush()
    days = list(store._days.all())
    begins = {day: day.begins("p", "rows") for day in days}
    gone = sorted(t0_ns for of_day in begins.values() for t0_ns in of_day)
    for day in days:
        day.begins = lambda _point, _stream, own=begins[day]: own
        for number in removed:
            place = ("p", "rows", gone[number])
            day.database.execute("DELETE FROM block WHERE point = ? AND stream = ? AND t0_ns = ?", place)
    expected = [(number + 1, 2000 * number, 2000 * number + 99) for number in range(3) if number not in removed]
    assert spans(store) == expected
    store.close()
