"""The search for the clock offset: all offsets at once by correlation, against one regression after the other."""

import numpy as np
import pytest
from radar_cases import RATE, UNIT, accelerometer

from midspan.radar.alignment import Integrals, _offsets, _regressions, align
from midspan.radar.unwrap import wrapped
from midspan.simulate.motion.motion import random_motion

MOTION = random_motion((0.5, 4.0), 1e-3, rng=np.random.default_rng(0))


@pytest.mark.parametrize("lag", [1, 4, 16])
def test_all_offsets_at_once_are_the_regressions_one_by_one(lag) -> None:
    rng = np.random.default_rng(lag)
    time = np.arange(700) / RATE
    integrals = Integrals.of(accelerometer(MOTION, 8.0, noise=3e-3, delay_s=0.04))
    frame = np.flatnonzero(rng.random(700 - 2 * lag) < 0.8) + lag
    value = integrals.second_difference(time[frame] + 0.03, lag / RATE) + rng.normal(0.0, 1e-5, len(frame)) + 2e-5
    offsets = _offsets(1 / RATE, 0.15)
    slope, std = _regressions(value, frame, (time, 1 / RATE, lag), integrals, offsets)
    for k, offset in enumerate(offsets):
        response = integrals.second_difference(time[frame] + offset, lag / RATE)
        (expected, _), covariance = np.polyfit(response, value, 1, cov=True)
        assert slope[k] == pytest.approx(expected, rel=1e-6, abs=1e-6)
        # polyfit divides by the degrees of freedom.
        assert std[k] == pytest.approx(np.sqrt(covariance[0, 0] * (len(value) - 2) / len(value)), rel=1e-5)


def test_offsets_are_half_a_frame_apart_and_reach_as_far_as_asked() -> None:
    offsets = _offsets(0.01, 0.152)
    np.testing.assert_allclose(np.diff(offsets), 0.005)
    assert offsets[0] <= -0.152 < 0.152 <= offsets[-1]
    assert 0.0 in offsets


@pytest.mark.parametrize("rms_m", [2e-4, 3e-3, 4e-2])
def test_ratio_and_offset_lie_within_four_deviations_at_a_thousand_frames_a_second(rms_m) -> None:
    rng = np.random.default_rng(1)
    motion = random_motion((0.5, 4.0), rms_m, rng=rng)
    time = np.arange(20_000) / 1000.0
    phase = wrapped(0.8 * UNIT * motion.displacement(time) + rng.normal(0.0, 0.05, len(time)))
    phase[rng.random(len(time)) < 0.02] = np.nan
    # The accelerometer tells later what happened: its clock is that much ahead.
    samples = accelerometer(motion, 20.0, noise=1e-3, delay_s=0.0512)
    found = align(time, phase, samples=samples, phase_per_m=UNIT)
    assert abs(found.ratio - 0.8) < 4 * found.ratio_std < 0.02
    assert abs(found.offset_s - 0.0512) < 4 * found.offset_std_s < 2e-3
