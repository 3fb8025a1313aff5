"""How much white noise a sensor's readings can have: no more than the lowest part of their spectrum."""

import numpy as np

from midspan.records import Floats

# Bands of the spectrum hold this many ordinates at least: the mean of one is right to a quarter. Of an accelerometer's
# they are this many at most.
ORDINATES, MAX_BANDS = 16, 32
# An accelerometer's noise is read up to this share of its rate: above it most loggers' anti-aliasing filters take it.
UNFILTERED_SHARE = 0.4
# Chance that the noise of white readings is said to be more than `most_noise`.
CHANCE = 1e-3


def noise_floor(value: Floats) -> float:
    """Variance of the white noise in evenly spaced readings (n,) at most; infinite where they are too few.

    White noise has the same power at all frequencies, to which motion only adds: no band has less than the noise.
    """
    means = _bands(value)
    return float(np.min(means)) if len(means) else float("inf")


def most_noise(value: Floats) -> float:
    """Variance of the white noise that evenly spaced readings (n,) of an accelerometer can have: CHANCE is exceeded.

    The lowest of many bands lies below the noise by chance: the mean of a band's ordinates has a gamma distribution, of
    which the lowest quantile of so many is the most that it lies below. Infinite where they are too few.
    """
    from scipy.special import gammaincinv

    ordinates = max(ORDINATES, len(value) // (4 * MAX_BANDS))
    means = _bands(value, ordinates)
    means = means[: int(np.ceil(2.0 * UNFILTERED_SHARE * len(means)))]
    if not len(means):
        return float("inf")
    return float(np.min(means) * ordinates / gammaincinv(ordinates, CHANCE / len(means)))


def _bands(value: Floats, ordinates: int = ORDINATES) -> Floats:
    """Mean power of each band of the spectrum of readings (n,), as the variance of a white noise of as much."""
    # A Hann window keeps slow motion from leaking; every other of its ordinates is nearly independent.
    n = len(value)
    power = np.abs(np.fft.rfft(np.hanning(n) * (value - np.mean(value))))[2:-1:2] ** 2
    count = len(power) // ordinates
    means = power[: count * ordinates].reshape(count, ordinates).mean(axis=1)
    return np.asarray(means / np.sum(np.hanning(n) ** 2))
