"""Whether a displacement was felt by the accelerometer."""

import numpy as np
import pytest

from midspan.engine.unshaken import refuse_unshaken
from midspan.errors import UntrustedError
from midspan.records import Acceleration, Estimate

TIME_S = np.arange(0.0, 60.0, 0.01)
SWING = 2.0 * np.pi * 0.7


def rows(moved_m, std_m=2e-4) -> Estimate:
    time_ns = np.rint(1e9 * TIME_S).astype(np.int64)
    code = np.zeros(len(TIME_S), dtype=np.uint8)
    return Estimate(time_ns, moved_m, np.full(len(TIME_S), std_m**2), np.zeros(len(TIME_S)), code, code)


def felt(value_m_s2, density=4e-8) -> Acceleration:
    time_ns = np.rint(1e9 * TIME_S).astype(np.int64)
    return Acceleration(time_ns, value_m_s2, np.full(len(TIME_S), density))


MOVED = 3e-3 * np.sin(SWING * TIME_S)
ACCELERATION = -(SWING**2) * MOVED + 0.02 + 1e-4 * TIME_S + np.random.default_rng(0).normal(0, 2e-3, len(TIME_S))


def test_what_the_acceleration_shows_is_accepted_with_a_slow_part_that_it_cannot_show() -> None:
    # A span that bends by 0.3 m within the minute, as the sun or a tide makes it: over 5 s a cubic.
    refuse_unshaken(rows(MOVED + 0.3 * np.sin(2.0 * np.pi * TIME_S / 120.0)), felt(ACCELERATION))


def test_a_step_of_decimetres_that_nothing_felt_is_refused_and_a_felt_one_is_not() -> None:
    since = np.clip((TIME_S - 31.0) / 2.0, 0.0, 1.0)
    step = 0.2 * (10 * since**3 - 15 * since**4 + 6 * since**5)
    with pytest.raises(UntrustedError, match=r"mm rms within 5 s from 30\.000 s"):
        refuse_unshaken(rows(MOVED + step), felt(ACCELERATION))
    pushed = 0.2 / 4.0 * (60 * since - 180 * since**2 + 120 * since**3) * (since < 1.0)
    refuse_unshaken(rows(MOVED + step), felt(ACCELERATION + pushed))


def test_an_accelerometer_that_dies_or_is_bridged_makes_no_motion() -> None:
    refuse_unshaken(rows(MOVED), felt(np.where(TIME_S > 30.0, 0.0, ACCELERATION)))
    refuse_unshaken(rows(MOVED), felt(np.where(np.abs(TIME_S - 30.0) < 0.5, 5.0, ACCELERATION)))
    # Where acceleration is missing for seconds its noise says so.
    density = np.where(np.abs(TIME_S - 32.0) < 2.0, 1e-3, 4e-8)
    bumped = MOVED + 0.02 * np.exp(-((TIME_S - 32.0) ** 2))
    refuse_unshaken(rows(bumped), felt(np.where(density > 1e-4, 0.0, ACCELERATION), density))


def test_what_is_uncertain_by_as_much_is_no_contradiction() -> None:
    wide = np.where(np.abs(TIME_S - 32.0) < 2.5, 0.1, 2e-4)
    bumped = rows(MOVED + 0.1 * np.exp(-((TIME_S - 32.0) ** 2)), wide)
    refuse_unshaken(bumped, felt(ACCELERATION))
