"""The Numerov input: amplitude and phase of integrated sines, exactness inside an interval, gaps and jitter."""

import numpy as np
import pytest
from fusion_oracles import acceleration_block, displacement_block, filtered
from hypothesis import given, settings
from hypothesis import strategies as st

from midspan.fusion.streams import NO_ERRORS, KalmanFilter, KalmanSettings
from midspan.records import Innovation, joined

REAL = st.floats(-10.0, 10.0)
FRACTION = st.floats(0.02, 0.98)
OPEN = KalmanSettings(rates=NO_ERRORS, noise_memory=np.inf)


def integrated(time, value):
    """Displacement (n,) that the filter integrates from acceleration alone, started from nothing."""
    return filtered(acceleration_block(time, value, 1e-6), displacement_block([], [], 1.0))[0].displacement_m


def integrated_gain(cycles_per_sample):
    """Complex gain of acceleration → displacement relative to the true −1/ω², from the filter's own steps."""
    n, dt = 400, 0.01
    omega, time = 2 * np.pi * cycles_per_sample / dt, np.arange(n) * dt
    columns = []
    for signal in (np.cos(omega * time), np.sin(omega * time)):
        moved = integrated(time, signal)
        # What the unknown start leaves is a straight line; sine and cosine are fitted with it.
        basis = np.column_stack((np.ones(n), time, np.cos(omega * time), np.sin(omega * time)))
        fit = np.linalg.lstsq(basis, moved, rcond=None)[0]
        np.testing.assert_allclose(basis @ fit, moved, atol=1e-9)
        columns.append(fit[2:])
    (cc, cs), (sc, ss) = columns
    assert cs == pytest.approx(-sc, abs=1e-7 * abs(cc))
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
    # Numerov's rule is of fourth order: a constant fourth derivative of x leaves no error in its second difference.
    time = np.arange(6) * 0.2
    acceleration, truth = 3.0 + 2.0 * time - 5.0 * time**2, 1.5 * time**2 + time**3 / 3.0 - 5.0 * time**4 / 12.0
    # The segment before lets the filter settle its idea of the interval's length.
    moved = integrated(np.arange(-20, 6) * 0.2, np.concatenate((np.full(20, 3.0), acceleration)))[20:]
    np.testing.assert_allclose(np.diff(moved, 2), np.diff(truth, 2), rtol=1e-9)


def states_at(theta, acceleration, dt=0.02, variance=1e30):
    """Displacement predicted at fraction `theta` of the last interval, and mean and covariance at its end."""
    time = np.arange(len(acceleration)) * dt
    # The first measurement says nothing but that the rows begin.
    met = [0.0] if theta is None else [0.0, (len(acceleration) - 2 + theta) * dt]
    stream = KalmanFilter(OPEN)
    stream.push(displacement_block(met, np.zeros(len(met)), variance))
    outputs = [*stream.push(acceleration_block(time, acceleration, 2e-3)), *stream.finish()]
    innovation = joined([item for item in outputs if isinstance(item, Innovation)])
    _, x, p = stream._estimator.core.filter()
    return -innovation.value_m[-1], (x[:3, 0], p[:3, :3])


@settings(deadline=None)
@given(theta=FRACTION, a=st.lists(REAL, min_size=4, max_size=4))
def test_inside_an_interval_the_displacement_is_a_cubic_that_bends_as_the_acceleration(theta, a):
    acceleration = np.concatenate((np.full(10, a[0]), a))
    low, at, high = (states_at(theta + shift * 0.01, acceleration)[0] for shift in (-1, 0, 1))
    # The second difference of a cubic is its second derivative in the middle: the interpolated acceleration. Stamps
    # are whole nanoseconds, which the division turns into 1e-4 m/s².
    bend = (low - 2 * at + high) / (0.01 * 0.02) ** 2
    assert bend == pytest.approx(a[2] + theta * (a[3] - a[2]), abs=2e-2)


@settings(deadline=None)
@given(theta=FRACTION, a=st.lists(REAL, min_size=3, max_size=3))
def test_a_measurement_that_says_nothing_splits_the_interval_without_a_trace(theta, a):
    acceleration = np.concatenate((np.full(10, a[0]), a))
    _, whole = states_at(None, acceleration)
    _, split = states_at(theta, acceleration)
    for ours, theirs in zip(split, whole, strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=1e-9, atol=1e-12)


@settings(deadline=None)
@given(bias=REAL, a=REAL)
def test_a_bias_is_taken_off_the_measured_acceleration(bias, a):
    # a measured, of which `bias` is bias: the structure accelerates with a − bias.
    known = KalmanSettings(bias=bias, bias_std=1e-9, rates=NO_ERRORS)
    rows = filtered(
        acceleration_block(np.arange(101) / 100.0, np.full(101, a), 1e-6), displacement_block([], [], 1.0), known
    )[0]
    moved = rows.displacement_m[-1] - rows.displacement_m[0] - rows.velocity_m_s[0]
    assert moved == pytest.approx(0.5 * (a - bias), rel=1e-9, abs=1e-9)
    assert rows.velocity_m_s[-1] - rows.velocity_m_s[0] == pytest.approx(a - bias, rel=1e-9, abs=1e-9)


def moving(time):
    """3 mm at 3.3 Hz on 8 mm at 0.2 Hz: displacement, velocity, acceleration."""
    parts = ((3e-3, 2 * np.pi * 3.3, 0.4), (8e-3, 2 * np.pi * 0.2, 1.0))
    return (
        sum(a * np.sin(w * time + p) for a, w, p in parts),
        sum(a * w * np.cos(w * time + p) for a, w, p in parts),
        -sum(a * w * w * np.sin(w * time + p) for a, w, p in parts),
    )


@pytest.mark.parametrize("gap_s", [0.5, 2.0, 5.0])
def test_a_gap_in_the_acceleration_leaves_no_false_velocity(gap_s):
    # The velocity state runs ahead by dt²/12 times the slope; taken over from the gap it would be metres per second.
    time = np.arange(6000) / 100.0
    kept = (time < 30.0) | (time > 30.0 + gap_s)
    density = np.full(6000, 4e-8)
    density[np.flatnonzero(kept & (time > 30.0))[0]] = 0.1
    acceleration = acceleration_block(time[kept], moving(time)[2][kept], density[kept])
    met = np.arange(600) / 10.0 + 0.004
    estimate, found = filtered(acceleration, displacement_block(met, moving(met)[0], 1e-8))
    assert np.all(found.innovation.verdict == 0)
    after = np.flatnonzero(time[kept] > 30.0 + gap_s)[0]
    # From four frames after the gap on the velocity is known again to some millimetres per second.
    error = estimate.velocity_m_s - moving(time)[1][kept]
    assert np.max(np.abs(error)[after + 40 : after + 200]) < 5e-3


def test_jittered_stamps_of_the_acceleration_are_integrated_with_their_own_lead():
    # 5 % jitter, truly stamped, 3 mm at 8 Hz, ten seconds: the velocity state's lead changes with each interval. Left
    # as it is that walks off by 2.2 mm, moved by the mean slope at the sample by 0.6 mm.
    errors = []
    for seed in range(4):
        rng, omega = np.random.default_rng(seed), 2 * np.pi * 8.0
        time = np.arange(1000) / 100.0 + 5e-4 * np.clip(rng.normal(size=1000), -3, 3)
        error = integrated(time, -3e-3 * omega**2 * np.sin(omega * time)) - 3e-3 * np.sin(omega * time)
        errors.append(np.std(error - np.polynomial.Polynomial.fit(time, error, 1)(time)))
    assert np.sqrt(np.mean(np.square(errors))) < 1e-3


def test_filter_gives_the_true_velocity_not_numerovs():
    # A fast sine, known exactly by dense, precise measurements. Numerov's velocity state is w²/12 = 2.1 % wrong there;
    # taking off the slope of the last interval, half a sample late, leaves w³/24 = 0.5 %.
    omega, time = 2 * np.pi * 8.0, np.arange(1000) / 100.0
    acceleration = acceleration_block(time, -1e-3 * omega**2 * np.sin(omega * time), 1e-8)
    displacement = displacement_block(time, 1e-3 * np.sin(omega * time), 1e-12)
    velocity = filtered(acceleration, displacement)[0].velocity_m_s[500:]
    truth = 1e-3 * omega * np.cos(omega * time[500:])
    assert np.sqrt(np.mean((velocity - truth) ** 2)) < 0.8 * 0.0053 * 1e-3 * omega
