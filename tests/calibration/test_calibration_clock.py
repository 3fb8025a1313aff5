"""Clocks that run apart during a record."""

import numpy as np
import pytest

from midspan.calibration.clock import clock_course
from midspan.records import Acceleration, Displacement, Floats, Source, nanoseconds
from midspan.simulate.motion.beam import paper_beam_motion
from repeats import slow

LENGTH_S, RATE_HZ, SLOW_HZ = 400.0, 100.0, 10.0
NOISE = (0.01, 1e-4)  # m/s² and m


def record(seed: int, offset_s: float, skew: float) -> tuple[Acceleration, Displacement, Floats]:
    """A beam whose displacement is stamped early by offset + skew (t - middle); the third: that lateness."""
    rng = np.random.default_rng(seed)
    motion = paper_beam_motion(seed, duration_s=LENGTH_S)
    time = np.arange(0.0, LENGTH_S, 1.0 / RATE_HZ)
    stamps = np.arange(0.5, LENGTH_S - 0.5, 1.0 / SLOW_HZ)
    late = offset_s + skew * (stamps - 0.5 * (stamps[0] + stamps[-1]))
    acceleration = motion.acceleration(time) + rng.normal(0.0, NOISE[0], time.size)
    displacement = motion.displacement(stamps + late) + rng.normal(0.0, NOISE[1], stamps.size)
    return (
        Acceleration(nanoseconds(time), acceleration, np.full(time.size, NOISE[0] ** 2 / RATE_HZ)),
        Displacement(
            nanoseconds(stamps),
            displacement,
            np.full(stamps.size, NOISE[1] ** 2),
            np.full(stamps.size, Source.CAMERA, dtype=np.uint8),
        ),
        late,
    )


@pytest.mark.parametrize(("offset_s", "skew"), [(0.0, 0.0), (-0.001, 3e-5), *slow((0.002, 0.0), (0.003, -2e-5))])
def test_offset_and_skew_come_out_within_their_standard_deviations(offset_s: float, skew: float) -> None:
    acceleration, displacement, _ = record(3, offset_s, skew)
    course = clock_course(acceleration, displacement)
    std = np.sqrt(np.diag(course.covariance))
    # Four standard deviations: one case in ten thousand; 0.02 ms for what is not linear in the lateness.
    assert abs(course.offset_s - offset_s) < 4.0 * std[0] + 2e-5
    assert abs(course.skew - skew) < 4.0 * std[1] + 2e-5 / LENGTH_S
    assert std[0] < 1e-4


def test_the_standard_deviations_are_those_of_repeated_draws() -> None:
    normalised = []
    for seed in range(6):
        acceleration, displacement, _ = record(seed, 0.0, 1e-5)
        course = clock_course(acceleration, displacement)
        std = np.sqrt(np.diag(course.covariance))
        normalised += [course.offset_s / std[0], (course.skew - 1e-5) / std[1]]
    # The root mean square of 12 normal values lies within 0.5 and 1.5 but for one case in a hundred.
    assert 0.5 < float(np.sqrt(np.mean(np.square(normalised)))) < 1.5


def test_windows_follow_a_clock_that_does_not_run_straight() -> None:
    acceleration, displacement, _ = record(1, 0.0, 0.0)
    late = np.where(displacement.time_ns < 200_000_000_000, 0.0, 0.004)
    early = Displacement(
        displacement.time_ns - np.rint(1e9 * late).astype(np.int64),
        displacement.value_m,
        displacement.variance_m2,
        displacement.source,
    )
    course = clock_course(acceleration, early, window_s=50.0)
    expected = np.where(course.time_ns < 200_000_000_000, 0.0, 0.004)
    assert np.abs(course.lateness_s - expected).max() < 5.0 * course.std_s.max() + 1e-4


def test_taking_the_lateness_out_restores_the_stamps() -> None:
    acceleration, displacement, late = record(5, 0.002, 2e-5)
    course = clock_course(acceleration, displacement)
    restored = course.corrected(displacement)
    error = (restored.time_ns - displacement.time_ns) / 1e9 - late
    assert np.abs(error).max() < 5.0 * course.std_at(displacement.time_ns).max() + 2e-5
