"""The Numerov input: amplitude and phase of integrated sines, exactness inside an interval, sub-steps."""

from itertools import pairwise

import numpy as np
import pytest
from fusion_oracles import acceleration_block, displacement_block, filtered
from hypothesis import given
from hypothesis import strategies as st

from midspan.fusion.state_space import B, V, X, advance_covariance, advance_mean, initial_state, input_response

REAL = st.floats(-10.0, 10.0)
FRACTION = st.floats(0.0, 1.0)


def integrated_gain(cycles_per_sample):
    """Complex gain of acceleration → displacement relative to the true −1/ω², from the model's own steps."""
    n, dt = 400, 0.01
    omega = 2 * np.pi * cycles_per_sample / dt
    time = np.arange(n) * dt
    columns = []
    for signal in (np.cos(omega * time), np.sin(omega * time)):
        state = initial_state(0.0, (0.0, 0.0, 0.0), (1.0, 1.0, 1.0))
        moved = [0.0]
        for k in range(n - 1):
            advance_mean(state, dt, (0.0, 0.0), input_response(1.0, dt, signal[k], signal[k + 1]))
            moved.append(state[X])
        # What the unknown start leaves is a straight line; sine and cosine are fitted beside it.
        basis = np.column_stack((np.ones(n), time, np.cos(omega * time), np.sin(omega * time)))
        fit = np.linalg.lstsq(basis, np.array(moved), rcond=None)[0]
        np.testing.assert_allclose(basis @ fit, moved, atol=1e-9)
        columns.append(fit[2:])
    (cc, cs), (sc, ss) = columns
    assert cs == pytest.approx(-sc, abs=1e-9 * abs(cc))
    assert cc == pytest.approx(ss, rel=1e-6)
    return (cc - 1j * cs) * -(omega**2)


@pytest.mark.parametrize(
    ("cycles_per_sample", "error_percent"), [(0.01, 0.000), (0.05, 0.004), (0.10, 0.066), (0.15, 0.34), (0.20, 1.1)]
)
def test_amplitude_of_an_integrated_sine_has_the_error_of_numerovs_rule(cycles_per_sample, error_percent):
    gain = integrated_gain(cycles_per_sample)
    # Analytic: (10 + 2 cos w)/12 · w²/(2 − 2 cos w); the table's figures are rounded to their last digit.
    w = 2 * np.pi * cycles_per_sample
    assert gain.real == pytest.approx((10 + 2 * np.cos(w)) / 12 * w * w / (2 - 2 * np.cos(w)), rel=1e-6)
    assert 100 * (gain.real - 1) == pytest.approx(error_percent, abs=0.06 * error_percent + 6e-4)


@pytest.mark.parametrize("cycles_per_sample", [0.01, 0.1, 0.2])
def test_an_integrated_sine_has_no_phase_error(cycles_per_sample):
    # The usual zero-order hold lags by half a sample: 0.03 rad at the lowest of these.
    assert abs(np.angle(integrated_gain(cycles_per_sample))) < 1e-7


def test_a_parabola_of_acceleration_is_integrated_exactly_on_the_grid():
    # Numerov's rule is of fourth order: x'''' constant leaves no error in the second difference of x.
    time = np.arange(6) * 0.2
    acceleration, truth = 3.0 + 2.0 * time - 5.0 * time**2, 1.5 * time**2 + time**3 / 3.0 - 5.0 * time**4 / 12.0
    state = initial_state(0.0, (0.0, 0.0, 0.0), (1.0, 1.0, 1.0))
    moved = [0.0]
    for a0, a1 in pairwise(acceleration):
        advance_mean(state, 0.2, (0.0, 0.0), input_response(1.0, 0.2, a0, a1))
        moved.append(state[X])
    np.testing.assert_allclose(np.diff(moved, 2), np.diff(truth, 2), rtol=1e-12)


@given(theta=FRACTION, a0=REAL, a1=REAL, v=REAL, dt=st.floats(1e-3, 1.0))
def test_inside_an_interval_the_displacement_is_the_exact_cubic(theta, a0, a1, v, dt):
    slope, t = (a1 - a0) / dt, theta * dt
    true_velocity = v - dt * dt / 12.0 * slope  # the state's velocity leads by this
    x, _ = input_response(theta, dt, a0, a1)
    cubic = true_velocity * t + 0.5 * a0 * t * t + slope * t**3 / 6.0
    assert v * t + x == pytest.approx(cubic, rel=1e-9, abs=1e-12)


@given(theta=FRACTION, a0=REAL, a1=REAL, b=REAL, dt=st.floats(1e-3, 1.0))
def test_two_sub_steps_move_mean_and_covariance_as_one_step(theta, a0, a1, b, dt):
    one = initial_state(0.0, (0.3, -1.2, b), (0.4, 0.5, 0.6))
    two = one.copy()
    end, between = input_response(1.0, dt, a0, a1), input_response(theta, dt, a0, a1)
    advance_mean(one, dt, (0.0, 0.0), end)
    advance_mean(two, theta * dt, (0.0, 0.0), between)
    advance_mean(two, dt - theta * dt, between, end)
    advance_covariance(one, dt, 2.0, 0.0)
    advance_covariance(two, theta * dt, 2.0, 0.0)
    advance_covariance(two, dt - theta * dt, 2.0, 0.0)
    np.testing.assert_allclose(two, one, rtol=1e-10, atol=1e-12)


@given(b=REAL, a=REAL, dt=st.floats(1e-3, 1.0))
def test_a_bias_is_taken_off_the_measured_acceleration(b, a, dt):
    # a measured, of which b is bias: the structure accelerates with a − b.
    state = initial_state(0.0, (0.0, 0.0, b), (1.0, 1.0, 1.0))
    advance_mean(state, dt, (0.0, 0.0), input_response(1.0, dt, a, a))
    assert state[X] == pytest.approx(0.5 * (a - b) * dt * dt, rel=1e-9, abs=1e-12)
    assert state[V] == pytest.approx((a - b) * dt, rel=1e-9, abs=1e-12)
    assert state[B] == b


def test_filter_gives_the_true_velocity_not_numerovs():
    # A fast sine, known exactly by dense, precise measurements. Numerov's velocity state is w²/12 = 2.1 % wrong there;
    # taking off the slope of the last interval, half a sample late, leaves w³/24 = 0.5 %.
    omega, time = 2 * np.pi * 8.0, np.arange(1000) / 100.0
    acceleration = acceleration_block(time, -1e-3 * omega**2 * np.sin(omega * time), 1e-8)
    displacement = displacement_block(time, 1e-3 * np.sin(omega * time), 1e-12)
    velocity = filtered(acceleration, displacement)[0].velocity_m_s[500:]
    truth = 1e-3 * omega * np.cos(omega * time[500:])
    # Left over is the next order of the rule: w⁴/720 of the amplitude, 9e-5 at w = 0.5.
    assert np.sqrt(np.mean((velocity - truth) ** 2)) < 0.8 * 0.0053 * 1e-3 * omega
