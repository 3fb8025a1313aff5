"""The cycle and the first speed shown by the range, frame by frame."""

import numpy as np
import pytest

from midspan.radar.range_gap import MEMORY_FRAMES, FirstFrames, RangeGap, cycles_lost


def gap_of(cycles, phase_rad) -> RangeGap:
    gap = RangeGap()
    for one, phase in zip(cycles, phase_rad, strict=True):
        gap = gap.met(float(one), float(phase))
    return gap


def test_the_mean_and_its_deviation_are_those_of_the_frames() -> None:
    rng = np.random.default_rng(0)
    phase, cycles = np.linspace(0, 100, 400), 1000.0 + rng.normal(0, 1.2, 400)
    gap = gap_of(cycles, phase)
    assert gap.mean == pytest.approx(np.mean(cycles), abs=1e-9)
    assert gap.square == pytest.approx(np.var(cycles), rel=1e-9)
    # Half the mean square of steps knows the noise to 5 %; what is left of slow parts adds a little.
    assert gap.std == pytest.approx(1.2 / np.sqrt(400), rel=0.15)
    assert gap.shifted(3).mean == gap.mean - 3
    assert gap_of(cycles[:20], phase[:20]).std == np.inf


def test_clutter_that_turns_with_the_phase_counts_only_where_the_phase_rests() -> None:
    rng = np.random.default_rng(1)
    turning, resting = np.linspace(0, 200, 800), 0.3 * np.sin(np.linspace(0, 20, 800))
    found = [gap_of(np.cos(p) + rng.normal(0, 0.1, 800), p) for p in (turning, resting)]
    # Means over whole turns are none; at rest the mean of the cosine is 0.98 and moves with the phase's place.
    assert abs(found[0].mean) < 0.05
    assert found[0].std > abs(found[0].mean)
    swinging = gap_of(np.cos(resting * 5) + rng.normal(0, 0.1, 800), resting * 5)
    assert swinging.std > 0.1


def test_a_cycle_is_reported_when_it_is_sure_and_hardly_ever_wrongly() -> None:
    reported = wrong = 0
    for seed in range(100):
        rng = np.random.default_rng(seed)
        lost, count = int(rng.integers(-5, 6)), int(rng.integers(24, MEMORY_FRAMES))
        phase = rng.uniform(0, 30) * np.sin(np.linspace(0, 30, 2 * count))
        clutter = rng.uniform(0, 0.8) * np.sin(rng.choice([0.5, 1.0, 1.7]) * phase + rng.uniform(0, 6))
        cycles = clutter + rng.normal(0, 0.8, 2 * count)
        before = gap_of(cycles[:count], phase[:count])
        found = cycles_lost(before, gap_of(cycles[count:] + lost, phase[count:]))
        reported += found is not None
        wrong += found is not None and found != lost
    assert reported > 10
    assert wrong == 0


@pytest.mark.parametrize("slope", [-2, -1, 0, 1])
def test_the_first_frames_tell_a_speed_of_whole_cycles_a_frame(slope: int) -> None:
    rng, first, cycles = np.random.default_rng(3), FirstFrames(), []
    while first.cycles_per_frame is None:
        cycles.append(1000.0 + (slope + 0.1) * len(cycles) + rng.normal(0, 1.2))
        first = first.met(cycles[-1])
    assert first.cycles_per_frame == (slope, 0.0)
    # The line's deviation √12 σ / n^1.5 falls to 0.12 at 11 frames; the scatter of so few is known to a third.
    assert 10 <= len(cycles) <= 18
    assert slope == round(float(np.polyfit(np.arange(len(cycles)), cycles, 1)[0]))
    noisy = FirstFrames()
    for _ in range(64):
        noisy = noisy.met(float(rng.normal(0, 100.0)))
    # It cannot be reported: the smallest speed is taken, which may well be a wrong one.
    cycles_per_frame, wrong = noisy.cycles_per_frame
    assert cycles_per_frame == 0
    assert wrong > 0.4


@pytest.mark.parametrize("slope", [-1, 0, 1])
def test_where_the_range_is_not_measured_the_usual_motion_tells_the_speed(slope: int) -> None:
    # A swing of 2 cycles rms whose period is longer than what is waited for; its phase turns whole cycles more a frame.
    for start in np.linspace(0.0, 2.0 * np.pi, 12):
        first, count = FirstFrames(moved=2.0), 0
        while first.cycles_per_frame is None:
            first = first.met(2.0 * np.sqrt(2.0) * np.sin(start + 2 * np.pi * count / 150.0) + slope * count)
            count += 1
        assert first.cycles_per_frame == (slope, 0.0)
        # √12 · 2 cycles over n frames falls to 0.12 at 58.
        assert count == 58
    assert FirstFrames(moved=0.01).met(0.0).cycles_per_frame == (0, 0.0)
