"""What is changed in a track once all of it is known: frames that are lost after all, and variances made fair."""

from dataclasses import replace

import numpy as np

from midspan.records import Floats, PixelTrack, Status
from midspan.signals.health import Mask

# A variance below this share of the usual one is the mark of a frame that matches itself, not of a quiet one.
SUSPICIOUS_SHARE = 0.25
# Noise of the template over the noise of a frame, as standard deviations.
TEMPLATE_NOISE = 1.15


def lost_where(track: PixelTrack, mask: Mask) -> PixelTrack:
    """The track with the frames of `mask` (n,) marked lost."""
    if not mask.any():
        return track
    empty = {
        name: np.where(mask, np.nan, getattr(track, name))
        for name in ("x_px", "y_px", "variance_x_px2", "variance_y_px2")
    }
    return replace(track, status=np.where(mask, np.uint8(Status.LOST), track.status), **empty)


def more_variance(track: PixelTrack, added_px2: Floats) -> PixelTrack:
    """The track with variances (n, 2) along x and y added."""
    if not added_px2.any():
        return track
    x, y = (own + more for own, more in zip((track.variance_x_px2, track.variance_y_px2), added_px2.T, strict=True))
    return replace(track, variance_x_px2=x, variance_y_px2=y)


def with_fair_variance(track: PixelTrack) -> PixelTrack:
    """The track with the usual variance where a frame matched the reference without noise.

    The reference frame (and any frame equal to it) matches itself perfectly and would seem to be known exactly; but its
    noise is the noise of the template, and the zero of the displacement is no better known than that. A template's
    noise also enters through the edge of its window, which moves over the frame: measured 1.2 to 1.4 times a frame's
    own.
    """

    def fair(variance: Floats) -> Floats:
        known = variance[np.isfinite(variance)]
        usual = float(np.median(known)) if len(known) else 0.0
        return np.where(variance < SUSPICIOUS_SHARE * usual, TEMPLATE_NOISE**2 * usual, variance)

    return replace(track, variance_x_px2=fair(track.variance_x_px2), variance_y_px2=fair(track.variance_y_px2))
