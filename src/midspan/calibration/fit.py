"""The likelihood of a translation given the acceleration, as a function of time offset and noise ratio.

Scale factor and noise variance are solved in closed form inside (see `whitening`). Regressing the translation on the
response to the acceleration, not the other way round, keeps pixel noise from shrinking the scale factor.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import minimize

from midspan.calibration.whitening import Whitened, whiten
from midspan.records import Floats

# Ratio, time offset and the ratio of the noise levels are fitted beside the noise itself.
FITTED = 3
# Ratios below this share of the reference are no explanation of the motion.
SMALLEST_RATIO = 0.01


@dataclass(frozen=True, slots=True)
class Pair:
    """What is compared: translation (px, or m) and acceleration.

    samples (n, 3): time (s), acceleration (m/s²), relative noise density; rows (m, 3): time on the sensor's own clock
    (s), translation, relative variance (infinite: not used).
    ratio: the translation per metre of displacement where it is known (1 for a displacement sensor), else None.
    exposure_s: time over which each translation is averaged.
    outside: samples (n, 3) with the part of the acceleration that must not decide the ratio (motion outside a band); it
    gets a factor of its own. None: all of the acceleration decides.
    reference: the size of the ratio beside which other ratios are compared, None at first (see `shrinking`).
    level_m_s2: the mean acceleration, which the samples are without.
    """

    samples: Floats
    rows: Floats
    ratio: float | None = None
    exposure_s: float = 0.0
    outside: Floats | None = None
    reference: float | None = None
    level_m_s2: float = 0.0

    @property
    def rate_hz(self) -> float:
        """Mean rate of the translation."""
        return (len(self.rows) - 1) / float(self.rows[-1, 0] - self.rows[0, 0])


@dataclass(frozen=True, slots=True)
class Fit:
    """One evaluation of the likelihood.

    ratio: translation per metre of displacement (the inverse scale factor), with its variance at this offset;
    noise: variance of the translation per unit of relative variance; input_density: noise density of the acceleration
    in (m/s²)²/Hz; information: squared ratio over its variance, the number of standard deviations squared;
    likelihood: logarithm, without constants; without: the same with the acceleration ignored.
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


def evaluate(pair: Pair, offset_s: float, corner: float) -> Fit:
    """The fit for a time offset (s) and a corner frequency (rad/s) where the two noise levels meet.

    The corner w of the optimum filter stands for the ratio of the noise levels: w⁴ = S_a · rate / R.
    """
    rows = pair.rows.copy()
    rows[:, 0] += offset_s
    density = corner**4 / pair.rate_hz
    w = whiten(pair.samples, rows, density, pair.exposure_s)
    n = max(len(w.variance), 1)
    if pair.outside is not None:
        w = _without(w, whiten(pair.outside, rows, density, pair.exposure_s))
    power = float(np.sum(w.response**2 / w.variance))
    cross = float(np.sum(w.response * w.translation / w.variance))
    total = float(np.sum(w.translation**2 / w.variance))
    ratio = pair.ratio if pair.ratio is not None else cross / max(power, 1e-300)
    left = max(total - 2.0 * ratio * cross + ratio * ratio * power, 1e-300)
    noise = left / max(n - FITTED, 1)
    entropy = 0.5 * float(np.sum(np.log(w.variance)))
    favour = shrinking(w, ratio, pair.reference) if pair.ratio is None and pair.reference is not None else 0.0
    if pair.ratio is None:
        # Accelerometer noise in the response shrinks the regression; its expected share is known and taken back.
        ratio *= 1.0 + min(noise * float(np.sum(w.input_part / w.variance)) / max(ratio * ratio * power, 1e-300), 0.1)
    return Fit(
        offset_s=offset_s,
        corner=corner,
        ratio=ratio,
        ratio_variance=noise / max(power, 1e-300),
        noise=noise,
        input_density=density * noise / max(ratio * ratio, 1e-300),
        likelihood=-0.5 * n * np.log(left / n) - entropy - favour,
        without=-0.5 * n * np.log(max(total, 1e-300) / n) - entropy,
        whitened=w,
    )


def shrinking(w: Whitened, ratio: float, reference: float) -> float:
    """What the logarithm of the likelihood gains by a ratio that is smaller than the reference, and must not.

    The noise of the accelerometer is seen in the acceleration itself, multiplied by the ratio: where two offsets
    explain the motion alike with different ratios, the smaller ratio leaves less of it, whichever is true.
    """
    share = float(np.sum(w.input_part / w.variance))
    return share * float(np.log(reference / max(abs(ratio), SMALLEST_RATIO * reference)))


def _without(inside: Whitened, outside: Whitened) -> Whitened:
    """The innovations with the share of `outside`'s response taken out of translation and response alike."""
    power = max(float(np.sum(outside.response**2 / inside.variance)), 1e-300)

    def rest(values: Floats) -> Floats:
        return values - float(np.sum(values * outside.response / inside.variance)) / power * outside.response

    return replace(inside, translation=rest(inside.translation), response=rest(inside.response))


def corner_range(pair: Pair) -> tuple[float, float]:
    """Lowest and highest corner frequency (rad/s) worth trying: up to the frame rate's Nyquist frequency."""
    return 0.1, max(np.pi * pair.rate_hz, 1.0)


def best_corner(pair: Pair, offset_s: float, corner: float | None = None) -> Fit:
    """The most likely noise ratio at a fixed time offset."""
    low, high = np.log(corner_range(pair))
    starts = np.linspace(low, high, 9) if corner is None else [np.log(corner)]
    first = max(starts, key=lambda value: evaluate(pair, offset_s, float(np.exp(value))).likelihood)

    def cost(value: Floats) -> float:
        return -evaluate(pair, offset_s, float(np.exp(np.clip(value[0], low, high)))).likelihood

    found = minimize(
        cost,
        [first],
        method="Nelder-Mead",
        options={"xatol": 0.02, "fatol": 0.02, "initial_simplex": [[first], [first + 0.3]]},
    )
    return evaluate(pair, offset_s, float(np.exp(np.clip(found.x[0], low, high))))


def refine(pair: Pair, fit: Fit, bound_s: float) -> Fit:
    """The most likely offset and noise ratio near `fit`, the offset within `bound_s` of it."""
    low, high = np.log(corner_range(pair))

    def at(value: Floats) -> Fit:
        offset = fit.offset_s + bound_s * float(np.clip(value[0], -1.5, 1.5))
        return evaluate(pair, offset, float(np.exp(np.clip(value[1], low, high))))

    start = np.array([0.0, np.log(fit.corner)])
    simplex = start + np.array([[0.0, 0.0], [0.5, 0.0], [0.0, 0.3]])
    found = minimize(
        lambda value: -at(value).likelihood,
        start,
        method="Nelder-Mead",
        options={"xatol": 1e-5, "fatol": 1e-4, "maxfev": 160, "initial_simplex": simplex},
    )
    return at(found.x)
