"""Equations 9 and 11 against the intersection of the line of sight with the surface."""

import math

import numpy as np
import pytest

from midspan.errors import UsageError
from midspan.papers.radar_002 import factor_by_angles, factor_by_distances


def range_to_wall(place, wall_at, along_wall):
    """Distance from `place` along the line of sight (x) to the line through `wall_at` along `along_wall`."""
    matrix = np.column_stack(([1.0, 0.0], -np.asarray(along_wall)))
    return np.linalg.solve(matrix, np.asarray(wall_at) - place)[0]


@pytest.mark.parametrize("theta", [-0.6, 0.0, 0.3, 0.8])
@pytest.mark.parametrize("phi", [0.9, math.pi / 2, 2.0])
def test_equation_11_is_the_change_of_the_range_to_a_wall(theta, phi):
    # The radar moves towards the wall; the surface runs back from the line of sight at the angle φ to it.
    wall, step = ((5.0, 0.0), (-math.cos(phi), math.sin(phi))), 1e-3
    moved = step * np.array([math.cos(theta), math.sin(theta)])
    change = range_to_wall(np.zeros(2), *wall) - range_to_wall(moved, *wall)
    # A plane: exact but for rounding of 5 m against a millimetre.
    assert factor_by_angles(theta, phi) == pytest.approx(step / change, rel=1e-9)


def test_equation_9_is_equation_11_for_a_surface_at_right_angles():
    for across in (0.0, 1.0, 3.2):
        assert factor_by_distances(4.0, across) == pytest.approx(factor_by_angles(math.asin(across / 4.0)), rel=1e-12)
    assert factor_by_distances(5.0, 3.0) == pytest.approx(5.0 / 4.0, rel=1e-15)


def test_what_has_no_factor_is_refused():
    with pytest.raises(UsageError, match="along_m"):
        factor_by_distances(4.0, 4.0)
    with pytest.raises(UsageError, match="surface_rad"):
        factor_by_angles(0.1, 0.0)
    with pytest.raises(UsageError, match="direction"):
        factor_by_angles(math.pi / 2, math.pi / 2)
