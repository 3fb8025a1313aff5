"""Features of an image cut, by SURF or OpenCV's detectors."""

import importlib
import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from midspan import _core
from midspan.errors import UsageError
from midspan.records import Floats, Floats32
from midspan.vision.texture import values


@dataclass(frozen=True, slots=True)
class SurfSettings:
    """Which blobs are kept.

    octaves: doublings of the filters' size, 1 to 4. threshold: least determinant, in the image's variance or in
    `contrast` where that is less; lower gives more and weaker blobs. least: the same in squared values of the image,
    whatever its contrast; the greater of both counts. most: the strongest this many are kept. upright:
    without orientation, for a camera that rolls less than some 15 degrees; quicker and more distinctive.
    """

    octaves: int = 3
    threshold: float = 0.002
    most: int = 400
    upright: bool = True
    contrast: float = math.inf
    least: float = 0.0


DETECTORS = {
    "surf": "box-filter blobs (Bay 2006), the published choice; may still be patented in some countries",
    "sift": "difference-of-Gaussian blobs; exact and slow",
    "akaze": "blobs of a non-linear scale space, binary descriptors",
    "orb": "corners with binary descriptors; quick and coarse",
}
# OpenCV's detectors other than SIFT find nothing in a small region unless it is enlarged; SIFT enlarges it itself.
ENLARGED = ("surf", "akaze", "orb")
# ORB's corners lie on whole pixels of its pyramid: an error that all of them share and their scatter does not show.
GRID_STD_PX = {"orb": 0.07}


@dataclass(frozen=True, slots=True)
class Keypoints:
    """Features (n,) of an image, strongest first: `xy` (n, 2) in px of the whole image, `descriptor` (n, m) float32.

    `kind` (n,) must be equal in two features that match (the sign of a SURF blob, else 0).
    """

    xy: Floats
    descriptor: Floats32
    kind: NDArray[np.int8]

    def part(self, which: NDArray[np.generic]) -> "Keypoints":
        """The features of a mask or index array."""
        return Keypoints(self.xy[which], self.descriptor[which], self.kind[which])

    def __len__(self) -> int:
        return len(self.xy)


class Detector:
    """One of DETECTORS; `level` and `span` say which values of the image OpenCV's 8 bit grey scale should cover."""

    def __init__(self, name: str, settings: SurfSettings, *, level: float = 0.0, span: float = 255.0) -> None:
        self.name, self.settings = name, settings
        self.level, self.span = level, span

    def detect(
        self, image: NDArray[np.generic], place: tuple[int, int, int, int], offset: float, most: int
    ) -> Keypoints:
        """At most `most` features of the part at `place` (x, y, width, height) of an image.

        `offset` is taken off its pixels. No features where more than 2 % of them have no value.
        """
        if self.name == "surf":
            return Keypoints(*_core.surf_features(image, place, offset, replace(self.settings, most=most)))
        x, y, width, height = place
        pixels = values(image[y : y + height, x : x + width], offset)
        if pixels is None:
            return Keypoints(np.empty((0, 2)), np.empty((0, 1), dtype=np.float32), np.empty(0, dtype=np.int8))
        enlarged = self.name in ENLARGED
        pixels = _core.doubled_image(pixels) if enlarged else pixels
        grey = np.clip(np.rint((pixels - self.level) * (255.0 / self.span)), 0, 255).astype(np.uint8)
        xy, descriptor = _by_opencv(grey, self.name, most)
        return Keypoints(
            xy * (0.5 if enlarged else 1.0) + np.array([x, y], dtype=np.float64),
            descriptor,
            np.zeros(len(xy), dtype=np.int8),
        )


def _by_opencv(grey: NDArray[np.uint8], name: str, most: int) -> tuple[Floats, Floats32]:
    """Positions (n, 2) and descriptors (n, m), strongest first; binary ones as numbers +1 and -1."""
    found, descriptor = _opencv_detector(name, most).detectAndCompute(grey, None)
    if descriptor is None or not found:
        return np.empty((0, 2)), np.empty((0, 1), dtype=np.float32)
    order = np.argsort([-p.response for p in found], kind="stable")[:most]
    xy = np.array([p.pt for p in found], dtype=np.float64)[order]
    rows = np.ascontiguousarray(descriptor[order])
    if rows.dtype == np.uint8:
        rows = 2.0 * np.unpackbits(rows, axis=1) - 1.0
    return xy, rows.astype(np.float32)


def _opencv_detector(name: str, most: int) -> Any:
    cv2: Any = importlib.import_module("cv2")
    if name == "sift":
        return cv2.SIFT_create(nfeatures=most)
    if name == "orb":
        return cv2.ORB_create(nfeatures=most, fastThreshold=5, edgeThreshold=16, patchSize=31)
    # AKAZE moved from the main module to xfeatures2d of the contrib wheel with OpenCV 5.
    make = getattr(cv2, "AKAZE_create", None) or getattr(getattr(cv2, "xfeatures2d", None), "AKAZE_create", None)
    if make is None:
        raise UsageError(
            f"The detector 'akaze' needs OpenCV with its contrib modules; OpenCV {cv2.__version__} without them is "
            "installed. Install opencv-contrib-python-headless, or choose the detector 'sift'."
        )
    return make(threshold=1e-4)
