"""What the events of a record are worth in sentences."""

from midspan.engine.row_messages import event_warnings
from midspan.records import NANOSECONDS, Event


def test_a_clock_that_is_corrected_again_and_again_runs_unevenly():
    steps = tuple(Event(k * NANOSECONDS, "clock", f"camera: its clock jumped by {k} ms.") for k in range(10, 15))
    assert [str(line) for line in event_warnings(steps[:2])] == [event.text for event in steps[:2]]
    (line,) = event_warnings(steps)
    assert line.code == "clock-differs"
    assert "unevenly" in line
    assert "from 10.000 s to 14.000 s" in line
    assert "jumped" not in line
