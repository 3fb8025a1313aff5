"""SURF: blobs by box filters on an integral image, and their descriptors of 64 values.

Bay, Tuytelaars and Van Gool, "SURF: speeded up robust features", 2006, doi 10.1007/11744023_32. Derivatives of a
Gaussian are replaced by boxes of sizes 9, 15, 21, 27 … px, a filter of size L standing for the scale 1.2 L / 9 px.
A blob is a maximum of the Hessian's determinant over position and scale, refined by a quadratic in all three.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from midspan import _core
from midspan.records import Floats
from midspan.vision.spline import Floats32


@dataclass(frozen=True, slots=True)
class SurfSettings:
    """Which blobs are kept.

    octaves: doublings of the filters' size, 1 to 4. threshold: least determinant, in the image's variance or in
    `contrast` where that is less; lower gives more and weaker blobs. most: the strongest so many are kept. upright:
    without orientation, for a camera that rolls less than some 15 degrees; quicker and more distinctive.
    """

    octaves: int = 3
    threshold: float = 0.002
    most: int = 400
    upright: bool = True
    contrast: float = math.inf


@dataclass(frozen=True, slots=True)
class Blobs:
    """Blobs (n,) of an image, strongest first: position x, y and scale in px, and the determinant there.

    `bright` is 1 for a dark blob on bright ground and -1 for the reverse; `descriptor` (n, 64) has unit length.
    """

    x: Floats
    y: Floats
    scale: Floats
    strength: Floats
    bright: NDArray[np.int8]
    descriptor: Floats32


def detect_surf(image: Floats32, settings: SurfSettings) -> Blobs:
    """The blobs of `image` (rows, columns), float32, with their descriptors."""
    rows, descriptor, bright = _core.surf_blobs(image, settings)
    x, y, scale, strength = rows.T
    return Blobs(x, y, scale, strength, bright, descriptor)
