"""Acceleration integrated twice: between samples and in gaps it is what a constant makes."""

import numpy as np

from midspan.signals.integrate import path


def test_a_constant_is_a_parabola_at_any_instant_and_through_a_gap():
    sampled = np.r_[np.arange(0.0, 5.0, 0.1), np.arange(12.0, 20.0, 0.1)]
    # Its mean is taken off: half of the samples' number each way, so that the constant is the same on both sides.
    value = np.where(sampled < 5.0, 0.3, -0.3 * 50 / 80)
    at = np.random.default_rng(0).uniform(0.0, 4.9, 200)
    at.sort()
    moved = path(at, sampled, value)
    np.testing.assert_allclose(moved, 0.15 * at**2, atol=1e-12)
    # Within the gap the acceleration goes from one to the other in a straight line; the slope is that at its ends.
    inside = np.linspace(5.0, 11.9, 50)
    assert np.all(np.isfinite(path(inside, sampled, value)))
    still = path(inside, sampled, np.where(sampled < 5.0, 1e-9, 0.0))
    assert np.max(np.abs(still)) < 1e-7


def test_what_is_integrated_with_a_constant_differs_by_a_parabola_also_in_a_gap():
    rng = np.random.default_rng(1)
    sampled = np.r_[np.arange(0.0, 20.0, 0.1), np.arange(40.0, 60.0, 0.1)]
    value, at = rng.normal(0.0, 0.01, len(sampled)), np.arange(0.0, 59.0, 0.37)
    # A constant over a part of a longer record is what that part's own mean differs by.
    longer = np.r_[sampled, 60.0 + sampled], np.r_[value + 0.05, value - 0.05]
    differs = path(at, *longer) - path(at, sampled, value)
    left = differs - np.polynomial.Polynomial.fit(at, differs, 2)(at)
    assert np.max(np.abs(left)) < 1e-9 * np.max(np.abs(differs))
