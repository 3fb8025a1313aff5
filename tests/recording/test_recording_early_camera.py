"""A camera that starts before the accelerometer: zero and band of every method."""

from dataclasses import replace

import numpy as np
import pytest

from midspan.fusion.kalman import KalmanSettings
from midspan.fusion.methods import METHODS
from midspan.recording.fusing.fuse import FusionInputs, SensorError, fuse
from midspan.recording.inputs import from_first_measurement
from midspan.records import Acceleration, Displacement, Source, nanoseconds

RATE_HZ, NOISE_A, NOISE_D = 100.0, 2e-3, 1e-4
TIME = np.arange(6000) / RATE_HZ


def motion(time):
    """2 mm at 0.3 Hz and 1 mm at 2.2 Hz: displacement and acceleration."""
    parts = ((2e-3, 0.3), (1e-3, 2.2))
    value = sum(a * np.sin(2 * np.pi * f * time + 1.0) for a, f in parts)
    return value, -sum(a * (2 * np.pi * f) ** 2 * np.sin(2 * np.pi * f * time + 1.0) for a, f in parts)


def inputs(seed, early_s):
    """A camera's record that begins so many seconds before the accelerometer's."""
    rng = np.random.default_rng(seed)
    met = np.arange(590 + round(10 * early_s)) / 10.0 - early_s
    acceleration = Acceleration(
        nanoseconds(TIME),
        motion(TIME)[1] + rng.normal(0, NOISE_A, len(TIME)),
        np.full(len(TIME), NOISE_A**2 / RATE_HZ),
    )
    measured = Displacement(
        nanoseconds(met),
        motion(met)[0] + rng.normal(0, NOISE_D, len(met)),
        np.full(len(met), NOISE_D**2),
        np.full(len(met), Source.CAMERA, dtype=np.uint8),
    )
    begun = from_first_measurement(acceleration, measured, RATE_HZ)
    return FusionInputs(
        begun,
        measured,
        KalmanSettings(bias_std=0.05),
        zero_ns=int(measured.time_ns[0]),
        sampled=None if begun is acceleration else acceleration,
    )


def error_and_band(given, method):
    """Error and standard deviation of the accelerometer's rows that a measurement is near."""
    rows = fuse(given, method).estimate
    own = np.isin(rows.time_ns, nanoseconds(TIME[:5800]))
    assert own.sum() == 5800
    zero = motion(np.array([1e-9 * given.zero_ns]))[0]
    return rows.displacement_m[own] - motion(TIME[:5800])[0] + zero, np.sqrt(rows.variance_m2[own])


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("early_s", [0.004, 0.03, 0.25, 1.2, 2.5, 10.0])
def test_an_early_camera_gives_the_zero_of_its_first_frame_and_a_band_that_holds_it(method, early_s):
    errors, bands = [], []
    for seed in range(3):
        error, band = error_and_band(inputs(seed, early_s), method)
        errors.append(error[500:])
        bands.append(band[500:])
    # One frame is good for 0.1 mm, and no method needs more of a band than that for the zero and for a row together.
    assert np.median(bands) < 1.5 * NOISE_D
    # The zero is one draw for a whole record: three records stay within three standard deviations.
    assert np.max(np.abs(np.mean(errors, axis=1)) / np.median(bands, axis=1)) < 3.0
    assert np.std(errors, axis=1).max() < 1.5 * NOISE_D


@pytest.mark.parametrize("method", ["fir", "two-stage-fir"])
def test_an_early_camera_is_no_gap_to_a_method_without_a_state(method):
    assert "gap" not in [event.kind for event in fuse(inputs(0, 0.25), method).events]


@pytest.mark.parametrize("method", METHODS)
def test_an_uncertain_scale_of_an_early_camera_widens_the_band_by_what_it_moves_the_rows(method):
    given = inputs(1, 0.25)
    error, plain = error_and_band(given, method)
    wide = error_and_band(replace(given, errors=(SensorError(Source.CAMERA, relative_scale_std=0.05),)), method)[1]
    scaled = replace(given, displacement=replace(given.displacement, value_m=1.05 * given.displacement.value_m))
    moved = error_and_band(scaled, method)[0] - error
    added = np.sqrt(wide**2 - plain**2)
    # All methods are linear, apart from what is learnt or rejected anew: `adaptive-kalman` moves up to a quarter less.
    size = np.sqrt(np.mean(moved[500:] ** 2))
    assert np.sqrt(np.mean(added[500:] ** 2)) == pytest.approx(size, rel=0.3)
