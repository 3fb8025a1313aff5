"""The start of a record: outliers among its first measurements, and frames before its first sample."""

from dataclasses import replace

import numpy as np
import pytest

from midspan.fusion.runners import run_method
from midspan.fusion.streams import KalmanSettings, MethodSettings, smooth
from midspan.records import Acceleration, Displacement, Floats, Source, nanoseconds
from midspan.simulate.motion.beam import paper_beam_motion

NOISE = (0.01, 2e-4)  # m/s² and m
LENGTH_S = 60.0


def record(seed: int) -> tuple[Acceleration, Displacement, Floats]:
    """A beam at 100 Hz and 5 Hz, and its true displacement at the samples."""
    rng = np.random.default_rng(seed)
    motion = paper_beam_motion(seed, duration_s=LENGTH_S)
    time, stamps = np.arange(0.0, LENGTH_S, 0.01), np.arange(0.014, LENGTH_S - 1.0, 0.2)
    return (
        Acceleration(
            nanoseconds(time),
            motion.acceleration(time) + rng.normal(0.0, NOISE[0], time.size),
            np.full(time.size, NOISE[0] ** 2 / 100.0),
        ),
        Displacement(
            nanoseconds(stamps),
            motion.displacement(stamps) + rng.normal(0.0, NOISE[1], stamps.size),
            np.full(stamps.size, NOISE[1] ** 2),
            np.full(stamps.size, Source.DISPLACEMENT, dtype=np.uint8),
        ),
        motion.displacement(time),
    )


def spoilt(measured: Displacement, which: list[int], by_m: float) -> Displacement:
    value = measured.value_m.copy()
    value[which] += by_m
    return replace(measured, value_m=value)


@pytest.mark.parametrize("method", ["smoother", "kalman", "lag", "adaptive-kalman"])
@pytest.mark.parametrize("which", [[1], [2]])
def test_an_outlier_at_the_start_moves_no_row_that_says_it_is_tracking(which: list[int], method: str) -> None:
    acceleration, measured, truth = record(2)
    settings = MethodSettings(KalmanSettings(velocity_std=0.1, bias_std=0.03))
    clean, dirty = (
        run_method(method, acceleration, item, settings) for item in (measured, spoilt(measured, which, 6e-3))
    )
    rows = dirty.estimate
    share = np.abs(rows.displacement_m - truth) / np.sqrt(rows.variance_m2)
    # Six standard deviations: none in 6000 rows; the outlier is thirty of a measurement's.
    assert share.max() < 6.0
    after = slice(200, None)
    error, best = (np.sqrt(np.mean((f.estimate.displacement_m - truth)[after] ** 2)) for f in (dirty, clean))
    assert error < 1.1 * best


@pytest.mark.parametrize("early_ns", [1, 3, 1000, 4_000_000, 9_999_999, 25_000_000])
def test_a_first_frame_just_before_the_first_sample_does_not_throw_the_filter(early_ns: int) -> None:
    rng = np.random.default_rng(4)
    time, stamps = np.arange(0.0, 30.0, 0.01), np.arange(0.0, 29.0, 0.1)
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
    found = smooth(acceleration, measured).estimate
    np.testing.assert_array_equal(found.time_ns, acceleration.time_ns)
    error = found.displacement_m - size * np.sin(omega * time + 0.7)
    # A frame is good for 0.1 mm; nothing may be worse than four of its standard deviations.
    assert np.abs(error).max() < 4e-4
