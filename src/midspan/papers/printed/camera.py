"""Scale factor and clock offset of a camera as the papers print them, to compare with.

The acceleration is integrated twice (trapezoids), both series are band-passed, the clock offset is where their
cross-correlation at the camera's rate is largest, and the scale factor is the least-squares fit of the displacement on
the translation: Ma, Choi, Sohn (2022), section 3.1.1, doi 10.1111/mice.12767, which Choi, Ma, Kim, Sohn (2023), section
2.1.1, and Ma, Choi, Liu, Sohn (hybrid phase), section 3.1, repeat; Ma, Liu, Choi, Sohn (two-stage), section 3, steps 1
to 4, with the displacement sampled as the camera samples before it is filtered.

The papers do not print the filter: here it is Butterworth's of order 4, forwards and backwards, and the seconds at
both ends in which it has not settled are left out. Lost frames are interpolated. Translation on acceleration, as in
`fit`, is the other regression.
"""

from dataclasses import dataclass

import numpy as np

from midspan.calibration.camera.view import PrintedSteps
from midspan.calibration.fit import Pair
from midspan.errors import UntrustedError
from midspan.records import Floats, ScaleFactor, TimeOffset
from midspan.signals.integrate import path

# Lower end of the band, Hz: AMKF paper, section 4.1, and infrared paper, section 3.1.
LOW_HZ = 0.3
# Upper end as a share of the frame rate. For a slower camera than this, Hz, all up to half the rate, as the two-stage
# paper has it for "a rather small" rate: a tenth of it would be below 2 Hz, where footbridges and houses do not move.
HIGH_SHARE, SLOW_CAMERA_HZ = 0.1, 20.0
# Left out at both ends, in periods of the lower end of the band.
SETTLING_PERIODS = 1.0
# The series are mirrored so far beyond their ends, in the same periods, before they are filtered.
PAD_PERIODS = 2.0
# Frames that a scale factor is fitted to, and lags that a cubic spline is laid through, at least.
MIN_ROWS, MIN_LAGS = 20, 4
# Lags on either side that it is laid through at least, beyond `max_offset_s` where that is less: with three to each
# side what is assumed at its ends has fallen to a tenth in the middle.
SPLINE_LAGS = 4


def printed_band(rate_hz: float) -> tuple[float, float]:
    """The band (Hz) that is compared at a frame rate: from 0.3 Hz to a tenth of the rate, or half of a slow one."""
    return LOW_HZ, (HIGH_SHARE if rate_hz >= SLOW_CAMERA_HZ else 0.5) * rate_hz


def printed_offset(pair: Pair, max_offset_s: float, steps: PrintedSteps) -> float:
    """The clock offset (s) of largest cross-correlation within ±`max_offset_s`.

    Where the sign is not known, the one whose fit leaves less is taken: in a narrow band the correlation half a period
    away is nearly as large, and a spline through few frames a period may show it larger.
    """
    signs = (steps.sign,) if steps.sign else (1, -1)
    offsets = [_offset(pair, max_offset_s, steps, sign) for sign in signs]
    if len(offsets) == 1:
        return offsets[0]
    return min(offsets, key=lambda offset_s: _fitted(pair, offset_s, steps).left)


def _offset(pair: Pair, max_offset_s: float, steps: PrintedSteps, sign: int) -> float:
    time_s, translation, rate_hz, band_hz = _translation(pair, steps)
    displacement = _displacement(pair, time_s, band_hz, steps)
    whole = sign * np.correlate(displacement, translation, mode="full")
    middle, most = len(translation) - 1, max_offset_s * rate_hz
    # The spline rests on lags beyond those that are looked at, too: of a slow camera there are few.
    reach = min(max(int(most), SPLINE_LAGS if steps.spline else 0), middle)
    lags, near = np.arange(-reach, reach + 1), whole[middle - reach : middle + reach + 1]
    inside = np.abs(lags) <= most
    best = float(lags[inside][np.argmax(near[inside])])
    if not steps.spline or len(lags) < MIN_LAGS:
        return best / rate_hz
    from scipy.interpolate import CubicSpline

    curve = CubicSpline(lags, near)
    turns = [lag for lag in curve.derivative().roots(extrapolate=False) if abs(lag) <= most]
    return float(max((*turns, best), key=lambda lag: float(curve(lag)))) / rate_hz


@dataclass(frozen=True, slots=True)
class _Fitted:
    value_m_per_px: float
    left: float
    power_px2: float
    speed_power: float


def printed_scale(pair: Pair, offset_s: float, steps: PrintedSteps) -> tuple[ScaleFactor, float]:
    """Scale factor (m/px, signed) by least squares of displacement on translation at a clock offset; AMKF, eq. 14.

    Its variance is that of the fit, as if the residuals were independent: no band. The second value is the offset's
    variance (s²) by the same residuals.
    """
    fit = _fitted(pair, offset_s, steps)
    return ScaleFactor(fit.value_m_per_px, fit.left / fit.power_px2), fit.left / fit.speed_power


def _fitted(pair: Pair, offset_s: float, steps: PrintedSteps) -> _Fitted:
    time_s, translation, _, band_hz = _translation(pair, steps)
    displacement = _displacement(pair, time_s + offset_s, band_hz, steps)
    margin_s = SETTLING_PERIODS / band_hz[0]
    inner = (time_s >= time_s[0] + margin_s) & (time_s <= time_s[-1] - margin_s)
    if np.count_nonzero(inner) < MIN_ROWS:
        raise UntrustedError(
            f"calibration.literal: the calibration window must hold {MIN_ROWS} frames or more besides "
            f"{margin_s:.3g} s at both ends, in which the printed band-pass from {band_hz[0]:g} Hz on settles; it "
            f"holds {np.count_nonzero(inner)}. Widen calibration.window_s, or raise calibration.band_hz."
        )
    d, u = translation[inner], displacement[inner]
    power = float(d @ d)
    value = float(u @ d) / power
    left = float(np.sum((u - value * d) ** 2)) / (len(d) - 1)
    speed = np.gradient(displacement, time_s)[inner]
    return _Fitted(value, left, power, float(speed @ speed))


def calibrate_printed(pair: Pair, max_offset_s: float, steps: PrintedSteps) -> tuple[ScaleFactor, TimeOffset]:
    """Both, one after the other."""
    offset_s = printed_offset(pair, max_offset_s, steps)
    scale, variance = printed_scale(pair, offset_s, steps)
    return scale, TimeOffset(offset_s, variance)


def _translation(pair: Pair, steps: PrintedSteps) -> tuple[Floats, Floats, float, tuple[float, float]]:
    """Times (m,) in s of an even grid at the frame rate, the band-passed translation (m,) there, rate and band."""
    seen = pair.rows[np.isfinite(pair.rows[:, 2])]
    step_s = float(np.median(np.diff(pair.rows[:, 0])))
    count = int(np.rint((seen[-1, 0] - seen[0, 0]) / step_s)) + 1
    time_s = np.linspace(seen[0, 0], seen[-1, 0], count)
    rate_hz = (count - 1) / float(time_s[-1] - time_s[0])
    band_hz = steps.band_hz or printed_band(rate_hz)
    return time_s, band_passed(np.interp(time_s, seen[:, 0], seen[:, 1]), band_hz, rate_hz), rate_hz, band_hz


def _displacement(pair: Pair, time_s: Floats, band_hz: tuple[float, float], steps: PrintedSteps) -> Floats:
    own_s, value = pair.samples[:, 0], pair.samples[:, 1]
    if steps.sampled_first:
        rate_hz = (len(time_s) - 1) / float(time_s[-1] - time_s[0])
        return band_passed(_without_drift(path(time_s, own_s, value)), band_hz, rate_hz)
    even_s = np.linspace(own_s[0], own_s[-1], len(own_s))
    whole = band_passed(_without_drift(path(even_s, own_s, value)), band_hz, pair.sample_rate_hz)
    return np.interp(time_s, even_s, whole)


def _without_drift(value: Floats) -> Floats:
    """Values (n,) without their parabola: first velocity and bias are not known, and the filter would ring."""
    number = np.arange(len(value))
    return np.asarray(value - np.polynomial.Polynomial.fit(number, value, 2)(number))


def band_passed(value: Floats, band_hz: tuple[float, float], rate_hz: float) -> Floats:
    """Values (n,) of an even grid within a band: Butterworth of order 4, forwards and backwards.

    A band that reaches half the rate has no upper end.
    """
    from scipy.signal import butter, sosfiltfilt

    low, high = band_hz
    kind, edges = ("bandpass", [low, high]) if high < 0.49 * rate_hz else ("highpass", low)
    beyond = min(round(PAD_PERIODS * rate_hz / low), len(value) - 1)
    return np.asarray(sosfiltfilt(butter(4, edges, kind, fs=rate_hz, output="sos"), value, padlen=beyond))
