"""Tilt from gravity and a gyroscope: what an accelerometer's other axis shows slowly, and the gyroscope quickly.

The complementary filter of two sensors (W. T. Higgins, A comparison of complementary and Kalman filtering, IEEE Trans.
Aerosp. Electron. Syst. 11 (1975) 321-325, doi 10.1109/TAES.1975.308081) with a window that is symmetric, so that it
delays nothing: gravity through the window, the integrated rotation rate less what the window leaves of it.
"""

from dataclasses import dataclass

import numpy as np

from midspan.records import NANOSECONDS, Floats, Nanoseconds

# Length of the Hann window, s: its stop band begins at 0.5 Hz, where structures begin to vibrate along the view. Longer
# leaves more of the gyroscope's angle random walk.
WINDOW_S = 4.0
# The results follow each other at this interval, s.
INTERVAL_S = 1.0


@dataclass(frozen=True, slots=True, eq=False)
class Attitude:
    """An angle (n,), rad, at time_ns (n,).

    own_std: standard deviation of a value's noise by the acceleration's; share_of_rate: what that of a rate (rad/s)
    makes besides, rad; turned (k, 2): what both turn by from one window to the next, gravity and the gyroscope, rad,
    without their mean; lapse_s: the square root of the time that a rate's noise adds up over there.
    """

    time_ns: Nanoseconds
    value: Floats
    own_std: float
    share_of_rate: float
    turned: Floats
    lapse_s: float

    def noise_std(self, rate_std: float) -> float:
        """Of a value, rad; rate_std: white noise of the rotation rate, rad/s."""
        return float(np.hypot(self.own_std, self.share_of_rate * rate_std))

    def agreement(self, rate_std: float) -> float:
        """Logarithm of how much likelier both turn the same way than against each other; rate_std as above."""
        one, other = self.turned.T
        left = min(float(np.mean((other - one) ** 2)), float(np.mean((other + one) ** 2)))
        return 2.0 * float(one @ other) / max((self.lapse_s * rate_std) ** 2, left, 1e-300)


def attitude(time_ns: Nanoseconds, leaning: Floats, rate: Floats, gravity_m_s2: float) -> Attitude | None:
    """The angle whose sine gravity shows along an axis at right angles to it.

    time_ns (n,): at even intervals; leaning (n,): acceleration along that axis, m/s², finite; rate (n,): rotation rate,
    rad/s; gravity_m_s2: what turning by a radian adds, signed. None where the record is shorter than the window.
    """
    step_s = float(np.median(np.diff(time_ns))) / NANOSECONDS
    window = np.hanning(2 * (round(0.5 * WINDOW_S / step_s) // 1) + 3)[1:-1]
    window /= window.sum()
    half, every = len(window) // 2, max(round(INTERVAL_S / step_s), 1)
    if len(time_ns) < len(window) + every:
        return None
    angle = step_s * np.concatenate(([0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1]))))
    both = np.column_stack([np.convolve(one, window, mode="valid") for one in (leaning / gravity_m_s2, angle)])
    slow, turned = both[:, 0] - both[:, 1], np.diff(both[:: len(window)], axis=0)
    inner = slice(half, len(time_ns) - half)
    places = np.arange(0, len(slow), every)
    # What of the rate's noise is in the angle less its windowed course: the window's step response, less a step.
    response = np.cumsum(window) - (np.arange(len(window)) >= half)
    of_rate = step_s * float(np.sqrt(np.sum(response**2)))
    vibration = np.diff(leaning, 2) / np.sqrt(6.0) / gravity_m_s2
    of_gravity = float(np.std(vibration) * np.sqrt(np.sum(window**2)))
    value = slow + angle[inner]
    turned = turned - np.mean(turned, axis=0) if len(turned) else np.zeros((1, 2))
    return Attitude(time_ns[inner][places], value[places], of_gravity, of_rate, turned, step_s * len(window) ** 0.5)
