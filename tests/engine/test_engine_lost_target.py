"""A camera that loses its target is told: when, for how long, and whether it was dark."""

import numpy as np

from midspan.engine.lost_target import lost_events, lost_warnings
from midspan.engine.sensor_series import series_of
from midspan.records import NANOSECONDS, Displacement, Source


def measured(blind, length_s=60.0, rate_hz=4.0):
    """Displacement of zeros that is not seen in the stretches `blind` (s)."""
    time_s = np.arange(0.0, length_s, 1.0 / rate_hz)
    value = np.zeros(len(time_s))
    for begin, end in blind:
        value[(time_s >= begin) & (time_s < end)] = np.nan
    source = np.full(len(time_s), Source.INFRARED, np.uint8)
    return Displacement(np.rint(1e9 * time_s).astype(np.int64), value, np.full(len(time_s), 1e-10), source)


def seen(block, dark=(0.0, 0.0)):
    """The series of a camera, and which of its frames were black."""
    lit = (block.time_ns / NANOSECONDS < dark[0]) | (block.time_ns / NANOSECONDS >= dark[1])
    return series_of("infrared", Source.INFRARED, block), ~lit


def test_a_target_lost_for_seconds_is_one_event_and_its_return_another():
    camera = seen(measured([(10.0, 15.0), (20.0, 22.0), (50.0, 60.0)]))
    events = lost_events(*camera)
    assert [(event.kind, event.time_ns / NANOSECONDS) for event in events] == [
        ("lost", 10.0),
        ("seen", 15.0),
        ("lost", 50.0),
    ]
    assert "lost for 5.0 s" in events[0].text
    assert "to the end" in events[2].text
    (line,) = lost_warnings(*camera)
    # From 50 s to the last frame at 59.75 s.
    assert line.startswith(
        "infrared: the target was lost for 14.8 s in 2 stretches, the longest from 50.000 s to the end"
    )


def test_a_night_is_an_event_but_no_fault():
    camera = seen(measured([(10.0, 30.0)]), dark=(10.0, 30.0))
    begun, back = lost_events(*camera)
    assert "it is dark for 20.0 s" in begun.text
    assert back.time_ns == 30 * NANOSECONDS
    assert not lost_warnings(*camera)


def test_short_losses_and_a_camera_that_is_left_out_are_not_told():
    assert not lost_events(*seen(measured([(10.0, 12.5)])))
    # One frame in two seconds: four of them are no loss yet.
    assert not lost_events(*seen(measured([(10.0, 18.0)], rate_hz=0.5)))
    assert not lost_events(*seen(measured([(0.0, 60.0)])))
