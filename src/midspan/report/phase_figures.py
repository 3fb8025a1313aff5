"""The figure of the phase trackers: which pixels of the region tell the translation."""

from typing import Any

import numpy as np

from midspan.report.drawing import ORANGE, SKY, Picture, picture, sheet
from midspan.vision.hybrid import PhaseTracker

TINT = 0.45  # of the colour over an active pixel


def active_pixels(tracker: PhaseTracker) -> Picture:
    """The region in the reference frame, and its active pixels along x and y tinted."""
    region = tracker.measured_region
    pixels = np.asarray(tracker.reference.pixels, dtype=np.float64)
    cut = pixels[region.y : region.y + region.height, region.x : region.x + region.width]
    low, high = np.nanpercentile(cut, (0.5, 99.5))
    grey = np.clip((cut - low) / max(high - low, 1e-9), 0.0, 1.0)
    figure = sheet(3.2)
    for axes, axis, colour in zip(figure.subplots(1, 3), ("", "x", "y"), ("", ORANGE, SKY), strict=True):
        axes.set_title(_title(tracker, axis) if axis else f"region, {region.width} × {region.height} px", fontsize=9)
        axes.imshow(_tinted(grey, tracker.active_pixels(axis), colour) if axis else _tinted(grey, None, ""))
        axes.grid(False)
        axes.set_xlabel("x in the region (px)")
    return picture(figure, dots=True)


def _title(tracker: PhaseTracker, axis: str) -> str:
    k = "xy".index(axis)
    share, fit = 100.0 * float(np.mean(tracker.active_pixels(axis))), tracker.model.r_squared[k]
    how = f"learnt, R² = {fit:.4f}" if np.isfinite(fit) else "by amplitude"
    return f"active along {axis}: {share:.0f} % ({how})"


def _tinted(grey: Any, active: Any, colour: str) -> Any:
    """An image (rows, columns, 3) from 0 to 1 with the pixels of the mask coloured."""
    from matplotlib.colors import to_rgb

    out = np.repeat(grey[:, :, None], 3, axis=2)
    if active is not None:
        out[active] = (1.0 - TINT) * out[active] + TINT * np.array(to_rgb(colour))
    return out
