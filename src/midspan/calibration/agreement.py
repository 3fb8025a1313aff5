"""Whether a clock offset that was found is to be accepted: what is left of the motion, and what lies farther off.

The noise of a displacement sensor is not declared, so that at a wrong offset everything that is left would pass for
noise. But it is motion: innovations of a right model are white, whatever the noise levels (Kailath 1968,
doi:10.1109/TAC.1968.1099025), and at a wrong offset they are not.
"""

from dataclasses import dataclass

import numpy as np

from midspan.calibration.clock import Compared, drift
from midspan.calibration.fit import Fit, Pair, best_corner, refine
from midspan.notices import Notice
from midspan.records import Floats
from midspan.signals.medians import SIGMA_OF_MEDIAN

# The less likely of two offsets must be so by this much, and its residual power larger by this share (a model never
# fits to the last digit, and with a very quiet camera the likelihood alone would be over-confident).
AMBIGUOUS_BELOW = 8.0
AMBIGUOUS_SHARE = 0.05
AMBIGUOUS_DRAWS = 3.0
# Innovations are compared with this many that follow; their squared correlations times their number sum up to this
# many when they are white (Box and Pierce 1970). Five times in a hundred thousand white ones reach the limit.
FOLLOWING = 10
MAX_FOLLOWING = 35.0
# In a long record noise that is a little coloured exceeds any limit: the correlations themselves must be large too.
MAX_CORRELATED = 0.15
# The share of the innovations' power without the acceleration that an accelerometer's slow errors may leave with it: a
# tenth of the motion, by its gain, attitude and place.
MAX_SLOW_ERROR = 0.01
# Innovations beyond this many robust standard deviations count as that many.
CLIPPED = 4.0
# Bands of the innovations' spectrum are this many corner frequencies wide, as wide as the frequencies that the filter's
# errors come from, and hold this many ordinates at least. Of a thousand records with white innovations one has a band
# that counts as coloured.
BAND_CORNERS, MIN_ORDINATES, COLOURED_BY_CHANCE = 0.5, 8, 1e-3
# In a record longer than this a clock may drift, which windows of this length show.
LONG_S, WINDOW_S = 100.0, 40.0
# No clock drifts by more than this (s/s, a hundred times a cheap quartz): the search has run away.
MAX_SKEW = 0.01


def clearly_better(fit: Fit, other: Fit) -> bool:
    """Whether a fit is so much more likely than another that no noise can have decided between them."""
    # Residual powers at two offsets compare with the innovations' variances.
    apart = np.mean(np.log(other.whitened.variance)) - np.mean(np.log(fit.whitened.variance))
    share = other.noise / fit.noise * np.exp(apart) - 1.0
    lead = fit.likelihood - other.likelihood
    return bool(lead >= _least_by_chance(len(fit.whitened.variance)) and share >= AMBIGUOUS_SHARE)


def least_lead(count: int) -> float:
    """By how much (logarithm) the likelier of two fits to this many measurements must lead for no noise to decide."""
    return max(_least_by_chance(count), 0.5 * count * float(np.log1p(AMBIGUOUS_SHARE)))


def _least_by_chance(count: int) -> float:
    # Alternatives of a single tone differ by what the noise looks like at shifted instants, which grows with sqrt(n).
    return max(AMBIGUOUS_BELOW, AMBIGUOUS_DRAWS * float(np.sqrt(count)))


@dataclass(frozen=True, slots=True)
class Misfit:
    """How far the innovations' spectrum exceeds a white one: factor on the variance, 1 where it may be white; where."""

    factor: float = 1.0
    frequency_hz: float = 0.0

    def text(self, sensor: str) -> list[Notice]:
        """A sentence where the model does not hold."""
        if self.factor <= 1.0:
            return []
        text = (
            f"{sensor}: its difference from the accelerometer is not white noise: near {self.frequency_hz:.2g} Hz it "
            f"is {self.factor:.2g} times the mean, and the error band is wider by the square root of that. Likely "
            "causes: cross motion on an inclined axis, an undeclared exposure or low-pass, tilt of the structure, a "
            "soft mounting, slow errors of the sensor, a machine above the accelerometer's Nyquist frequency, play in "
            "a joint, a clock step. Check these."
        )
        return [Notice("misfit", text)]


def misfit(pair: Pair, fit: Fit) -> Misfit:
    """How far the innovations are from white, where that is no chance.

    Innovations of a right model are white (Kailath 1968). Where a band of their spectrum exceeds the mean, the error of
    the estimate is larger there by as much. Bands overlap by half. A clock that drifts evenly is no misfit.
    """
    found = _coloured_band(pair, fit)
    straight = straightened(pair, fit) if found.factor > 1.0 else None
    return found if straight is None else _coloured_band(pair, straight[0])


def _coloured_band(pair: Pair, fit: Fit) -> Misfit:
    from scipy.special import gammainccinv

    residual = fit.residual
    n = len(residual)
    power = np.abs(np.fft.rfft(residual - np.mean(residual)))[1:] ** 2 / max(n, 1)
    if len(power) < 2 * MIN_ORDINATES or not np.any(power):
        return Misfit()
    wide = BAND_CORNERS * fit.corner / (2.0 * np.pi) * n / pair.rate_hz
    width = int(np.clip(round(wide), MIN_ORDINATES, len(power) // 2))
    starts = np.arange(0, len(power) - width + 1, max(width // 2, 1))
    means = (np.cumsum(np.r_[0.0, power])[starts + width] - np.cumsum(np.r_[0.0, power])[starts]) / width
    k = int(np.argmax(means))
    factor = float(means[k] / np.mean(power))
    # The mean of this many squares is chi-squared over its degrees of freedom, 2 width.
    if factor < gammainccinv(width, COLOURED_BY_CHANCE / len(starts)) / width:
        return Misfit()
    return Misfit(factor, float((starts[k] + 0.5 * width) * pair.rate_hz / n))


def offset_variance_factor(fit: Fit) -> float:
    """By how much coloured innovations make the clock offset's variance larger than white ones do; 1 or more.

    The offset is the sum of the innovations times the whitened velocity: its variance is their spectra's product.
    """
    w = fit.whitened
    residual, speed = fit.residual, w.columns[:, 2] / np.sqrt(w.variance)
    power, weight = (np.abs(np.fft.rfft(one - np.mean(one)))[1:] ** 2 for one in (residual, speed))
    if len(power) < MIN_ORDINATES:
        return 1.0
    smooth = np.convolve(np.pad(power, MIN_ORDINATES // 2, "reflect"), np.ones(MIN_ORDINATES) / MIN_ORDINATES, "same")
    smooth = smooth[MIN_ORDINATES // 2 : MIN_ORDINATES // 2 + len(power)]
    return max(1.0, float(weight @ smooth / max(float(np.sum(weight) * np.mean(power)), 1e-300)))


def unexplained(pair: Pair, fit: Fit) -> bool:
    """Whether what the fit leaves is motion, not noise, even where the sensor's clock may run apart evenly.

    Where the acceleration explains nearly all, it is how that errs: slowly.
    """
    if not _coloured(fit) or np.exp(-2.0 * fit.gain / len(fit.whitened.variance)) < MAX_SLOW_ERROR:
        return False
    straight = straightened(pair, fit)
    return straight is None or _coloured(straight[0])


def _coloured(fit: Fit) -> bool:
    """Whether squared autocorrelations of the innovations sum up to more than white ones do."""
    residual = fit.residual
    residual = residual - np.median(residual)
    limit = CLIPPED * SIGMA_OF_MEDIAN * float(np.median(np.abs(residual)))
    left = np.clip(residual, -limit, limit)
    power = float(np.sum(left**2))
    if len(left) <= 2 * FOLLOWING or power == 0.0:
        return False
    total = sum(float(np.sum(left[k:] * left[:-k]) / power) ** 2 for k in range(1, FOLLOWING + 1))
    return len(left) * total > MAX_FOLLOWING and total > MAX_CORRELATED


def noise_share(pair: Pair, fit: Fit, noise: float) -> float:
    """The share of the response's power that white accelerometer noise (m/s² per sample) alone would make."""
    w, assumed = fit.whitened, fit.corner**4 / pair.rate_hz
    power = max(w.product(w.response, w.response), 1e-300)
    return noise**2 / pair.sample_rate_hz / assumed * w.input_share / power


def straightened(pair: Pair, fit: Fit) -> tuple[Fit, float] | None:
    """The fit with a clock that drifts evenly, and its rate (s/s); None where that is not clearly better."""
    rows = pair.rows[pair.used(fit.offset_s)]
    if rows[-1, 0] - rows[0, 0] < LONG_S:
        return None
    rate = drift(compared_by(pair, fit, rows), WINDOW_S).skew
    if not abs(rate) < MAX_SKEW:
        return None
    pair = at_rate(pair, fit.offset_s, rate)
    other = refine(pair, best_corner(pair, fit.offset_s), 0.02)
    return (other, rate) if clearly_better(other, fit) else None


def compared_by(pair: Pair, fit: Fit, rows: Floats) -> Compared:
    """Rows (m, 3) of a pair in metres on the accelerometer's clock, and its samples, with the noise levels of a fit."""
    metres = rows / np.array([1.0, fit.ratio, fit.ratio**2 / fit.noise])
    samples = pair.samples * np.array([1.0, 1.0, fit.input_density])
    return Compared(samples, metres + np.array([fit.offset_s, 0.0, 0.0]))


def at_rate(pair: Pair, offset_s: float, rate: float) -> Pair:
    """The pair with stamps that run faster by `rate` (s/s) about the middle of the rows compared at an offset (s)."""
    moved = pair.rows.copy()
    moved[:, 0] += rate * (moved[:, 0] - pair.rows[pair.used(offset_s), 0].mean())
    return pair.changed(rows=moved)
