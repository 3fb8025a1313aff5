"""A sensor that helps others: what of its values is used, and what is an event."""

import numpy as np
import pytest

from midspan.engine.auxiliary import AuxiliarySensor
from midspan.records import NANOSECONDS, Readings

STEP_S = 0.02


def pushed(sensor, time_s, value):
    """Push values one by one; returns the stamps (s) of those that are used, and time and kind of the events."""
    used, events = [], []
    for at_s, one in zip(time_s, value, strict=True):
        seen = sensor.push(Readings(np.array([round(at_s * NANOSECONDS)]), np.array([[one]])), lambda *_: (0.0, 0.0))
        if seen is not None:
            events += [(event.time_ns / NANOSECONDS, event.kind) for event in seen.events]
            used += [] if seen.measured is None else (seen.measured.time_ns / NANOSECONDS).tolist()
    return np.array(used), events


def test_a_gap_and_values_that_do_not_change_are_events():
    time_s = np.arange(0.0, 6.0, STEP_S)
    value = np.sin(time_s)
    value[(time_s > 1.0) & (time_s < 2.0)] = np.nan
    value[(time_s > 2.99) & (time_s < 4.99)] = 0.3
    used, events = pushed(AuxiliarySensor("gyroscope", 0, 1.0, STEP_S), time_s, value)
    assert [kind for _, kind in events] == ["gap", "frozen", "released"]
    # After half a second of equal values they are left out.
    assert [at_s for at_s, _ in events] == pytest.approx([1.0, 3.5, 5.0], abs=1e-9)
    assert not np.any((used > 1.0) & (used < 2.0))
    assert not np.any((used > 3.499) & (used < 4.99))
    assert len(used) == len(time_s) - 49 - 75


def test_without_a_usual_interval_nothing_is_a_gap():
    _, events = pushed(AuxiliarySensor("velocity", 0, 1.0), [0.0, 0.02, 3.0], [0.1, 0.2, 0.3])
    assert not events
