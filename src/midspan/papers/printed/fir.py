"""`fir`: displacement by regularised least squares over a moving window, as a pair of complementary filters.

In a window of 2 M + 1 samples the displacement u* minimises

    || L_a (L_c u* − dt² N a) ||² + lambda² || u* − u ||²

with L_c the second difference, L_a a weight of 1 (1/sqrt(2) on the first and last row), a the acceleration, u the
measured displacement on the accelerometer's grid. Only the middle row of the solution is kept: it is one filter on a
and one on u, which for a long window are

    C_H = D / (D² + lambda²) · dt²,    C_L = lambda² / (D² + lambda²),    D = 2 − 2 cos(2 pi f dt)

References: H. S. Lee, Y. H. Hong, H. W. Park, Design of an FIR filter for the displacement reconstruction using
measured acceleration in low-frequency dominant structures, Int. J. Numer. Meth. Eng. 82 (2010) 403-434, doi
10.1002/nme.2769; Z. Ma, J. Choi, L. Yang, H. Sohn, Structural displacement estimation using accelerometer and FMCW
millimeter wave radar, Mech. Syst. Signal Process. 182 (2023) 109582, doi 10.1016/j.ymssp.2022.109582, equations 17 to
21.
"""

from dataclasses import dataclass, replace

import numpy as np

from midspan.checks import positive, refuse
from midspan.fusion.methods import SPLINE_FRAMES
from midspan.fusion.streams import KalmanSettings, MethodSettings, Smoothed
from midspan.papers.printed.branches import AtFrames, Branches, Rates, check_spline_frames
from midspan.papers.printed.complementary import fused, smoothed_record
from midspan.papers.printed.filters import complement
from midspan.papers.printed.integrate import integrating, weights
from midspan.records import Acceleration, Displacement, Estimate, Floats

# Half the window: this many times the time constant 1/corner of matched noises, or periods of the cut-off (Lee and
# others, 2010); as printed in the radar paper, s.
CORNER_WINDOWS = 5.0
CUT_OFF_PERIODS = 1.5
PRINTED_HALF_S = 0.5
SHORTEST_HALF = 8
# The corner stays below this share of the displacement's Nyquist frequency: above it folding would pass.
NYQUIST_SHARE = 0.5
SECOND_DIFFERENCE = np.array([1.0, -2.0, 1.0])


@dataclass(frozen=True, slots=True)
class FirSettings:
    """How the two branches share the frequencies.

    literal: as in the papers, with a fixed cut-off, the second difference as the acceleration and no bias among the
    unknowns; otherwise the weight follows from the measured noise levels, the integration is Numerov's, and a constant
    bias is one more unknown of the least squares. cut_off_hz, accuracy: for literal, the frequency (Hz) from which the
    acceleration gives this share (0 to 1) of the amplitude; lower leaves more to the accelerometer and lengthens the
    delay. half_window: samples on each side. As printed a window holds three periods of the cut-off: what is None of
    half_window and cut_off_hz follows from the other, and with both None the window reaches 0.5 s to each side, the
    order of 101 at 100 Hz of the radar paper. Otherwise None is 5 time constants of the matched filter. spline_frames:
    displacements after an interval that the spline to the accelerometer's grid looks at, 0 to 4; fewer shortens the
    delay by a displacement interval each.
    """

    literal: bool = False
    cut_off_hz: float | None = None
    accuracy: float = 0.97
    half_window: int | None = None
    spline_frames: int = SPLINE_FRAMES

    def __post_init__(self) -> None:
        if self.cut_off_hz is not None:
            positive("cut_off_hz", self.cut_off_hz, "Hz")
        if not 0.0 < self.accuracy < 1.0:
            raise refuse("accuracy", "between 0 and 1 (share of the amplitude)", self.accuracy)
        if self.half_window is not None and self.half_window < SHORTEST_HALF:
            raise refuse("half_window", f"at least {SHORTEST_HALF} samples", self.half_window)
        check_spline_frames(self.spline_frames)


def cut_off_weight(cut_off_hz: float, accuracy: float, step_s: float) -> float:
    """Regularisation factor lambda for which the acceleration gives `accuracy` of the amplitude at `cut_off_hz`.

    From the response of a long window: lambda = sqrt((1 − accuracy)/accuracy) · (2 − 2 cos(2 pi cut_off_hz step_s)).
    """
    turn = 2.0 - 2.0 * np.cos(2.0 * np.pi * cut_off_hz * step_s)
    return float(np.sqrt((1.0 - accuracy) / accuracy) * turn)


def noise_weight(rates: Rates) -> float:
    """Regularisation factor lambda of least mean square error: (w_c dt)², w_c where both noises meet (rad/s)."""
    return float((_corner(rates) * rates.step_s) ** 2)


def window_filters(half: int, weight: float, step_s: float, *, rule: str, free_bias: bool) -> tuple[Floats, Floats]:
    """Middle rows (2 half + 1,) of the least-squares solution: for the displacement, and for the acceleration in m/s².

    weight: lambda; rule: integration rule, which is the weighting N of the acceleration; free_bias: a constant in the
    acceleration is one more unknown of the least squares, so that it shows nowhere; otherwise equation 20 as printed,
    where a constant is integrated over the finite window (−0.022 m per m/s² at the default cut-off).
    """
    ends = np.ones(2 * half - 1)
    ends[0] = ends[-1] = np.sqrt(0.5)
    constant = ends / np.linalg.norm(ends)
    columns = np.zeros((2 * half + 1, 2))
    columns[half, 0], columns[:, 1] = 1.0, np.convolve(ends * constant, SECOND_DIFFERENCE)
    (row, spread), (bent, bent_spread) = _solve(ends, weight, columns)
    if free_bias:
        share = (columns[:, 1] @ row) / (1.0 - columns[:, 1] @ spread)
        row, bent = row + share * spread, bent + share * bent_spread
        bent = bent - constant * (constant @ bent)
    low, high = _even(row), step_s**2 * _even(np.convolve(ends * bent, weights(rule)))
    return low / np.sum(low), high


def design(rates: Rates, settings: FirSettings) -> Branches:
    """The two filters for given rates and noise levels."""
    half_s = PRINTED_HALF_S if settings.cut_off_hz is None else CUT_OFF_PERIODS / settings.cut_off_hz
    if not settings.literal:
        half_s = CORNER_WINDOWS / _corner(rates)
    half = settings.half_window or max(round(half_s / rates.step_s), SHORTEST_HALF)
    if settings.literal:
        cut_off_hz = settings.cut_off_hz or CUT_OFF_PERIODS / (half * rates.step_s)
        weight, rule = cut_off_weight(cut_off_hz, settings.accuracy, rates.step_s), "central-difference"
    else:
        weight, rule = noise_weight(rates), "numerov"
    low, high = window_filters(half, weight, rates.step_s, rule=rule, free_bias=not settings.literal)
    return Branches(low, high, rule, spline_frames=settings.spline_frames)


def at_frames(low_pass: Floats, rates: Rates, rule: str) -> AtFrames:
    """The complement of a low-pass, from acceleration to displacement at any instant."""
    high_pass = complement(low_pass)
    return AtFrames(integrating(high_pass, rates.step_s, rule=rule), rates.step_s**2 * high_pass)


def fir(acceleration: Acceleration, displacement: Displacement, settings: FirSettings | None = None) -> Estimate:
    """Fuse a whole record: one row a sample, from acceleration (n samples) and displacement (m) in time order.

    As printed a bias shows: the mean of the acceleration is taken off for it.
    """
    smoothed = smoothed_record(acceleration, displacement, KalmanSettings())
    settings = settings or FirSettings()
    bias = float(np.mean(acceleration.value_m_s2)) if settings.literal else 0.0
    return _fused(acceleration, displacement, settings, smoothed, bias).estimate


def run_fir(
    acceleration: Acceleration, displacement: Displacement, settings: MethodSettings, path: Smoothed | None
) -> Smoothed:
    """The same as `on_series` of METHODS, see `fused`; as printed, the bias of the settings is taken off."""
    smoothed = path or smoothed_record(acceleration, displacement, settings.kalman)
    own = FirSettings(
        settings.literal, settings.cut_off_hz, settings.accuracy, settings.half_window, settings.spline_frames
    )
    return _fused(acceleration, displacement, own, smoothed, settings.kalman.bias if settings.literal else 0.0)


def _fused(
    acceleration: Acceleration, displacement: Displacement, settings: FirSettings, smoothed: Smoothed, bias: float
) -> Smoothed:
    without = replace(acceleration, value_m_s2=acceleration.value_m_s2 - bias)
    return fused(design, settings, (without, displacement), smoothed)


def _corner(rates: Rates) -> float:
    """The noises' corner in rad/s, kept where the displacement does not alias."""
    return min(rates.corner_rad_s, NYQUIST_SHARE * np.pi / rates.frame_s, 0.5 / rates.step_s)


def _solve(ends: Floats, weight: float, columns: Floats) -> tuple[Floats, Floats]:
    """x (c, n) with (L'L + lambda²) x = columns (n, c), and L x (c, n − 2); L = L_a L_c with `ends` the weights L_a.

    Solved as lambda r = L y, L'r + lambda y = columns with y = lambda x and r = L x, the entries of r standing between
    those of y: a band of seven. Its condition is the root of that of the normal equations, which at high rates would
    leave no digit.
    """
    from scipy.linalg import solve_banded

    count = len(columns)
    place_x = np.maximum(2 * np.arange(count) - 1, 0)
    place_r = 2 * np.arange(count - 2) + 2
    bands = np.zeros((7, 2 * count - 2))
    bands[3] = weight
    for shift, value in enumerate(SECOND_DIFFERENCE):
        x = place_x[shift : shift + count - 2]
        bands[3 + place_r - x, x] = -value * ends
        bands[3 + x - place_r, place_r] = value * ends
    right = np.zeros((2 * count - 2, columns.shape[1]))
    right[place_x] = columns
    found = solve_banded((3, 3), bands, right)
    return found[place_x].T / weight, found[place_r].T


def _even(taps: Floats) -> Floats:
    """Taps without the rounding that breaks their symmetry."""
    result: Floats = 0.5 * (taps + taps[::-1])
    return result
