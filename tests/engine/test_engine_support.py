"""Rows that no measurement supports for long are an event, and so is the first one that is supported again."""

import numpy as np

from midspan.engine.point import Support
from midspan.fusion.blocks import Rows
from midspan.records import Estimate, Status, part

CODES = {"t": Status.TRACKING, "c": Status.COASTING, "l": Status.LOST}


def rows_of(letters):
    """One row a second with these statuses."""
    status = np.array([CODES[letter] for letter in letters], dtype=np.uint8)
    nothing = np.zeros(len(status))
    return Estimate(np.arange(len(status)) * 10**9, nothing, nothing, nothing, status, status)


def reported(rows, cuts=()):
    """The events of rows that are cut into pushes at these places."""
    support, events = Support(), []
    for places in np.split(np.arange(len(rows.time_ns)), cuts):
        support, (found,) = support.after([Rows((part(rows, places),), (), ())])
        events += found.events
    return events


def test_lost_rows_are_reported_from_the_first_unsupported_one_on():
    begun, back = reported(rows_of("tttccllcltt"))
    assert (begun.kind, begun.time_ns, back.kind, back.time_ns) == ("lost", 3 * 10**9, "seen", 9 * 10**9)
    assert "from 3.000 s on" in begun.text
    assert "for 6.0 s" in back.text
    assert reported(rows_of("tttccctt")) == []
    assert [event.kind for event in reported(rows_of("ccltccll"))] == ["lost", "seen", "lost"]


def test_any_cutting_gives_the_same_events():
    rng = np.random.default_rng(0)
    for _ in range(50):
        rows = rows_of("".join(rng.choice(list("tcl"), 60, p=(0.5, 0.4, 0.1)).repeat(3)))
        assert reported(rows, np.sort(rng.integers(0, 180, 12))) == reported(rows)
