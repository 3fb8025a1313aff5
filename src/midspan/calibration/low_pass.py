"""A low-pass in the accelerometer's logger, as a displacement sensor shows it.

It delays all motion, fast motion more, and weakens what is fast. The delay of slow motion is no different from a clock
offset. How delay and weakening grow with frequency shows (see `frequency_response`); what the low-pass takes away
altogether is motion that the accelerometer does not feel, and looks like noise of the sensor.
"""

from dataclasses import dataclass, replace

import numpy as np

from midspan.calibration.causes import Cause, likeliest_cause
from midspan.calibration.fit import Fit, Pair, best_corner, refine
from midspan.calibration.frequency_response import MAX_LATE, MIN_GAIN, Kind, with_response


@dataclass(frozen=True, slots=True)
class LowPass:
    """What shows of a low-pass: of motion of frequency_hz, relative to slow motion, the delay (s) and what is lost
    (share); offset_s: clock offset of slow motion, its delay included; taken_m: what it makes of the displacement but
    for that delay, rms; stands_out: whether it explains the readings clearly better than all other causes.
    """

    frequency_hz: float
    late_s: float
    lost: float
    offset_s: float
    taken_m: float
    stands_out: bool = True

    def text(self) -> str:
        """What it does, in words."""
        later = [f"{1e3 * self.late_s:.2g} ms later"] if self.late_s > 0.0 else []
        weaker = [f"{100.0 * self.lost:.2g} % weaker"] if self.lost > 0.0 else []
        doubt = "" if self.stands_out else " (likelier than a clock offset, not clearly told from a clock that steps)"
        return (
            "a low-pass in the accelerometer's logger delays and weakens fast motion: that of "
            f"{self.frequency_hz:.2g} Hz comes {' and '.join((*later, *weaker))} than slow motion{doubt}"
        )


def find_low_pass(pair: Pair, fit: Fit) -> LowPass | None:
    """The low-pass that shows between a displacement sensor and the accelerometer at the clock offset of a fit; None
    where none shows.

    It shows where the delay grows with the frequency, or the acceleration weakens, and that explains the readings
    better by frequency_response.MIN_GAIN (logarithm of the likelihood), with any gain of the accelerometer, and no
    other cause does so clearly.
    """
    free = replace(pair, ratio=None, reference=None)
    before = best_corner(free, fit.offset_s, fit.corner)
    explained = with_response(free, before, (Kind.LAG, Kind.DROOP), most_open=np.inf)
    without = explained.pair
    droop, lag = without.logger
    if not explained.known or lag > 0.0:
        return None
    cause = likeliest_cause(pair, fit.offset_s)
    if cause is not None and cause.named and cause.cause is not Cause.LOW_PASS:
        return None
    after = refine(without, best_corner(without, fit.offset_s), MAX_LATE / pair.rate_hz)
    if after.likelihood - before.likelihood < MIN_GAIN:
        return None
    frequency_hz = after.motion_hz
    square = (2.0 * np.pi * frequency_hz) ** 2
    path, time_s = pair.responses[0], pair.samples[:, 0]
    taken_m = float(np.std(droop * path.derivative(time_s, 2) + lag * path.derivative(time_s, 3)))
    stands_out = cause is not None and cause.named
    return LowPass(frequency_hz, -lag * square, min(-droop * square, 1.0), after.offset_s, taken_m, stands_out)
