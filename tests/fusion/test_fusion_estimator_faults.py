"""What goes wrong in the field, one at a time, through the estimator: the error against the truth, and the band."""

import numpy as np
import pytest
from estimator_cases import LIVELY, NOISE_D, camera, estimated, oscillating, samples_of, scores, sensor_of

from midspan.records import seconds

SEEDS = range(801, 807)


def between(sensor, first_s=60.0, last_s=np.inf):
    return (sensor.time > first_s) & (sensor.time < last_s)


def clean(rng, samples, sensor):
    pass


def frozen(rng, samples, sensor):
    stuck = between(sensor, 60.0, 64.0)
    sensor.value[stuck] = sensor.value[np.argmax(stuck)]


def stuck_with_noise(rng, samples, sensor):
    stuck = between(sensor, 60.0, 64.0)
    noise = rng.normal(0.0, 0.3 * NOISE_D, np.count_nonzero(stuck))
    sensor.value[stuck] = sensor.value[np.argmax(stuck)] + 8e-3 + noise


def off_for_4_s(rng, samples, sensor):
    sensor.value += 8e-3 * between(sensor, 60.0, 64.0)


def shifted(size_m):
    def spoil(rng, samples, sensor):
        sensor.value += size_m * between(sensor)

    return spoil


def noisier(factor):
    def spoil(rng, samples, sensor):
        later = between(sensor)
        sensor.value[later] += rng.normal(0, np.sqrt(factor**2 - 1.0) * NOISE_D, np.count_nonzero(later))

    return spoil


def outliers(share, low, high):
    def spoil(rng, samples, sensor):
        size = rng.choice([-1.0, 1.0], len(sensor.time)) * rng.uniform(low, high, len(sensor.time))
        sensor.value += np.where(rng.random(len(sensor.time)) < share, size, 0.0)

    return spoil


def during(samples, last_s):
    time = seconds(samples.time_ns, 0)
    return (time > 60.0) & (time < last_s)


def gain_for_1_s(rng, samples, sensor):
    samples.value_m_s2[during(samples, 61.0)] *= 0.7


def pushed(rng, samples, sensor):
    samples.value_m_s2[during(samples, 60.5)] += 1.0


def gap(rng, samples, sensor):
    keep = ~between(sensor, 60.0, 63.0)
    for name in ("time", "value", "variance", "reference"):
        setattr(sensor, name, getattr(sensor, name)[keep])


def reported(factor):
    def spoil(rng, samples, sensor):
        sensor.variance *= factor

    return spoil


# Root mean square error that is allowed, mm; the causal bound without faults is 0.06 mm. A frozen value costs the time
# until the next one differs; one that is stuck with noise a quarter more than 4 s without it, 0.16 mm; an error of the
# acceleration the 0.1 s until the next measurement: 1 m/s² makes 5 mm in that time, and 30 mm in the next two tenths.
CASES = {
    "clean": (clean, 0.07),
    "frozen for 4 s": (frozen, 0.2),
    "stuck 8 mm off for 4 s": (stuck_with_noise, 0.2),
    "8 mm off for 4 s": (off_for_4_s, 0.08),
    "8 mm off for good": (shifted(8e-3), 0.1),
    "1 mm off for good": (shifted(1e-3), 0.1),
    "noise times 5": (noisier(5.0), 0.45),
    "10 % outliers": (outliers(0.1, 1e-3, 6e-3), 0.12),
    "20 % outliers": (outliers(0.2, 3e-3, 7e-3), 0.3),
    "gain 0.7 for 1 s": (gain_for_1_s, 0.8),
    "1 m/s² more for 0.5 s": (pushed, 1.5),
    "no measurements for 3 s": (gap, 0.15),
    "noise reported 10 times too large": (reported(100.0), 0.08),
}


# And on the mean of all seeds: outliers that are rejected at once cost less than twice the error without any.
MEAN_MM = {"20 % outliers": 0.12}


@pytest.mark.parametrize("name", CASES)
def test_faults_cost_little_and_the_band_holds_them(name):
    spoil, limit_mm = CASES[name]
    inside, errors = [], []
    for seed in SEEDS:
        rng = np.random.default_rng(seed)
        truth = oscillating(rng, 120.0)
        samples, sensor = samples_of(truth, rng), sensor_of(truth, rng)
        spoil(rng, samples, sensor)
        rms, _, share = scores(estimated(samples, [sensor]), truth)
        assert rms < limit_mm
        errors.append(rms), inside.append(share)
    assert np.mean(errors) < MEAN_MM.get(name, limit_mm)
    # Rows of one record hang together over a second: 660 independent ones in all, of which 95 ± 1 % lie inside.
    assert np.mean(inside) > 0.92


def test_outliers_of_one_size_from_the_first_measurement_on():
    rng = np.random.default_rng(801)
    truth = oscillating(rng, 120.0)
    samples, sensor = samples_of(truth, rng), sensor_of(truth, rng)
    outliers(0.2, 5e-3, 5e-3)(rng, samples, sensor)
    assert scores(estimated(samples, [sensor]), truth)[2] > 0.9


@pytest.mark.parametrize("step_m_s2", [0.5, 1.0, 2.0])
def test_an_accelerometer_that_is_knocked_over_is_found_again(step_m_s2):
    """Tilted by 3 to 12 degrees within a second it measures that much more of gravity from then on."""
    for seed in range(700, 703):
        rng = np.random.default_rng(seed)
        truth = oscillating(rng, 60.0, LIVELY)
        sensor = sensor_of(truth, rng, camera(coasting_s=0.8), rate_hz=3.0, length_s=60.0, std=1e-3)
        samples = samples_of(truth, rng, length_s=60.0, std=0.3)
        samples.value_m_s2[:, 0] += step_m_s2 * np.clip(seconds(samples.time_ns, 0) - 30.0, 0.0, 1.0)
        found = estimated(samples, [sensor], log=True)
        found.rows = found.estimator.smoothed()[0]
        # Measurements of 1 mm; the acceleration's noise lets predictions spread to 5 mm between them, and what is
        # smoothed from both sides to half of it where the bias is not known.
        assert scores(found, truth, inner=(28.0, 59.0))[0] < 2.5
        # All measurements are sound: none but a few of those before the bias is found again may be left out.
        assert np.mean(found.rows.status == 0) > 0.95
