"""What is fused: the streams brought together."""

import numpy as np
import pytest

from midspan.fusion.kalman import KalmanSettings
from midspan.fusion.smoother import smooth
from midspan.recording.inputs import from_first_measurement
from midspan.records import Acceleration, Displacement, Source, nanoseconds

RATE_HZ = 100.0


@pytest.mark.parametrize("early_ns", [1, 3, 1000, 4_000_000, 9_999_999, 25_000_000])
def test_a_first_frame_just_before_the_first_sample_does_not_throw_the_filter(early_ns: int) -> None:
    rng = np.random.default_rng(4)
    time, stamps = np.arange(0.0, 30.0, 1.0 / RATE_HZ), np.arange(0.0, 29.0, 0.1)
    omega, size = 2.0 * np.pi * 1.3, 0.01
    acceleration = Acceleration(
        nanoseconds(time),
        -size * omega**2 * np.sin(omega * time + 0.7) + rng.normal(0.0, 0.01, time.size),
        np.full(time.size, 1e-6),
    )
    measured = Displacement(
        nanoseconds(stamps) - early_ns,
        size * np.sin(omega * (stamps - 1e-9 * early_ns) + 0.7) + rng.normal(0.0, 1e-4, stamps.size),
        np.full(stamps.size, 1e-8),
        np.full(stamps.size, Source.CAMERA, dtype=np.uint8),
    )
    begun = from_first_measurement(acceleration, measured, RATE_HZ)
    found = smooth(begun, measured, KalmanSettings()).estimate
    rows = np.isin(found.time_ns, acceleration.time_ns)
    error = found.displacement_m[rows] - size * np.sin(omega * time + 0.7)
    # A frame is good for 0.1 mm; nothing may be worse than four of its standard deviations.
    assert np.abs(error).max() < 4e-4
