"""The estimator as a stream: cuts, saved states, axes, channels, waiting, predictions."""

from dataclasses import replace

import numpy as np
import pytest
from estimator_cases import (
    camera,
    estimated,
    measured_of,
    oscillating,
    samples_of,
    scores,
    sensor_of,
)

from midspan.fusion.estimator import Estimator
from midspan.fusion.model import EstimatorSettings, Parameter, ParameterKind
from midspan.records import Event, Samples, Source, Status, joined, part, seconds

LENGTH_S = 40.0


def spoilt(seed=5):
    """Samples and two sensors of different rate and unit, with outliers, a shift and references that change."""
    rng = np.random.default_rng(seed)
    truth = oscillating(rng, LENGTH_S)
    samples = samples_of(truth, rng, length_s=LENGTH_S)
    first = sensor_of(truth, rng, camera(units_per_m=-800.0, exposure_s=0.02), length_s=LENGTH_S)
    second = sensor_of(
        truth,
        rng,
        camera(sensor="radar", source=Source.RADAR, units_per_m=3.0, zero_std_m=np.inf),
        rate_hz=37.0,
        length_s=LENGTH_S,
        zero=0.05,
    )
    first.value[rng.random(len(first.time)) < 0.1] += 3.0
    second.value[second.time > 20.0] += 6e-3
    first.reference[(first.time > 10.0) & (first.time < 15.0)] = (800.0 * 2e-4) ** 2
    return truth, samples, [first, second]


def settings_of(sensors):
    return EstimatorSettings(
        channels=tuple(s.channel for s in sensors),
        parameters=(
            Parameter(ParameterKind.SCALE_ERROR, (0,), 1e-3),
            Parameter(ParameterKind.CLOCK_OFFSET, (0, 1), 5e-4),
        ),
        zero_ns=int(2.5e9),
    )


def pushed(estimator, samples, measured, edges):
    """Rows and events of pushes that end at the samples `edges`, each after the measurements that it covers."""
    found, done = [], -np.inf
    for first, last in zip((0, *edges), (*edges, len(samples.time_ns)), strict=True):
        block = part(samples, slice(first, last))
        until = block.time_ns[-1]
        found += estimator.push(part(measured, (measured.time_ns > done) & (measured.time_ns <= until)))
        found += estimator.push(block)
        done = until
    return found


def all_of(outputs):
    """Every number that was given out."""
    rows = joined([one.estimates[0] for one in outputs if one.estimates])
    met = [joined([one.innovations[c] for one in outputs if one.innovations]) for c in (0, 1)]
    events = [event for one in outputs for event in one.events]
    numbers = [rows.displacement_m, rows.variance_m2, rows.velocity_m_s, rows.source, rows.status]
    for one in met:
        numbers += [one.time_ns, one.value_m, one.variance_m2, one.verdict]
    return numbers, events


def same(one, other):
    assert [e.text for e in one[1]] == [e.text for e in other[1]]
    for mine, its in zip(one[0], other[0], strict=True):
        assert np.array_equal(mine, its)


def test_any_cutting_gives_the_same_bits():
    _, samples, sensors = spoilt()
    measured, settings = measured_of(sensors), settings_of(sensors)
    whole = Estimator(settings)
    found = all_of([*pushed(whole, samples, measured, ()), *whole.finish()])
    for edges in ((1, 2, 3, 50, 51, 300), tuple(range(7, len(samples.time_ns), 97)), range(1, 300)):
        stream = Estimator(settings)
        same(found, all_of([*pushed(stream, samples, measured, tuple(edges)), *stream.finish()]))


@pytest.mark.parametrize("cut", [3, 60, 200, 1999, 2100])
def test_a_restored_estimator_goes_on_with_the_same_bits(cut):
    _, samples, sensors = spoilt()
    measured, settings = measured_of(sensors), settings_of(sensors)
    one, other = Estimator(settings), Estimator(settings)
    before = part(measured, measured.time_ns <= samples.time_ns[cut])
    after = part(measured, measured.time_ns > samples.time_ns[cut])
    begun = [*one.push(before), *one.push(part(samples, slice(cut + 1)))]
    saved = one.state
    rest = [*one.push(after), *one.push(part(samples, slice(cut + 1, None))), *one.finish()]
    other.restore(saved)
    again = [*other.push(after), *other.push(part(samples, slice(cut + 1, None))), *other.finish()]
    same(all_of([*begun, *rest]), all_of([*begun, *again]))


def test_the_order_of_targets_does_not_matter():
    rng = np.random.default_rng(8)
    truth = oscillating(rng, LENGTH_S)
    samples = samples_of(truth, rng, length_s=LENGTH_S)
    targets = [sensor_of(truth, rng, camera(target=str(i)), length_s=LENGTH_S) for i in range(3)]
    targets[1].value[rng.random(len(targets[1].time)) < 0.1] += 2e-3
    forth, back = estimated(samples, targets), estimated(samples, targets[::-1])
    # Nanometres: what is left is rounding, once decisions and order are the same.
    assert np.abs(forth.rows.displacement_m - back.rows.displacement_m).max() < 1e-10


def test_two_axes_are_two_estimators_of_one():
    rng = np.random.default_rng(9)
    truths = [oscillating(rng, LENGTH_S) for _ in range(2)]
    each = [samples_of(truth, rng, length_s=LENGTH_S) for truth in truths]
    sensors = [sensor_of(truth, rng, camera(axis=a), length_s=LENGTH_S) for a, truth in enumerate(truths)]
    both = Samples(
        each[0].time_ns,
        np.hstack([s.value_m_s2 for s in each]),
        np.hstack([s.noise_density for s in each]),
        each[0].kind,
    )
    # Two axes wait half as long for their first measurements; what is undecided of them weighs less and less.
    speed = {"velocity_std_m_s": (0.1, 0.1)}
    joint = Estimator(EstimatorSettings(tuple(s.channel for s in sensors), axes=2, zero_ns=0, **speed))
    found = [*joint.push(measured_of(sensors)), *joint.push(both)]
    for a in range(2):
        rows = joined([one.estimates[a] for one in found])
        alone = estimated(each[a], [replace(sensors[a], channel=camera())], zero_ns=0, **speed).rows
        later = rows.time_ns > 5e9
        assert np.allclose(rows.displacement_m[later], alone.displacement_m[later[-len(alone.time_ns) :]], atol=2e-6)


def test_a_prediction_is_what_is_measured_next_within_its_deviation():
    truth, samples, sensors = spoilt()
    measured, settings = measured_of(sensors), settings_of(sensors)
    stream = Estimator(settings)
    assert np.isinf(stream.predict(0, int(1e9))[1])
    off = []
    for k in range(300, 1800, 10):
        edge = samples.time_ns[k]
        done = samples.time_ns[k - 10] if k > 300 else -1
        stream.push(part(measured, (measured.time_ns > done) & (measured.time_ns <= edge)))
        stream.push(part(samples, slice(k - 9 if k > 300 else 0, k + 1)))
        value, variance = stream.predict(0, int(edge + 4_000_000))
        exact = -800.0 * truth.at(seconds(np.array([edge]), 0) + 4e-3, 0.02)[0]
        off.append((value - exact) / np.sqrt(variance))
    assert np.mean(np.abs(off) < 1.96) > 0.85
    assert np.sqrt(np.mean(np.square(off))) < 1.5


def test_rows_begin_with_the_first_measurement_and_tell_what_they_rest_on():
    rng = np.random.default_rng(10)
    truth = oscillating(rng, LENGTH_S)
    samples = samples_of(truth, rng, length_s=LENGTH_S)
    sensor = sensor_of(truth, rng, length_s=LENGTH_S, start_s=3.004)
    keep = (sensor.time < 10.0) | (sensor.time > 25.0)
    for name in ("time", "value", "variance", "reference"):
        setattr(sensor, name, getattr(sensor, name)[keep])
    rows = estimated(samples, [sensor]).rows
    time_s = seconds(rows.time_ns, 0)
    assert time_s[0] == pytest.approx(3.01)
    assert set(rows.status[time_s < 10.0]) == {Status.TRACKING}
    assert set(rows.status[(time_s > 10.5) & (time_s < 19.5)]) == {Status.COASTING}
    assert set(rows.status[(time_s > 20.5) & (time_s < 25.0)]) == {Status.LOST}
    assert set(rows.source[time_s < 10.0]) == {Source.CAMERA}
    assert set(rows.source[(time_s > 10.5) & (time_s < 25.0)]) == {Source.PREDICTION}


def running():
    """An estimator that has taken 100 measurements and 2000 samples of a record, and both whole."""
    rng = np.random.default_rng(11)
    truth = oscillating(rng, LENGTH_S)
    samples = samples_of(truth, rng, length_s=LENGTH_S)
    measured = measured_of([sensor_of(truth, rng, length_s=LENGTH_S)])
    stream = Estimator(EstimatorSettings((camera(),)))
    stream.push(part(measured, slice(100)))
    stream.push(part(samples, slice(2000)))
    return stream, samples, measured


def test_a_measurement_that_comes_too_late_is_reported_once():
    stream, samples, measured = running()
    stream.push(part(measured, slice(100, 110)))
    stream.push(part(measured, slice(110, 120)))
    found = stream.push(part(samples, slice(2000, 2100)))
    assert [(event.kind, event.time_ns) for one in found for event in one.events] == [("late", measured.time_ns[100])]


def test_a_late_measurement_among_others_is_reported_with_its_own_stamp():
    stream, samples, measured = running()
    assert measured.time_ns[250] > samples.time_ns[1999]
    stream.push(part(measured, np.array([250, 110])))
    found = stream.push(part(samples, slice(2000, 3000)))
    assert [(event.kind, event.time_ns) for one in found for event in one.events] == [("late", measured.time_ns[110])]


def test_an_overflow_drops_no_datum_and_no_mark_of_stamps_that_went_back(monkeypatch):
    monkeypatch.setattr("midspan.fusion.estimator.MAX_WAITING", 100)
    rng = np.random.default_rng(11)
    truth = oscillating(rng, LENGTH_S)
    samples = samples_of(truth, rng, length_s=LENGTH_S)
    measured = measured_of([sensor_of(truth, rng, length_s=LENGTH_S)])
    datum_ns = int(measured.time_ns[60])
    stream = Estimator(EstimatorSettings((camera(),), zero_ns=datum_ns))
    stream.push(part(measured, slice(30)))
    stream.push(part(samples, slice(300)))
    stream.push(Event(int(measured.time_ns[50]), "backwards", ""))
    for k in range(30, 300):
        stream.push(part(measured, slice(k, k + 1)))
    _, channels = stream.core.waiting()
    # Stamps that went back, then the datum.
    assert [c for c in channels if c < 0] == [-2, -1]
    assert len(channels) == 102
    rows = joined([one.estimates[0] for one in stream.push(part(samples, slice(300, None)))])
    # Rows count from the datum: the next one is as far from it as the velocity says, to half of 1 m/s² times (10 ms)².
    at = int(np.searchsorted(rows.time_ns, datum_ns))
    since_s = (rows.time_ns[at] - datum_ns) / 1e9
    assert abs(rows.displacement_m[at] - since_s * rows.velocity_m_s[at]) < 5e-5


@pytest.mark.parametrize("begun", [False, True])
def test_measurements_that_wait_for_samples_are_bounded_and_an_overflow_is_reported_once(begun, monkeypatch):
    monkeypatch.setattr("midspan.fusion.estimator.MAX_WAITING", 100)
    rng = np.random.default_rng(11)
    truth = oscillating(rng, LENGTH_S)
    samples = samples_of(truth, rng, length_s=LENGTH_S)
    measured = measured_of([sensor_of(truth, rng, length_s=LENGTH_S)])
    stream = Estimator(EstimatorSettings((camera(),)))
    events, done = [], 0
    if begun:
        done = 30
        stream.push(part(measured, slice(done)))
        events += stream.push(part(samples, slice(300)))
    for k in range(done, 300):
        stream.push(part(measured, slice(k, k + 1)))
        assert len(stream.core.waiting()[0]) <= 100
        assert stream.core.early() <= 100
    stream.restore(stream.state)
    events += stream.push(part(samples, slice(300 if begun else 0, 2000)))
    rest = stream.push(part(samples, slice(2000, None)))
    reported = [event for one in [*events, *rest] for event in one.events if event.kind == "overflow"]
    assert [event.time_ns for event in reported] == [measured.time_ns[done]]
    # The newest hundred are used.
    used = np.concatenate([one.innovations[0].time_ns for one in [*events, *rest] if one.innovations])
    np.testing.assert_array_equal(used[done:], measured.time_ns[200:300])


def test_an_overflow_is_reported_where_samples_never_come():
    rng = np.random.default_rng(11)
    measured = measured_of([sensor_of(oscillating(rng, LENGTH_S), rng, length_s=LENGTH_S)])
    stream = Estimator(EstimatorSettings((camera(),)))
    for _ in range(65537):
        stream.push(part(measured, slice(1)))
    assert [event.kind for one in stream.finish() for event in one.events] == ["overflow"]


def test_unusable_measurements_are_left_out():
    rng = np.random.default_rng(12)
    truth = oscillating(rng, LENGTH_S)
    samples, sensor = samples_of(truth, rng, length_s=LENGTH_S), sensor_of(truth, rng, length_s=LENGTH_S)
    sensor.value[50:60], sensor.variance[70:80] = np.nan, np.inf
    found = estimated(samples, [sensor])
    assert np.all(np.isfinite(found.rows.displacement_m))
    assert scores(found, truth, inner=(5.0, 38.0))[0] < 0.2


def test_the_band_holds_scale_and_clock():
    share = []
    for seed in range(6):
        rng = np.random.default_rng(seed)
        truth = oscillating(rng, 60.0)
        samples, sensor = samples_of(truth, rng, length_s=60.0), sensor_of(truth, rng, length_s=60.0)
        sensor.value *= 1.0 - rng.normal(0, 0.02)
        sensor.time += rng.normal(0, 3e-3)
        parameters = (
            Parameter(ParameterKind.SCALE_ERROR, (0,), 0.02),
            Parameter(ParameterKind.CLOCK_OFFSET, (0,), 3e-3),
        )
        found = estimated(samples, [sensor], parameters=parameters)
        # What a scale error of 3 % and a late clock make of the innovations is no step of the zero.
        assert not found.events
        share.append(scores(found, truth, inner=(5.0, 55.0))[2])
    # Each record has one error of each for all its rows: the mean of six shares scatters.
    assert np.mean(share) > 0.85
