"""How fast and how late a stream comes, and how its clock drifts, against what was sent."""

import numpy as np
import pytest

from midspan.records import NANOSECONDS
from midspan.service.pace import ClockDrift, Pace
from midspan.service.running import Stream

T0 = 1_790_000_000 * NANOSECONDS
# What an offset is relative to: an opening, and what was set, s.
OPENING = ("opening", 0.2)


def s(seconds):
    return T0 + round(seconds * NANOSECONDS)


@pytest.mark.parametrize("values", [1, 20])
def test_rate_is_of_values_by_their_stamps_however_they_arrive(values):
    pace, rng = Pace(), np.random.default_rng(0)
    assert (pace.rate_hz, pace.delay_s) == (None, None)
    for number in range(1, 401):
        newest_s = 0.01 * values * number
        pace.came(s(newest_s), values, s(newest_s + rng.uniform(0.2, 0.4)))
    # Whole nanoseconds alone keep it from being exact.
    assert pace.rate_hz == pytest.approx(100.0, rel=1e-6)
    # The mean of 400 delays of an even distribution between both: 0.3 ± 0.003 s; of ten seconds' fifty, ± 0.008.
    assert pace.delay_s == pytest.approx(0.3, abs=0.03)


def test_rate_and_delay_are_those_of_the_last_seconds():
    pace = Pace()
    for number in range(2000):
        pace.came(s(0.01 * number), 1, s(0.01 * number + 1.0))
    for number in range(1, 241):
        pace.came(s(20.0 + 0.05 * number), 1, s(20.0 + 0.05 * number + 0.1))
    assert pace.rate_hz == pytest.approx(20.0, rel=0.01)
    assert pace.delay_s == pytest.approx(0.1, abs=0.01)


@pytest.mark.parametrize("step_s", [-3600.0, 3600.0])
def test_a_gap_or_a_clock_that_was_set_leaves_a_right_rate(step_s):
    pace = Pace()
    for number in range(500):
        moved_s = step_s * (number >= 250)
        pace.came(s(0.01 * number + moved_s), 1, s(0.01 * number + moved_s))
    assert pace.rate_hz == pytest.approx(100.0, rel=1e-6)


def test_what_comes_out_of_order_changes_no_rate():
    pace = Pace()
    for number in range(1000):
        pace.came(s(0.01 * (number ^ 1)), 1, s(0.01 * number))
    assert pace.rate_hz == pytest.approx(100.0, rel=0.002)


def test_drift_is_the_slope_of_the_offset():
    drift = ClockDrift()
    for minute in range(30):
        # Twice in a minute counts once.
        for at_s in (60.0 * minute, 60.0 * minute + 20.0):
            drift.look(s(at_s), 0.2 + 25e-6 * at_s, 1e-3, OPENING)
        assert (drift.ppm is None) == (minute < 10)
    assert drift.ppm == pytest.approx(25.0, abs=0.1)


def test_a_clock_that_is_set_or_not_estimated_does_not_drift():
    drift, first, second = ClockDrift(), object(), object()
    for minute in range(30):
        drift.look(s(60.0 * minute), 0.01, first, 0)
    assert drift.ppm == pytest.approx(0.0, abs=1e-6)
    # Its clock is set by half a second, then the point is opened anew with another offset.
    for begin_min, offset_s, point, set_ns in ((30, 0.51, first, 500_000_000), (60, 0.02, second, 0)):
        for minute in range(begin_min, begin_min + 30):
            drift.look(s(60.0 * minute), offset_s, point, set_ns)
            assert (drift.ppm is None) == (minute - begin_min < 10)
            assert drift.ppm is None or abs(drift.ppm) < 1e-6
    drift.look(s(60.0 * 90), None, second, 0)
    assert drift.ppm is None


@pytest.mark.parametrize("interval_s", [8.0, 12.0, 60.0])
@pytest.mark.parametrize("values", [1, 1200])
def test_what_comes_seldom_has_a_rate(interval_s, values):
    pace = Pace()
    for number in range(10):
        pace.came(s(interval_s * number), values, s(interval_s * number + 0.1))
        # The first two records tell the interval.
        assert number < 2 or pace.rate_hz == pytest.approx(values / interval_s, rel=1e-6)


@pytest.mark.parametrize("blocks", [1, 2, 20])
def test_an_outage_of_an_hour_does_not_make_a_source_look_fresh_later(blocks):
    stream = Stream("p", "accelerometer", "mqtt:b/acceleration", reason="")
    arrivals_s = [*range(blocks), *range(3600, 3603)]
    for now_s in arrivals_s:
        stream.heard(float(now_s), s(now_s), 100)
        assert stream.why(float(now_s)) == ""
    # Three of its intervals, of which the first one may be the outage's: a minute at most.
    assert stream.why(3602.0 + 181.0) == "silent"
    if blocks == 20:
        assert stream.why(3602.0 + 10.0) == "silent"
