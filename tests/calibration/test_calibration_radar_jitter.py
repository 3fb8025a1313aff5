"""Frames of a radar that are not taken at their stamps are told from a target that moves on its own."""

import numpy as np
import pytest

from midspan.calibration.fit import Pair, best_corner
from midspan.calibration.radar.jitter import frames_jitter
from midspan.simulate.motion.motion import random_motion


def pair_of(seed, *, jitter_s=0.0, own_m=0.0, bent=0.0, gain=0.0):
    """A minute of 4 mm rms at 0.5 to 4 Hz: 100 Hz of acceleration, 50 frames a second that are known to 20 µm."""
    rng = np.random.default_rng(seed)
    motion = random_motion((0.5, 4.0), 4e-3, rng=rng)
    time_s, frame_s = np.arange(6000) / 100.0, 1.0 + np.arange(2900) / 50.0
    # An accelerometer that warms up in a quarter of a minute.
    warm = 1 + gain * (1 - np.exp(-time_s / 15))
    felt = warm * motion.acceleration(time_s) + rng.normal(0, 2e-3, len(time_s))
    own = random_motion((3.0, 6.0), own_m, rng=rng).displacement(frame_s) if own_m else 0.0
    moved = motion.displacement(frame_s + jitter_s * rng.normal(size=len(frame_s))) + own
    # Something else in its bin moves by 0.9 times as much: the phasors add.
    turn = 4 * np.pi / 3.9e-3 * np.asarray(moved)
    moved = moved + np.angle(1 + bent * np.exp(-0.1j * turn)) * 3.9e-3 / (4 * np.pi)
    moved = moved + rng.normal(0, 2e-5, len(frame_s))
    samples = np.column_stack((time_s, felt - felt.mean(), np.ones(len(time_s))))
    return Pair(samples, np.column_stack((frame_s, moved, np.ones(len(frame_s)))))


@pytest.mark.parametrize(
    ("kind", "jitters"),
    [
        ({"jitter_s": 1e-3}, True),
        ({"jitter_s": 4e-3}, True),
        ({"own_m": 1e-4}, False),
        ({"bent": 0.3}, False),
        ({"gain": 0.02}, False),
        ({}, False),
    ],
)
def test_what_grows_with_the_speed_is_jitter(kind, jitters):
    for seed in range(3):
        pair = pair_of(seed, **kind)
        assert frames_jitter(pair, best_corner(pair, 0.0)) is jitters
