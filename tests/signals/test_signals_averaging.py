"""What averaging over an exposure takes, against the closed form of a sine."""

import numpy as np
import pytest

from midspan.records import Acceleration, Displacement, nanoseconds
from midspan.signals.averaging import at_instants, taken_by_averaging


@pytest.mark.parametrize("share", [0.05, 0.4, 0.9, 1.7])
def test_of_a_sine_all_but_the_sinc_is_taken(share):
    hertz, time = 2.0, np.arange(0.0, 10.0, 0.002)
    omega, exposure_s = 2.0 * np.pi * hertz, share / hertz
    at = np.linspace(1.0, 9.0, 57)
    found = taken_by_averaging(nanoseconds(time), -(omega**2) * np.sin(omega * time), nanoseconds(at), exposure_s)
    # Straight lines between samples take (omega dt)²/12 of the acceleration, 5e-5.
    np.testing.assert_allclose(found, (np.sinc(share) - 1.0) * np.sin(omega * at), atol=1e-4)


def test_means_become_values_at_their_middles():
    hertz, time, exposure_s = 1.3, np.arange(0.0, 20.0, 0.005), 0.3
    omega, at = 2.0 * np.pi * hertz, np.arange(0.5, 19.5, 0.2)
    mean = np.sinc(hertz * exposure_s) * np.sin(omega * at)
    shaken = Acceleration(nanoseconds(time), 9.81 - omega**2 * np.sin(omega * time), np.ones(len(time)))
    measured = Displacement(nanoseconds(at), mean, np.ones(len(at)), np.zeros(len(at), dtype=np.uint8))
    found = at_instants(measured, exposure_s, shaken)
    # What the mean over a record that is no whole number of periods is taken for as the bias: 0.06 m/s² of T²/24.
    np.testing.assert_allclose(found.value_m, np.sin(omega * at), atol=1e-3)
    assert at_instants(measured, 0.0, shaken) is measured
