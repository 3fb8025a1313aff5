"""The slow error of a camera or radar: a mast that nods, a lens that breathes, air that shimmers over warm ground.

A displacement sensor's white noise is unknown, so that `slow_error` asks how much likelier a slow error makes it. What
looks from outside shows one otherwise: it differs from the accelerometer by more than the noise that both show alone.
With the accelerometer's noise held at its own three explanations compete by their likelihood: none, a first-order
Gauss-Markov process, and a damped oscillator, which is smooth (`core/src/estimator/slow.rs`). Whose it is, the
correlation tells: p − s D goes with the translation p where that errs, with the integrated acceleration D where this
does.
"""

from dataclasses import dataclass, replace

import numpy as np

from midspan.calibration.fit import MIN_MEASUREMENTS, Aligned, Fit, Pair, aligned, corner_range
from midspan.calibration.own_noise import most_density
from midspan.calibration.whitening import NO_SLOW_ERROR
from midspan.notices import rounded
from midspan.records import Floats

# What each unknown of a slow error must gain (logarithm of the likelihood) where something hints at one: by chance one
# in two hundred does (half the chi-square of one degree of freedom).
MIN_GAIN = 4.0
# Starts: standard deviations in units of the white noise, times as shares of the record, peaks of the innovations'
# spectrum that are tried and an ordinate's neighbours that are the same peak, and how many periods such a one lasts.
SIZES, SHARES, PEAKS, NEAR, PERIODS = (3.0, 30.0), (0.01, 0.1), 3, 3, 5.0
# Deviations in units of the white noise that are searched; times and periods up to this many seconds: what is slower is
# an accelerometer's drift at least as often. An oscillation loses all but a third in one radian at most, and is a tone
# where it lasts for this many times that.
SIZE_RANGE, LONGEST_S, MAX_TIMES = (0.1, 1e4), 10.0, 1000.0
# A tone has less than this share of the critical damping; masts and brackets have 0.5 % at least.
MIN_DAMPING = 0.002
# A tracker's own variance is no less than this of a frame's noise (the noise levels of simulated cameras are 0.4 to 1).
OWN_SHARE = 0.25
# By how much (logarithm) a density or noise beyond its bound is less likely, by the square of the ratio's logarithm.
BEYOND = 100.0
# Of the starts the likeliest this many are followed: a slow error shows at more than one.
CLIMBED = 2
# The logarithms of size, time, frequency and corner are found to this, in no more evaluations than these.
TOLERANCE, MAX_EVALUATIONS = 0.02, 400
# An error is one sensor's alone where by this many deviations more than half of it goes with that one.
CERTAIN = 2.5
# An oscillator that decays in less than this many periods is no sway to speak of.
PERIODS_SEEN = 0.5
# An optimum within this factor of the lowest frequency is at the edge of the search.
SLOWEST = 1.05
# Errors that do not sway are looked at at instants so far apart, s: what exposures and shimmering air smooth them by is
# less, and what errs faster the accelerometer shows. Close by, how smooth an error is counts more than how large it is.
SPARSE_STEP_S = 0.3
# A process of LONGEST_S shows two thirds of its standard deviation in twice that time, on average, and seldom a half.
MAX_SHOWN = 2.0
# Half the widths of its resonance, or ordinates, within which a sway is looked at: all but a fifth of it.
WIDTHS = 3.0
# Powers at a frequency are means over this many ordinates.
SMOOTHED = 9


@dataclass(frozen=True, slots=True)
class OwnError:
    """A pair with the slow error of its measurements, and its fit.

    fitted_std: its standard deviation as fitted, in the unit of the translation; no limit holds it for a drift.
    alone: whether it goes with the measurements alone; else the accelerometer may have it, and the band must hold it.
    taken: whether it is the pair's and the estimator's; else the accelerometer is the likelier cause, and the rows
    follow the measurements.
    """

    pair: Pair
    fit: Fit
    fitted_std: float
    alone: bool
    taken: bool = True

    @property
    def sways(self) -> bool:
        """Whether it oscillates to speak of, and no more slowly than the search goes."""
        return self.hertz * self.time_s > PERIODS_SEEN and self.hertz * LONGEST_S > SLOWEST

    @property
    def is_tone(self) -> bool:
        """Whether it has less damping than any structure."""
        return self.hertz * self.time_s > 1.0 / (2.0 * np.pi * MIN_DAMPING)

    @property
    def std(self) -> float:
        """Standard deviation of the error, in the translation's unit: where it would show, no more than shows."""
        return self.translation_std if self.beyond_readings else self.fitted_std

    @property
    def beyond_readings(self) -> bool:
        """Whether it would be far more than was read: it is the drift of an accelerometer, integrated twice."""
        return self.fitted_std > MAX_SHOWN * self.translation_std

    @property
    def translation_std(self) -> float:
        """Standard deviation of the translation as it was measured."""
        return float(np.std(self.pair.rows[np.isfinite(self.pair.rows[:, 2]), 1]))

    @property
    def time_s(self) -> float:
        """The time in which it decays, s."""
        return 1.0 / self.pair.slow[1]

    @property
    def hertz(self) -> float:
        """Natural frequency of an oscillator, Hz; 0: it is none."""
        return self.pair.slow[2] / (2.0 * np.pi)

    def text(self, sensor: str, std_m: float, remedy: str = "") -> str:
        """A sentence on it; std_m: its standard deviation, m; remedy: what would show whose error it is."""
        if self.beyond_readings:
            return (
                f"accelerometer: it drifts from the {sensor} by more than all motion that the {sensor} shows, as with "
                f"a bias drift during warm-up. The error band includes all of that motion, {rounded(1e3 * std_m)} mm "
                "rms. Let the accelerometer warm up before recording."
            )
        size = f"{rounded(1e3 * std_m)} mm rms besides its noise"
        course = f"has a slow error of {size} over {rounded(self.time_s)} s, as from hot air or autofocus"
        if self.sways:
            course = f"vibrates by {size} at {rounded(self.hertz)} Hz, as on a mast or bracket"
        if self.alone and self.taken:
            return f"{sensor}: it {course}. The accelerometer does not show it and separates it from the displacement."
        return (
            f"{sensor}: it {course}, or the accelerometer has an error of this size. The data cannot show which; the "
            f"error band includes all of it. {remedy}".rstrip()
        )


def find_own_error(pair: Pair, fit: Fit, own_variance: float) -> tuple[OwnError | None, bool]:
    """The slow error of a camera or radar, None where it has none for certain; whether the accelerometer errs instead.

    pair, fit: as calibrated without one; own_variance: what the measurements are said to vary by, of which OWN_SHARE
    is noise for certain.
    """
    if pair.lines:
        # An accelerometer with lines is known to err itself.
        return None, False
    here, bounds = aligned(pair, fit.offset_s), (most_density(pair), OWN_SHARE * own_variance)
    climb = _Climb(here, *bounds)
    none = climb.best([np.log([fit.corner])])
    share, std = _share(none)
    if share + CERTAIN * std < 0.5:
        return None, True
    own = _sway(climb, none) or _drift(here, fit, bounds)
    if own is None:
        return None, False
    alone = share - CERTAIN * std > 0.5
    # A drift or a tone is an accelerometer's as soon as a camera's: of a tone one phase is all there is to tell by.
    alone = alone and not own.is_tone
    taken = (alone or (own.sways and not own.is_tone)) and own.fit.likelihood > fit.likelihood
    taken = taken and not own.beyond_readings
    return replace(own, alone=alone, taken=taken), False


def averaged(pair: Pair, count: int) -> Pair:
    """The pair with the weighted mean of each `count` rows for one of them: of each n-th row alone a motion near a
    multiple of the rate that is left would be aliased.

    The variance of a mean is relative to that of a row; its exposure is that of a row and of the block together.
    """
    if count < 2:
        return pair
    blocks = pair.rows[: len(pair.rows) // count * count].reshape(-1, count, 3)
    weight = 1.0 / blocks[:, :, 2]
    total = np.sum(weight, axis=1)
    share = np.where(total[:, None] > 0.0, weight, 1.0)
    share /= np.sum(share, axis=1, keepdims=True)
    means = np.einsum("bk,bkc->bc", share, np.nan_to_num(blocks[:, :, :2]))
    with np.errstate(divide="ignore"):
        rows = np.column_stack((means, 1.0 / total))
    # The second moment of `count` instants that are evenly spaced is that of an exposure.
    block_s = np.sqrt(count**2 - 1.0) / pair.rate_hz
    return pair.changed(rows=rows, exposure_s=float(np.hypot(pair.exposure_s, block_s)))


def _sway(climb: "_Climb", none: Fit) -> OwnError | None:
    """The oscillator that makes the measurements clearly likelier; None where none does, or that hardly oscillates."""
    rate_hz = climb.pair.rate_hz
    starts = [[size, hertz / PERIODS, 2.0 * np.pi * hertz] for size in SIZES for hertz in _peaks(none, rate_hz)]
    found = climb.best([np.log([none.corner, *one]) for one in starts])
    slow = climb.slow[found.corner, found.likelihood]
    own = OwnError(climb.pair.changed(slow=slow), found, float(np.sqrt(slow[0] * found.noise)), alone=False)
    gain = found.likelihood - none.likelihood - 3.0 * MIN_GAIN
    return own if gain > 0.0 and own.sways else None


def _drift(here: Aligned, fit: Fit, bounds: tuple[float, float]) -> OwnError | None:
    """The Gauss-Markov process that makes measurements SPARSE_STEP_S apart clearly likelier."""
    pair = here.pair
    sparse = pair.changed(rows=pair.rows[:: max(round(SPARSE_STEP_S * pair.rate_hz), 1)])
    if len(sparse.rows) < MIN_MEASUREMENTS:
        return None
    climb = _Climb(Aligned(sparse, aligned(sparse, fit.offset_s).columns), *bounds)
    none = climb.best([np.log([fit.corner])])
    starts = [[size, 1.0 / (share * climb.span_s)] for size in SIZES for share in SHARES]
    found = climb.best([np.log([none.corner, *one]) for one in starts])
    if found.likelihood - none.likelihood < 2.0 * MIN_GAIN:
        return None
    size2, rate, omega = climb.slow[found.corner, found.likelihood]
    # Of all measurements both noises are as found, and so is the error; what is left of them is their own noise.
    variance, corner = size2 * found.noise, found.corner * (pair.rate_hz / sparse.rate_hz) ** 0.25
    whole = pair.changed(slow=(size2, rate, omega))
    return OwnError(whole, here.of(whole).fit(corner), float(np.sqrt(variance)), alone=False)


class _Climb:
    """The likeliest fit of a pair with noise levels within bounds, by the simplex method of Nelder and Mead.

    Where it begins: logarithms of the corner frequency (rad/s), the slow error's deviation in units of the noise, the
    rate at which it forgets (1/s) and its angular frequency (rad/s); without the last ones there is none.
    """

    def __init__(self, here: Aligned, most: float, least: float) -> None:
        """most: of the acceleration's noise density, (m/s²)²/Hz; least: of the measurements' noise variance."""
        self._here, self._most, self._least, self.pair = here, most, least, here.pair
        rate_hz = here.pair.rate_hz
        self.span_s = len(here.pair.rows) / rate_hz
        self.slow: dict[tuple[float, float], tuple[float, float, float]] = {}
        self._bounds = np.log(
            [
                corner_range(here.pair),
                SIZE_RANGE,
                (1.0 / LONGEST_S, 0.5 * rate_hz),
                (2.0 * np.pi / LONGEST_S, np.pi * rate_hz),
            ]
        )

    def best(self, starts: list[Floats]) -> Fit:
        """The likeliest fit of those that the CLIMBED likeliest starts lead to."""
        starts = [np.clip(start, *self._bounds_of(start).T) for start in starts]
        chosen = sorted(starts, key=self._cost)[:CLIMBED]
        return max((self._climbed(start) for start in chosen), key=lambda fit: fit.likelihood)

    def _bounds_of(self, start: Floats) -> Floats:
        bounds = self._bounds[: len(start)].copy()
        if len(start) == len(self._bounds):
            bounds[2, 0] -= np.log(MAX_TIMES)
        return bounds

    def _climbed(self, start: Floats) -> Fit:
        from scipy.optimize import minimize

        bounds = self._bounds_of(start)
        # The frequency is known better than half an octave.
        simplex = np.vstack((start, start + np.diag([0.5, 0.5, 0.5, 0.1])[: len(start), : len(start)]))
        options = {"xatol": TOLERANCE, "fatol": 0.1, "maxfev": MAX_EVALUATIONS, "initial_simplex": simplex}
        found = minimize(self._cost, start, method="Nelder-Mead", options=options, bounds=bounds)
        fit = self._fit(found.x)
        self.slow[fit.corner, fit.likelihood] = _slow(found.x)
        return fit

    def _cost(self, at: Floats) -> float:
        fit = self._fit(at)
        beyond = [fit.input_density / self._most, self._least / fit.noise]
        beyond += [1.0 / (LONGEST_S * _slowest(*np.exp(at[2:])))] if len(at) > 2 else []
        cost = -fit.likelihood + BEYOND * sum(max(float(np.log(one)), 0.0) ** 2 for one in beyond)
        return cost if np.isfinite(cost) else 1e300

    def _fit(self, at: Floats) -> Fit:
        with np.errstate(all="ignore"):
            return self._here.of(self._here.pair.changed(slow=_slow(at))).fit(float(np.exp(at[0])))


def _slow(at: Floats) -> tuple[float, float, float]:
    """The slow error as of `Pair` at logarithms as of `_Climb`."""
    if len(at) < len(NO_SLOW_ERROR):
        return NO_SLOW_ERROR
    size, rate, *omega = np.exp(at[1:]).tolist()
    return size**2, rate, omega[0] if omega else 0.0


def _slowest(rate: float, omega: float = 0.0) -> float:
    """The slower pole of a damped oscillator, or the rate at which it decays, 1/s."""
    if not 0.0 < omega < rate:
        return rate if omega == 0.0 else omega
    return omega * omega / (rate + float(np.sqrt(rate * rate - omega * omega)))


def _peaks(fit: Fit, rate_hz: float) -> list[float]:
    """Frequencies, Hz, of the strongest peaks of the innovations' spectrum."""
    residual, found = fit.residual, list[int]()
    power = np.abs(np.fft.rfft(np.hanning(len(residual)) * (residual - np.mean(residual))))[1:] ** 2
    for k in np.argsort(-power):
        if len(found) < PEAKS and all(abs(k - other) > NEAR for other in found):
            found.append(int(k))
    return [(k + 1) * rate_hz / len(residual) for k in found]


def whose(own: OwnError, none: Fit) -> OwnError | None:
    """A sway by what a fit without it leaves near its frequency: elsewhere a noisy sensor errs alone, which tells
    nothing of the sway. None where it is neither sensor's own but goes with the motion.
    """
    per_hz = len(none.residual) / own.pair.rate_hz
    place, width = own.hertz * per_hz, WIDTHS * max(per_hz / (2.0 * np.pi * own.time_s), 1.0)
    share, std = _share(none, (place - width, place + width))
    if abs(share - 1.0) > CERTAIN * std and abs(share) > CERTAIN * std:
        return None
    return replace(own, alone=own.alone and share - CERTAIN * std > 0.5)


def _share(fit: Fit, within: tuple[float, float] = (0.0, np.inf)) -> tuple[float, float]:
    """How much of the innovations goes with the translation, the rest being the integrated acceleration's, and the
    standard deviation of that; within: of ordinates with these numbers.

    The motion is in both, at random phases: what it adds to the product of error and translation has a variance of half
    the product of their powers, by which frequencies are weighed. Its power is that of whichever has less.
    """
    w, root = fit.whitened, np.sqrt(fit.whitened.variance)
    seen, felt = (np.fft.rfft(one / root)[1:] for one in (w.translation, fit.ratio * w.response))
    motion = np.convolve(np.minimum(np.abs(seen) ** 2, np.abs(felt) ** 2), np.ones(SMOOTHED) / SMOOTHED, "same")
    motion, left = np.maximum(motion, 1e-300), seen - felt
    number = np.arange(1, len(left) + 1)
    left = np.where((number >= within[0]) & (number <= within[1]), left, 0.0)
    known = float(np.sum(np.abs(left) ** 2 / motion))
    return float(np.sum(np.real(left * np.conj(seen)) / motion)) / known, float(np.sqrt(0.5 / known))
