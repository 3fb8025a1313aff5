import numpy as np
import pytest

from midspan.papers.printed.phase import gradient_form, phase_change
from midspan.vision.phase_model import phase_curvatures, phase_slopes
from midspan.vision.steerable import quadrature, responses


def plane_wave(fx, fy, dx=0.0, dy=0.0, side=48):
    y, x = np.mgrid[0:side, 0:side]
    return (100 + 30 * np.cos(2 * np.pi * (fx * (x - dx) + fy * (y - dy)) + 0.3)).astype(np.float32)


def change(axis, before, after):
    reference = quadrature(before, axis)
    return phase_change(responses(after, axis), reference.ravel(), np.arange(reference.size))


@pytest.mark.parametrize("shift", [-0.4, 0.05, 0.45])
@pytest.mark.parametrize(("axis", "fx", "fy"), [("x", 0.2, 0.05), ("y", -0.04, 0.22)])
def test_phase_falls_by_two_pi_times_frequency_times_shift(axis, fx, fy, shift):
    # The mean over whole periods takes the pair's ripple away: the slope is the closed form to a thousandth.
    dx, dy = (shift, 0.0) if axis == "x" else (0.0, shift)
    found = change(axis, plane_wave(fx, fy), plane_wave(fx, fy, dx, dy)).mean()
    assert found == pytest.approx(-2 * np.pi * (fx * dx + fy * dy), abs=2e-3 * np.pi)


@pytest.mark.parametrize(("shift", "wrapped"), [(2.4, -2 * np.pi * 0.48), (2.6, 2 * np.pi * 0.48)])
def test_phase_wraps_once_it_passes_pi_and_never_leaves_the_circle(shift, wrapped):
    # At 0.2 cycles/px a shift of 2.5 px is π: just below it the phase is nearly -π, just above nearly +π.
    found = change("x", plane_wave(0.2, 0.0), plane_wave(0.2, 0.0, dx=shift))
    assert np.abs(found).max() <= np.float32(np.pi)
    assert np.median(found) == pytest.approx(wrapped, abs=0.06)


def test_a_phase_near_pi_on_both_sides_changes_by_little():
    # 3.1 and -3.1 rad are 0.083 rad apart; a plain difference would give 6.2.
    reference = np.array([np.exp(3.1j)], dtype=np.complex64)
    now = np.exp(-3.1j)
    parts = (np.array([[now.real]], dtype=np.float32), np.array([[now.imag]], dtype=np.float32))
    assert phase_change(parts, reference, np.array([0]))[0] == pytest.approx(2 * np.pi - 6.2, abs=1e-6)


def test_slopes_are_the_local_frequency_and_a_plane_wave_has_no_curvature():
    field = quadrature(plane_wave(0.2, 0.06), "x")
    x, y = phase_slopes(field)
    assert x.mean() == pytest.approx(2 * np.pi * 0.2, rel=0.005)
    assert y.mean() == pytest.approx(2 * np.pi * 0.06, rel=0.005)
    assert [abs(c.mean()) for c in phase_curvatures(field)] == pytest.approx([0, 0, 0], abs=0.005)


def test_curvatures_of_a_quadratic_phase_are_its_second_derivatives():
    y, x = np.mgrid[-8:9, -8:9]
    field = np.exp(1j * (0.7 * x + 0.01 * x**2 - 0.02 * y**2 + 0.03 * x * y)).astype(np.complex64)
    xx, yy, xy = phase_curvatures(field)
    assert (xx.mean(), yy.mean(), xy.mean()) == pytest.approx((0.02, -0.04, 0.03), abs=1e-5)


def test_the_gradient_form_gives_the_shift_of_a_sinusoid():
    before, after = plane_wave(0.2, 0.0), plane_wave(0.2, 0.0, dx=0.3)
    slope = phase_slopes(quadrature(after, "x"))[0].ravel()
    inner = before[1:-1, 1:-1]
    found = gradient_form(change("x", inner, after[1:-1, 1:-1]), slope)
    assert found == pytest.approx(0.3, abs=0.003)  # the pair's ripple


def test_the_gradient_form_leaves_pixels_without_slope_out():
    assert gradient_form(np.array([0.2, 5.0], dtype=np.float32), np.array([-1.0, 0.0])) == pytest.approx(0.2)
    assert np.isnan(gradient_form(np.array([1.0], dtype=np.float32), np.array([0.0])))
