"""The published rule of two cameras: the one with the larger mean number of matches measures."""

import numpy as np
import pytest

from midspan.papers.printed.switching import AVERAGE_S, Switch

BOTH = ("camera", "infrared")


def run(rows, rate_hz=5.0, switch=None):
    """A switch that was given rows of (camera's matches, infrared's), and its events."""
    switch, events = switch or Switch(BOTH), []
    for k, pair in enumerate(rows):
        for late, (sensor, matches) in enumerate(zip(BOTH, pair, strict=True)):
            reported = switch.push(sensor, round((k / rate_hz + 0.03 * late) * 1e9), matches)
            events += [] if reported is None else [reported]
    return switch, events


def test_the_larger_mean_number_of_matches_decides_and_is_reported():
    switch, events = run([(50.0, 40.0)] * 50 + [(20.0, 40.0)] * 50)
    assert switch.chosen == "infrared"
    (event,) = events
    assert event.kind == "switch"
    assert event.text.startswith("camera → infrared: ")
    # A mean of 2 s that falls from 50 to 20 crosses 40 after a third of that.
    assert event.time_ns / 1e9 == pytest.approx(10.0 + AVERAGE_S / 3.0, abs=0.25)


def test_single_frames_do_not_switch():
    rng = np.random.default_rng(0)
    # The mean of ten frames that scatter by 5 scatters by 1.6: 10 matches more are six times that.
    rows = np.array([50.0, 40.0]) + 5.0 * rng.standard_normal((1500, 2))
    assert run(rows)[1] == []


def test_a_camera_that_goes_blind_or_silent_is_left_within_the_mean():
    blind = [(50.0, 20.0)] * 50 + [(0.0, 20.0)] * 50
    switch, (event,) = run(blind)
    assert switch.chosen == "infrared"
    assert 10.0 < event.time_ns / 1e9 <= 10.0 + AVERAGE_S
    silent = Switch(BOTH)
    run([(50.0, 20.0)] * 50, switch=silent)
    reported = [silent.push("infrared", round(1e9 * (10.0 + 0.2 * k)), 20.0) for k in range(20)]
    assert silent.chosen == "infrared"
    assert len([event for event in reported if event is not None]) == 1


def test_a_record_that_begins_in_the_dark_begins_with_the_camera_that_sees_and_without_an_event():
    switch, events = run([(0.0, 10.0)] * 50)
    assert switch.chosen == "infrared"
    assert events == []


def test_a_state_taken_earlier_goes_on_to_the_same_decisions():
    rng = np.random.default_rng(1)
    rows = 30.0 + 20.0 * rng.standard_normal((400, 2)).cumsum(axis=0)
    _, whole = run(rows)
    switch, events = run(rows[:150])
    again = Switch(BOTH)
    again.state = switch.state
    for k, pair in enumerate(rows[150:], start=150):
        for late, (sensor, matches) in enumerate(zip(BOTH, pair, strict=True)):
            reported = again.push(sensor, round((k / 5.0 + 0.03 * late) * 1e9), matches)
            events += [] if reported is None else [reported]
    assert events == whole
    assert len(whole) > 2
