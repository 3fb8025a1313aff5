"""After a long time without measurements a structure is still near to where it was, and the rows say so."""

from dataclasses import replace

import numpy as np
import pytest
from estimator_cases import BRIDGE, Sensor, estimated, oscillating, samples_of, scores, sensor_of

from midspan.records import NANOSECONDS, Samples, joined, part, seconds

BEGIN_S, END_S, LENGTH_S = 60.0, 660.0, 720.0
# Of an acceleration of which nothing is known: its variance over the slowest frequency it is taken to have, 0.5 Hz.
UNKNOWN_DENSITY = 2.0 * 0.6**2


@pytest.fixture(scope="module")
def bridge():
    rng = np.random.default_rng(7)
    truth = oscillating(rng, LENGTH_S, BRIDGE)
    return truth, samples_of(truth, rng, length_s=LENGTH_S), sensor_of(truth, rng, length_s=LENGTH_S)


def chosen(sensor, kept):
    fields = (sensor.time, sensor.value, sensor.variance, sensor.reference)
    return Sensor(sensor.channel, *(one[kept] for one in fields))


def without(sensor):
    return chosen(sensor, (sensor.time < BEGIN_S) | (sensor.time >= END_S))


def with_gap(samples):
    """Without the samples of the gap, and with two of the mean in it, as the guard puts them there."""
    time_s = seconds(samples.time_ns, 0)
    before, after = part(samples, time_s < BEGIN_S), part(samples, time_s >= END_S)
    step_ns = NANOSECONDS // 100
    inserted = np.array([before.time_ns[-1] + step_ns, after.time_ns[0] - step_ns])
    mean = np.full((2, 1), np.mean(samples.value_m_s2))
    bridged = Samples(inserted, mean, np.full((2, 1), UNKNOWN_DENSITY), np.full(2, 2, dtype=np.uint8))
    density = after.noise_density.copy()
    density[0] = UNKNOWN_DENSITY
    return joined([before, bridged, replace(after, noise_density=density)])


def within(rows, first_s, last_s):
    time_s = seconds(rows.time_ns, 0)
    return (time_s > first_s) & (time_s < last_s)


@pytest.mark.parametrize("all_gone", [True, False], ids=["nothing measures", "the camera is gone"])
def test_the_first_rows_after_ten_minutes_are_within_metres_and_soon_as_good_as_any(bridge, all_gone):
    truth, samples, sensor = bridge
    found = estimated(with_gap(samples) if all_gone else samples, [without(sensor)])
    time_s, std_m = seconds(found.rows.time_ns, 0), np.sqrt(found.rows.variance_m2)
    # The acceleration alone leaves hundreds of metres: its unknown mean grows with the time squared. A measurement, or
    # the gap's end, bounds it by the metre that a structure is within; an hypothesis that the sensor was moved keeps
    # part of it until the next ones.
    returned = time_s >= END_S + 0.2
    assert np.max(std_m[returned]) < 1.0
    assert np.median(std_m[time_s > END_S + 5.0]) < 1.5 * np.median(std_m[(time_s > 20.0) & (time_s < BEGIN_S)])
    assert scores(found, truth, inner=(END_S + 0.2, LENGTH_S - 2.0))[2] > 0.9


@pytest.mark.parametrize("all_gone", [True, False], ids=["nothing measures", "the camera is gone"])
def test_both_halves_say_the_same_as_records_of_their_own(bridge, all_gone):
    """The second route, of filter and smoother: across the gap nothing is of use but the accelerometer's bias."""
    _, samples, sensor = bridge
    whole = estimated(with_gap(samples) if all_gone else samples, [without(sensor)], log=True)
    time_s, late = seconds(samples.time_ns, 0), sensor.time >= END_S
    for own_samples, own_measured, first_s, last_s in (
        (time_s < BEGIN_S, sensor.time < BEGIN_S, 5.0, BEGIN_S - 1.0),
        (time_s >= END_S, late, END_S + 5.0, LENGTH_S - 1.0),
    ):
        own = estimated(part(samples, own_samples), [chosen(sensor, own_measured)], log=True)
        for both in ((whole.rows, own.rows), (whole.estimator.smoothed()[0], own.estimator.smoothed()[0])):
            ours, others = (part(one, within(one, first_s, last_s)) for one in both)
            assert np.array_equal(ours.time_ns, others.time_ns)
            std_m = np.sqrt(others.variance_m2)
            # The bias is known better from both halves: less than half a deviation of the rows, a tenth of their width.
            assert np.sqrt(np.mean(((ours.displacement_m - others.displacement_m) / std_m) ** 2)) < 0.5
            assert np.all(np.abs(np.sqrt(ours.variance_m2) / std_m - 1.0) < 0.1)


@pytest.mark.parametrize("moved_m", [0.02, 0.8])
def test_a_structure_that_is_elsewhere_after_the_gap_is_followed(bridge, moved_m):
    truth, samples, sensor = bridge
    sensor = replace(sensor, value=sensor.value + moved_m * (sensor.time >= END_S))
    found = estimated(with_gap(samples), [without(sensor)])
    rows = part(found.rows, within(found.rows, END_S + 5.0, LENGTH_S))
    error = rows.displacement_m - truth.at(seconds(rows.time_ns, 0)) - moved_m
    assert np.mean(np.abs(error) < 1.96 * np.sqrt(rows.variance_m2)) > 0.9


def test_of_what_no_structure_does_the_rows_say_so(bridge):
    """It moved by 5 m, or the sensor was set up anew: reported, and the band is as wide as what is not known."""
    _, samples, sensor = bridge
    sensor = replace(sensor, value=sensor.value + 5.0 * (sensor.time >= END_S))
    found = estimated(with_gap(samples), [without(sensor)])
    assert [event.kind for event in found.events] == ["level_shift"]
    rows = part(found.rows, within(found.rows, END_S + 5.0, LENGTH_S))
    assert np.min(rows.variance_m2) > 0.3**2
