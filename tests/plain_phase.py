"""The hybrid of Ma, Choi, Liu and Sohn (2022) in plain NumPy, written from the paper: the other route of the tests.

Arrays are double precision; an axis is 0 (x) or 1 (y); regions are (x, y, width, height).
"""

import numpy as np
from scipy.ndimage import correlate1d
from scipy.signal import butter, sosfiltfilt

TAPS = 0.67 * np.arange(-4, 5)


def local_phase(image, region, axis):
    """Complex response to G2 + j H2 along an axis (equation 1), tables III and V of Freeman and Adelson."""
    bell = np.exp(-(TAPS**2))
    even, odd = -0.9213 * (2 * TAPS**2 - 1) * bell, 0.9780 * (TAPS**3 - 2.254 * TAPS) * bell
    even = even - bell * even.sum() / bell.sum()
    along, across = 1 - axis, axis
    smooth = correlate1d(np.asarray(image, dtype=float), bell, axis=across)
    whole = correlate1d(smooth, even, axis=along) + 1j * correlate1d(smooth, odd, axis=along)
    x, y, width, height = region
    return whole[y : y + height, x : x + width]


def moved(region, place):
    return (region[0] + place[0], region[1] + place[1], region[2], region[3])


def phase_variation(image, first, region, place, axis):
    """Phase (k,) of the moved region less that of the first one: the variation of equation 2."""
    return np.angle(local_phase(image, moved(region, place), axis) * np.conj(local_phase(first, region, axis))).ravel()


def double_integral(time_s, acceleration):
    """Displacement by two trapezoidal sums, without the parabola that a bias and a start in motion make."""
    for _ in range(2):
        acceleration = acceleration - acceleration.mean()
        steps = np.diff(time_s) * (acceleration[1:] + acceleration[:-1]) / 2
        acceleration = np.concatenate([[0.0], np.cumsum(steps)])
    return acceleration - np.polyval(np.polyfit(time_s, acceleration, 2), time_s)


def filtered(values, rate_hz, band_hz):
    sections = butter(4, band_hz, "bandpass", fs=rate_hz, output="sos")
    return sosfiltfilt(sections, values - values.mean(axis=0), axis=0)


def least_squares(given, wanted):
    """Ratio of wanted to given by least squares, and the determination coefficient."""
    ratio = (given @ wanted) / (given @ given)
    return ratio, 1 - np.sum((wanted - ratio * given) ** 2) / np.sum(wanted**2)


def active_pixels(phase, residual):
    """Steps b to d: pixels (k,), ratio and R² of the threshold with the largest R²; both sides are filtered."""
    rho = np.abs([np.corrcoef(column, residual)[0, 1] for column in phase.T])
    best = (np.ones(len(rho), dtype=bool), 0.0, -1.0)
    for threshold in rho:
        active = rho >= threshold
        ratio, r_squared = least_squares(phase[:, active].mean(axis=1), residual)
        if r_squared > best[2]:
            best = (active, ratio, r_squared)
    return best


def flow_terms(image, first, region, axis):
    """Slope of the present phase along an axis (k,), rad/px, and variation of equation 2 (k,), rad."""
    x, y, width, height = region
    wide = local_phase(image, (x - 1, y - 1, width + 2, height + 2), axis)
    steps = np.angle(wide[:, 1:] * np.conj(wide[:, :-1])) if axis == 0 else np.angle(wide[1:] * np.conj(wide[:-1]))
    slope = steps[1:-1, 1:] + steps[1:-1, :-1] if axis == 0 else steps[1:, 1:-1] + steps[:-1, 1:-1]
    return slope.ravel() / 2, phase_variation(image, first, region, (0, 0), axis)


def existing_flow(image, first, region, axis, active):
    """Equation 3 without its scale factor, px: mean of -(slope of the present phase)^-1 times the variation."""
    slope, change = flow_terms(image, first, region, axis)
    return np.mean((-change / slope)[active])
