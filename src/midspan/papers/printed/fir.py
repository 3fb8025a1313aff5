"""`fir`: displacement by regularised least squares over a moving window, as a pair of complementary filters.

In a window of 2 M + 1 samples the displacement u* minimises

    || L_a (L_c u* − dt² a) ||² + lambda² || u* − u ||²

with L_c the second difference, L_a a weight of 1 (1/sqrt(2) on the first and last row), a the acceleration, u the
measured displacement on the accelerometer's grid. Only the middle row of the solution is kept: it is one filter on a
and one on u, which for a long window are

    C_H = D / (D² + lambda²) · dt²,    C_L = lambda² / (D² + lambda²),    D = 2 − 2 cos(2 pi f dt)

References: H. S. Lee, Y. H. Hong, H. W. Park, Design of an FIR filter for the displacement reconstruction using
measured acceleration in low-frequency dominant structures, Int. J. Numer. Meth. Eng. 82 (2010) 403-434, doi
10.1002/nme.2769; Z. Ma, J. Choi, L. Yang, H. Sohn, Structural displacement estimation using accelerometer and FMCW
millimeter wave radar, Mech. Syst. Signal Process. 182 (2023) 109582, doi 10.1016/j.ymssp.2022.109582, equations 17 to
21.

A bias shows: what is known of it is taken off.
"""

import numpy as np

from midspan.checks import refuse
from midspan.fusion.methods import MIN_HALF_WINDOW
from midspan.fusion.on_series import Usual
from midspan.fusion.streams import MethodSettings
from midspan.papers.printed.fir_rows import Branches, FirRows
from midspan.records import Floats

# Half the window: this many periods of the cut-off (Lee and others, 2010); as printed in the radar paper, s.
CUT_OFF_PERIODS, PRINTED_HALF_S = 1.5, 0.5
SECOND_DIFFERENCE = np.array([1.0, -2.0, 1.0])


def cut_off_weight(cut_off_hz: float, accuracy: float, step_s: float) -> float:
    """Regularisation factor lambda for which the acceleration gives `accuracy` of the amplitude at `cut_off_hz`.

    From the response of a long window: lambda = sqrt((1 − accuracy)/accuracy) · (2 − 2 cos(2 pi cut_off_hz step_s)).
    """
    turn = 2.0 - 2.0 * np.cos(2.0 * np.pi * cut_off_hz * step_s)
    return float(np.sqrt((1.0 - accuracy) / accuracy) * turn)


def window_filters(half: int, weight: float, step_s: float) -> tuple[Floats, Floats]:
    """Middle rows (2 half + 1,) of the least-squares solution: for the displacement, and for the acceleration in m/s².

    weight: lambda. A constant acceleration is integrated over the finite window (−0.022 m per m/s² at a cut-off of
    1 Hz).
    """
    ends = np.ones(2 * half - 1)
    ends[0] = ends[-1] = np.sqrt(0.5)
    row, bent = _solve(ends, weight, half)
    low, high = _even(row), step_s**2 * _even(np.pad(ends * bent, 1))
    return low / np.sum(low), high


def design(settings: MethodSettings, usual: Usual) -> Branches:
    """The two filters for the steps of both series; of half_window and cut_off_hz what is None is by the other."""
    half_s = PRINTED_HALF_S if settings.cut_off_hz is None else CUT_OFF_PERIODS / settings.cut_off_hz
    half = settings.half_window or max(round(half_s / usual.step_s), MIN_HALF_WINDOW)
    cut_off_hz = settings.cut_off_hz or CUT_OFF_PERIODS / (half * usual.step_s)
    if cut_off_hz >= 0.5 / usual.step_s:
        raise refuse(
            "fusion.cut_off_hz", f"below half the accelerometer's rate ({0.5 / usual.step_s:g} Hz)", cut_off_hz
        )
    low, high = window_filters(half, cut_off_weight(cut_off_hz, settings.accuracy, usual.step_s), usual.step_s)
    return Branches(low, high, usual.step_s, usual.frame_s, settings.spline_frames, bias_m_s2=settings.kalman.bias)


def fir(settings: MethodSettings, usual: Usual) -> FirRows:
    """The method as a stream, see `fusion.on_series`."""
    return FirRows(design(settings, usual))


def _solve(ends: Floats, weight: float, half: int) -> tuple[Floats, Floats]:
    """The middle row x (n,) of the inverse of L'L + lambda², and L x (n − 2,); L = L_a L_c with `ends` the weights L_a.

    Solved as lambda r = L y, L'r + lambda y = e with y = lambda x and r = L x, the entries of r standing between those
    of y: a band of seven. Its condition is the root of that of the normal equations, which at high rates would leave no
    digit.
    """
    from scipy.linalg import solve_banded

    count = 2 * half + 1
    place_x = np.maximum(2 * np.arange(count) - 1, 0)
    place_r = 2 * np.arange(count - 2) + 2
    bands = np.zeros((7, 2 * count - 2))
    bands[3] = weight
    for shift, value in enumerate(SECOND_DIFFERENCE):
        x = place_x[shift : shift + count - 2]
        bands[3 + place_r - x, x] = -value * ends
        bands[3 + x - place_r, place_r] = value * ends
    right = np.zeros(2 * count - 2)
    right[place_x[half]] = 1.0
    found = solve_banded((3, 3), bands, right)
    return found[place_x] / weight, found[place_r]


def _even(taps: Floats) -> Floats:
    """Taps without the rounding that breaks their symmetry."""
    result: Floats = 0.5 * (taps + taps[::-1])
    return result
