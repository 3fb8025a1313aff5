"""Clocks that drift apart during a long recording."""

import numpy as np
import pytest

from midspan.calibration.one_clock import on_one_clock
from midspan.records import Acceleration, Displacement, Floats, Source, nanoseconds
from midspan.simulate.motion.beam import paper_beam_motion

NOISE = (0.01, 1e-4)  # m/s² and m


def record(length_s: float, late_s: Floats, stamps: Floats) -> tuple[Acceleration, Displacement]:
    """A beam at 100 Hz; its displacement is stamped early by `late_s` (n,) at `stamps` (n,)."""
    rng = np.random.default_rng(2)
    motion = paper_beam_motion(2, duration_s=length_s)
    time = np.arange(0.0, length_s, 0.01)
    value = motion.displacement(stamps + late_s) + rng.normal(0.0, NOISE[1], stamps.size)
    return (
        Acceleration(
            nanoseconds(time),
            motion.acceleration(time) + rng.normal(0.0, NOISE[0], time.size),
            np.full(time.size, NOISE[0] ** 2 / 100.0),
        ),
        Displacement(
            nanoseconds(stamps),
            value,
            np.full(stamps.size, NOISE[1] ** 2),
            np.full(stamps.size, Source.CAMERA, dtype=np.uint8),
        ),
    )


def test_a_skew_of_a_cheap_quartz_is_taken_out_and_reported() -> None:
    stamps = np.arange(1.0, 399.0, 0.1)
    late = 25e-6 * (stamps - 20.0)
    acceleration, measured = record(400.0, late, stamps)
    found = on_one_clock(measured, acceleration, "camera")
    moved = (found.measured.time_ns - measured.time_ns) / 1e9
    assert found.course is not None
    std_s = found.course.std_at(measured.time_ns).max()
    # Five of the standard deviations it promises, and 0.02 ms for what is not linear.
    assert np.abs(moved - late).max() < 5.0 * std_s + 2e-5
    # What calibration promises for a minute is 1 ms.
    assert std_s < 2e-4
    assert "ppm" in found.warnings[0]


@pytest.mark.parametrize(("length_s", "skew"), [(400.0, 0.0), (90.0, 25e-6)])
def test_even_clocks_and_short_records_are_left_alone(length_s: float, skew: float) -> None:
    stamps = np.arange(1.0, length_s - 1.0, 0.1)
    acceleration, measured = record(length_s, skew * stamps, stamps)
    found = on_one_clock(measured, acceleration, "camera")
    assert found.measured is measured
    assert found.course is None
    assert found.warnings == ()


def test_a_clock_that_was_set_in_the_middle_is_reported() -> None:
    stamps = np.arange(1.0, 599.0, 0.1)
    acceleration, measured = record(600.0, np.where(stamps < 300.0, 0.0, 0.004), stamps)
    found = on_one_clock(measured, acceleration, "camera")
    assert any("drift is not linear" in text for text in found.warnings)


def test_two_minutes_are_enough_to_see_it() -> None:
    stamps = np.arange(1.0, 179.0, 0.1)
    late = 25e-6 * stamps
    acceleration, measured = record(180.0, late, stamps)
    found = on_one_clock(measured, acceleration, "camera")
    assert found.course is not None
    moved = (found.measured.time_ns - measured.time_ns) / 1e9
    assert np.abs(moved - late).max() < 5.0 * found.course.std_at(measured.time_ns).max() + 2e-5
