"""Features of an image cut, by SURF or OpenCV's detectors, and their matches by the nearest descriptor."""

import importlib
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from midspan.errors import UsageError
from midspan.records import Floats
from midspan.vision.spline import Floats32
from midspan.vision.surf import SurfSettings, detect_surf, doubled

DETECTORS = {
    "surf": "box-filter blobs (Bay 2006), the published choice; may still be patented in some countries",
    "sift": "difference-of-Gaussian blobs; exact and slow",
    "akaze": "blobs of a non-linear scale space, binary descriptors",
    "orb": "corners with binary descriptors; quick and coarse",
}
# OpenCV's detectors other than SIFT find nothing in a small region unless it is enlarged; SIFT enlarges it itself.
ENLARGED = ("surf", "akaze", "orb")
FAR = np.float32(3.0e38)
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

    def detect(self, image: Floats32, origin: tuple[int, int], most: int) -> Keypoints:
        """At most `most` features of `image` (rows, columns), whose first pixel is `origin` (x, y) of the whole one."""
        enlarged = self.name in ENLARGED
        pixels = doubled(image) if enlarged else image
        if self.name == "surf":
            blobs = detect_surf(pixels, replace(self.settings, most=most))
            xy, descriptor, kind = np.stack([blobs.x, blobs.y], axis=1), blobs.descriptor, blobs.bright
        else:
            grey = np.clip(np.rint((pixels - self.level) * (255.0 / self.span)), 0, 255).astype(np.uint8)
            xy, descriptor = _by_opencv(grey, self.name, most)
            kind = np.zeros(len(xy), dtype=np.int8)
        return Keypoints(xy * (0.5 if enlarged else 1.0) + np.array(origin, dtype=np.float64), descriptor, kind)


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


@njit(cache=True, fastmath=True)
def squared_distances(a: Floats32, b: Floats32, kind_a: NDArray[np.int8], kind_b: NDArray[np.int8]) -> Floats32:
    """Squared distances (n, m) of all descriptors (n, k) from all others (m, k); very large between kinds."""
    out = np.empty((a.shape[0], b.shape[0]), dtype=np.float32)
    for i in range(a.shape[0]):
        for j in range(b.shape[0]):
            if kind_a[i] != kind_b[j]:
                out[i, j] = FAR
                continue
            total = np.float32(0.0)
            for k in range(a.shape[1]):
                d = a[i, k] - b[j, k]
                total += d * d
            out[i, j] = total
    return out


def mutual_matches(first: Keypoints, now: Keypoints) -> NDArray[np.int64]:
    """Matches (n, 2) as indices into `first` and `now`: features that are each other's nearest by descriptor."""
    square = _squares(first, now)
    if square is None:
        return np.empty((0, 2), dtype=np.int64)
    nearest, rows = square.argmin(axis=1), np.arange(len(first))
    keep = (square.argmin(axis=0)[nearest] == rows) & (square[rows, nearest] < FAR)
    return np.stack([rows[keep], nearest[keep]], axis=1).astype(np.int64)


def ratio_matches(first: Keypoints, now: Keypoints, ratio: float) -> NDArray[np.int64]:
    """Matches (n, 2) of each feature of `first` whose nearest in `now` is nearer than `ratio` times the second "
    "nearest."""
    square = _squares(first, now)
    if square is None:
        return np.empty((0, 2), dtype=np.int64)
    two = np.partition(square, 1, axis=1)[:, :2].astype(np.float64)
    keep = two[:, 0] < ratio**2 * two[:, 1]
    return np.stack([np.flatnonzero(keep), square.argmin(axis=1)[keep]], axis=1).astype(np.int64)


def _squares(first: Keypoints, now: Keypoints) -> Floats32 | None:
    """Squared distances of the descriptors, None when there are too few features for a match."""
    if len(first) < 2 or len(now) < 2 or first.descriptor.shape[1] != now.descriptor.shape[1]:
        return None
    square: Floats32 = squared_distances(first.descriptor, now.descriptor, first.kind, now.kind)
    return square
