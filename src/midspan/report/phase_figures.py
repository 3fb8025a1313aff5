"""The figure of the phase trackers: which pixels of the region tell the translation."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from midspan.report.drawing import ORANGE, SKY, Picture, picture, sheet
from midspan.signals.health import Mask
from midspan.vision.active_pixels import ActivePixels

TINT = 0.45  # of the colour over an active pixel


def active_pixels(found: ActivePixels, reference: NDArray[Any]) -> Picture:
    """The region in the `reference` frame (rows, columns), and its active pixels along x and y tinted."""
    region = found.region
    pixels = np.asarray(reference, dtype=np.float64)
    cut = pixels[region.y : region.y + region.height, region.x : region.x + region.width]
    low, high = np.nanpercentile(cut, (0.5, 99.5))
    grey = np.clip((cut - low) / max(high - low, 1e-9), 0.0, 1.0)
    figure = sheet(3.2)
    whole, *others = figure.subplots(1, 3)
    whole.set_title(f"region, {region.width} × {region.height} px", fontsize=9)
    whole.imshow(_tinted(grey, None, ""))
    for axes, axis, mask, fit, colour in zip(
        others, "xy", (found.x, found.y), found.r_squared, (ORANGE, SKY), strict=True
    ):
        axes.set_title(_title(axis, mask, fit), fontsize=9)
        axes.imshow(_tinted(grey, mask, colour))
    for axes in (whole, *others):
        axes.grid(False)
        axes.set_xlabel("x in the region (px)")
    return picture(figure)


def _title(axis: str, mask: Mask, fit: float) -> str:
    how = f"learnt, R² = {fit:.4f}" if np.isfinite(fit) else "by amplitude"
    return f"active along {axis}: {100.0 * float(np.mean(mask)):.0f} % ({how})"


def _tinted(grey: Any, active: Any, colour: str) -> Any:
    """An image (rows, columns, 3) from 0 to 1 with the pixels of the mask coloured."""
    from matplotlib.colors import to_rgb

    out = np.repeat(grey[:, :, None], 3, axis=2)
    if active is not None:
        out[active] = (1.0 - TINT) * out[active] + TINT * np.array(to_rgb(colour))
    return out
