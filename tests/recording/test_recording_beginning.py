"""Outliers among a record's first measurements, which a filter that has just begun would believe."""

from dataclasses import replace

import numpy as np
import pytest

from midspan.fusion.beginning import judged_backwards
from midspan.fusion.kalman import KalmanSettings
from midspan.recording.fusing.fuse import FusionInputs, fuse
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


@pytest.mark.parametrize("which", [[], [0], [1], [0, 2], [1, 4, 7]])
def test_the_outliers_are_found_and_the_others_known_to_be_right(which: list[int]) -> None:
    acceleration, measured, _ = record(1)
    found = judged_backwards(acceleration, spoilt(measured, which, 6e-3), KalmanSettings())
    assert np.flatnonzero(found.wrong).tolist() == which
    assert np.flatnonzero(found.right).tolist() == [k for k in range(20) if k not in which]


@pytest.mark.parametrize("method", ["smoother", "kalman", "lag", "adaptive-kalman"])
@pytest.mark.parametrize("which", [[0], [1], [1, 3]])
def test_an_outlier_at_the_start_moves_no_row_that_says_it_is_tracking(which: list[int], method: str) -> None:
    acceleration, measured, truth = record(2)
    settings = KalmanSettings(velocity_std=0.1)
    clean, dirty = (
        fuse(FusionInputs(acceleration, item, settings), method) for item in (measured, spoilt(measured, which, 6e-3))
    )
    rows = dirty.estimate
    share = np.abs(rows.displacement_m - truth) / np.sqrt(rows.variance_m2)
    # Six standard deviations: none in 6000 rows; the outlier is thirty of a measurement's.
    assert share.max() < 6.0
    after = slice(200, None)
    error, best = (np.sqrt(np.mean((f.estimate.displacement_m - truth)[after] ** 2)) for f in (dirty, clean))
    assert error < 1.1 * best
    assert any("contradict those after them" in event.text for event in dirty.events)


def test_short_records_are_not_judged() -> None:
    acceleration, measured, _ = record(3)
    few = Displacement(*(getattr(measured, n)[:30] for n in ("time_ns", "value_m", "variance_m2", "source")))
    found = judged_backwards(acceleration, spoilt(few, [0], 6e-3), KalmanSettings())
    assert not found.wrong.any()
    assert not found.right.any()
