"""Which share of a course is in a target's translation, as the accelerometer tells it.

The translation p follows the displacement, and some share q of a course d that is known with noise η only:

    p(t) = s · (D(t) + x) + q · (d(t) − η(t)) + n

Innovations of both columns through the filter of `whitening` make q a regression. Noise in the regressor draws such a
one to zero (W. A. Fuller, Measurement error models, Wiley 1987, chapter 1, doi 10.1002/9780470316665); its expected
part in the sums is known from draws of white noise that go the same way, and is taken out of them.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from midspan.calibration.agreement import misfit
from midspan.calibration.fit import Fit, Pair, aligned
from midspan.fusion.targets import AGREE_STD
from midspan.records import Floats

# Draws of noise: their mean is known to a third of one draw's scatter, and the same ones are used each time.
DRAWS, SEED = 12, 1


@dataclass(frozen=True, slots=True, eq=False)
class Course:
    """A course: time_s (n,) on the translation's clock, value_px (n,).

    shaped: what became of a series (n,) of white noise in it; noise_px: standard deviation of that series;
    part_of_noise: share of its variance that is the translation's own noise.
    """

    time_s: Floats
    value_px: Floats
    shaped: Callable[[Floats], Floats]
    noise_px: float
    part_of_noise: float


@dataclass(frozen=True, slots=True)
class Share:
    """A share with its standard deviation: std + growth · |share|; infinite where nothing tells it."""

    value: float
    std: float
    growth: float

    def allows(self, share: float) -> bool:
        """Whether it may be this one."""
        return not abs(self.value - share) > AGREE_STD * np.hypot(self.std, self.growth * share)


def share_in(pair: Pair, fit: Fit, course: Course) -> Share:
    """The share of a course in a translation whose fit is given."""
    rng = np.random.default_rng(SEED)
    noise = course.noise_px * rng.normal(0.0, 1.0, (DRAWS, len(course.time_s)))
    columns = [course.value_px, *(course.shaped(one) for one in noise), *noise]

    def at(values: Floats) -> Callable[[Floats], Floats]:
        return lambda time_s: np.interp(time_s - fit.offset_s, course.time_s, values)

    w = aligned(pair, fit.offset_s, *(at(one) for one in columns)).whitened(fit.corner)
    own, added = w.columns[:, 0], w.columns[:, -len(columns) :]
    power = max(w.product(w.response, w.response), 1e-300)

    def without_motion(column: Floats) -> Floats:
        return np.asarray(column - w.product(column, w.response) / power * w.response)

    own = without_motion(own)
    known, *drawn = (without_motion(added[:, k]) for k in range(len(columns)))
    shaped, raw = drawn[:DRAWS], drawn[DRAWS:]
    squares = np.array([w.product(one, one) for one in shaped])
    products = np.array([w.product(one, other) for one, other in zip(shaped, raw, strict=True)])
    left = w.product(known, known) - float(np.mean(squares))
    scatter = float(np.std(squares))
    if left <= AGREE_STD * scatter:
        return Share(0.0, np.inf, 0.0)
    value = (w.product(own, known) - course.part_of_noise * float(np.mean(products))) / left
    white = fit.noise * misfit(pair, fit).factor
    std = np.sqrt(white * w.product(known, known) + (course.part_of_noise * float(np.std(products))) ** 2) / left
    return Share(value, float(std), scatter / left)
