"""Where a camera is from where it sees fixed targets: six degrees of freedom, frame by frame, of an exact pinhole.

A target at rest is seen along the ray r = (x, y, 1) and is 1/ρ away along the view. From the camera that has moved by t
and turned by R it is seen along Rᵀ (r − ρ t) (R. Hartley and A. Zisserman, Multiple View Geometry, 2004, chapter 6, doi
10.1017/CBO9780511811685). The six unknowns of a frame are found by weighted least squares, linearised anew until they
stay (Gauss-Newton). Axes: x right, y down, z along the view, right-handed; translations in m, rotations in rad.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from midspan.records import Floats

# A camera that sees nothing may be anywhere within this, m and rad: it keeps equations without a solution solvable.
ANYWHERE = 1.0
MAX_STEPS = 12
# The last step is this share of a standard deviation at most.
SETTLED = 1e-3
# Frames that are solved at once.
FRAMES = 20_000


@dataclass(frozen=True, slots=True, eq=False)
class Geometry:
    """Targets before a camera: focal_px (2,) along x and y; place_px (k, 2) from the optical axis, in the ideal picture
    of the reference frame; inverse_distance (k,), 1/m along the view, 0: far.
    """

    focal_px: Floats
    place_px: Floats
    inverse_distance: Floats

    def __len__(self) -> int:
        return len(self.inverse_distance)

    def moved_px(self, pose: Floats) -> Floats:
        """By how much the targets are seen to move (n, k, 2), px, from a camera at poses (n, 6)."""
        return self._seen(pose[:, :3], rotated(pose[:, 3:]))[0]

    def jacobian(self, pose: Floats) -> Floats:
        """Derivatives (n, k, 2, 6), px/m and px/rad, by translation and by turning about the camera's axes."""
        return self._seen(pose[:, :3], rotated(pose[:, 3:]))[1]

    def _seen(self, place: Floats, turned: Floats) -> tuple[Floats, Floats]:
        ray = np.column_stack((self.place_px / self.focal_px, np.ones(len(self))))
        back = np.swapaxes(turned, 1, 2)
        x, y, z = np.moveaxis((ray - self.inverse_distance[:, None] * place[:, None]) @ turned, -1, 0)
        by_ray = np.zeros((*x.shape, 2, 3))
        by_ray[..., 0, 0], by_ray[..., 0, 2] = self.focal_px[0] / z, -self.focal_px[0] * x / z**2
        by_ray[..., 1, 1], by_ray[..., 1, 2] = self.focal_px[1] / z, -self.focal_px[1] * y / z**2
        # A turn δ of the camera takes δ × ray from the ray.
        nothing = np.zeros_like(x)
        turn = np.stack([nothing, -z, y, z, nothing, -x, -y, x, nothing], axis=-1).reshape(*x.shape, 3, 3)
        shift = -self.inverse_distance[:, None, None] * back[:, None]
        moved = self.focal_px * np.stack((x / z, y / z), axis=-1) - self.place_px
        return moved, by_ray @ np.concatenate((shift, turn), axis=-1)

    def varied(self) -> Iterator["Geometry"]:
        """The same with a focal length that is larger by a factor e^1e-6, and with each target nearer by 1e-6/m."""
        yield replace(self, focal_px=self.focal_px * np.exp(VARIED))
        for k in range(len(self)):
            yield replace(self, inverse_distance=self.inverse_distance + VARIED * (np.arange(len(self)) == k))


VARIED = 1e-6


@dataclass(frozen=True, slots=True, eq=False)
class Poses:
    """Poses (n, 6): translation (m) and rotation vector (rad), with covariances (n, 6, 6).

    misfit (n,): sum of squared residuals over their variances; spare (n,): equations beyond six. Where there are fewer
    than six the pose is NaN and the covariance infinite.
    """

    value: Floats
    covariance: Floats
    misfit: Floats
    spare: Floats


def poses(geometry: Geometry, moved_px: Floats, variance_px2: Floats) -> Poses:
    """The pose in each frame in which the targets are seen moved by (n, k, 2) px; not finite: not seen."""
    parts = [slice(first, first + FRAMES) for first in range(0, max(len(moved_px), 1), FRAMES)]
    found = [_poses(geometry, moved_px[part], variance_px2[part]) for part in parts]
    return Poses(*(np.concatenate([getattr(one, name) for one in found]) for name in Poses.__slots__))


def _poses(geometry: Geometry, moved: Floats, variance: Floats) -> Poses:
    seen = np.isfinite(moved) & np.isfinite(variance) & (variance > 0.0)
    seen[~seen.all(axis=-1)] = False
    count = seen.sum(axis=(1, 2))
    weight = np.where(seen, 1.0 / np.where(seen, variance, 1.0), 0.0)
    moved = np.where(seen, moved, 0.0)
    place, turned = np.zeros((len(moved), 3)), np.tile(np.eye(3), (len(moved), 1, 1))
    for _ in range(MAX_STEPS):
        expected, by_pose = geometry._seen(place, turned)
        normal = _normal(by_pose, weight)
        step = np.linalg.solve(normal, np.einsum("nkap,nka->np", by_pose, weight * (moved - expected))[..., None])
        step = np.where(count[:, None] >= 6, step[..., 0], 0.0)
        place, turned = place + step[:, :3], turned @ rotated(step[:, 3:])
        # A step of this many standard deviations.
        if np.all(np.einsum("np,npq,nq->n", step, normal, step) < SETTLED**2):
            break
    expected, by_pose = geometry._seen(place, turned)
    covariance = np.linalg.inv(_normal(by_pose, weight))
    solved = count >= 6
    return Poses(
        np.where(solved[:, None], np.concatenate((place, rotation_vector(turned)), axis=1), np.nan),
        np.where(solved[:, None, None], covariance, np.inf),
        np.sum(weight * (moved - expected) ** 2, axis=(1, 2)),
        np.maximum(count - 6.0, 0.0),
    )


def _normal(by_pose: Floats, weight: Floats) -> Floats:
    normal: Floats = np.einsum("nkap,nka,nkaq->npq", by_pose, weight, by_pose, optimize=True)
    return normal + np.eye(6) / ANYWHERE**2


def inflation(geometry: Geometry, variance_px2: Floats) -> Floats:
    """By how much (6,) each degree is more uncertain than with the other five known; variance_px2 (k, 2).

    Large where targets do not tell degrees from each other; it does not depend on the size of the noise.
    """
    normal = _normal(geometry.jacobian(np.zeros((1, 6))), (1.0 / variance_px2)[None])[0]
    return np.asarray(np.sqrt(np.diag(np.linalg.inv(normal)) * np.diag(normal)))


def by_geometry(geometry: Geometry, pose: Floats, variance_px2: Floats) -> Floats:
    """What errors of the geometry make of poses (n, 6): derivatives (n, 6, 1 + k) by the logarithm of the focal length
    and the inverse distances, for pictures with variances (k, 2) of each frame.
    """
    weight = 1.0 / variance_px2
    found = np.empty((*pose.shape, 1 + len(geometry)))
    for first in range(0, len(pose), FRAMES):
        part = slice(first, first + FRAMES)
        expected, by_pose = geometry._seen(pose[part, :3], rotated(pose[part, 3:]))
        normal = _normal(by_pose, np.broadcast_to(weight, expected.shape))
        varied = [(other.moved_px(pose[part]) - expected) / VARIED for other in geometry.varied()]
        right = np.stack([np.einsum("nkap,nka->np", by_pose, weight * one) for one in varied], axis=-1)
        found[part] = -np.linalg.solve(normal, right)
    return found


def rotated(vector: Floats) -> Floats:
    """Rotation matrices (n, 3, 3) of rotation vectors (n, 3), by Rodrigues' formula."""
    angle = np.linalg.norm(vector, axis=-1)[..., None, None]
    x, y, z = np.moveaxis(vector, -1, 0)
    nothing = np.zeros_like(x)
    cross = np.stack([nothing, -z, y, z, nothing, -x, -y, x, nothing], axis=-1).reshape(*x.shape, 3, 3)
    safe = np.where(angle > 0.0, angle, 1.0)
    sine = np.where(angle > 0.0, np.sin(angle) / safe, 1.0)
    rest = np.where(angle > 0.0, (1.0 - np.cos(angle)) / safe**2, 0.5)
    return np.asarray(np.eye(3) + sine * cross + rest * cross @ cross)


def rotation_vector(turned: Floats) -> Floats:
    """Rotation vectors (n, 3) of rotation matrices (n, 3, 3) that turn by less than a quarter."""
    axis = 0.5 * np.stack(
        (
            turned[:, 2, 1] - turned[:, 1, 2],
            turned[:, 0, 2] - turned[:, 2, 0],
            turned[:, 1, 0] - turned[:, 0, 1],
        ),
        axis=-1,
    )
    sine = np.linalg.norm(axis, axis=-1, keepdims=True)
    return np.asarray(
        axis * np.where(sine > 0.0, np.arcsin(np.minimum(sine, 1.0)) / np.where(sine > 0.0, sine, 1.0), 1.0)
    )
