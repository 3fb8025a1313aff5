"""Two sensors that measure at the same instants: each keeps its own verdicts and noise."""

import numpy as np
import pytest

from midspan.fusion.gate import REJECTED
from midspan.fusion.kalman import KalmanFilter, KalmanSettings
from midspan.fusion.response import places, used_variance
from midspan.recording.fusing.fuse import FusionInputs, fuse
from midspan.records import Acceleration, Displacement, Innovation, Source, nanoseconds, part

TIME, MET = np.arange(6000) / 100.0, np.repeat(np.arange(598) / 10.0 + 0.05, 2)
SOURCE = np.tile(np.array([Source.CAMERA, Source.DISPLACEMENT], dtype=np.uint8), 598)
NOISE_A, NOISE_D = 2e-3, 1e-4
OUTLIERS = slice(201, 1100, 40)  # all of the second sensor


def motion(time):
    """2 mm at 0.3 Hz: displacement and acceleration."""
    value = 2e-3 * np.sin(2 * np.pi * 0.3 * time)
    return value, -((2 * np.pi * 0.3) ** 2) * value


def inputs(noise_of_second=NOISE_D):
    rng = np.random.default_rng(5)
    deviation = np.where(SOURCE == Source.CAMERA, NOISE_D, noise_of_second)
    return FusionInputs(
        Acceleration(
            nanoseconds(TIME), motion(TIME)[1] + rng.normal(0, NOISE_A, len(TIME)), np.full(len(TIME), NOISE_A**2 / 100)
        ),
        Displacement(
            nanoseconds(MET), motion(MET)[0] + deviation * rng.normal(size=len(MET)), np.full(len(MET), 1e-8), SOURCE
        ),
        KalmanSettings(bias_std=0.05),
        zero_ns=int(nanoseconds(MET[:1])[0]),
    )


def with_outliers(given):
    given.displacement.value_m[OUTLIERS] += 0.02
    return given


@pytest.mark.parametrize("method", ["smoother", "kalman"])
def test_rejected_measurements_of_one_sensor_are_found_among_those_of_the_other(method):
    given = with_outliers(inputs())
    given.displacement.value_m[300:320:2] = np.nan  # the camera lost the target; the other sensor did not
    found = fuse(given, method).innovation
    met = places(given.displacement, found)
    usable = np.flatnonzero(np.isfinite(given.displacement.value_m))
    np.testing.assert_array_equal(met, usable)
    np.testing.assert_array_equal(given.displacement.time_ns[met], found.time_ns)
    assert set(met[found.verdict == REJECTED]) == set(range(len(MET))[OUTLIERS])
    # What was predicted is the motion to a fraction of a millimetre: value minus innovation tells whose value it was.
    predicted = given.displacement.value_m[met] - found.value_m
    assert np.abs(predicted - motion(MET[met])[0])[20:].max() < 1e-3


def test_the_variance_that_was_used_is_each_sensors_own():
    given = with_outliers(inputs())
    stream = KalmanFilter(given.kalman)
    stream.push(given.displacement)
    (found,) = [item for item in stream.push(given.acceleration) if isinstance(item, Innovation)]
    left_out = np.flatnonzero(np.isinf(used_variance(given.displacement, found)))
    np.testing.assert_array_equal(left_out, np.arange(len(MET))[OUTLIERS])


def test_noise_is_learnt_for_the_sensor_that_has_it():
    given = inputs(noise_of_second=6 * NOISE_D)
    found = fuse(given, "smoother")
    assert found.variance_m2 is not None
    source = SOURCE[places(given.displacement, found.innovation)]
    # Windows of 61 know a deviation to a fifth.
    learnt = [np.median(np.sqrt(found.variance_m2[source == code])) for code in (Source.CAMERA, Source.DISPLACEMENT)]
    assert learnt == [pytest.approx(NOISE_D, rel=0.3), pytest.approx(6 * NOISE_D, rel=0.3)]


@pytest.mark.parametrize("apart_ns", [0, 1, 1000])
def test_innovations_belong_to_their_measurements_however_close_the_stamps(apart_ns):
    given = inputs()
    stamps = given.displacement.time_ns + np.where(SOURCE == Source.CAMERA, 0, apart_ns)
    measured = Displacement(stamps, given.displacement.value_m, given.displacement.variance_m2, SOURCE)
    n = len(stamps)
    # The last digit of a stamp is lost on the way through seconds, in either direction.
    found = Innovation(stamps, measured.value_m, np.ones(n), np.zeros(n, dtype=np.int8))
    np.testing.assert_array_equal(places(measured, found), np.arange(n))
    np.testing.assert_array_equal(places(measured, part(found, slice(100, 500))), np.arange(100, 500))
