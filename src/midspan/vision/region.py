"""Arithmetic of regions of interest: check, clamp, shift."""

from collections.abc import Sequence

import numpy as np

from midspan.checks import refuse
from midspan.errors import DataError, UsageError
from midspan.records import Frame, Region

MIN_SIDE_PX = 12  # a window below this has too few pixels for a sub-pixel peak


def region_of(roi: Region | Sequence[int]) -> Region:
    """The region of x, y, width and height in px; UsageError for anything but four whole numbers."""
    if isinstance(roi, Region):
        return roi
    if not isinstance(roi, Sequence) or len(roi) != 4 or not all(isinstance(one, int | np.integer) for one in roi):
        raise refuse("roi", "four whole numbers x, y, width, height (px)", roi)
    return Region(*map(int, roi))


def check_region(region: Region, columns: int, rows: int) -> Region:
    """Return `region` if it lies inside an image of `columns` by `rows` px and is not too small; else UsageError."""
    received = f"received x={region.x}, y={region.y}, width={region.width}, height={region.height}"
    if not region.inside(columns, rows):
        raise UsageError(
            f"camera.roi must lie inside the image ({columns}x{rows} px); {received}. Correct roi, or leave it out to "
            "have it chosen."
        )
    if min(region.width, region.height) < MIN_SIDE_PX:
        raise UsageError(
            f"camera.roi must be at least {MIN_SIDE_PX} px wide and high; {received}. Give a larger region."
        )
    return region


def inner(region: Region, columns: int, rows: int, inset_px: int) -> Region:
    """The part of a region that keeps `inset_px` away from the border of an image; UsageError where it is too small."""
    x0, y0 = max(region.x, inset_px), max(region.y, inset_px)
    x1, y1 = min(region.x + region.width, columns - inset_px), min(region.y + region.height, rows - inset_px)
    if min(x1 - x0, y1 - y0) < MIN_SIDE_PX:
        raise UsageError(
            f"camera.roi must keep at least {MIN_SIDE_PX} px of width and height {inset_px} px away from the "
            f"border of the image ({columns}x{rows} px); received {region}. Move it inwards or make it larger."
        )
    return Region(x0, y0, x1 - x0, y1 - y0)


def clamp(region: Region, columns: int, rows: int) -> Region:
    """The region of the same size, or the image's where that is smaller, moved the least to lie inside the image."""
    if region.inside(columns, rows):
        return region
    width, height = min(region.width, columns), min(region.height, rows)
    x = min(max(region.x, 0), columns - width)
    y = min(max(region.y, 0), rows - height)
    return Region(x, y, width, height)


def shift(region: Region, dx: float, dy: float) -> Region:
    """The region moved by (dx, dy) px, rounded to whole pixels (equation 28 of doi 10.1111/mice.12767)."""
    return Region(region.x + round(dx), region.y + round(dy), region.width, region.height)


def check_size(frame: Frame, reference: Frame) -> None:
    """DataError naming both sizes (px) unless `frame` has the size of the reference frame."""
    if frame.pixels.shape == reference.pixels.shape:
        return
    now, then = ("x".join(str(n) for n in picture.pixels.shape[::-1]) for picture in (frame, reference))
    raise DataError(
        f"All frames must have the size of the first ({then} px); frame {frame.index} has {now} px. "
        "Split the recording where the camera's format changed."
    )
