"""What is worth telling of the pictures of a run, in words."""

import math

import numpy as np

from midspan.records import Floats, PixelTrack
from midspan.vision.picture_quality import SATURATED_SHARE, PictureWatch

TELLING_STD_PX = 0.003  # below this, compression does less than the noise of a usual frame
SWALLOWED = 3.0  # motion below so many standard deviations of the codec loses half of its size, or all
BLURRED = 0.5  # of the first frame's detail (square)
TOLD_SHARE, TOLD_FRAMES = 0.02, 3  # of the frames; and not less than so many
MOST_FRAMES = 0.5
COARSE_STD_PX = 0.06


def picture_warnings(watch: PictureWatch, track: PixelTrack, axes: str) -> list[str]:
    """What `watch` found, for the `track` before it was widened and the measured image axes "x", "y" or "xy"."""
    values, variances = zip(*(track.along(axis) for axis in axes), strict=True)
    most = max(values, key=_moved)
    least_known = max(variances, key=_typical)
    found = (_compression(watch, most), _blur(watch), _saturation(watch), _texture(least_known))
    return [text for text in found if text]


def _moved(value_px: Floats) -> float:
    """Standard deviation (px) of a translation (n,) with NaN where it is not known."""
    known = value_px[np.isfinite(value_px)]
    return float(np.std(known)) if len(known) else 0.0


def _typical(variance: Floats) -> float:
    """Median of variances (n,) with NaN where they are not known."""
    known = variance[np.isfinite(variance)]
    return float(np.median(known)) if len(known) else 0.0


def _compression(watch: PictureWatch, value_px: Floats) -> str:
    found = watch.compression
    if found.std_px < TELLING_STD_PX:
        return ""
    moved, limit = _moved(value_px), SWALLOWED * found.std_px
    scale = 100.0 * watch.relative_scale_std(value_px)
    small = (
        f"The motion measured here, {moved:.2g} px rms, is not larger: much of it may be missing."
        if moved < limit
        else f"The scale factor can be off by {scale:.2g} %."
    )
    shares = [f"a frame inherits {100.0 * found.inherited_share:.0f} % of the one before"]
    if found.frozen_share > 0.005:
        shares.append(f"{100.0 * found.frozen_share:.0f} % of the texture stands still")
    return (
        f"camera: the frames are compressed ({', '.join(shares)}). A standard deviation of {found.std_px:.2g} px is "
        f"added to each, and motion below about {limit:.2g} px can be lost. {small} Record raw or lossless, or at "
        "the best quality that the camera has."
    )


def _blur(watch: PictureWatch) -> str:
    sharp = watch.sharpness
    count = len(sharp)
    with np.errstate(invalid="ignore"):
        blurred = int(np.count_nonzero((sharp < BLURRED).any(axis=1)))
        sharper = int(np.count_nonzero((sharp > 1.0 / BLURRED).any(axis=1)))
    least = max(TOLD_SHARE * count, TOLD_FRAMES)
    # One frame out of focus at the start leaves all others sharper; a few sharper ones are brighter, or covered.
    if sharper > MOST_FRAMES * count:
        return (
            f"camera: {sharper} of {count} frames show more than twice the detail of the first one, which is out of "
            "focus or was taken in motion. Start at a sharp frame."
        )
    if blurred > least:
        return (
            f"camera: {blurred} of {count} frames show less than half the detail of the first one (motion blur or "
            "focus); their standard deviations are widened. Shorten the exposure or fix the focus."
        )
    return ""


def _saturation(watch: PictureWatch) -> str:
    share, single = watch.saturated_share, watch.saturated
    some = int(np.count_nonzero(single))
    if share <= SATURATED_SHARE and some > max(TOLD_SHARE * len(single), TOLD_FRAMES):
        most = 100.0 * float(single.max() / (1.0 + single.max()))
        return (
            f"camera: in {some} of {len(single)} frames pixels of the region are at the end of the scale, up to "
            f"{most:.0f} % of them; their standard deviations are widened. Fix the exposure, and keep glare out."
        )
    if share <= SATURATED_SHARE:
        return ""
    return (
        f"camera: {100.0 * share:.0f} % of the region's pixels are at the end of the scale (too bright or too dark). "
        "They show no motion, and the edges between them err. Change the exposure, or choose another region."
    )


def _texture(variance: Floats) -> str:
    std_px = math.sqrt(_typical(variance))
    if std_px <= COARSE_STD_PX:
        return ""
    return (
        f"camera: the region has little texture for its noise: a frame is known to ±{std_px:.2g} px (one standard "
        "deviation). Choose a larger region or one with more edges, or give it more light."
    )
