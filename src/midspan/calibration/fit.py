"""The likelihood of a translation given the acceleration, as a function of time offset and noise ratio.

Scale factor and noise variance are solved in closed form inside (see `whitening`). Regressing the translation on the
response to the acceleration, not the other way round, keeps pixel noise from shrinking the scale factor.

A short window hardly shows the accelerometer's noise: the likelihood is flat towards none at all. So its standard
deviation has an even prior (Gelman 2006, doi:10.1214/06-BA117A), which is as the square of the corner frequency; where
the motion is long enough to tell the noise, this changes nothing.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cache, cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from midspan.calibration.minimum import global_minimum, minimum
from midspan.calibration.whitening import (
    NO_SLOW_ERROR,
    Response,
    Whitened,
    integrated,
    levelled,
    usable,
    whiten_columns,
)
from midspan.records import NANOSECONDS, Floats, InputNoise, Nanoseconds
from midspan.signals.health import mean_square
from midspan.signals.lines import Line

# Fewer usable measurements than these tell no scale.
MIN_FRAMES = 20
# Ratio, time offset and the ratio of the noise levels are fitted together with the noise itself.
FITTED = 3
# Ratios below this share of the reference are no explanation of the motion.
MIN_RATIO = 0.01
# The prior of the corner frequency is its own power of this order.
PRIOR_POWER = 2.0
# The density of an acceleration's noise that goes with its motion is constant for this long, s.
PIECE_S = 0.1
# Shares of the noise that may go with the motion, as the logarithm of their odds: from a hundredth on.
ODDS, ODDS_TRIED, ODDS_TOLERANCE = (-4.6, 9.2), 6, 0.3
# Corner frequencies tried before the best one's neighbours are searched, and how well its logarithm is found.
CORNERS, CORNER_TOLERANCE = 9, 0.02
# The ratio of a translation that never changes, which has none: its inverse is finite.
NEXT_TO_NO_RATIO = 1e-12
# Step of the logarithm of a corner frequency by which the likelihood's curvature is found, and the largest standard
# deviation of that logarithm: a factor of sixteen in the accelerometer's noise.
CORNER_STEP, MAX_CORNER_STD = 0.2, 0.7
# A known corner is searched within this factor (logarithm).
NEAR_CORNER = 0.6
# What was whitened at a place is kept for this many corner frequencies, of this many rows together at most.
MAX_KEPT, KEPT_ROWS = 16, 300_000
# Rounds of offset and noise ratio in turn, Gauss-Newton steps in each, and halvings of a step that overshoots, at most;
# a likelihood that gains (logarithm) less than this is at its maximum.
ROUNDS, STEPS, HALVINGS, MIN_GAIN = 6, 12, 4, 1e-4
# Fewer measurements than this are not calibrated on.
MIN_MEASUREMENTS = 20
# What a pair makes once, and of which fields.
MADE_OF = {"responses": ("samples", "outside"), "pieces": ("samples", "level", "motion_share"), "lively": ("samples",)}


@dataclass(frozen=True)
class Pair:
    """What is compared: translation (px, or m) and acceleration.

    samples (n, 3): time (s), acceleration (m/s²), relative noise density; rows (m, 3): time on the sensor's own clock
    (s), translation, relative variance (infinite: not used).
    ratio: the translation per metre of displacement where it is known (1 for a displacement sensor), else None.
    exposure_s: time over which each translation is averaged.
    outside: samples (n, 3) with the part of the acceleration that must not decide the ratio (motion outside a band); it
    gets a factor of its own. None: all of the acceleration decides.
    reference: the size of the ratio that other ratios are compared with, None at first (see `shrinking`).
    level_m_s2: the mean acceleration, which the samples are without.
    motion_share: share of the accelerometer's noise, 0 to 1, that goes with the mean square of the motion (see
    `signals.health.mean_square`), of the mean over the record.
    slow: variance of the slow error of the measurements in units of their noise variance, the rate (1/s) at which it
    forgets, and the angular frequency of an oscillator (0: first-order Gauss-Markov).
    cross: acceleration (n, k) of the accelerometer's other axes at the samples, without its means (k,), and these; None
    once the samples are along the sensor's axis (see `direction`).
    logger, lean, sight: see `frequency_response`; what leaning takes from the acceleration is in the samples again.
    seen (m,): what another target of a camera that tilts moves by (px) in the frames of the rows, NaN where unknown;
    None: nothing shows a tilt.
    bias_drifts: whether the accelerometer's bias drifts at one rate, which is taken out: it is no noise.
    level: relative level (n,) of the accelerometer's noise at the samples, of mean 1, where that changes; None: one.
    lines: narrow ones of the acceleration that are no motion.
    """

    samples: Floats
    rows: Floats
    ratio: float | None = None
    exposure_s: float = 0.0
    outside: Floats | None = None
    reference: float | None = None
    level_m_s2: float = 0.0
    motion_share: float = 0.0
    slow: tuple[float, float, float] = NO_SLOW_ERROR
    logger: tuple[float, float] = (0.0, 0.0)
    lean: float = 0.0
    sight: float = 0.0
    seen: Floats | None = None
    cross: tuple[Floats, Floats] | None = None
    bias_drifts: bool = False
    level: Floats | None = None
    lines: tuple[Line, ...] = ()

    @cached_property
    def rate_hz(self) -> float:
        """Mean rate of the translation."""
        return (len(self.rows) - 1) / float(self.rows[-1, 0] - self.rows[0, 0])

    @cached_property
    def sample_rate_hz(self) -> float:
        """Mean rate of the acceleration."""
        return (len(self.samples) - 1) / float(self.samples[-1, 0] - self.samples[0, 0])

    @cached_property
    def responses(self) -> tuple[Response, ...]:
        """The acceleration integrated twice, and what is outside a band where one is given."""
        return tuple(integrated(samples) for samples in (self.samples, self.outside) if samples is not None)

    @cached_property
    def recent(self) -> "list[Columns]":
        """What was whitened at the clock offset of the last comparison, where most of the work is done."""
        return []

    @cached_property
    def lively(self) -> Floats:
        """Mean square (n,) of the acceleration up to each sample, m²/s⁴."""
        value = self.samples[:, 1]
        return mean_square(value, 0.0, float(np.mean(value**2)), self.sample_rate_hz)

    @cached_property
    def pieces(self) -> Floats:
        """Times (g,) until which the relative density of the acceleration's noise is constant, and that density."""
        time_s, density = self.samples[:, 0], self.samples[:, 2] * (1.0 if self.level is None else self.level)
        ends = np.r_[np.diff(density) != 0.0, True]
        if self.motion_share > 0.0:
            # What bridging adds stays.
            own = self.lively / np.mean(self.lively)
            density = density + self.motion_share * (own - np.minimum(density, 1.0))
            ends[:: max(round(PIECE_S * self.sample_rate_hz), 1)] = True
        return np.column_stack((time_s, density))[ends]

    def changed(self, **fields: Any) -> "Pair":
        """The pair with other fields; what is made of those that stay is made once: of a long record most work.

        A pair whose fields are all as they were is itself.
        """
        if all(_same(getattr(self, name), value) for name, value in fields.items()):
            return self
        other = replace(self, **fields)
        kept = [name for name, of in MADE_OF.items() if fields.keys().isdisjoint(of)]
        vars(other).update({name: getattr(self, name) for name in kept})
        return other

    def input_noise(self, mean_density: float) -> InputNoise:
        """The acceleration's noise whose mean density over the record is `mean_density`, (m/s²)²/Hz."""
        share = self.motion_share
        # Levels add to what goes with the motion, see `pieces`; on average it is a constant.
        constant = 1.0 - share
        if self.level is not None:
            constant = float(np.mean(self.level - share * np.minimum(self.level, 1.0)))
        return InputNoise(constant * mean_density, share * mean_density / float(np.mean(self.lively)))

    def used(self, offset_s: float) -> NDArray[np.int64]:
        """Which rows are compared at an offset."""
        return usable(self.rows, offset_s, (float(self.responses[0].edges_s[0]), float(self.samples[-1, 0])))


def _same(before: Any, after: Any) -> bool:
    return before is after or (isinstance(before, float) and isinstance(after, float) and before == after)


@dataclass(frozen=True, slots=True)
class Fit:
    """One evaluation of the likelihood.

    ratio: translation per metre of displacement (the inverse scale factor), with its variance at this offset;
    noise: variance of the translation per unit of relative variance; input_density: mean noise density of the
    acceleration, (m/s²)²/Hz; likelihood: logarithm, without constants; without: the same with no acceleration.
    """

    offset_s: float
    corner: float
    ratio: float
    ratio_variance: float
    noise: float
    input_density: float
    likelihood: float
    without: float
    whitened: Whitened

    @property
    def residual(self) -> Floats:
        """Innovations in units of their predicted standard deviation."""
        w = self.whitened
        return (w.translation - self.ratio * w.response) / np.sqrt(self.noise * w.variance)

    @property
    def gain(self) -> float:
        """By how much the acceleration makes the translation more likely (logarithm)."""
        return self.likelihood - self.without

    @property
    def motion_hz(self) -> float:
        """Middle frequency (Hz) of the motion that is compared, by its speed over its displacement, both whitened."""
        w = self.whitened
        speed, moved = (w.product(column, column) for column in (w.columns[:, 2], w.response))
        return float(np.sqrt(speed / max(moved, 1e-300)) / (2.0 * np.pi))

    @property
    def relative_std(self) -> float:
        """Standard deviation of the ratio over its size."""
        return float(np.sqrt(self.ratio_variance)) / max(abs(self.ratio), 1e-300)


def likelihood_of(fit: Fit) -> float:
    """What the likelier of fits is known by."""
    return fit.likelihood


@dataclass(frozen=True, slots=True)
class Columns:
    """What is whitened at a clock offset.

    rows (k, 2): time and relative variance; values (k, c): translation, response to the acceleration, its velocity and,
    with a band, the response to what is outside it, without what is open of them (see `levelled`); cubic (2, c): of
    that the second derivative at the end and the third one; index (k,): which rows of the pair these are; fits: of the
    pair that keeps the columns, by their corner frequencies.
    """

    offset_s: float
    rows: Floats
    values: Floats
    cubic: Floats
    index: NDArray[np.int64]
    fits: dict[float, Fit] = field(init=False, repr=False, compare=False, default_factory=dict)


@dataclass(frozen=True, slots=True)
class Aligned:
    """A pair at a clock offset. The pair keeps the columns alone: a circle would hold a day's arrays for long."""

    pair: Pair
    columns: Columns

    def of(self, pair: Pair) -> "Aligned":
        """The same of a pair with other noise, of which nothing is fitted yet."""
        return Aligned(pair, replace(self.columns))

    def whitened(self, corner: float) -> Whitened:
        """The columns' innovations with a corner frequency (rad/s) where the two noise levels meet."""
        pair, own = self.pair, self.columns
        columns = (own.rows, own.values, pair.pieces, corner**4 / pair.rate_hz)
        return whiten_columns(*columns, slow=pair.slow, index=own.index, open_bias=own.cubic[0])

    def fit(self, corner: float) -> Fit:
        """The fit with a corner frequency (rad/s), made once."""
        fits = self.columns.fits
        if corner not in fits:
            if len(fits) >= kept(self.columns.rows):
                fits.pop(next(iter(fits)))
            fits[corner] = self._fit(corner)
        return fits[corner]

    def _fit(self, corner: float) -> Fit:
        pair, w = self.pair, self.whitened(corner)
        if pair.outside is not None:
            # Without the share of what is outside the band.
            last, outside = w.columns[:, -1], w.columns[:, -1] / w.variance
            shares = outside @ w.columns / max(float(outside @ last), 1e-300)
            w = replace(w, columns=w.columns - np.outer(last, shares))
        n = max(len(w.variance), 1)
        power, cross = w.product(w.response, w.response), w.product(w.response, w.translation)
        total = w.product(w.translation, w.translation)
        ratio = pair.ratio if pair.ratio is not None else cross / max(power, 1e-300)
        left = max(total - 2.0 * ratio * cross + ratio * ratio * power, 1e-300)
        noise = left / max(n - FITTED, 1)
        ratio_variance = noise / max(power, 1e-300)
        favour = 0.0
        if pair.ratio is None:
            input_share = w.input_share
            if pair.reference is not None:
                favour = shrinking(input_share, ratio, pair.reference)
            share = min(input_share / n, 1.0)
            ratio = unattenuated(total, cross, power, share)
            # The cross products are the ratio times the true response's power; products of both noises scatter as well.
            # Without any common motion the deviation is beyond all bounds, and still a number.
            small = max(abs(cross), 1e-100 * noise, 1e-300)
            ratio_variance = noise * abs(ratio) / small + share * (1.0 - share) * n * (noise / small) ** 2
        # The corner of the noise that does not go with the motion.
        alike = PRIOR_POWER * float(np.log(corner) + 0.25 * np.log1p(-pair.motion_share)) - w.entropy
        return Fit(
            offset_s=self.columns.offset_s,
            corner=corner,
            ratio=ratio,
            ratio_variance=ratio_variance,
            noise=noise,
            input_density=corner**4 / pair.rate_hz * noise / max(ratio * ratio, 1e-300),
            likelihood=-0.5 * n * np.log(left / n) + alike - favour,
            without=-0.5 * n * np.log(max(total, 1e-300) / n) + alike,
            whitened=w,
        )


def kept(rows: Floats) -> int:
    """How much that was whitened of rows (m, …) is kept: no more than KEPT_ROWS rows together, for memory."""
    return max(1, min(MAX_KEPT, KEPT_ROWS // max(len(rows), 1)))


def aligned(pair: Pair, offset_s: float, *more: Callable[[Floats], Floats]) -> Aligned:
    """A pair at a clock offset, s, with columns that are functions of time in addition to its own."""
    if not more and pair.recent and pair.recent[0].offset_s == offset_s:
        return Aligned(pair, pair.recent[0])
    index = pair.used(offset_s)
    rows = pair.rows[index]
    time_s = rows[:, 0] + offset_s
    inside, *outside = pair.responses
    columns = [rows[:, 1], inside.at(time_s, pair.exposure_s, pair.logger), inside.velocity(time_s, pair.exposure_s)]
    columns += [response.at(time_s, pair.exposure_s, pair.logger) for response in outside]
    columns += [column(time_s) for column in more]
    values, cubic = levelled(time_s, np.column_stack(columns), drifts=pair.bias_drifts)
    own = Columns(offset_s, np.column_stack((time_s, rows[:, 2])), values, cubic, index)
    if not more:
        pair.recent[:] = [own]
    return Aligned(pair, own)


def evaluate(pair: Pair, offset_s: float, corner: float) -> Fit:
    """The fit for a time offset (s) and a corner frequency (rad/s) where the two noise levels meet.

    The corner w of the optimum filter stands for the ratio of the noise levels: w⁴ = S_a · rate / R.
    """
    return aligned(pair, offset_s).fit(corner)


def unattenuated(total: float, cross: float, power: float, share: float) -> float:
    """The ratio without what the accelerometer's noise in the response shrinks its regression by.

    total, cross, power: sums of products of translation and translation, translation and response, response and
    response, whitened; share: of the innovations' variance, what the accelerometer's noise makes. With x the true
    response, p = s x + r and D = x + w, where s² var(w) = share · var(p − s D), the moments give

        (1 − share) power s² − (1 − 2 share) cross s − share total = 0:

    the regression of p on D where the share is 0, that of D on p where it is 1 (W. A. Fuller, Measurement error models,
    1987, section 1.3, doi 10.1002/9780470316665). What an uncertain share makes is not in the ratio's variance.
    """
    if cross == 0.0:
        return NEXT_TO_NO_RATIO
    half = 0.5 * (1.0 - 2.0 * share) * abs(cross)
    root = float(np.sqrt(half * half + share * (1.0 - share) * power * total))
    # Two forms of one root: neither is a difference of nearly equal numbers.
    size = (half + root) / ((1.0 - share) * power) if half > 0.0 else share * total / (root - half)
    return float(np.copysign(max(size, NEXT_TO_NO_RATIO), cross))


def shrinking(input_share: float, ratio: float, reference: float) -> float:
    """What the logarithm of the likelihood gains by a ratio that is smaller than the reference, and must not.

    The noise of the accelerometer is seen in the acceleration itself, multiplied by the ratio: where two offsets
    explain the motion alike with different ratios, the smaller ratio leaves less of it, whichever is true.
    """
    return input_share * float(np.log(reference / max(abs(ratio), MIN_RATIO * reference)))


def corner_range(pair: Pair) -> tuple[float, float]:
    """Lowest and highest corner frequency (rad/s) worth trying: up to the frame rate's Nyquist frequency."""
    return 0.1, max(np.pi * pair.rate_hz, 1.0)


def best_corner(pair: Pair, offset_s: float, corner: float | None = None) -> Fit:
    """The most likely noise ratio at a fixed time offset, near `corner` (rad/s) where one is given."""
    return best_corner_here(aligned(pair, offset_s), corner)


def best_corner_here(here: Aligned, corner: float | None) -> Fit:
    """The most likely noise ratio of what is compared, near `corner` (rad/s) where one is given."""
    best = here.fit(likeliest_corner(here.pair, lambda one: here.fit(one).likelihood, corner))
    here.columns.fits.clear()
    here.columns.fits[best.corner] = best
    return best


def likeliest_corner(pair: Pair, likelihood: Callable[[float], float], corner: float | None = None) -> float:
    """The corner frequency (rad/s) of the largest likelihood (logarithm), near `corner` where one is given."""
    low, high = np.log(corner_range(pair))

    def cost(value: float) -> float:
        return -likelihood(float(np.exp(value)))

    if corner is None:
        return float(np.exp(global_minimum(cost, low, high, tried=CORNERS, tolerance=CORNER_TOLERANCE)))
    first = np.clip(np.log(corner), low, high)
    bounds = max(low, first - NEAR_CORNER), min(high, first + NEAR_CORNER)
    return float(np.exp(minimum(cost, *bounds, CORNER_TOLERANCE)))


def corner_std(pair: Pair, fit: Fit) -> float:
    """Standard deviation of the logarithm of a fit's corner frequency by the curvature of the likelihood; no more than
    MAX_CORNER_STD where that is flat.
    """
    below, here, above = _around_corner(pair, fit)
    curved = (2.0 * here.likelihood - below.likelihood - above.likelihood) / CORNER_STEP**2
    return min(1.0 / float(np.sqrt(max(curved, 1e-300))), MAX_CORNER_STD)


def _around_corner(pair: Pair, fit: Fit) -> list[Fit]:
    return [evaluate(pair, fit.offset_s, fit.corner * float(np.exp(k * CORNER_STEP))) for k in (-1, 0, 1)]


def with_corner_doubt(pair: Pair, fit: Fit, *, disputed: bool) -> Fit:
    """The fit whose ratio is as uncertain as the ratio of the noise levels makes it, by which it is no regression.

    disputed: what counts as noise of the accelerometer may be none; all that it makes of the ratio is uncertain.
    """
    if pair.ratio is not None:
        return fit
    below, _, above = _around_corner(pair, fit)
    doubt = corner_std(pair, fit) * (above.ratio - below.ratio) / (2.0 * CORNER_STEP)
    if disputed:
        w = fit.whitened
        doubt = np.hypot(doubt, fit.ratio - w.product(w.translation, w.response) / w.product(w.response, w.response))
    return replace(fit, ratio_variance=fit.ratio_variance + float(doubt) ** 2)


def with_input_noise(pair: Pair, fit: Fit) -> tuple[Pair, Fit]:
    """The pair with what the accelerometer errs by, and its fit: a bias that drifts, and the most likely share of its
    noise that goes with the motion.

    A bias that does not drift and a constant noise are kept unless either gains more than a parameter costs that tells
    nothing (G. Schwarz, Estimating the dimension of a model, Ann. Statist. 6 (1978) 461-464, doi
    10.1214/aos/1176344136).
    """
    constant = pair.changed(motion_share=0.0, bias_drifts=False)
    without = best_corner(constant, fit.offset_s, fit.corner)
    least = 0.5 * np.log(max(len(without.whitened.variance), 1))
    drifting = pair.changed(motion_share=0.0, bias_drifts=True)
    found = best_corner(drifting, fit.offset_s)
    if found.likelihood - without.likelihood > least:
        constant, without = drifting, found
    here = aligned(constant, fit.offset_s)

    @cache
    def with_odds(odds: float) -> tuple[Pair, Fit]:
        noisy = constant.changed(motion_share=float(1.0 / (1.0 + np.exp(-odds))))
        return noisy, best_corner_here(here.of(noisy), without.corner)

    odds = global_minimum(lambda one: -with_odds(one)[1].likelihood, *ODDS, tried=ODDS_TRIED, tolerance=ODDS_TOLERANCE)
    noisy, found = with_odds(odds)
    return (constant, without) if found.likelihood - without.likelihood < least else (noisy, found)


def refine(pair: Pair, fit: Fit, bound_s: float) -> Fit:
    """The most likely offset and noise ratio near `fit`, the offset within 1.5 `bound_s` of it.

    A Gauss-Newton step is linear in the offset, so `fit` must lie within a fraction of the motion's period.
    """
    span = (fit.offset_s - 1.5 * bound_s, fit.offset_s + 1.5 * bound_s)
    for _ in range(ROUNDS):
        before = fit.likelihood
        fit = _climb(pair, fit, span)
        fit = max(fit, best_corner(pair, fit.offset_s, fit.corner), key=likelihood_of)
        if fit.likelihood - before < MIN_GAIN:
            break
    return fit


def _climb(pair: Pair, fit: Fit, span: tuple[float, float]) -> Fit:
    """The most likely offset within a span (s) at the noise ratio of `fit`, by Gauss-Newton steps."""
    for _ in range(STEPS):
        (step, information), best = gauss_newton(pair, fit), fit
        if 0.5 * step * step * information < MIN_GAIN:
            break
        for _ in range(HALVINGS):
            offset_s = float(np.clip(fit.offset_s + step, *span))
            # At the end of the overlap nothing may be left to compare.
            if len(pair.used(offset_s)) >= MIN_FRAMES:
                other = evaluate(pair, offset_s, fit.corner)
                best = max(best, other, key=likelihood_of)
                if best is other:
                    break
            step *= 0.5
        if best is fit:
            break
        fit = best
    return fit


def gauss_newton(pair: Pair, fit: Fit) -> tuple[float, float]:
    """Step (s) towards the most likely offset and its information (1/s²), the ratio going along where it is unknown."""
    w, s = fit.whitened, fit.ratio
    velocity, response = w.columns[:, 2], w.response
    power = max(w.product(response, response), 1e-300)
    if pair.ratio is None:
        # The likelihood is that of the regression.
        s = w.product(w.translation, response) / power
    left = w.translation - s * response
    pulled = 0.0
    if pair.ratio is None:
        if pair.reference is not None:
            change = (w.product(left, velocity) - s * w.product(response, velocity)) / power
            pulled = w.input_share * change / s if s != 0.0 else 0.0
        velocity = velocity - w.product(velocity, response) / power * response
    information = max(s * s * w.product(velocity, velocity) / fit.noise, 1e-300)
    return (s * w.product(left, velocity) / fit.noise + pulled) / information, information


def measured_rows(time_ns: Nanoseconds, value: Floats, variance: Floats, origin_ns: int) -> Floats:
    """Rows (m, 3) for calibration: time (s), value counted from its first, variance (infinite where unusable)."""
    usable = np.isfinite(value) & np.isfinite(variance)
    if not usable.any():
        return np.empty((0, 3))
    filled = np.where(usable, value - value[np.argmax(usable)], 0.0)
    return np.column_stack(((time_ns - origin_ns) / NANOSECONDS, filled, np.where(usable, variance, np.inf)))
