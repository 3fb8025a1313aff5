"""What a complementary FIR method consists of, and what noise passes through it.

The result is the sum of two branches on the accelerometer's grid: the displacement, brought to the grid by a cubic
spline, through a low-pass, and the acceleration through a filter that integrates twice and passes the rest.
"""

from dataclasses import dataclass

import numpy as np

from midspan.checks import refuse
from midspan.fusion.methods import SPLINE_FRAMES
from midspan.papers.printed.filters import FilterSum
from midspan.papers.printed.integrate import RULES
from midspan.papers.printed.resample import spline_kernel, spline_reach
from midspan.records import Floats

# Its own error counts as none: 0.07 % at a tenth of the rate, 1.1 % at a fifth.
EXACT_RULE = "numerov"


@dataclass(frozen=True, slots=True)
class Rates:
    """Steps of both series in s, noise density of the acceleration ((m/s²)²/Hz), variance of a displacement (m²)."""

    step_s: float
    frame_s: float
    noise_density: float
    variance_m2: float

    @property
    def corner_rad_s(self) -> float:
        """Where both noises meet: (S_a / S_d)^(1/4) with S_d the displacement's variance over its rate, rad/s."""
        return float((self.noise_density / (self.variance_m2 * max(self.frame_s, self.step_s))) ** 0.25)


@dataclass(frozen=True, slots=True)
class AtFrames:
    """A filter from acceleration to displacement at any instant: its taps and those of the second derivative · dt²."""

    wanted: Floats
    bend: Floats

    @property
    def half(self) -> int:
        """Samples that it needs on each side."""
        return len(self.wanted) // 2


@dataclass(frozen=True, slots=True)
class Branches:
    """A method made for given rates; all taps symmetric, odd in number.

    low: displacement on the grid → low-frequency displacement; high: acceleration → high-frequency displacement (m);
    rule: integration rule of `high`; removed: what is taken off each displacement before it is interpolated (the
    anti-aliasing stage); spline_frames: how many displacements after an interval the spline looks at; warnings: in
    sentences.
    """

    low: Floats
    high: Floats
    rule: str
    removed: AtFrames | None = None
    spline_frames: int = SPLINE_FRAMES
    warnings: tuple[str, ...] = ()

    @property
    def reach_steps(self) -> float:
        """How far the spline looks behind the start of an interval, displacement intervals."""
        return spline_reach(self.spline_frames)


def check_spline_frames(count: int) -> None:
    """UsageError unless the spline to the grid can look at this many displacements after an interval."""
    if not 0 <= count <= SPLINE_FRAMES:
        raise refuse("spline_frames", f"from 0 to {SPLINE_FRAMES} displacements", count)


class NoiseGain:
    """Variance of a row from the noise of both series, through the squares of the method's own responses.

    Acceleration noise is white with density S: its samples have the variance S · rate, and the branch adds
    sum(high²) of it. A displacement's error spreads as spline * low; rows fall anywhere between displacements, so the
    mean over that place counts: R / frame interval · integral of (spline * low)².
    """

    def __init__(self, branches: Branches, rates: Rates) -> None:
        steps = max(rates.frame_s / rates.step_s, 1.0)
        spread = np.convolve(branches.low, spline_kernel(steps, branches.reach_steps)) if steps > 1.0 else branches.low
        keep = min(len(spread) // 2, max(len(branches.low), len(branches.high)) // 2)
        power = spread**2 / steps
        inner = power[len(power) // 2 - keep : len(power) // 2 + keep + 1]
        self._low = inner * (np.sum(power) / np.sum(inner))
        self._high = branches.high**2 / rates.step_s
        self._sum = FilterSum(self._low, self._high)
        self.half = self._sum.half

    def rows(self, variance_m2: Floats, density: Floats) -> Floats:
        """Variance (n − 2 half,) from the displacement's variance and the acceleration's density on the grid (n,)."""
        half, usual = self._sum.half, float(variance_m2[0])
        level = np.sum(self._low) * usual + np.sum(self._high) * density[0]
        result = np.full(len(density) - 2 * half, level)
        # A day of even noise with a few raised variances must not be filtered as a whole.
        odd = np.flatnonzero((variance_m2 != usual) | (density != density[0]))
        if not len(odd):
            return result
        for run in np.split(odd, np.flatnonzero(np.diff(odd) > 2 * half) + 1):
            first, last = max(int(run[0]) - 2 * half, 0), min(int(run[-1]) + 2 * half + 1, len(density))
            # Rounding of the transforms must not make a variance negative compared with a far larger one.
            near = (variance_m2[first:last], density[first:last])
            result[first : last - 2 * half] = np.maximum(self._sum(*near), self._floor(*near))
        return result

    def _floor(self, variance_m2: Floats, density: Floats) -> float:
        return float(np.sum(self._low) * np.min(variance_m2) + np.sum(self._high) * np.min(density))


def integration_error(displacement: Floats, rule: str) -> Floats:
    """What the rule's own error is for a displacement (n + 2,) on the grid: (n,) m, leading term.

    The second difference stands for dt² · acceleration; Numerov's error of fourth order is small below a fifth of the
    rate, and is not counted.
    """
    excess = RULES[rule] - RULES[EXACT_RULE]
    result: Floats = excess * (displacement[2:] - 2.0 * displacement[1:-1] + displacement[:-2])
    return result


def velocity(displacement: Floats, acceleration: Floats, step_s: float) -> Floats:
    """Velocity (n,) in m/s of a displacement (n + 2,) with its acceleration (n + 2,), of fourth order.

    The central difference is too large by dt²/6 · the second derivative of the velocity; a constant bias drops out.
    """
    difference = (displacement[2:] - displacement[:-2]) / (2.0 * step_s)
    result: Floats = difference - step_s / 12.0 * (acceleration[2:] - acceleration[:-2])
    return result
