import numpy as np
import pytest
from scipy.interpolate import BSpline
from scipy.ndimage import map_coordinates

from midspan import _core
from midspan.vision.texture import REACH


@pytest.mark.parametrize("derivative", [0, 1, 2])
def test_the_quintic_agrees_with_scipys_b_spline(derivative):
    reference = BSpline.basis_element(np.arange(-3.0, 4.0), extrapolate=False)
    reference = reference.derivative(derivative) if derivative else reference
    for x in np.linspace(-2.99, 2.99, 41):
        # Truncated powers cancel terms of up to 65, so that rounding leaves some 1e-13.
        assert _core.quintic(x, derivative) == pytest.approx(float(reference(x)), abs=1e-12)


@pytest.mark.parametrize("shift", [-1.0, -0.37, 0.0, 0.5, 0.999])
def test_weights_sum_to_one_and_their_derivatives_to_nothing(shift):
    assert _core.spline_weights(shift, 0).sum() == pytest.approx(1.0, abs=1e-12)
    assert _core.spline_weights(shift, 1).sum() == pytest.approx(0.0, abs=1e-12)
    assert _core.spline_weights(shift, 2).sum() == pytest.approx(0.0, abs=1e-12)


def test_the_derivative_of_the_weights_is_their_slope_by_the_shift():
    step = 1e-5
    slope = (_core.spline_weights(0.3 + step, 0) - _core.spline_weights(0.3 - step, 0)) / (2 * step)
    # Central differences: the third derivative of the spline (below 10) times step²/6, and rounding / step.
    np.testing.assert_allclose(_core.spline_weights(0.3, 1), slope, atol=1e-7)


@pytest.mark.parametrize(("x", "y"), [(0.0, 0.0), (0.3, -0.8), (-0.5, 0.5), (1.0, -1.0)])
def test_a_translated_spline_agrees_with_scipys_interpolation(x, y):
    image = np.random.default_rng(1).normal(0, 30, (40, 50))
    grid = _core.spline_coefficients(image).astype(np.float32)
    rows, columns = np.mgrid[REACH : 40 - REACH, REACH : 50 - REACH].astype(float)
    expected = map_coordinates(image, [rows - y, columns - x], order=5, mode="mirror")
    # float32 coefficients of up to some 300 carry 2e-5 each.
    np.testing.assert_allclose(_core.translated(grid, x, y), expected, atol=5e-4)
