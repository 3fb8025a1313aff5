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


def test_the_steps_of_clocks_count_for_each_sensor():
    # Three clocks that were set once each are no clock that runs unevenly.
    steps = tuple(
        Event(k * NANOSECONDS, "clock", f"{sensor}: its clock jumped.", 0, sensor)
        for k, sensor in enumerate(("camera", "radar", "displacement"), start=1)
    )
    assert [str(line) for line in event_warnings(steps)] == [event.text for event in steps]
    uneven = tuple(Event(k * NANOSECONDS, "clock", "camera: its clock jumped.", 0, "camera") for k in range(5, 9))
    *lone, line = event_warnings((steps[1], *uneven))
    assert [str(one) for one in lone] == [steps[1].text]
    assert "unevenly" in line
    assert "camera" in line
