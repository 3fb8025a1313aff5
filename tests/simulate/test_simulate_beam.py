import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import eigh

from midspan.errors import UsageError
from midspan.simulate.motion.beam import Beam, paper_beam_motion, paper_force, respond


def test_the_papers_beam_has_its_first_mode_at_6_22_hz():
    assert Beam().frequencies_hz()[0] == pytest.approx(6.22, abs=0.005)  # the two digits that the paper prints


def test_natural_frequencies_agree_with_a_finite_element_beam():
    beam, elements = Beam(), 40
    h = beam.length_m / elements
    stiff = (
        np.array([[12, 6 * h, -12, 6 * h], [6 * h, 4 * h**2, -6 * h, 2 * h**2]]) * beam.rigidity_n_m2 / h**3
    )  # the two upper rows of the Hermite beam element; the lower two follow by symmetry
    flip = np.diag([1.0, -1.0])
    stiff = np.vstack([stiff, np.hstack([flip @ stiff[:, 2:] @ flip, flip @ stiff[:, :2] @ flip])])
    heavy = np.array([[156, 22 * h, 54, -13 * h], [22 * h, 4 * h**2, 13 * h, -3 * h**2]])
    heavy = np.vstack([heavy, np.hstack([flip @ heavy[:, 2:] @ flip, flip @ heavy[:, :2] @ flip])])
    heavy = heavy * beam.mass_kg_m * h / 420
    size = 2 * (elements + 1)
    stiffness, mass = np.zeros((size, size)), np.zeros((size, size))
    for e in range(elements):
        part = np.s_[2 * e : 2 * e + 4]
        stiffness[part, part] += stiff
        mass[part, part] += heavy
    free = np.setdiff1d(np.arange(size), [0, size - 2])
    found = np.sqrt(eigh(stiffness[np.ix_(free, free)], mass[np.ix_(free, free)], eigvals_only=True)) / (2 * np.pi)
    # Forty elements err by (k h)⁴/720: 5e-4 at the ninth mode, the highest of the five.
    np.testing.assert_allclose(beam.frequencies_hz(), found[:10:2], rtol=6e-4)


def test_a_force_put_on_slowly_deflects_the_beam_as_statics_says():
    beam = Beam()
    force = 1e5 * np.minimum(np.arange(4 * 40_000) / 80_000, 1.0)
    moved = respond(beam, force).displacement_m[-1]
    # Five odd modes hold (1 + 1/3⁴ + … + 1/9⁴) / (π⁴/96) = 0.99984 of the deflection; ringing has died to 1e-4 of it.
    assert moved == pytest.approx(1e5 * beam.length_m**3 / (48 * beam.rigidity_n_m2), rel=3e-4)


def test_modes_agree_with_a_general_solver_of_differential_equations():
    beam = Beam(modes=2)
    time = np.arange(2 * 4000 + 1) / 4000
    force = 1e5 * np.sin(2 * np.pi * 3.1 * time) * np.minimum(time, 1.0)
    fine = respond(beam, force)
    omega = 2 * np.pi * beam.frequencies_hz()
    mass = beam.mass_kg_m * beam.length_m / 2

    def slope(t, state):
        x, v = state[:2], state[2:]
        return np.concatenate([v, np.interp(t, time, force) / mass - 2 * beam.damping * omega * v - omega**2 * x])

    found = solve_ivp(slope, (0, 2), np.zeros(4), rtol=1e-11, atol=1e-16, max_step=1 / 4000, t_eval=time[::400])
    # The solver at 1e-11 a step; 1e-9 of the motion over some hundred oscillations.
    np.testing.assert_allclose(fine.displacement_m[::400], found.y[0] + found.y[1], atol=1e-9 * 3e-3 * 100)
    np.testing.assert_allclose(fine.velocity_m_s[::400], found.y[2] + found.y[3], atol=1e-9 * 0.1 * 100)


def test_acceleration_is_the_second_difference_of_displacement_at_the_fine_step():
    fine = paper_beam_motion(5, duration_s=20.0)
    moved = fine.displacement_m
    second = (moved[2:] - 2 * moved[1:-1] + moved[:-2]) / fine.step_s**2
    # The second difference of the fastest strong component (10.3 Hz) errs by (ω h)²/12 = 2e-5; rounding by 1e-10.
    np.testing.assert_allclose(second, fine.acceleration_m_s2[1:-1], atol=2e-4 * np.abs(second).max())


def test_halving_the_step_leaves_the_papers_motion_unchanged():
    time = np.linspace(0.0, 20.0, 501)
    coarse = paper_beam_motion(5, duration_s=20.0, step_rate_hz=2000.0).displacement(time)
    fine = paper_beam_motion(5, duration_s=20.0, step_rate_hz=8000.0).displacement(time)
    # A force taken as linear between 2 kHz steps is off by (ω h)²/12 = 9e-5 of its 10.3 Hz part, 0.2 mm.
    np.testing.assert_allclose(coarse, fine, atol=1e-4 * 0.4e-3)


def test_the_papers_motion_peaks_at_about_eight_millimetres_and_starts_at_rest():
    fine = paper_beam_motion(0)
    assert np.abs(fine.displacement_m).max() == pytest.approx(8.1e-3, abs=0.5e-3)  # the paper's Fig. 14, by camera
    assert fine.displacement_m[0] == fine.velocity_m_s[0] == 0.0
    assert paper_force().displacement(np.array([0.0, 100.0])).tolist() == [0.0, 0.0]


def test_a_coarse_step_is_refused():
    with pytest.raises(UsageError, match="2000 Hz"):
        respond(Beam(), np.zeros(10), step_rate_hz=100.0)
