"""The band of a bank's rows where the sensors are not what was stated: nothing is calibrated before."""

from functools import cache

import numpy as np
import pytest
from tests.engine.bank_bridge import RATE_HZ, T0_NS, Sensors, markov, measured, motion, run

from midspan.engine.bank import Bank, BankBlocks, BankCode, BankSensor, BankSettings

SETTINGS = BankSettings(0.005, 0.0015)
SECONDS = 240
# A slow error of some seconds shows in what comes together over a minute.
LEARNT_S = 60
SEEDS = tuple(range(4))


@cache
def bridge(seed, rms_m=0.004):
    """The motion of a seed."""
    return motion(SECONDS, seed, rms_m)


def outliers(record, rng):
    """One in twenty measurements is off by up to 100 mm."""
    which = rng.random(len(record.displacement_m)) < 0.05
    record.displacement_m[which] += rng.uniform(-0.1, 0.1, which.sum())


def spikes(record, rng):
    """One in five hundred samples of the acceleration is off by up to 50 m/s²."""
    which = rng.random(len(record.acceleration)) < 0.002
    record.acceleration[which] += rng.uniform(-50.0, 50.0, which.sum())


def missing(record, rng):
    """Three in ten measurements and one in a hundred samples are missing."""
    record.displacement_m[rng.random(len(record.displacement_m)) < 0.3] = np.nan
    record.acceleration[rng.random(len(record.acceleration)) < 0.01] = np.nan


def frozen(record, _):
    """The displacement sensor repeats one value for 40 s."""
    record.displacement_m[1000:1400] = record.displacement_m[1000]


def zeros(record, _):
    """Far from zero, the displacement sensor gives zeros for 20 s."""
    record.displacement_m += 0.03
    record.truth_m += 0.03
    record.displacement_m[1000:1200] = 0.0


def many_outliers(record, rng):
    """Three in ten measurements of 20 s are 10 to 80 mm too large."""
    which = np.flatnonzero(rng.random(200) < 0.3) + 1000
    record.displacement_m[which] += rng.uniform(0.01, 0.08, len(which))


def shifted(record, _):
    """The displacement sensor's zero shifts by 8 mm for good."""
    record.displacement_m[1500:] += 0.008


# Sensors, further damage, least share of the rows inside the band, greatest error relative to that of clean sensors
# (rows of the last measurement older than 0.5 s left out).
CASES = {
    "as stated": (Sensors(), None, 0.95, 1.1),
    "displacement noise threefold": (Sensors(displacement_noise=3.0), None, 0.93, 3.0),
    "acceleration noise threefold": (Sensors(acceleration_noise=3.0), None, 0.93, 3.0),
    "slow error as large as the noise": (Sensors(slow_std_m=0.0015), None, 0.93, 4.0),
    "slow error twice the noise": (Sensors(slow_std_m=0.003), None, 0.90, 8.0),
    "gain 5 % too large": (Sensors(gain=1.05), None, 0.93, 1.2),
    "stamps 0.3 s late": (Sensors(delay_s=0.3), None, 0.93, 2.0),
    "stamps 0.3 s early": (Sensors(delay_s=-0.3), None, 0.93, 2.0),
    "outliers": (Sensors(), outliers, 0.93, 2.0),
    "spikes": (Sensors(), spikes, 0.93, 20.0),
    "missing": (Sensors(), missing, 0.93, 1.5),
    "frozen": (Sensors(), frozen, 0.90, 3.0),
    "zeros": (Sensors(), zeros, 0.93, 3.0),
    "many outliers": (Sensors(), many_outliers, 0.93, 10.0),
    "1 Hz": (Sensors(displacement_hz=1.0), None, 0.93, 4.0),
}


def score(name, seeds, from_s=LEARNT_S):
    """Share inside ±1.96 σ of all rows, root mean square error and deviation (mm) of those that are not coasting."""
    sensors, damage = CASES[name][:2]
    inside, square, variance = [], [], []
    for seed in seeds:
        record = measured(*bridge(seed), seed, sensors)
        if damage:
            damage(record, np.random.default_rng(seed))
        rows, _ = run(record, SETTINGS)
        used = rows.index > from_s * RATE_HZ
        error = rows.displacement_m[used] - record.truth_m[rows.index[used]]
        inside.append(np.mean(np.abs(error) < 1.96 * rows.std_m[used]))
        tracking = rows.status[used] == 0
        square.append(np.mean(error[tracking] ** 2))
        variance.append(np.mean(rows.std_m[used][tracking] ** 2))
    return np.mean(inside), 1e3 * np.sqrt(np.mean(square)), 1e3 * np.sqrt(np.mean(variance))


@cache
def clean_rmse_mm():
    """Error with clean sensors."""
    return score("as stated", SEEDS)[1]


@pytest.mark.parametrize("name", CASES)
def test_the_truth_lies_in_the_band(name):
    least, most = CASES[name][2:]
    inside, rmse_mm, _ = score(name, SEEDS)
    assert inside > least
    assert rmse_mm < most * clean_rmse_mm()


def test_with_clean_sensors_and_no_slow_error_the_error_is_that_of_the_bound():
    record = measured(*bridge(0), 0)
    exact = BankSettings(0.005, 0.0015, slow_std_m=0.0, delay_std_s=0.0, gain_std=0.0, as_stated=True)
    bound = np.sqrt(np.mean(run(record, exact)[0].std_m ** 2))
    rows, _ = run(record, SETTINGS)
    error = (rows.displacement_m - record.truth_m[rows.index])[rows.index > LEARNT_S * RATE_HZ]
    assert np.sqrt(np.mean(error**2)) < 1.15 * bound


@pytest.mark.parametrize("seed", SEEDS)
def test_a_shifted_zero_is_reported_and_the_band_covers_both_zeros_for_half_a_minute(seed):
    record = measured(*bridge(seed), seed)
    shifted(record, None)
    rows, events = run(record, SETTINGS)
    assert BankCode.SHIFTED in {one.code for one in events}
    just = (rows.index > 150.5 * RATE_HZ) & (rows.index < 180 * RATE_HZ)
    error = rows.displacement_m[just] - record.truth_m[rows.index[just]]
    assert np.mean(np.abs(error) < 1.96 * rows.std_m[just]) > 0.9
    assert np.mean(np.abs(error - 0.008) < 1.96 * rows.std_m[just]) > 0.9


@pytest.mark.parametrize("displacement_hz", [1, 10])
@pytest.mark.parametrize("slow_time_s", [20, 60, 200])
def test_a_slow_error_that_is_stated_stays_in_the_band_for_an_hour(displacement_hz, slow_time_s):
    # Innovations show nothing of an error that lasts longer than the accelerometer remembers, some four seconds: a band
    # that followed them alone would contain a third of the rows after half an hour.
    seconds, points, slow_std_m = 3600, 8, 0.005
    rng = np.random.default_rng(slow_time_s + displacement_hz)
    settings = BankSettings(0.005, 0.0015, slow_std_m=slow_std_m)
    bank, numbers = Bank(points, settings), np.arange(points, dtype=np.uint32)
    error = np.stack([markov(seconds * displacement_hz, 1 / (displacement_hz * slow_time_s), rng) for _ in numbers])
    measured_m = slow_std_m * error + 0.0015 * rng.standard_normal(error.shape)
    samples = 9.81 + 0.005 * rng.standard_normal((points, seconds * RATE_HZ))
    inside = []
    for second in range(seconds):
        t0_ns = np.full(points, T0_NS + second * 10**9)
        for sensor, values, hz in ((0, samples, RATE_HZ), (1, measured_m, displacement_hz)):
            count, step = np.full(points, hz, dtype=np.uint32), np.full(points, 10**9 // hz)
            part = values[:, second * hz : (second + 1) * hz].ravel()
            bank.push(BankBlocks(BankSensor(sensor), numbers, t0_ns, step, count, part))
        rows = bank.rows(T0_NS + (second + 1) * 10**9)
        if second > seconds // 2:
            inside.append(np.mean(np.abs(rows.displacement_m) < 1.96 * rows.std_m))
    # Of an error that lasts 200 s eight points have some 70 independent values in half an hour.
    assert np.mean(inside) > 0.90


@pytest.mark.parametrize("seed", range(12))
def test_outliers_to_one_side_that_scatter_are_no_shift(seed):
    record = measured(*bridge(seed % 4), seed)
    many_outliers(record, np.random.default_rng(seed))
    rows, _ = run(record, SETTINGS)
    error = np.abs(rows.displacement_m - record.truth_m[rows.index])[rows.index > LEARNT_S * RATE_HZ]
    assert np.max(error / rows.std_m[rows.index > LEARNT_S * RATE_HZ]) < 6.0


@pytest.mark.parametrize("seed", SEEDS)
def test_a_frozen_sensor_is_reported_and_its_rows_coast(seed):
    record = measured(*bridge(seed), seed)
    frozen(record, None)
    rows, events = run(record, SETTINGS)
    assert [one.code for one in events][:3] == [BankCode.FROZEN, BankCode.LOST, BankCode.TRACKING]
    assert not np.any(rows.status[(rows.index > 102 * RATE_HZ) & (rows.index < 139 * RATE_HZ)] == 0)


@pytest.mark.parametrize("rms_m", [1e-7, 1e-4])
@pytest.mark.parametrize("displacement_hz", [1.0, 10.0])
def test_a_sensor_with_coarse_steps_is_not_frozen_where_the_structure_rests(rms_m, displacement_hz):
    # Steps of 0.1 mm, twice the stated noise: at rest the same value comes for minutes.
    stated = BankSettings(0.005, 5e-5)
    record = measured(*bridge(0, rms_m), 0, Sensors(displacement_hz=displacement_hz), displacement_std=1e-5)
    record.displacement_m[:] = np.round(record.displacement_m / 1e-4) * 1e-4 + 0.0
    rows, events = run(record, stated)
    begun = rows.index > LEARNT_S * RATE_HZ
    assert np.all(rows.status[begun] == 0)
    assert BankCode.FROZEN not in {event.code for event in events if event.time_ns > T0_NS + LEARNT_S * 10**9}
    error = rows.displacement_m[begun] - record.truth_m[rows.index[begun]]
    assert np.mean(np.abs(error) < 1.96 * rows.std_m[begun]) > 0.93
    assert np.median(rows.std_m[begun]) < 1e-3


@pytest.mark.parametrize("gap_s", [2, 5, 12, 20, 28, 40])
@pytest.mark.parametrize("seed", SEEDS)
def test_after_both_sensors_were_away_the_rows_are_as_at_a_start(gap_s, seed):
    record = measured(*bridge(seed), seed)
    begin, end = 60 * RATE_HZ, (60 + gap_s) * RATE_HZ
    record.acceleration[begin:end] = np.nan
    record.displacement_m[begin // 10 : end // 10] = np.nan
    rows, _ = run(record, SETTINGS)
    after = (rows.index >= end + 3 * RATE_HZ) & (rows.index < end + 60 * RATE_HZ)
    error = rows.displacement_m[after] - record.truth_m[rows.index[after]]
    assert np.mean(np.abs(error) < 1.96 * rows.std_m[after]) > 0.93
    # Of clean sensors 0.65 mm; at a start bias and velocity are unknown for some seconds.
    assert np.sqrt(np.mean(error**2)) < 3.0 * 0.65e-3
    # As at a start: how large the slow error is shows within the next minute.
    assert np.median(rows.std_m[after]) < 6e-3


@pytest.mark.parametrize("gap_s", [5, 12, 28])
def test_a_gap_of_the_acceleration_alone_is_bridged_by_the_displacement(gap_s):
    record = measured(*bridge(0), 0)
    begin, end = 60 * RATE_HZ, (60 + gap_s) * RATE_HZ
    record.acceleration[begin:end] = np.nan
    rows, _ = run(record, SETTINGS)
    after = (rows.index >= end) & (rows.index < end + 60 * RATE_HZ)
    error = rows.displacement_m[after] - record.truth_m[rows.index[after]]
    assert rows.index[after][0] == end
    assert np.mean(np.abs(error) < 1.96 * rows.std_m[after]) > 0.93
