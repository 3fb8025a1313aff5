"""Pairs of acceleration and translation with everything known."""

import numpy as np

from midspan.calibration.fit import Pair
from midspan.simulate.motion.beam import paper_beam_motion
from midspan.simulate.motion.motion import Sines, random_motion
from midspan.simulate.motion.sensors import AccelerometerModel, DisplacementSensorModel, noise_std_for, simulate_pair

SCALE = 2.289e-3  # m/px
OFFSET = 0.05
DURATION_S = 60.0


def observed(motion, seed, *, rate_hz=10.0, noise_px=0.02, scale=SCALE, offset_s=OFFSET, accelerometer=None):
    """A minute of 100 Hz acceleration (2 mm/s² noise, bias) and of translation in px counted from the first frame."""
    model = accelerometer or AccelerometerModel(100.0, 2e-3, 0.02)
    sensor = DisplacementSensorModel(rate_hz, noise_px * abs(scale), offset_s)
    pair = simulate_pair(motion, DURATION_S, accelerometer=model, displacement=sensor, seed=seed)
    time, value = pair.acceleration.time_ns / 1e9, pair.acceleration.value
    met, moved = pair.displacement.time_ns / 1e9, pair.displacement.value / scale
    inner = (met > 0.55) & (met < DURATION_S - 0.55)
    return Pair(
        np.column_stack((time, value - value.mean(), np.ones(len(time)))),
        # The third column is the tracker's own variance, here a right one.
        np.column_stack((met, moved - moved[inner][0], np.full(len(met), noise_px**2)))[inner],
    )


def tones(seed, *parts):
    """A sum of sines given as (amplitude in m, frequency in Hz) with drawn phases."""
    amplitude, frequency = np.array(parts).T
    return Sines(amplitude, frequency, phase_rad=np.random.default_rng(seed).uniform(0, 2 * np.pi, len(parts)))


def broadband(seed, std_m=3e-3):
    """Random motion of 0.3 to 8 Hz with an even spectrum of velocity."""
    return random_motion((0.3, 8.0), std_m, rng=np.random.default_rng(seed), flat="velocity")


def beam_in_pixels(seed, offset_s, scale=-SCALE, noise_px=0.01):
    """The paper's beam with 40 dB of acceleration and a camera at 10 Hz."""
    motion = paper_beam_motion(seed, duration_s=DURATION_S)
    noise = noise_std_for(motion.acceleration(np.arange(0, DURATION_S, 0.01)), 40.0)
    model = AccelerometerModel(100.0, noise, 0.05)
    return observed(motion, seed, noise_px=noise_px, scale=scale, offset_s=offset_s, accelerometer=model)


def spoilt(pair, seed, share=0.05):
    """The pair with a share of the frames wrong by 3 to 30 px, and which."""
    rng = np.random.default_rng(seed)
    rows, bad = pair.rows.copy(), rng.random(len(pair.rows)) < share
    rows[bad, 1] += rng.choice([-1.0, 1.0], bad.sum()) * rng.uniform(3.0, 30.0, bad.sum())
    return Pair(pair.samples, rows), bad
