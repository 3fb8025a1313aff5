"""An inclinometer's angle in the image: its sign and size by the translation that the acceleration does not explain.

    p(t) = r D(t) + q f θ(t) + n

With sign and unit as declared q is 1. The angle is noisy, so means over a second are the instrument (W. A. Fuller,
Measurement error models, 1987, section 1.4, doi 10.1002/9780470316665); what noise they share with it is known from
draws.
"""

from collections.abc import Callable

import numpy as np

from midspan.calibration.agreement import misfit
from midspan.calibration.camera.difference import DRAWS, SEED, Share
from midspan.calibration.fit import Fit, Pair, aligned
from midspan.errors import UntrustedError
from midspan.fusion.targets import AGREE_STD
from midspan.notices import rounded
from midspan.records import Floats

# Faster than means over this time, s, an inclinometer's noise is more than a tilt.
SMOOTH_S = 1.0
# Shares that differ by less are the same size.
SAME_SIZE = 0.3


def angle_share(pair: Pair, fit: Fit, time_s: Floats, turned_px: Floats, noise_px: float) -> Share:
    """The share of a tilt (n,), px, in a translation whose fit is given; noise_px: standard deviation of one value."""
    window = np.hanning(2 * round(0.5 * SMOOTH_S / float(np.median(np.diff(time_s)))) + 3)[1:-1]

    def smooth(value: Floats) -> Floats:
        around = np.pad(value, len(window) // 2, "edge")
        return np.asarray(np.convolve(around, window / np.sum(window), "valid"))

    def at(values: Floats) -> Callable[[Floats], Floats]:
        return lambda stamps: np.interp(stamps - fit.offset_s, time_s, values)

    noise = noise_px * np.random.default_rng(SEED).normal(0.0, 1.0, (DRAWS, len(time_s)))
    raw = [turned_px - np.mean(turned_px), *noise]
    columns = [at(one) for one in (*raw, *(smooth(one) for one in raw))]
    w = aligned(pair, fit.offset_s, *columns).whitened(fit.corner)
    power = max(w.product(w.response, w.response), 1e-300)

    def without_motion(column: Floats) -> Floats:
        return np.asarray(column - w.product(column, w.response) / power * w.response)

    own, added = without_motion(w.columns[:, 0]), [without_motion(one) for one in w.columns[:, -len(columns) :].T]
    smoothed = added[len(raw) :]
    products = np.array([w.product(one, other) for one, other in zip(added[: len(raw)], smoothed, strict=True)])
    left, scatter = float(products[0] - np.mean(products[1:])), float(np.std(products[1:]))
    if left <= AGREE_STD * scatter:
        return Share(0.0, np.inf, 0.0)
    white = fit.noise * misfit(pair, fit).factor
    std = np.sqrt(white * w.product(smoothed[0], smoothed[0])) / left
    return Share(float(w.product(own, smoothed[0])) / left, float(std), scatter / left)


def is_shown(share: Share, channel: str) -> bool:
    """Whether the image shows the angle with its sign and size; channel: key of the column.

    Raises UntrustedError where it shows another sign or size.
    """
    if share.value < -AGREE_STD * share.std:
        raise UntrustedError(
            f"inclinometer: its angle has the wrong sign, the image turns by {share.value:.2g} ± {rounded(share.std)} "
            "times as much. Its axes are the camera's: x right, y down, z along the view, right-handed. Change the "
            f'sign: {channel} = "-NAME".'
        )
    if not share.allows(1.0) and abs(share.value - 1.0) > SAME_SIZE:
        raise UntrustedError(
            f"inclinometer: the image turns by {share.value:.3g} ± {rounded(share.std)} times its angle. Check "
            "inclinometer.unit (1 mm/m is 0.0573°, 1 rad 57.3°), its axis, its clock and camera.lens."
        )
    return share.std < SAME_SIZE
