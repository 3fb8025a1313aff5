import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from midspan.simulate.motion.motion import Rest, Sines
from midspan.simulate.motion.sensors import (
    AccelerometerModel,
    DisplacementSensorModel,
    exposed,
    noise_std_for,
    simulate_pair,
)

SINE = Sines([0.003], [1.9])
MANY = (0.0, 500.0)  # 50 000 samples at 100 Hz: a standard deviation is then known to 1/√100000 = 0.3 %


def phase_of(time_s, value, frequency_hz):
    """Phase in rad of the sine in `value`, by least squares on sine and cosine."""
    angle = 2 * np.pi * frequency_hz * time_s
    sine, cosine = np.linalg.lstsq(np.stack([np.sin(angle), np.cos(angle)], axis=1), value, rcond=None)[0]
    return np.arctan2(cosine, sine)


def test_a_perfect_accelerometer_reads_the_exact_acceleration():
    series = AccelerometerModel().measure(SINE, (0.0, 10.0), rng=np.random.default_rng(0))
    assert len(series.value) == 1000
    np.testing.assert_array_equal(series.time_ns, np.arange(1000) * 10_000_000)
    expected = -0.003 * (2 * np.pi * 1.9) ** 2 * np.sin(2 * np.pi * 1.9 * np.arange(1000) / 100)
    np.testing.assert_allclose(series.value, expected, atol=1e-12)


def test_accelerometer_noise_and_bias_are_what_was_asked_for():
    model = AccelerometerModel(noise_std_m_s2=2.5e-3, bias_m_s2=0.05)
    value = model.measure(Rest(), MANY, rng=np.random.default_rng(1)).value
    assert value.std() == pytest.approx(2.5e-3, rel=0.015)  # 4.7 standard deviations of a standard deviation
    assert value.mean() == pytest.approx(0.05, abs=5 * 2.5e-3 / np.sqrt(50_000))
    correlation = np.corrcoef(value[1:], value[:-1])[0, 1]
    assert abs(correlation) < 5 / np.sqrt(50_000)


def test_drift_grows_as_the_root_of_time():
    model = AccelerometerModel(rate_hz=50.0, drift_m_s2_per_root_s=1e-4)
    ends = [model.measure(Rest(), (0.0, 16.0), rng=np.random.default_rng(k)).value[-1] for k in range(800)]
    assert np.std(ends) == pytest.approx(1e-4 * 4.0, rel=5 / np.sqrt(2 * 800))


def test_clipping_limits_the_reading():
    value = AccelerometerModel(clip_m_s2=0.3).measure(SINE, (0.0, 10.0), rng=np.random.default_rng(0)).value
    assert value.max() == 0.3
    assert value.min() == -0.3


def test_jitter_is_stamped_truly_or_nominally():
    true = AccelerometerModel(jitter_s=5e-4).measure(SINE, MANY, rng=np.random.default_rng(3))
    nominal = AccelerometerModel(jitter_s=5e-4, nominal_stamps=True).measure(SINE, MANY, rng=np.random.default_rng(3))
    np.testing.assert_array_equal(true.value, nominal.value)
    # A stamp is rounded to the nanosecond: half of one at the largest jerk, 5.1 m/s³.
    np.testing.assert_allclose(true.value, SINE.acceleration(true.time_ns / 1e9), atol=3e-9)
    assert (true.time_ns - nominal.time_ns).std() == pytest.approx(5e5, rel=0.015)


@given(offset=st.floats(-0.2, 0.2))
def test_time_on_the_accelerometers_clock_is_the_sensors_plus_the_offset(offset):
    pair = simulate_pair(
        SINE,
        20.0,
        accelerometer=AccelerometerModel(),
        displacement=DisplacementSensorModel(rate_hz=10.0, time_offset_s=offset),
    )
    # Displacement is minus acceleration over ω², so the two phases differ by π when the clocks agree.
    late = phase_of(pair.displacement.time_ns / 1e9, pair.displacement.value, 1.9)
    reference = phase_of(pair.acceleration.time_ns / 1e9, -pair.acceleration.value, 1.9)
    # At its own stamp s the sensor sees what the accelerometer sees at s + offset: a phase lead of 2π f offset.
    turn = (late - reference - 2 * np.pi * 1.9 * offset + np.pi) % (2 * np.pi) - np.pi
    assert abs(turn) < 2 * np.pi * 1.9 * 1e-8  # stamps are rounded to nanoseconds


def test_an_exposure_averages_a_sine_by_its_sinc():
    centre = np.linspace(0.0, 2.0, 40)
    seen = exposed(SINE, centre, exposure_s=0.05)
    np.testing.assert_allclose(seen, np.sinc(1.9 * 0.05) * SINE.displacement(centre), atol=1e-15)


def test_noise_for_a_signal_to_noise_ratio_is_a_hundredth_at_40_decibels():
    signal = SINE.displacement(np.arange(0, 100, 0.01))
    assert noise_std_for(signal, 40.0) == pytest.approx(0.01 * 0.003 / np.sqrt(2), rel=1e-6)


def test_a_pair_repeats_with_its_seed_and_differs_with_another():
    def displacement(seed):
        return simulate_pair(
            SINE,
            5.0,
            accelerometer=AccelerometerModel(noise_std_m_s2=1e-3),
            displacement=DisplacementSensorModel(noise_std_m=1e-5),
            seed=seed,
        ).displacement.value

    np.testing.assert_array_equal(displacement(1), displacement(1))
    assert np.any(displacement(1) != displacement(2))
