"""Whether what two sensors differ by is more than the accelerometer's own noise: then one of them errs on its own.

Where the camera errs (a mast that nods, a lens that breathes, air that shimmers) the likelihood has no other place for
it than the accelerometer's noise, or the camera's. The accelerometer's own readings say how much noise they can have.
"""

from collections.abc import Callable
from functools import partial

import numpy as np

from midspan.calibration.agreement import MIN_ORDINATES, straightened
from midspan.calibration.fit import Fit, Pair, aligned, corner_std
from midspan.calibration.slow_error import likeliest_slow_error
from midspan.notices import Notice
from midspan.records import Floats
from midspan.signals.lines import away_from_lines

# Bands of the spectrum hold this many ordinates at least: the mean of one is right to a quarter. Of an accelerometer's
# they are this many at most.
ORDINATES, MAX_BANDS = 16, 32
# An accelerometer's noise is read up to this share of its rate: above it most loggers' anti-aliasing filters take it.
UNFILTERED_SHARE = 0.4
# Chance that the noise of white readings is said to be more than `_most_noise`.
CHANCE = 1e-3
# Noise as estimated is more than the accelerometer's own where it is so by this many deviations: one in a thousand.
CERTAIN = 3.1
# A narrow band of the innovations is no chance where its power beyond the usual has this probability in a white record.
NARROW_BY_CHANCE = 1e-4
# Below this frequency, Hz, an accelerometer hardly feels what a target or a camera moves by: each ordinate counts by
# itself there, and a white record has one that is strong enough with this probability.
SLOW_HZ, SLOW_BY_CHANCE = 0.3, 1e-3
# Gain in the logarithm of the likelihood from which a slow error counts as found: a factor of 20 000 in likelihood.
MIN_GAIN = 10.0
# Ordinates of such bands that are fitted as what one sensor alone shows: those of this many times the usual power, and
# this many at most, and no less than this share of the strongest, which leaks as much into its neighbours.
STRONG, MAX_ORDINATES, LEAKED = 3.0, 24, 0.02


def noise_floor(value: Floats) -> float:
    """Variance of the white noise in evenly spaced readings (n,) at most; infinite where they are too few.

    White noise has the same power at all frequencies, to which motion only adds: no band has less than the noise.
    """
    means = _bands(value)
    return float(np.min(means)) if len(means) else float("inf")


def most_density(pair: Pair) -> float:
    """The largest density of white noise that the acceleration's readings can have, (m/s²)²/Hz: CHANCE is exceeded.

    The lowest of many bands lies below the noise by chance: the mean of a band's ordinates has a gamma distribution, of
    which the lowest quantile of this many is the most that it lies below. Infinite where they are too few.
    """
    from scipy.special import gammaincinv

    value = pair.samples[:, 1]
    ordinates = max(ORDINATES, len(value) // (4 * MAX_BANDS))
    means = _bands(value, ordinates)
    means = means[: int(np.ceil(2.0 * UNFILTERED_SHARE * len(means)))]
    if not len(means):
        return float("inf")
    return float(np.min(means) * ordinates / gammaincinv(ordinates, CHANCE / len(means))) / pair.sample_rate_hz


def _bands(value: Floats, ordinates: int = ORDINATES) -> Floats:
    """Mean power of each band of the spectrum of readings (n,), as the variance of a white noise of as much."""
    # A Hann window keeps slow motion from leaking; every other of its ordinates is nearly independent.
    n = len(value)
    power = np.abs(np.fft.rfft(np.hanning(n) * (value - np.mean(value))))[2:-1:2] ** 2
    count = len(power) // ordinates
    means = power[: count * ordinates].reshape(count, ordinates).mean(axis=1)
    return np.asarray(means / np.sum(np.hanning(n) ** 2))


def exceeds_own_noise(pair: Pair, fit: Fit) -> bool:
    """Whether the accelerometer's noise as estimated is certainly more than its readings have."""
    estimated, most = pair.input_noise(fit.input_density).density, most_density(pair)
    if not 0.0 < most < estimated:
        return False
    # The density is as the fourth power of the corner frequency.
    return bool(np.log(estimated / most) > 4.0 * CERTAIN * corner_std(pair, fit))


def contradiction(pair: Pair, fit: Fit) -> float:
    """What the translation differs by from the accelerometer beyond the noise of both (rms); 0 where that is chance.

    One of both sensors is wrong then, and nothing tells which: what shakes between them shows in a camera as slower
    than it is.
    """
    narrow = narrow_motion(pair, fit)
    if pair.lines or not exceeds_own_noise(pair, fit):
        # What is left of lines of the acceleration is noise of it.
        return narrow
    # An error over seconds (haze), where it is far likelier than the noise that the accelerometer would need instead.
    likelihood, std = likeliest_slow_error(pair.changed(ratio=fit.ratio), fit)
    moved = float(np.std(pair.rows[np.isfinite(pair.rows[:, 2]), 1]))
    return max(narrow, min(std, moved)) if likelihood - fit.likelihood > MIN_GAIN else narrow


def narrow_motion(pair: Pair, fit: Fit) -> float:
    """What narrow bands of the translation hold that the accelerometer does not feel, rms; 0 where that is chance.

    A mast that sways is a line in the innovations, long before it counts as noise. Its size is fitted.
    """
    lines = _lines(pair, fit)
    if not len(lines):
        return 0.0
    straight = straightened(pair, fit)
    if straight is not None and not len(lines := _lines(pair, straight[0])):
        # A clock that drifts evenly.
        return 0.0
    columns = [partial(_wave, shape=shape, hertz=hertz) for hertz in lines for shape in (np.cos, np.sin)]
    here = aligned(pair, fit.offset_s, *columns)
    w, moved = here.whitened(fit.corner), here.columns.values[:, -len(columns) :]
    waves = w.columns[:, -len(columns) :] / np.sqrt(w.variance)[:, None]
    left = (w.translation - fit.ratio * w.response) / np.sqrt(w.variance)
    inverse = np.linalg.pinv(waves.T @ waves, hermitian=True)
    size = inverse @ (waves.T @ left)
    noise = float(np.sum((left - waves @ size) ** 2)) / max(len(left) - len(size), 1)
    by_chance = noise * float(np.mean(np.einsum("mi,ij,mj->m", moved, inverse, moved)))
    # What is far more than the translation moves there is the drift of an accelerometer, integrated twice.
    shown = moved @ np.linalg.lstsq(moved, here.columns.values[:, 0], rcond=None)[0]
    return float(np.sqrt(max(min(np.mean((moved @ size) ** 2), np.mean(shown**2)) - by_chance, 0.0)))


def _lines(pair: Pair, fit: Fit) -> Floats:
    """Frequencies (k,), Hz, of narrow bands of the innovations with more power than chance gives."""
    from scipy.special import gammainccinv

    residual = fit.residual
    n = len(residual)
    power = np.abs(np.fft.rfft(residual - np.mean(residual)))[1:] ** 2
    if len(power) < 4 * MIN_ORDINATES or not np.any(power):
        return np.empty(0)
    # Of the powers, which are exponentially distributed, the median is no line's.
    power /= float(np.median(power)) / np.log(2.0)
    count = min(int(SLOW_HZ / (pair.rate_hz / n)), len(power))
    power /= _bias_walk(power[:count], len(power))
    starts = np.arange(0, len(power) - MIN_ORDINATES + 1, MIN_ORDINATES // 2)
    means = np.array([np.mean(power[k : k + MIN_ORDINATES]) for k in starts])
    most = gammainccinv(MIN_ORDINATES, NARROW_BY_CHANCE / len(starts)) / MIN_ORDINATES
    index = np.unique(starts[means > most][:, None] + np.arange(MIN_ORDINATES))
    # Those that hold next to nothing, or what leaks from a line, would be fitted for their noise.
    enough = max(STRONG, LEAKED * float(np.max(power)))
    # Of slow motion each ordinate counts that is stronger than chance makes any.
    slow = np.flatnonzero(power[:count] > np.log(max(count, 1) / SLOW_BY_CHANCE))
    strong = sorted({*index[power[index] > enough], *slow}, key=lambda k: -power[k])[:MAX_ORDINATES]
    hertz = np.asarray((np.array(strong) + 1) * pair.rate_hz / n)
    return hertz[away_from_lines(hertz, pair.lines)]


def _bias_walk(slow: Floats, count: int) -> Floats:
    """How much stronger than white noise an accelerometer may make the powers of the innovations (count,).

    slow: the lowest of them, in units of the white noise. A bias walks (1/f noise, warm-up): its power is as 1/f², or
    less steep. Nothing that a camera errs by rises so towards low frequencies: a first-order process is as f² there,
    and a mast is a peak, of which a median takes no notice.
    """
    squares = np.arange(1.0, count + 1.0) ** 2
    walk = float(np.median((slow / np.log(2.0) - 1.0) * squares[: len(slow)])) if len(slow) else 0.0
    return np.asarray(1.0 + max(walk, 0.0) / squares)


def _wave(time_s: Floats, shape: Callable[[Floats], Floats], hertz: float) -> Floats:
    return np.asarray(shape(2.0 * np.pi * hertz * time_s))


def strange_noise(pair: Pair, fit: Fit, sensor: str, causes: str) -> list[Notice]:
    """A sentence where what differs is far more than the accelerometer's own noise; causes: what in the sensor errs."""
    if not exceeds_own_noise(pair, fit):
        return []
    implied, own = (
        float(np.sqrt(density * pair.sample_rate_hz))
        for density in (pair.input_noise(fit.input_density).density, most_density(pair))
    )
    text = (
        f"accelerometer: its difference from the {sensor} corresponds to accelerometer noise of {1e3 * implied:.2g} "
        f"mm/s² per sample, but the fast part of its readings has at most {1e3 * own:.2g} mm/s²; the band uses the "
        "larger value. The data cannot show which sensor errs. Possible accelerometer causes: bias drift (1/f noise), "
        "cross motion on an inclined axis, a vibrating mounting, clipped peaks, or a logger's low-pass, which hides "
        f"fast noise. Possible {sensor} causes: {causes}. Check these."
    )
    return [Notice("accelerometer-noisy", text)]
