"""The part of a camera's frames that a point needs: the regions of its targets and what is around them."""

from collections.abc import Sequence

import numpy as np

from midspan.calibration.sensors.camera import CameraCalibration
from midspan.records import Region
from midspan.settings.stored.calibration import Calibration

# Of a camera's frame more than its region is needed: by this many of its own widths on each side.
MARGIN = 0.5


def around(regions: Sequence[Region]) -> Region:
    """The smallest region that holds all of these."""
    x, y = min(one.x for one in regions), min(one.y for one in regions)
    right, low = max(one.x + one.width for one in regions), max(one.y + one.height for one in regions)
    return Region(x, y, right - x, low - y)


def wider(region: Region) -> Region:
    """A region with what is around it."""
    x, y = round(MARGIN * region.width), round(MARGIN * region.height)
    left, top = max(region.x - x, 0), max(region.y - y, 0)
    return Region(left, top, region.x + region.width + x - left, region.y + region.height + y - top)


def needed(calibration: Calibration) -> dict[str, Region]:
    """What is needed of each camera's frames with a calibration, by the cameras' names."""
    return {
        name: wider(around([target.region for target in one.used]))
        for name, _, one in calibration.sensors
        if isinstance(one, CameraCalibration)
    }


def part_of(pixels: np.ndarray, region: Region | None) -> tuple[np.ndarray, tuple[int, int]]:
    """The part of a frame (rows, columns) in a region, and its place (x, y); None: the whole frame."""
    if region is None:
        return np.ascontiguousarray(pixels), (0, 0)
    x, y = max(region.x, 0), max(region.y, 0)
    part = pixels[y : max(region.y + region.height, 0), x : max(region.x + region.width, 0)]
    return np.ascontiguousarray(part), (x, y)


def whole_frame(part: np.ndarray, place: tuple[int, int], shape: tuple[int, int]) -> np.ndarray:
    """A frame of this shape with a part at its place (x, y), so that all places stay those of the image.

    Around the part is its mean level: what is not transmitted must not look like a lit, sharp or unchanged image.
    """
    if part.shape == shape:
        return part
    (x, y), (rows, columns) = place, part.shape
    whole = np.full(shape, part.mean() if part.size else 0, dtype=part.dtype)
    whole[y : y + rows, x : x + columns] = part
    return whole
