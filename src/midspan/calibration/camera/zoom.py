"""What the picture's zoom moves a target by: a lens that breathes (autofocus), a target that moves in depth.

A picture that grows by a share z moves what lies r px from the optical axis by r z, and shows 1 + z times the motion.
The `registration` tracker measures z frame by frame. The lever r is where the region lies relative to the axis, as far
as that is known, and what makes the rest of the translation follow the acceleration best: a normal prior and the
likelihood of `calibration.fit`.
"""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from midspan.calibration.camera.view import Lever, SeenTarget, View, camera_pair, scale_of
from midspan.calibration.fit import MIN_FRAMES, Fit, Pair, aligned, best_corner
from midspan.calibration.whitening import NO_SLOW_ERROR
from midspan.errors import UntrustedError
from midspan.records import NANOSECONDS, Floats

# A picture zooms where means of the zoom over some seconds vary by this factor of what their noise makes (variance).
# Those of pictures that do not vary by up to five times it, as what the tracker errs by depends on where the target is.
GROWS = 12.0
# The axis of a lens that was calibrated, and of one that was not as a share of half the picture's diagonal: a film may
# have been cut from a larger one.
KNOWN_PX, UNKNOWN_SHARE = 10.0, 2.0
# Lever and noise in turn: both are settled after this many rounds.
ROUNDS = 4
# Zooms are averaged over the longest of these times, s, that leaves this share of their variance.
SMOOTH_S, LEFT = (16.0, 8.0, 4.0, 2.0), 0.7


def without_zoom(views: Sequence[View], target: SeenTarget) -> SeenTarget:
    """A target without what the picture's zoom moves it by along the views' axes, where there is a zoom."""
    zoom, variance = target.rows.zoom, target.rows.variance_zoom
    place = target.rows.along(views[0].axis)[0]
    known = np.isfinite(place) & np.isfinite(zoom) & np.isfinite(variance)
    # A zoom moves nothing of a target that stays exactly where it is.
    if np.count_nonzero(known) < MIN_FRAMES or np.ptp(place[known]) == 0.0:
        return target
    own = float(np.mean(variance[known]))
    # What grows with the place is the lens' distortion or the target's turning: it goes with the scale factor.
    free = zoom[known] - np.polyval(np.polyfit(place[known], zoom[known], 1), place[known])
    smooth, averaged = _smoothed(free, own, _rate_hz(target))
    if np.var(smooth) < GROWS * own * averaged:
        return target
    levers = {view.axis: lever for view in views if (lever := _lever(view, target)) is not None}
    x, y = (levers[axis].value_px if axis in levers else 0.0 for axis in "xy")
    return replace(target, rows=target.rows.without_zoom((x, y)), levers=levers)


def _lever(view: View, target: SeenTarget) -> Lever | None:
    """The lever along an axis; None where the target cannot be calibrated along it."""
    try:
        found = scale_of(view, camera_pair(view, target.rows, target.blur_s))
    except UntrustedError:
        return None
    track, (place, std) = target.rows, _prior(target, view.axis)
    known = np.isfinite(track.zoom) & np.isfinite(track.variance_zoom)
    seen = track.zoom[known]
    stamps = (track.time_ns[known] + view.late_ns - view.window_ns[0]) / NANOSECONDS
    smooth, _ = _smoothed(seen, float(np.mean(track.variance_zoom[known])), _rate_hz(target))
    zoom, smooth = (np.interp(found.search.pair.rows[:, 0], stamps, one) for one in (seen, smooth))
    white, fit = found.search.pair.changed(slow=NO_SLOW_ERROR), found.search.fit
    lever, weight = place, 1.0 / std**2
    for _ in range(ROUNDS):
        rows = white.rows.copy()
        rows[:, 1] = (rows[:, 1] - lever * zoom) / (1.0 + zoom)
        pair = white.changed(rows=rows)
        fit = best_corner(pair, fit.offset_s)
        step, information = _step(pair, fit, zoom, smooth)
        weight = information + 1.0 / std**2
        lever += (information * step + (place - lever) / std**2) / weight
    # The zero is that of the first frame.
    return Lever(lever, float(np.sqrt(np.mean((zoom - zoom[0]) ** 2) / weight)))


def _rate_hz(target: SeenTarget) -> float:
    return (len(target.rows.time_ns) - 1) * NANOSECONDS / float(target.rows.time_ns[-1] - target.rows.time_ns[0])


def _smoothed(zoom: Floats, variance: float, rate_hz: float) -> tuple[Floats, float]:
    """The zoom (n,) as weighted means over some seconds, and the share of its noise's variance that these have.

    The noise of single frames is that of the translations as well, and much faster than an accelerometer is blind to.
    """
    for lasting_s in SMOOTH_S:
        window = np.hanning(max(round(lasting_s * rate_hz), 1) + 2)[1:-1]
        window /= np.sum(window)
        around = np.pad(zoom, (len(window) // 2, (len(window) - 1) // 2), "edge")
        found = np.asarray(np.convolve(around, window, "valid"))
        if np.var(found) > LEFT * (np.var(zoom) - variance):
            break
    return found, float(np.sum(window**2))


def _prior(target: SeenTarget, axis: str) -> tuple[float, float]:
    """The lever along an axis by the region's place, and its standard deviation, px."""
    k, region = "xy".index(axis), target.region
    middle = (region.x, region.y)[k] + 0.5 * ((region.width, region.height)[k] - 1)
    if target.lens is not None:
        return middle - target.lens.matrix[2 + k], KNOWN_PX
    return middle - 0.5 * (target.frame_px[k] - 1), UNKNOWN_SHARE * 0.5 * float(np.hypot(*target.frame_px))


def _at(time_s: Floats, known_s: Floats, values: Floats) -> Floats:
    return np.asarray(np.interp(time_s, known_s, values))


def _step(pair: Pair, fit: Fit, zoom: Floats, smooth: Floats) -> tuple[float, float]:
    """What more of a lever (px) the innovations ask for, and its information, 1/px²; the ratio goes along.

    The smooth zoom is the instrument, without whose noise the lever is not drawn to zero (W. A. Fuller, Measurement
    error models, 1987, section 1.4, doi 10.1002/9780470316665).
    """
    times = pair.rows[:, 0] + fit.offset_s
    columns = (partial(_at, known_s=times, values=one) for one in (zoom, smooth))
    w = aligned(pair, fit.offset_s, *columns).whitened(fit.corner)
    grown, instrument, left = w.columns[:, -2], w.columns[:, -1], w.translation - fit.ratio * w.response
    if pair.ratio is None:
        power = max(w.product(w.response, w.response), 1e-300)
        instrument = instrument - w.product(instrument, w.response) / power * w.response
    common = w.product(instrument, grown)
    if common == 0.0:
        return 0.0, 0.0
    return w.product(instrument, left) / common, common**2 / w.product(instrument, instrument) / fit.noise
