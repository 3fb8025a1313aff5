"""A fair variance for frames that match the reference without noise."""

import math
from dataclasses import replace

from midspan.records import PixelTranslation
from midspan.signals.running_median import RunningMedian

# The usual variance is a median over so many frames.
USUAL_FRAMES = 64
# A variance below this share of the usual one is the mark of a frame that matches itself, not of a quiet one.
SUSPICIOUS_SHARE = 0.25
# Noise of the template over the noise of a frame, as standard deviations.
TEMPLATE_NOISE = 1.15

UsualVariances = tuple[tuple[float, ...], tuple[float, ...]]
"""The last variances (px²) along x and along y."""


class FairVariance:
    """Gives a frame that matched the reference without noise the usual variance.

    The reference frame (and any frame equal to it) matches itself perfectly and would seem to be known exactly; but its
    noise is the noise of the template, and the zero of the displacement is no better known than that. A template's
    noise also enters through the edge of its window, which moves over the frame: measured 1.2 to 1.4 times a frame's
    own.
    """

    def __init__(self) -> None:
        self.restore(((), ()))

    @property
    def state(self) -> UsualVariances:
        """Everything that changes from frame to frame."""
        return self._x.state, self._y.state

    def restore(self, state: UsualVariances) -> None:
        """Continue from a `state` taken earlier."""
        self._x, self._y = (RunningMedian(USUAL_FRAMES, values) for values in state)

    def push(self, found: PixelTranslation) -> PixelTranslation:
        """The translation with fair variances; one that is LOST stays as it is."""
        x, y = found.variance_x_px2, found.variance_y_px2
        if not math.isfinite(x + y):
            return found
        fair_x, fair_y = _fair(x, self._x), _fair(y, self._y)
        return found if fair_x == x and fair_y == y else replace(found, variance_x_px2=fair_x, variance_y_px2=fair_y)


def _fair(variance: float, last: RunningMedian) -> float:
    last.push(variance)
    return TEMPLATE_NOISE**2 * last.value if variance < SUSPICIOUS_SHARE * last.value else variance
