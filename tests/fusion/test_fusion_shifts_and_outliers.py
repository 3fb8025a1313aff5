"""Single wild values, records that begin with outliers, and a second shift that nearly undoes the first."""

import numpy as np
import pytest
from estimator_cases import BRIDGE, NOISE_D, estimated, oscillating, samples_of, sensor_of

LENGTH_S = 40.0
# Standard deviation (m) and middle angular frequency (1/s) of the motion, as a calibration tells them.
MOTION = ((float(np.hypot(1e-3, 1.5e-3)), 15.0), (0.0, 0.0))
FAST = BRIDGE[1:]


def record(seed):
    rng = np.random.default_rng(seed)
    truth = oscillating(rng, LENGTH_S, FAST)
    return rng, truth, samples_of(truth, rng, length_s=LENGTH_S), sensor_of(truth, rng, length_s=LENGTH_S)


@pytest.mark.parametrize("seed", [1, 2])
def test_a_wild_value_is_reported_and_moves_no_row(seed):
    _, _, samples, sensor = record(seed)
    usual = estimated(samples, [sensor], motion=MOTION)
    assert not usual.events
    true = sensor.value.copy()
    for size_m in (1.0, 30.0, -1000.0):
        sensor.value = true.copy()
        sensor.value[200] += size_m
        found = estimated(samples, [sensor], motion=MOTION)
        moved = np.abs(found.rows.displacement_m - usual.rows.displacement_m)
        # One measurement less: a few standard deviations of what it reported, whatever the value was.
        assert moved.max() < 3.0 * NOISE_D
        assert [event.kind for event in found.events] == ["rejected"]
        assert found.events[0].time_ns == pytest.approx(1e9 * sensor.time[200], abs=1.0)


def test_a_record_that_begins_with_outliers():
    inside = []
    for seed in range(1, 9):
        rng, truth, samples, sensor = record(seed)
        burst = 1 + seed % 5
        sensor.value[:burst] += rng.choice([-1.0, 1.0], burst) * rng.uniform(20.0, 60.0, burst) * NOISE_D
        found = estimated(samples, [sensor], log=True, motion=MOTION)
        settings, log = found.estimator.settings, found.estimator
        for rows in (found.rows, log.smoothed(settings)[0]):
            found.rows = rows
            _, error = found.error_of(truth)
            share = np.abs(error) / np.sqrt(rows.variance_m2)
            # A row of the first second that a wrong beginning explains as well lies in its band, which is wide then.
            assert share.max() < 8.0
            inside.append(np.mean(share < 1.96))
    # Sixteen records of some forty independent rows a second: 95 ± 1 %.
    assert np.mean(inside) > 0.93


def test_a_second_shift_that_nearly_undoes_the_first():
    inside = []
    for seed in range(1, 5):
        _, truth, samples, sensor = record(seed)
        # 1.6 deviations of the noise are left of 12: it looks as if the first shift had gone back.
        sensor.value += 12 * NOISE_D * (sensor.time > 8.0) - 10.4 * NOISE_D * (sensor.time > 32.0)
        found = estimated(samples, [sensor], log=True, motion=MOTION)
        found.rows = found.estimator.smoothed()[0]
        time, error = found.error_of(truth)
        share = np.abs(error) / np.sqrt(found.rows.variance_m2)
        assert share[time > 32.0].max() < 5.0
        inside.append(np.mean(share < 1.96))
    assert np.mean(inside) > 0.85
