"""A picture of a lens calibration: where the board was seen, how far the corners miss, what the correction does."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from midspan.report.drawing import Colour, sheet, style, write_picture
from midspan.vision.checkerboard import LensFit
from midspan.vision.lens import straight

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# Misfits are tenths of a pixel and are drawn this many times longer.
LONGER = 200.0


def draw_lens(fit: LensFit, picture: NDArray[Any], path: Path) -> Path:
    """Write a picture file: a photograph (rows, columns) with the corners used and their misfits, the correction."""
    with style():
        figure = sheet(4.4, 11.0)
        left, right = figure.subplots(1, 2, width_ratios=(1.5, 1.0))
        _coverage(left, fit, picture)
        _correction(right, fit)
        return write_picture(figure, path, 110, facecolor="white")


def _coverage(axes: "Axes", fit: LensFit, picture: NDArray[Any]) -> None:
    width, height = fit.lens.size
    axes.imshow(picture, cmap="gray", alpha=0.5, extent=(-0.5, width - 0.5, height - 0.5, -0.5))
    places, off = fit.corners.reshape(-1, 2), fit.residuals.reshape(-1, 2)
    axes.plot(places[:, 0], places[:, 1], ".", color=Colour.BLUE, markersize=2.5)
    axes.quiver(
        *places.T, *(LONGER * off).T, color=Colour.VERMILLION, angles="xy", scale_units="xy", scale=1.0, width=0.0015
    )
    axes.plot(*fit.lens.matrix[2:], "+", color=Colour.VERMILLION, markersize=12)
    axes.set(xlim=(-0.5, width - 0.5), ylim=(height - 0.5, -0.5), xlabel="x, px", ylabel="y, px")
    axes.set_title(f"{fit.boards} boards, misfit {fit.rms_px:.2f} px rms (arrows {LONGER:g} times longer)")
    axes.grid(visible=False)


def _correction(axes: "Axes", fit: LensFit) -> None:
    """Ideal pixels a pixel of the picture along and across the radius, from the middle to the lower right corner."""
    width, height = fit.lens.size
    centre = np.array(fit.lens.matrix[2:])
    way = np.array([width - 1.0, height - 1.0]) - centre
    length = float(np.hypot(*way))
    unit = way / length
    share = np.linspace(0.0, 1.0, 200)
    slope = straight(centre + share[:, None] * way, fit.lens)[1]
    across = np.array([-unit[1], unit[0]])
    axes.plot(share * length, np.einsum("i,nij,j->n", unit, slope, unit), color=Colour.BLUE, label="along the radius")
    axes.plot(share * length, np.einsum("i,nij,j->n", across, slope, across), color=Colour.GREY, label="across it")
    if fit.lens.covered_px is not None:
        axes.axvline(fit.lens.covered_px, color=Colour.VERMILLION, linestyle="--", label="covered by boards")
    axes.set(xlabel="distance from the principal point, px", ylabel="ideal px per image px")
    axes.set_title("Local scale of the correction")
    axes.legend()
