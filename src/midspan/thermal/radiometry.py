"""From a thermal camera's counts to the temperature of what it looks at.

A camera counts the radiance that reaches it: counts + O = R1 / (R2 · (exp(B / T) − F)) for a black body of T in kelvin
(Planck's law with the constants of the maker's calibration). On the way from the object a share is lost and another
added by reflection, the air and a window; that is taken off first (equation of measurement in Usamentiaga and others,
"Infrared thermography for temperature measurement and non-destructive testing", 2014, doi 10.3390/s140712305).
"""

import math
from dataclasses import dataclass, field

import numpy as np

from midspan.checks import positive, refuse
from midspan.records import Floats

ICE_K = 273.15
COUNTS = 1 << 16
# Saturation pressure of water over temperature in °C: exponents of the makers' formula for the air's transmission.
_WATER = (1.5587, 6.939e-2, -2.7816e-4, 6.8455e-7)


@dataclass(frozen=True, slots=True)
class Planck:
    """A camera's calibration: constants of Planck's law, `b_k` in K, the others in the camera's own counts."""

    r1: float
    b_k: float
    f: float
    o: float
    r2: float

    def __post_init__(self) -> None:
        for name in ("r1", "b_k", "r2"):
            positive(name, getattr(self, name))
        if not math.isfinite(self.f + self.o):
            raise refuse("f and o", "finite", (self.f, self.o))


@dataclass(frozen=True, slots=True)
class Air:
    """How the air dims: coefficients of its transmission, by the root of the distance and by the water in it."""

    alpha: tuple[float, float] = (0.006569, 0.01262)
    beta: tuple[float, float] = (-0.002276, -0.00667)
    x: float = 1.9


@dataclass(frozen=True, slots=True)
class OpticalPath:
    """What lies between object and camera: emissivity and window transmission (0 to 1), distance in m, temperatures in
    K, relative humidity (0 to 1).
    """

    emissivity: float = 1.0
    distance_m: float = 0.0
    reflected_k: float = 293.15
    air_k: float = 293.15
    window_k: float = 293.15
    window_transmission: float = 1.0
    humidity: float = 0.5
    air: Air = field(default_factory=Air)

    def __post_init__(self) -> None:
        for name in ("emissivity", "window_transmission"):
            if not 0.0 < getattr(self, name) <= 1.0:
                raise refuse(name, "above 0, up to 1", getattr(self, name))
        for name in ("reflected_k", "air_k", "window_k"):
            positive(name, getattr(self, name), "K")
        if not (0.0 <= self.distance_m < math.inf and 0.0 <= self.humidity <= 1.0):
            raise refuse("distance_m and humidity", "0 m or more and 0 to 1", (self.distance_m, self.humidity))


def transmission(path: OpticalPath) -> float:
    """Share (0 to 1) of the object's radiance that the air lets through."""
    t_air = path.air_k - ICE_K
    w = path.humidity * math.exp(sum(c * t_air**n for n, c in enumerate(_WATER)))
    d, air = math.sqrt(path.distance_m / 2.0), path.air
    first, second = (math.exp(-d * (a + b * math.sqrt(w))) for a, b in zip(air.alpha, air.beta, strict=True))
    return min(max(air.x * first + (1.0 - air.x) * second, 1e-3), 1.0)


def black_body_counts(kelvin: Floats | float, planck: Planck) -> Floats:
    """Counts that a black body of `kelvin` (any shape) gives right in front of the lens."""
    t = np.asarray(kelvin, dtype=np.float64)
    return np.asarray(planck.r1 / (planck.r2 * (np.exp(planck.b_k / t) - planck.f)) - planck.o)


def added_counts(planck: Planck, path: OpticalPath) -> tuple[float, float]:
    """Share of the object's black-body counts that arrives (0 to 1), and what reflection, air and window add.

    counts = share · (counts of the object as a black body) + added.
    """
    e, tau, window = path.emissivity, transmission(path), path.window_transmission
    reflected, air, pane = (float(black_body_counts(t, planck)) for t in (path.reflected_k, path.air_k, path.window_k))
    # The air lies on both sides of the window: once before the object's radiance is dimmed by the pane, once behind it.
    before = (1.0 - e) * tau * reflected + (1.0 - tau) * air
    behind = window * before + (1.0 - window) * pane
    return e * tau * window * tau, tau * behind + (1.0 - tau) * air


def celsius(counts: Floats, planck: Planck, path: OpticalPath | None = None) -> Floats:
    """Temperature of the object in °C from `counts` (any shape); NaN where a count lies below what is possible.

    path: what lies between; a black body right before the camera without it.
    """
    path = path or OpticalPath()
    share, added = added_counts(planck, path)
    own = (np.asarray(counts, dtype=np.float64) - added) / share + planck.o
    with np.errstate(divide="ignore", invalid="ignore"):
        kelvin = planck.b_k / np.log(planck.r1 / (planck.r2 * own) + planck.f)
    return np.where((own > 0.0) & np.isfinite(kelvin) & (kelvin > 0.0), kelvin - ICE_K, np.nan)


def celsius_table(planck: Planck, path: OpticalPath | None = None) -> np.ndarray[tuple[int], np.dtype[np.float32]]:
    """Temperature in °C of every 16-bit count (65536,): reading a frame is then one look-up a pixel."""
    return celsius(np.arange(COUNTS, dtype=np.float64), planck, path).astype(np.float32)
