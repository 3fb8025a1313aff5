"""Rows of the FIR methods without a full window: they follow the recording's filter settings."""

from dataclasses import replace

import numpy as np
import pytest
from fusion_oracles import acceleration_block, displacement_block

from midspan.fusion.kalman import KalmanSettings
from midspan.fusion.response import linear, standing_still
from midspan.fusion.runners import MethodSettings, run_method
from midspan.records import Status

METHODS = ["fir", "two-stage-fir"]
TIME, MET = np.arange(4000) / 100.0, np.arange(78) / 2.0 + 0.3
NOISE_A, NOISE_D = 2e-3, 1e-4


def record():
    """5 mm at 0.3 Hz, displacement at 2 Hz."""
    rng, omega = np.random.default_rng(8), 2 * np.pi * 0.3
    value = -5e-3 * omega**2 * np.sin(omega * TIME) + rng.normal(0, NOISE_A, TIME.size)
    return (
        acceleration_block(TIME, value, NOISE_A**2 / 100.0),
        displacement_block(MET, 5e-3 * np.sin(omega * MET) + rng.normal(0, NOISE_D, MET.size), NOISE_D**2),
    )


@pytest.mark.parametrize("method", METHODS)
def test_edge_rows_are_coasting_from_the_age_that_the_settings_say(method):
    acceleration, displacement = record()
    status = {}
    for coasting_s in (0.1, 1.0):
        settings = MethodSettings(kalman=KalmanSettings(coasting_s=coasting_s))
        status[coasting_s] = run_method(method, acceleration, displacement, settings).estimate.status
    between = slice(int(100 * MET[0]) + 1, 100)  # behind the first measurement, far within the half window
    # A measurement every 0.5 s: a row's age is up to 0.5 s, so 4 rows of 5 are older than 0.1 s and none than 1 s.
    assert np.mean(status[0.1][between] == Status.COASTING) > 0.7
    assert np.all(status[1.0][between] == Status.TRACKING)


@pytest.mark.parametrize("method", METHODS)
def test_edge_rows_know_the_start_as_well_as_the_settings_say(method):
    acceleration, displacement = record()
    variance = {}
    for velocity_std in (1e-6, 1.0):
        settings = MethodSettings(kalman=KalmanSettings(velocity_std=velocity_std, bias_std=1e-4))
        variance[velocity_std] = run_method(method, acceleration, displacement, settings).estimate.variance_m2[0]
    # A velocity that is known at the start leaves only the position to be found.
    assert variance[1e-6] < 0.7 * variance[1.0]


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("place", [3, 40, 75])
def test_without_a_gate_the_response_of_every_row_is_linear(method, place):
    acceleration, displacement = record()
    settings = MethodSettings(kalman=linear(KalmanSettings()))
    small = 0.01 * displacement.value_m
    # A hundred deviations: any gate would shut it out, at the ends as well as inside.
    single = np.where(np.arange(MET.size) == place, 100 * NOISE_D, 0.0)

    def response(error_m):
        still = standing_still(acceleration)
        return run_method(method, still, replace(displacement, value_m=error_m), settings).estimate.displacement_m

    alone = response(single)
    assert np.abs(alone).max() > 20 * NOISE_D
    np.testing.assert_allclose(response(small + single), response(small) + alone, atol=1e-9)
