import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from midspan.errors import UsageError
from midspan.papers.motions import Sweep
from midspan.simulate.motion.motion import FineSteps, Pulse, Rest, Sines, Sum, Window, random_motion

MOTIONS = {
    "rest": Rest(0.002),
    "sines": Sines([0.003, 0.001], [1.9, 4.6], phase_rad=[0.3, 2.0]),
    "sweep": Sweep(0.004, 0.5, 6.0, 20.0),
    "pulse": Pulse(0.008, 9.0, 2.0),
    "random": random_motion((1.8, 2.0), 1e-3, rng=np.random.default_rng(1)),
    "window": Window(Sines([0.003], [1.9], phase_rad=1.0), start_s=1.5, stop_s=16.0, ramp_s=2.0),
    "sum": Sum((Pulse(0.008, 9.0, 2.0), Window(Sweep(0.004, 0.5, 6.0, 20.0), start_s=2.0))),
}


def central_slope(function, time_s, step_s=1e-3):
    """Fourth-order central difference: at 6 Hz its relative error is (2π·6·1e-3)⁴/30 = 7e-8."""
    near = function(time_s + step_s) - function(time_s - step_s)
    far = function(time_s + 2 * step_s) - function(time_s - 2 * step_s)
    return (8 * near - far) / (12 * step_s)


@pytest.mark.parametrize("name", MOTIONS)
@given(start=st.floats(0.0, 18.0))
def test_velocity_and_acceleration_are_the_derivatives_of_the_displacement(name, start):
    motion = MOTIONS[name]
    time = start + np.linspace(0.0, 1.0, 23)
    # 1e-6 of the largest speed (0.2 m/s) and acceleration (6 m/s²); the ramps hold frequencies above the sines' own.
    np.testing.assert_allclose(motion.velocity(time), central_slope(motion.displacement, time), atol=3e-7)
    np.testing.assert_allclose(motion.acceleration(time), central_slope(motion.velocity, time), atol=1e-5)


def test_a_window_is_at_rest_before_its_start_and_after_its_stop_and_unchanged_in_between():
    whole = MOTIONS["sines"]
    motion = Window(whole, start_s=1.5, stop_s=16.0, ramp_s=2.0)
    outside = np.array([0.0, 1.0, 1.5, 16.0, 20.0])
    inside = np.linspace(3.5, 14.0, 50)
    for part in ("displacement", "velocity", "acceleration"):
        assert np.all(getattr(motion, part)(outside) == 0.0)
        np.testing.assert_allclose(getattr(motion, part)(inside), getattr(whole, part)(inside), rtol=1e-12)


@given(seed=st.integers(0, 50))
def test_random_motion_has_the_asked_standard_deviation_and_band(seed):
    motion = random_motion((1.0, 3.0), 2e-3, rng=np.random.default_rng(seed), lines=40)
    assert motion.frequency_hz.min() >= 1.0
    assert motion.frequency_hz.max() <= 3.0
    # Over 400 s the cross terms of lines at least 5 mHz apart leave some per cent of the variance.
    moved = motion.displacement(np.arange(0, 400, 0.05))
    assert moved.std() == pytest.approx(2e-3, rel=0.05)


def test_random_motion_flat_in_acceleration_has_equal_acceleration_in_every_line():
    motion = random_motion((1.0, 3.0), 2e-3, rng=np.random.default_rng(0), flat="acceleration")
    size = motion.amplitude_m * motion.frequency_hz**2
    np.testing.assert_allclose(size, size[0], rtol=1e-12)
    assert np.sum(motion.amplitude_m**2) / 2 == pytest.approx(2e-3**2, rel=1e-12)


def test_fine_steps_of_a_sine_give_it_back_between_the_steps():
    sine = Sines([0.003], [10.3])
    time = np.arange(4001) / 2000
    fine = FineSteps(0.0, 1 / 2000, sine.displacement(time), sine.velocity(time), sine.acceleration(time))
    between = np.random.default_rng(0).uniform(0, 2, 500)
    # Quintic Hermite error: h⁶ max|x⁽⁶⁾| / (720·64) with h ω = 0.032 gives 2.5e-14 of the amplitude, below rounding;
    # each derivative loses about a factor 10 / h.
    np.testing.assert_allclose(fine.displacement(between), sine.displacement(between), atol=1e-15)
    np.testing.assert_allclose(fine.velocity(between), sine.velocity(between), atol=1e-10)
    np.testing.assert_allclose(fine.acceleration(between), sine.acceleration(between), atol=1e-6)
    np.testing.assert_allclose(fine.acceleration(time), sine.acceleration(time), atol=1e-8)


def test_fine_steps_refuse_times_that_were_not_computed():
    fine = FineSteps(0.0, 0.5, np.zeros(3), np.zeros(3), np.zeros(3))
    with pytest.raises(UsageError, match=r"within the 1 s"):
        fine.displacement(np.array([1.2]))


def test_random_motion_refuses_a_band_upside_down():
    with pytest.raises(UsageError, match="band_hz"):
        random_motion((3.0, 1.0), 1e-3, rng=np.random.default_rng(0))
