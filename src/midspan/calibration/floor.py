"""How much white noise a sensor's readings can have: no more than the lowest part of their spectrum."""

import numpy as np

from midspan.records import Floats

# Bands of the spectrum hold this many ordinates: the mean of one is right to a quarter.
ORDINATES = 16


def noise_floor(value: Floats) -> float:
    """Variance of the white noise in evenly spaced readings (n,) at most; infinite where they are too few.

    White noise has the same power at all frequencies, to which motion only adds: no band has less than the noise.
    """
    # A Hann window keeps slow motion from leaking; every other of its ordinates is nearly independent.
    n = len(value)
    power = np.abs(np.fft.rfft(np.hanning(n) * (value - np.mean(value))))[2:-1:2] ** 2
    count = len(power) // ORDINATES
    if count == 0:
        return float("inf")
    means = power[: count * ORDINATES].reshape(count, ORDINATES).mean(axis=1)
    return float(np.min(means) / np.sum(np.hanning(n) ** 2))
