"""Motions, phases and scenes that the radar's tests share; the physics is written out here, apart from the package."""

import numpy as np

from midspan.radar.chirp import ChirpProfile
from midspan.simulate.motion.motion import Sines, Window
from midspan.simulate.radar.signal import RadarModel

C = 299_792_458.0
SHORT = ChirpProfile(77e9, 64.985e12, 6e6, 256, 0.01)
CARRIER = 77e9 + 64.985e12 * (6e-6 + 255 / (2 * 6e6))
UNIT = 4 * np.pi * CARRIER / C  # rad per m
CYCLE = C / (2 * CARRIER)  # m
RATE = 100.0


def sine(speed_m_s: float, frequency_hz: float, phase: float = 0.0) -> Window:
    """A sine of the given largest speed that begins smoothly between 1 and 3 s."""
    amplitude = speed_m_s / (2 * np.pi * frequency_hz)
    return Window(Sines(np.array([amplitude]), np.array([frequency_hz]), phase_rad=phase), start_s=1.0, ramp_s=2.0)


def accelerometer(motion, end_s: float, *, noise: float = 5e-5, seed: int = 0, delay_s: float = 0.0, gain: float = 1.0):
    """Samples (m, 2) at 100 Hz from -1 s to `end_s` + 1 s; a delayed one tells later what happened."""
    time = np.arange(-1.0, end_s + 1.0, 0.01)
    value = gain * motion.acceleration(time - delay_s) + np.random.default_rng(seed).normal(0, noise, len(time)) + 0.03
    return np.column_stack((time, value))


def phasors(range_change: np.ndarray, snr_db: float, seed: int = 0) -> np.ndarray:
    """Phasors (n,) of amplitude 1 whose phase is that of the range change, with complex noise."""
    rng = np.random.default_rng(seed)
    noise = (rng.normal(size=len(range_change)) + 1j * rng.normal(size=len(range_change))) / np.sqrt(2)
    return np.exp(1j * UNIT * range_change) + noise * 10 ** (-snr_db / 20)


def profiles_of(model: RadarModel, motion, frames: int, seed: int = 0) -> np.ndarray:
    """Range profiles (frames, channels, bins) of a simulated radar."""
    from midspan.radar.range_profile import averaged, range_profile

    rng = np.random.default_rng(seed)
    parts = [
        averaged(range_profile(cube, model.profile), model.profile) for cube in model.blocks(motion, frames, rng=rng)
    ]
    return np.concatenate(parts)
