"""The papers' calibration and filters in plain NumPy and SciPy, written from the papers: the other route of the tests.

Series are arrays of times (s) and values; displacements in m, accelerations in m/s², translations in px.
"""

import numpy as np
from scipy.integrate import cumulative_trapezoid
from scipy.interpolate import CubicSpline
from scipy.signal import butter, firwin, sosfiltfilt


def transition(dt):
    """A of AMKF, equation 6."""
    return np.array([[1.0, dt], [0.0, 1.0]])


def hold(dt):
    """B of AMKF, equation 6."""
    return np.array([0.5 * dt * dt, dt])


def adaptive_kalman(time, acceleration, q, frames, beta, *, first=10, begun=(1e-4, 1e-4)):
    """AMKF, equations 7 to 26 with plain matrices, for at most one frame in an interval of the accelerometer.

    frames: time and displacement of each, or what measures it by the prior state and its covariance, as equations 27
    to 30 ask; NaN is no frame. Returns displacement and velocity (n, 2), covariance (n, 2, 2) and R of each
    frame. begun: R of the first frames, `first` of them, which is the variance of the position at the start of the
    first frame's interval too, and that of the velocity.
    """
    row = np.array([1.0, 0.0])
    x, p, r, i = np.zeros(2), np.diag([0.0, begun[1]]), None, 0
    states, covariances, noises = [], [], []
    while i < len(frames) and frames[i][0] < time[0]:
        i += 1
    for k in range(len(time)):
        start, a = (time[k - 1], acceleration[k - 1]) if k else (time[0], 0.0)
        dt = time[k] - start
        met, u = i < len(frames) and frames[i][0] <= time[k], np.nan
        if met:
            stamp, u = frames[i]
            i += 1
            if r is None:
                r = begun[0]
                p = p + np.diag([r, 0.0])
            before, after = stamp - start, time[k] - stamp
            y = transition(before) @ x + hold(before) * a  # eq. 7 with the shorter step
            g = transition(before) @ p @ transition(before).T + q * np.outer(hold(before), hold(before))  # eq. 8
            u = u(y, g) if callable(u) else u
        if np.isfinite(u):
            eta = u - row @ y  # eq. 19
            if len(noises) >= first:
                r = beta * r + (1.0 - beta) * (eta**2 - row @ g @ row)  # eq. 20
            gain = g @ row / (row @ g @ row + r)  # eq. 9
            kept = np.eye(2) - np.outer(gain, row)
            w1 = transition(after) @ kept @ transition(before)  # eq. 23
            w2 = transition(after) @ kept @ hold(before) + hold(after)  # eq. 24
            w3 = transition(after) @ gain  # eq. 25
            x = w1 @ x + w2 * a + w3 * u  # eq. 22
            p = w1 @ p @ w1.T + q * np.outer(w2, w2) + r * np.outer(w3, w3)  # eq. 26
            noises.append(r)
        else:
            x = transition(dt) @ x + hold(dt) * a  # eqs. 7 and 12
            p = transition(dt) @ p @ transition(dt).T + q * np.outer(hold(dt), hold(dt))  # eqs. 8 and 13
        states.append(x)
        covariances.append(p)
    return np.array(states), np.array(covariances), np.array(noises)


def double_integral(time, acceleration):
    """Two trapezoidal sums, without the parabola that a bias and a start in motion make."""
    speed = cumulative_trapezoid(acceleration - acceleration.mean(), time, initial=0.0)
    moved = cumulative_trapezoid(speed, time, initial=0.0)
    return moved - np.polyval(np.polyfit(time, moved, 2), time)


def band_passed(values, rate_hz, band_hz):
    """Butterworth of order 4, forwards and backwards; a band that reaches half the rate has no upper end."""
    high = "highpass" if band_hz[1] > 0.49 * rate_hz else "bandpass"
    sections = butter(4, band_hz if high == "bandpass" else band_hz[0], high, fs=rate_hz, output="sos")
    return sosfiltfilt(sections, values, padlen=min(round(2.0 * rate_hz / band_hz[0]), len(values) - 1))


def printed_calibration(accelerometer, camera, band_hz, max_offset_s, *, sampled_first):
    """Clock offset (s) and scale factor (m/px): two-stage paper, section 3, steps 1 to 4.

    accelerometer, camera: times and values of each. sampled_first: step 2 as printed there; otherwise the displacement
    is filtered first, as in AMKF, section 3.1.1. The edges, in which the filter settles, do not count for the scale.
    """
    (time, value), (met, px) = accelerometer, camera
    rate_hz = (len(met) - 1) / (met[-1] - met[0])
    moved = double_integral(time, value)
    whole = moved if sampled_first else band_passed(moved, (len(time) - 1) / (time[-1] - time[0]), band_hz)
    seen = band_passed(px, rate_hz, band_hz)

    def felt(offset_s):
        taken = np.interp(met + offset_s, time, whole)
        return band_passed(taken, rate_hz, band_hz) if sampled_first else taken

    most = int(max_offset_s * rate_hz)
    lags, middle = np.arange(-most, most + 1), len(met) - 1
    likeness = CubicSpline(lags, np.correlate(felt(0.0), seen, "full")[middle - most : middle + most + 1])
    fine = np.linspace(-most, most, 20001)
    offset_s = fine[np.argmax(np.abs(likeness(fine)))] / rate_hz
    inner = (met > met[0] + 1.0 / band_hz[0]) & (met < met[-1] - 1.0 / band_hz[0])
    scale = np.linalg.lstsq(seen[inner, None], felt(offset_s)[inner], rcond=None)[0][0]
    return float(offset_s), float(scale)


def low_pass(taps, band_hz, rate_hz):
    """A window-designed low-pass with its transition in a band and a sum of 1: none of the package's filters."""
    return firwin(taps, np.mean(band_hz), window=("kaiser", 8.0), fs=rate_hz)


def two_stage(time, acceleration, met, measured, *, rate_hz=100.0, band_hz=(0.5, 1.0)):
    """The two-stage paper, section 2.2: displacement (n,) at the samples, near the ends without a part of a filter."""
    drifted = double_integral(time, acceleration)
    nyquist_hz = 0.5 * (len(met) - 1) / (met[-1] - met[0])
    below = low_pass(1201, (band_hz[1], nyquist_hz), rate_hz)
    above = drifted - np.convolve(drifted, below, mode="same")  # P_H
    anti_aliased = measured - CubicSpline(time, above)(met)
    slow = low_pass(1201, band_hz, rate_hz)  # Q_L
    raised = CubicSpline(met, anti_aliased)(time)
    return np.convolve(raised - drifted, slow, mode="same") + drifted


def regularised_filters(half, weight, step_s):
    """Middle rows (2 half + 1,) for displacement and acceleration: radar paper, eq. 17 to 21, with dense matrices."""
    count = 2 * half + 1
    second = np.zeros((count - 2, count))
    for k in range(count - 2):
        second[k, k : k + 3] = (1.0, -2.0, 1.0)
    ends = np.ones(count - 2)
    ends[[0, -1]] = np.sqrt(0.5)
    model = ends[:, None] * second
    inverse = np.linalg.inv(model.T @ model + weight**2 * np.eye(count))
    from_acceleration = step_s**2 * (inverse @ model.T)[half] * ends
    return weight**2 * inverse[half], np.pad(from_acceleration, 1)
