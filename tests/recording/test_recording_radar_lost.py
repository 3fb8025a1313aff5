"""Lost packets of a radar: frames that never arrived are no measurements, neither in the calibration nor after."""

import numpy as np
import pytest

from midspan.radar.blockage import blocked
from midspan.radar.channels import combined
from midspan.radar.chirp import RangeAxis
from midspan.radar.frames import RadarFrames, without_holes
from midspan.radar.target import find_targets
from midspan.simulate.motion.motion import random_motion
from repeats import slow

PERIOD_S, CYCLE_M = 0.01, 299_792_458.0 / (2 * 78e9)


def frames(seed: int, *, channels: int, lost: float, frame_count: int = 2000) -> tuple[RadarFrames, np.ndarray]:
    """One wall ahead in bin 10 of 24 at 30 dB, its frames with segments of one to three lost; its accelerometer."""
    rng = np.random.default_rng(seed)
    motion = random_motion((0.5, 3.0), 3e-3, rng=np.random.default_rng(77))
    time_s = np.arange(frame_count) * PERIOD_S
    turn = np.exp(2j * np.pi * motion.displacement(time_s) / CYCLE_M)
    shape = np.zeros(24)
    shape[9:12] = 0.5, 1.0, 0.5
    z = 1000 * turn[:, None, None] * np.exp(1j * np.arange(channels))[:, None] * shape
    noise = rng.normal(size=(2, *z.shape))
    z = z + 1000 * 10 ** (-30 / 20) / np.sqrt(2) * (noise[0] + 1j * noise[1])
    valid = np.ones((frame_count, channels), dtype=bool)
    for first in rng.integers(20, frame_count - 20, round(lost * frame_count / 2)):
        # A packet hits the end of one frame and the start of the next ones: all channels of some, one of others.
        valid[first : first + rng.integers(1, 3)] = False
        valid[first + 3, rng.integers(channels)] = False
    at = np.arange(-100, frame_count + 100) * PERIOD_S
    samples = np.column_stack((at, motion.acceleration(at) + rng.normal(0, 2e-3, len(at))))
    stamps = np.rint(1e9 * time_s).astype(np.int64)
    return RadarFrames(stamps, np.where(valid[..., None], z, 0.0).astype(np.complex64), valid), samples


@pytest.mark.parametrize("channels", [2, *slow(1)])
def test_lost_frames_move_neither_clock_nor_factor(channels: int) -> None:
    # Held frames were late by a frame's period times their share: 0.4 ms at 5 %, ten deviations and more.
    axis = RangeAxis(0.05 * np.arange(24), 78e9, 0.0)
    late, factor = [], []
    for seed in range(8):
        known, samples = frames(seed, channels=channels, lost=0.05)
        whole = without_holes(known)
        found = find_targets(whole.phasors, whole.time_ns / 1e9, samples=samples, axis=axis, valid=whole.valid)
        (target,) = (one for one in found if not one.objection)
        late.append(target.time_offset_s / target.time_offset_std_s)
        factor.append((target.conversion_factor - 1.0) / target.conversion_factor_std)
    # Eight draws: the mean within three deviations of a mean, the scatter within a factor of two.
    for ratio in (late, factor):
        assert abs(np.mean(ratio)) < 3.0 / np.sqrt(8)
        assert np.sqrt(np.mean(np.square(ratio))) < 2.0


def test_a_channel_with_a_hole_is_left_out_of_its_frame_and_the_others_keep_phase_and_size() -> None:
    known, _ = frames(0, channels=2, lost=0.05)
    weights = np.exp(1j * np.arange(2)).conj() / np.sqrt(2)
    seen = combined(known.phasors[..., 10], weights.conj(), known.valid)
    missing = ~known.valid.any(axis=1)
    partly = known.valid.any(axis=1) & ~known.valid.all(axis=1)
    assert missing.sum() > 20
    assert partly.sum() > 20
    assert np.isnan(seen[missing]).all()
    # 30 dB: one channel alone is good to 2 % of the amplitude, twice that for most of some dozens.
    assert np.abs(np.abs(seen[partly]) / 1000 - 1).max() < 0.1
    assert np.mean(np.abs(seen[partly])) == pytest.approx(1000, rel=0.01)


def test_a_frame_that_never_arrived_hides_none_of_those_after_it_as_something_in_the_way_does() -> None:
    amplitude = np.full(12, 100.0)
    amplitude[3] = np.nan
    assert np.flatnonzero(blocked(amplitude, 100.0)).tolist() == [3]
    amplitude[3] = 5.0
    # Five good frames in a row until it counts as back.
    assert np.flatnonzero(blocked(amplitude, 100.0)).tolist() == [3, 4, 5, 6, 7]
