"""Many points in one loop against the estimator of one, and any cutting."""

import numpy as np
import pytest
from estimator_cases import BIAS, NOISE_A, NOISE_D, camera, oscillating, samples_of, sensor_of

from midspan.fusion.bank import MET_AT, POINT, VALUE, VARIANCE, Bank
from midspan.fusion.model import Beginning, Block, EstimatorSettings, Filter, options_of, run, tables_of
from midspan.records import seconds

LENGTH_S, POINTS = 20.0, 3


def points():
    rng = np.random.default_rng(4)
    truths = [oscillating(rng, LENGTH_S) for _ in range(POINTS)]
    samples = [samples_of(truth, rng, length_s=LENGTH_S) for truth in truths]
    time_s = seconds(samples[0].time_ns, 0)
    acceleration = np.array([one.value_m_s2[:, 0] for one in samples])
    rows = []
    for i, truth in enumerate(truths):
        sensor = sensor_of(truth, rng, length_s=LENGTH_S)
        rows.append(np.column_stack((np.full(len(sensor.time), i), sensor.time, sensor.value, sensor.variance)))
    measured = np.concatenate(rows)
    return time_s, acceleration, np.full(POINTS, NOISE_A**2 / 100.0), measured[np.argsort(measured[:, MET_AT])]


def test_each_point_is_the_plain_filter():
    time_s, acceleration, density, measured = points()
    found = Bank(POINTS).push(time_s, acceleration, density, measured)
    # The estimator with one channel, nothing decided and its noise as told.
    settings = EstimatorSettings((camera(),), noise_memory=1e15, noise_weight=1e15)
    for i in range(POINTS):
        own = measured[measured[:, POINT] == i]
        rows = np.zeros((len(own), 5))
        rows[:, 0], rows[:, 2], rows[:, 3] = own[:, MET_AT], own[:, VALUE], own[:, VARIANCE]
        samples = np.column_stack((time_s, acceleration[i], np.full(len(time_s), density[i])))
        begin = Beginning(float(time_s[0]), acceleration[i, :1], np.zeros(1), np.ones(1), np.ones(1), 0)
        block = Block(samples, rows, np.zeros(len(rows), dtype=np.int64))
        left = run(Filter.begun(begin, settings), block, tables_of(settings), options_of(settings))
        # Picometres: the same algebra in another order.
        assert np.allclose(found[i, :, 0], left.found[:, 0, 0], atol=1e-10)
        assert np.allclose(found[i, :, 1], left.found[:, 0, 1], rtol=1e-6)
        assert np.allclose(found[i, :, 2], left.found[:, 0, 2], atol=1e-8)


def test_any_cutting_gives_the_same_bits():
    time_s, acceleration, density, measured = points()
    whole = Bank(POINTS).push(time_s, acceleration, density, measured)
    stream, found = Bank(POINTS), []
    for first, last in ((0, 1), (1, 400), (400, len(time_s))):
        due = measured[:, MET_AT] <= time_s[last - 1]
        due &= measured[:, MET_AT] > (time_s[first - 1] if first else -1.0)
        found.append(stream.push(time_s[first:last], acceleration[:, first:last], density, measured[due]))
        saved = stream.state
        stream = Bank(POINTS)
        stream.restore(saved)
    assert np.array_equal(np.concatenate(found, axis=1), whole)


def test_the_band_is_that_of_the_truth():
    time_s, acceleration, density, measured = points()
    bank = Bank(POINTS)
    bank.push(time_s, acceleration, density, measured)
    # 20 s at 0.1 mm: the bias is known to a few hundredths of what it may be.
    filters = bank.state.filters
    assert np.allclose(filters[:, 2], BIAS, atol=2e-3)
    assert np.all(np.sqrt(filters[:, 3]) < NOISE_D)


@pytest.mark.parametrize(
    ("column", "value"), [(VALUE, np.nan), (VALUE, np.inf), (VARIANCE, np.nan), (VARIANCE, np.inf)]
)
def test_of_what_is_not_finite_nothing_is_learnt(column, value):
    time_s, acceleration, density, measured = points()
    spoilt, wrong = measured.copy(), np.arange(len(measured)) % 50 == 20
    spoilt[wrong, column] = value
    found = Bank(POINTS).push(time_s, acceleration, density, spoilt)
    # One of which nothing is learnt: its gain is 1e-20.
    measured[wrong, VARIANCE] = 1e12
    expected = Bank(POINTS).push(time_s, acceleration, density, measured)
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-12)


def test_late_measurements_are_counted():
    time_s, acceleration, density, measured = points()
    bank = Bank(POINTS)
    bank.push(time_s[:400], acceleration[:, :400], density, measured[:0])
    late = measured[:, MET_AT] <= time_s[399]
    bank.push(time_s[400:], acceleration[:, 400:], density, measured)
    assert bank.state.late.tolist() == [np.count_nonzero(measured[late, POINT] == p) for p in range(POINTS)]


def test_a_bank_restored_before_its_first_push_begins_as_a_new_one():
    case = points()
    bank = Bank(POINTS)
    bank.restore(Bank(POINTS).state)
    np.testing.assert_array_equal(bank.push(*case), Bank(POINTS).push(*case))


def test_of_thousands_of_points_none_is_lost():
    """A first value that is four deviations off, as one of thousands has, leads a filter away for a moment only."""
    points, rate_hz, length_s, noise_m = 5000, 100, 6, 1e-4
    rng = np.random.default_rng(1)
    time_s = np.arange(1, length_s * rate_hz + 1) / rate_hz
    met_s = np.arange(1, length_s * 10 + 1) / 10.0
    speed = 2 * np.pi
    pull = -2e-3 * speed**2 * np.sin(speed * time_s) + rng.normal(0.0, 2e-3, (points, len(time_s)))
    moved = 2e-3 * np.sin(speed * met_s) + rng.normal(0.0, noise_m, (points, len(met_s)))
    columns = (np.repeat(np.arange(points), len(met_s)), np.tile(met_s, points), moved.ravel())
    measured = np.column_stack((*columns, np.full(moved.size, noise_m**2)))
    found = Bank(points).push(time_s, pull, np.full(points, 2e-3**2 / rate_hz), measured)
    last = found[:, -rate_hz:]
    z = (last[:, :, 0] - 2e-3 * np.sin(speed * time_s[-rate_hz:])) / np.sqrt(last[:, :, 1])
    # Normal errors: of some ten thousand independent ones the largest is near 4.
    assert np.abs(z).max() < 6.0
