"""The minimum between two bounds against scipy, which follows the same book, and against closed forms."""

import numpy as np
import pytest
from scipy.optimize import minimize_scalar

from midspan.calibration.minimum import minimum


@pytest.mark.parametrize("seed", range(20))
@pytest.mark.parametrize("tolerance", [1e-5, 0.02])
def test_every_function_is_tried_where_scipy_tries_it(seed, tolerance):
    rng = np.random.default_rng(seed)
    waves = rng.normal(0, 1, (4, 3))
    low, high = np.sort(rng.uniform(-3, 3, 2))
    tried = [], []

    def cost(place, kept):
        kept.append(place)
        return float(np.sum(waves[:, 0] * np.sin(waves[:, 1] * place + waves[:, 2]))) + 0.1 * place * place

    ours = minimum(lambda place: cost(place, tried[0]), low, high, tolerance)
    known = minimize_scalar(
        lambda place: cost(place, tried[1]), bounds=(low, high), method="bounded", options={"xatol": tolerance}
    )
    assert ours == known.x
    assert tried[0] == tried[1]


@pytest.mark.parametrize("place", [-1.0, 0.3, 2.0])
def test_a_parabola_has_its_minimum_at_its_vertex_or_the_nearer_bound(place):
    found = minimum(lambda x: (x - place) ** 2, -0.5, 1.5, 1e-6)
    assert found == pytest.approx(min(max(place, -0.5), 1.5), abs=1e-6)
