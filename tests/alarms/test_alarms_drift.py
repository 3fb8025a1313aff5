"""The drift of the daily mean of a bridge that breathes with the day's temperature."""

import json

import numpy as np
import pytest

from midspan.alarms.drift import HOUR_NS, DailyMean
from midspan.records import NANOSECONDS

# A row a minute from midnight on; the daily course has 5 mm, the drift 0.2 mm a day.
T0 = 20_000 * 24 * HOUR_NS
DRIFT_MM_DAY, COURSE_MM = 0.2, 5.0


def days(first, last, hours=range(24)):
    minute = np.arange(round(first * 1440), round(last * 1440))
    minute = minute[np.isin(minute // 60 % 24, list(hours))]
    day = minute / 1440
    value = DRIFT_MM_DAY * day + COURSE_MM * np.sin(2 * np.pi * day)
    return T0 + minute * 60 * NANOSECONDS, value, np.full(len(minute), 0.01**2)


def drifts(mean, time_ns, value, variance):
    parts = np.array_split(np.arange(len(value)), len(value) // 10)
    found = [mean.add(time_ns[part], value[part], variance[part]) for part in parts]
    return [drift for drift in found if drift is not None]


def test_a_drift_is_found_under_the_daily_course():
    found = drifts(DailyMean(), *days(0, 8))
    # Each hour from the second day's first on; what it is after a week: 24 h up to then against the first 24 h.
    end_ns, drift, std = found[-1]
    # The rows' interval of an hour's mean and of a day's slope: 1 % of a day.
    assert drift == pytest.approx(DRIFT_MM_DAY * ((end_ns - T0) / (24 * HOUR_NS) - 1.0), abs=0.01 * DRIFT_MM_DAY)
    assert std == pytest.approx(0.01 * 2**0.5, rel=1e-6)


def test_nights_without_a_camera_show_no_daily_course_as_drift():
    found = drifts(DailyMean(), *days(0, 6, range(6, 20)))
    # 14 hours of each day; of the rows of other hours the mean would be off by 1 mm and more.
    assert found
    assert max(abs(one[1]) for one in found) < DRIFT_MM_DAY * 6


def test_few_hours_are_no_day():
    assert drifts(DailyMean(), *days(0, 6, range(8, 16))) == []


def test_it_is_kept_over_a_restart():
    whole, mean = DailyMean(), DailyMean()
    expected = drifts(whole, *days(0, 4))
    found = drifts(mean, *days(0, 2.5))
    found += drifts(DailyMean.of_tree(json.loads(json.dumps(mean.to_tree()))), *days(2.5, 4))
    assert [one[0] for one in found] == [one[0] for one in expected]
    np.testing.assert_allclose([one[1] for one in found], [one[1] for one in expected], atol=1e-9)


def test_a_new_zero_begins_a_new_first_day():
    mean = DailyMean()
    drifts(mean, *days(0, 3))
    mean.restart(T0 + 3 * 24 * HOUR_NS)
    time_ns, value, variance = days(3, 5)
    found = drifts(mean, time_ns, value + 40.0, variance)
    assert max(abs(one[1]) for one in found) < 2 * DRIFT_MM_DAY
