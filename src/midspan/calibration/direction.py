"""The direction of a slow sensor's axis, from accelerations along all axes of the accelerometer.

An accelerometer that is inclined feels cross motion. Along the slow sensor's axis the acceleration is

    a = (a₁ + s₂ a₂ + s₃ a₃) / √(1 + s₂² + s₃²)

with a₁ along the accelerometer's main axis. Each component s is one more column of the regression of the whitened
translation (see `whitening`), together with the ratio and the clock offset, so that the covariance of all of them comes
from one run of the filter.

Where nothing moves along a cross axis but what the main axis shows as well, its column tells nothing: a component
counts by the share of its column's own power that is no white noise, so that it is 0 there. What then is left open of
it is in its standard deviation.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from midspan.calibration.fit import Fit, Pair, aligned, best_corner, with_input_noise
from midspan.calibration.outliers import cleaned
from midspan.calibration.time_offset import OffsetSearch, search_offset
from midspan.calibration.whitening import integrated, inverse_of
from midspan.records import Floats, TimeOffset
from midspan.signals.acceleration import PreparedAcceleration, along
from midspan.signals.medians import white_noise

# Standard deviation of a component before anything is known of it: a sensor that is mounted by camera, 17 degrees.
USUAL_COMPONENT = 0.3
# Steps towards the most likely direction, at most; one within this share of its standard deviation is the last.
STEPS, LAST_STEP = 6, 0.1
# Columns of what is whitened: translation, response to the acceleration, its velocity; then the cross axes' responses.
RESPONSE, VELOCITY = 1, 2
# Cross motion is taken to lie in a band of this width, Hz.
BAND_HZ = 1.0


@dataclass(frozen=True, slots=True)
class Direction:
    """Components of a sensor's axis along the accelerometer's cross axes, for one along the main one.

    components, std: (k,), without unit.
    """

    components: tuple[float, ...]
    std: tuple[float, ...]

    @property
    def variance(self) -> float:
        """Sum of the components' variances."""
        return float(np.sum(np.square(self.std)))

    @property
    def angle_deg(self) -> float:
        """Angle between the sensor's axis and the accelerometer's main one, degrees."""
        return float(np.degrees(np.arctan(np.linalg.norm(self.components))))

    def noise_density(self, prepared: PreparedAcceleration) -> float:
        """Density, (m/s²)²/Hz, of what the uncertain direction makes of the cross motion.

        Cross motion is what the main axis does not show as well, beyond white noise; its power is spread over BAND_HZ
        on either side of 0.
        """
        if prepared.cross_m_s2 is None:
            return 0.0
        main = prepared.value_m_s2 - np.mean(prepared.value_m_s2)
        share = main @ prepared.cross_m_s2 / max(float(main @ main), 1e-300)
        own = prepared.cross_m_s2 - np.outer(main, share)
        moved = [max(float(np.var(value)) - white_noise(value) ** 2, 0.0) for value in own.T]
        return float(np.dot(np.square(self.std), moved)) / (2.0 * BAND_HZ)


@dataclass(frozen=True, slots=True)
class Turned:
    """A pair with the acceleration along the sensor's axis, the direction of that, and what it leaves open besides.

    direction: None where no cross axes were recorded; relative_std: of the ratio; offset_variance: s².
    """

    pair: Pair
    direction: Direction | None = None
    relative_std: float = 0.0
    offset_variance: float = 0.0

    def turning(self, pair: Pair) -> Pair:
        """Another pair with its acceleration along this axis."""
        return pair if self.direction is None else _along(pair, np.array(self.direction.components))

    def widened(self, search: OffsetSearch) -> OffsetSearch:
        """A search with what the direction leaves open in the variances of its ratio and its offset."""
        fit, offset = search.fit, search.offset
        more = (self.relative_std * fit.ratio) ** 2
        offset = TimeOffset(offset.value_s, offset.variance + self.offset_variance)
        return replace(search, fit=replace(fit, ratio_variance=fit.ratio_variance + more), offset=offset)


def turned(pair: Pair, max_offset_s: float) -> Turned:
    """The pair with its acceleration along the axis of the slow sensor, as far as the motion shows that.

    max_offset_s: largest clock offset searched for; 0: the clocks are one.
    """
    if pair.cross is None:
        return Turned(pair)
    components = np.zeros(pair.cross[0].shape[1])
    for _ in range(STEPS):
        own = replace(_along(pair, components), ratio=None)
        if max_offset_s > 0.0:
            search = search_offset(own, max_offset_s)
            own, fit = search.pair, search.fit
        else:
            own = cleaned(*with_input_noise(own, best_corner(own, 0.0)))
            own, fit = with_input_noise(own, best_corner(own, 0.0))
        found, std, spread = _step(own, fit, pair.cross[0], components)
        change, components = np.abs(found - components), found
        if np.all(change < LAST_STEP * std):
            break
    direction = Direction(tuple(map(float, components)), tuple(map(float, std)))
    return Turned(_along(pair, components), direction, float(np.sqrt(spread[0])), float(spread[1]))


def _along(pair: Pair, components: Floats) -> Pair:
    assert pair.cross is not None
    cross, levels = pair.cross
    samples = pair.samples.copy()
    samples[:, 1] = along(samples[:, 1], cross, components)
    level = float(along(np.array([pair.level_m_s2]), levels[None, :], components)[0])
    return pair.changed(samples=samples, level_m_s2=level, cross=None)


def _step(pair: Pair, fit: Fit, cross: Floats, components: Floats) -> tuple[Floats, Floats, Floats]:
    """The components (k,) that follow from a pair along `components` and the cross axes' accelerations (n, k), their
    standard deviations, and the variances of ratio (relative) and offset that these leave.

    The translation is r (u + γ c) with the response u to what is along the axis so far, and c that to the cross axes.
    """

    def responding(value: Floats) -> Callable[[Floats], Floats]:
        samples = pair.samples.copy()
        samples[:, 1] = value
        response = integrated(samples)
        return lambda time_s: response.at(time_s, pair.exposure_s, pair.logger)

    w = aligned(pair, fit.offset_s, *(responding(value) for value in cross.T)).whitened(fit.corner)
    k, length = len(components), float(np.sqrt(1.0 + components @ components))
    power, aim = w.regression(w.columns[:, (RESPONSE, VELOCITY, *range(w.columns.shape[1] - k, w.columns.shape[1]))])
    # What white noise of a cross axis makes of its column's own power tells no component.
    own = 1.0 / np.maximum(np.diag(inverse_of(power))[2:], 1e-300)
    density = np.array([white_noise(value) ** 2 for value in cross.T]) / pair.sample_rate_hz
    shown = 1.0 - np.clip(density / (fit.corner**4 / pair.rate_hz) * w.input_share / own, 0.0, 1.0)
    # What is known before of the components themselves: near none.
    known = fit.noise * (length / (fit.ratio * USUAL_COMPONENT)) ** 2
    inverse = inverse_of(power + np.diag([0.0, 0.0, *np.full(k, known)]))
    found = inverse @ (aim - np.r_[0.0, 0.0, known * components * fit.ratio / length])
    std = shown * length * np.sqrt(fit.noise * np.diag(inverse)[2:]) / abs(fit.ratio)
    # How ratio and offset go with the components, where the ratio is that of a vector of length 1.
    drag = np.vstack((components / length, np.zeros(k))) - inverse_of(power[:2, :2]) @ power[:2, 2:]
    spread = fit.noise / fit.ratio**2 * np.diag(drag * shown @ inverse[2:, 2:] @ (drag * shown).T)
    components = shown * (components + found[2:] / found[0] * length)
    return components, np.hypot(std, (1.0 - shown**2) * USUAL_COMPONENT), spread
