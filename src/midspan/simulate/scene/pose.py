"""A camera that moves and turns with its structure, before planes at several distances: an exact pinhole with a lens.

A pixel's ray d, freed of the lens, is turned by the camera's rotation R and starts at its place t. It meets the plane
at the distance Z at the point t + s R d with s = (Z − t_z) / (R d)_z (R. Hartley and A. Zisserman, Multiple View
Geometry, 2004, chapter 6, doi 10.1017/CBO9780511811685). Axes: x right, y down, z along the view, right-handed.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np

from midspan.checks import refuse
from midspan.records import Floats, Region
from midspan.simulate.motion.motion import Motion, Rest
from midspan.simulate.scene.camera import Camera, Pixels
from midspan.simulate.scene.scene import Image, Scene
from midspan.vision.pose import rotated

# Of the motion within one exposure: at 5 Hz and 10 ms they leave 0.04 % of what the exposure takes.
MOMENTS = 3


@dataclass(frozen=True, slots=True)
class Pose:
    """Where a camera is: translation along x, y, z (m) and rotation vector about them (rad), as motions."""

    translation: tuple[Motion, Motion, Motion] = (Rest(), Rest(), Rest())
    rotation: tuple[Motion, Motion, Motion] = (Rest(), Rest(), Rest())

    def at(self, time_s: Floats) -> tuple[Floats, Floats]:
        """Place (n, 3) in m and rotation (n, 3, 3) from the camera's axes to those at rest, at times (n,)."""
        place = np.stack([motion.displacement(time_s) for motion in self.translation], axis=-1)
        vector = np.stack([motion.displacement(time_s) for motion in self.rotation], axis=-1)
        return place, rotated(vector)


@dataclass(frozen=True, slots=True)
class Plane:
    """What fills a part of the picture: a scene of its size, square to the view at rest, `distance_m` away."""

    region: Region
    scene: Scene
    distance_m: float


@dataclass(frozen=True, slots=True)
class PosedView:
    """A camera before planes; the optical axis is the middle of the picture of rows by columns pixels.

    focal_px: focal length, px; k1: radial distortion of the lens (D. C. Brown, Photogramm. Eng. 32 (1966) 444-462): a
    ray at the radius r is seen at r (1 + k1 r²).
    """

    planes: tuple[Plane, ...]
    pose: Pose
    shape: tuple[int, int]
    focal_px: float
    k1: float = 0.0
    camera: Camera = field(default_factory=Camera)

    def mean_image(self, stamp_s: float) -> Image:
        """The noise-free picture (rows, columns) in DN stamped `stamp_s` (true time)."""
        moments = self.camera.moments(stamp_s, self.shape[0], MOMENTS)
        place, turned = self.pose.at(moments)
        image: Image = np.zeros(self.shape, dtype=np.float32)
        for plane in self.planes:
            own = plane.region
            ray = _rays(own, self.shape, self.focal_px, self.k1)
            lines = slice(own.y, own.y + own.height) if len(moments) > 1 else slice(0, 1)
            part = np.zeros((own.height, own.width), dtype=np.float32)
            for k in range(moments.shape[1]):
                part += self._seen(plane, ray, place[lines, k], turned[lines, k])
            image[own.slices] = part / np.float32(moments.shape[1])
        return image

    def film(self, stamps_s: Floats, *, rng: np.random.Generator) -> Iterator[Pixels]:
        """The pictures at the true times `stamps_s` (n,), one after the other."""
        for stamp in stamps_s:
            yield self.camera.expose(self.mean_image(float(stamp)), rng=rng)

    def _seen(self, plane: Plane, ray: Floats, place: Floats, turned: Floats) -> Image:
        """A plane from one place and rotation (1 or rows, …)."""
        world = np.einsum("rij,rcj->rci", np.broadcast_to(turned, (len(ray), 3, 3)), ray)
        steps = (plane.distance_m - place[:, None, 2]) / world[..., 2]
        if not np.all(steps > 0.0):
            raise refuse("pose", "before its planes", "a camera behind one")
        # The texture has a pixel where a pixel sees it at rest, without the lens.
        per_m = self.focal_px / plane.distance_m
        x = per_m * (place[:, None, 0] + steps * world[..., 0]) + 0.5 * (self.shape[1] - 1) - plane.region.x
        y = per_m * (place[:, None, 1] + steps * world[..., 1]) + 0.5 * (self.shape[0] - 1) - plane.region.y
        return plane.scene.at_points(y, x)


@lru_cache(maxsize=8)
def _rays(region: Region, shape: tuple[int, int], focal_px: float, k1: float) -> Floats:
    """Rays (…, 3) of a region's pixels, without the lens; those of all frames are the same."""
    down, across = np.mgrid[region.y : region.y + region.height, region.x : region.x + region.width].astype(np.float64)
    x = (across - 0.5 * (shape[1] - 1)) / focal_px
    y = (down - 0.5 * (shape[0] - 1)) / focal_px
    seen, radius = np.hypot(x, y), np.hypot(x, y)
    for _ in range(20):
        radius = seen / (1.0 + k1 * radius**2)
    scale = np.where(seen > 0.0, radius / np.where(seen > 0.0, seen, 1.0), 1.0)
    rays = np.stack([scale * x, scale * y, np.ones_like(x)], axis=-1)
    rays.setflags(write=False)
    return rays
