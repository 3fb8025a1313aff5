"""Plain arrays from outside: what no number may be is one sentence, and never ends the process."""

from dataclasses import replace

import numpy as np
import pytest

from midspan import Acceleration, Displacement, KalmanFilter, UsageError, smooth

TIME_S = np.arange(0, 10, 0.01)
SLOW_S = np.arange(0.003, 9.9, 0.1)


def acceleration():
    value = -0.2 * np.sin(2 * np.pi * TIME_S)
    return Acceleration(np.rint(1e9 * TIME_S).astype(np.int64), value, np.full(TIME_S.size, 2.5e-7))


def displacement():
    value = 0.2 / (2 * np.pi) ** 2 * np.sin(2 * np.pi * SLOW_S)
    source = np.full(SLOW_S.size, 4, np.uint8)
    return Displacement(np.rint(1e9 * SLOW_S).astype(np.int64), value, np.full(SLOW_S.size, 1e-8), source)


def changed(record, name, value):
    array = getattr(record, name).copy()
    array[50] = value
    return replace(record, **{name: array})


WRONG_ACCELERATION = [
    *[("value_m_s2", value) for value in (np.nan, np.inf, 1e300)],
    *[("noise_density", value) for value in (np.nan, 0.0, -1e-9)],
    ("time_ns", 0),
]
WRONG_DISPLACEMENT = [("value_m", 1e300), ("variance_m2", 0.0), ("variance_m2", -1e-8), ("source", 9), ("time_ns", 0)]


@pytest.mark.parametrize(("name", "value"), WRONG_ACCELERATION)
def test_a_wrong_acceleration_is_refused_by_name_and_place(name, value):
    wrong = changed(acceleration(), name, value)
    for run in (lambda: KalmanFilter().push(wrong), lambda: smooth(wrong, displacement())):
        with pytest.raises(UsageError, match=rf"{name}.* must be .* at index 50"):
            run()


@pytest.mark.parametrize(("name", "value"), WRONG_DISPLACEMENT)
def test_a_wrong_displacement_is_refused_by_name_and_place(name, value):
    wrong = changed(displacement(), name, value)
    # A whole record is put in order.
    runs = [lambda: KalmanFilter().push(wrong), lambda: smooth(acceleration(), wrong)][: 1 if name == "time_ns" else 2]
    for run in runs:
        with pytest.raises(UsageError, match=rf"{name}.* must be .* at index 50"):
            run()


def test_lengths_times_and_lags_that_cannot_be_are_refused():
    short = replace(acceleration(), value_m_s2=np.zeros(3))
    with pytest.raises(UsageError, match="length"):
        KalmanFilter().push(short)
    seconds = replace(acceleration(), time_ns=TIME_S)
    with pytest.raises(UsageError, match="whole nanoseconds"):
        smooth(seconds, displacement())
    with pytest.raises(UsageError, match="lag_samples must be 0 or more"):
        KalmanFilter(lag_samples=-3)


def test_a_measurement_that_is_marked_as_missing_is_no_error():
    marked = changed(changed(displacement(), "value_m", np.nan), "variance_m2", np.nan)
    assert np.isfinite(smooth(acceleration(), marked).estimate.displacement_m).all()
