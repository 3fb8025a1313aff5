"""A checkerboard as a distorting camera shows it: the lens formulas in plain NumPy, applied by inverse mapping."""

from dataclasses import replace

import cv2
import numpy as np
from scipy.special import erf

from midspan.records import PixelTranslation, Region
from midspan.vision.lens import Lens, straight
from midspan.vision.target import lost

SIZE = (640, 480)
PINHOLE = {"matrix": (520.0, 515.0, 331.0, 236.0), "distortion": (-0.28, 0.09, 0.0011, -0.0007, -0.012)}
FISHEYE = {"matrix": (300.0, 298.0, 325.0, 238.0), "distortion": (0.04, -0.012, 0.004, -0.0008)}


def pinhole_image(x, y, distortion):
    """Where rays (x, y) fall, in units of the focal length: OpenCV's documented polynomial with k1 k2 p1 p2 k3."""
    k1, k2, p1, p2, k3 = distortion
    u = x**2 + y**2
    radial = 1 + k1 * u + k2 * u**2 + k3 * u**3
    return x * radial + 2 * p1 * x * y + p2 * (u + 2 * x**2), y * radial + p1 * (u + 2 * y**2) + 2 * p2 * x * y


def fisheye_image(x, y, distortion):
    """The same for the fisheye: the angle from the axis becomes the radius."""
    r = np.maximum(np.hypot(x, y), 1e-12)
    angle = np.arctan(r)
    bent = angle * (1 + sum(k * angle ** (2 * i + 2) for i, k in enumerate(distortion)))
    return x * bent / r, y * bent / r


IMAGES = {"pinhole": pinhole_image, "fisheye": fisheye_image}


def rays(model, case, x, y):
    """Rays of the places (x, y) px by fixed-point steps on the formula, to 1e-10 px; every step shrinks the error."""
    fx, fy, cx, cy = case["matrix"]
    there_x, there_y = (x - cx) / fx, (y - cy) / fy
    on_x, on_y = there_x.copy(), there_y.copy()
    for _ in range(100):
        seen_x, seen_y = IMAGES[model](on_x, on_y, case["distortion"])
        step_x, step_y = there_x - seen_x, there_y - seen_y
        on_x, on_y = on_x + step_x, on_y + step_y
        if max(np.abs(step_x).max(), np.abs(step_y).max()) < 1e-13:
            break
    return on_x, on_y


def places(model, case, x, y):
    """Places (px) of rays (x, y)."""
    fx, fy, cx, cy = case["matrix"]
    seen_x, seen_y = IMAGES[model](x, y, case["distortion"])
    return fx * seen_x + cx, fy * seen_y + cy


def turn(about_x, about_y, about_z):
    """Rotation matrix of three angles in degrees."""
    a, b, c = np.radians((about_x, about_y, about_z))
    x = np.array([[1, 0, 0], [0, np.cos(a), -np.sin(a)], [0, np.sin(a), np.cos(a)]])
    y = np.array([[np.cos(b), 0, np.sin(b)], [0, 1, 0], [-np.sin(b), 0, np.cos(b)]])
    z = np.array([[np.cos(c), -np.sin(c), 0], [np.sin(c), np.cos(c), 0], [0, 0, 1]])
    return z @ y @ x


class Scene:
    """Pictures of a board of squares of 25 mm by one camera whose lens and pixels blur an edge by 0.7 px."""

    def __init__(self, model, case, size=SIZE, columns=9, rows=6):
        self.columns, self.rows, self.size = columns, rows, size
        self.ray_x, self.ray_y = rays(model, case, *np.meshgrid(np.arange(size[0], dtype=float), np.arange(size[1])))
        self.model, self.case = model, case

    def pose(self, centre_px, distance_mm, angles):
        """Rotation and shift that put the board's middle on the ray of a place of the picture."""
        ray_x, ray_y = rays(self.model, self.case, np.array([centre_px[0]]), np.array([centre_px[1]]))
        rotation = turn(*angles)
        middle = 12.5 * np.array([self.columns - 1, self.rows - 1, 0.0])
        return rotation, distance_mm * np.array([ray_x[0], ray_y[0], 1.0]) - rotation @ middle

    def corners(self, pose):
        """Where the inner corners truly appear (n, 2), px."""
        rotation, shift = pose
        x, y = np.meshgrid(25.0 * np.arange(self.columns), 25.0 * np.arange(self.rows))
        there = np.column_stack((x.ravel(), y.ravel(), np.zeros(x.size))) @ rotation.T + shift
        seen = places(self.model, self.case, there[:, 0] / there[:, 2], there[:, 1] / there[:, 2])
        return np.column_stack(seen)

    def picture(self, pose, rng):
        """The board before grey, uint8, with noise of 1.5 levels."""
        rotation, shift = pose
        # The ray s (x, y, 1) meets the board's plane where n·(s r − shift) = 0.
        normal = rotation[:, 2]
        along = normal @ shift / (normal[0] * self.ray_x + normal[1] * self.ray_y + normal[2])
        away = np.stack((along * self.ray_x - shift[0], along * self.ray_y - shift[1], along - shift[2]), axis=-1)
        on_x, on_y = (away @ rotation[:, 0]) / 25.0, (away @ rotation[:, 1]) / 25.0
        blur_x, blur_y = blur(on_x), blur(on_y)
        squares = edges(on_x, blur_x) * edges(on_y, blur_y)
        board = within(on_x, blur_x, -1.0, self.columns) * within(on_y, blur_y, -1.0, self.rows)
        margin = within(on_x, blur_x, -1.7, self.columns + 0.7) * within(on_y, blur_y, -1.7, self.rows + 0.7)
        light = 120.0 + np.where(along > 0, margin * 90.0 - board * (90.0 - 90.0 * squares), 0.0)
        return np.clip(np.rint(light + rng.normal(0.0, 1.5, light.shape)), 0, 255).astype(np.uint8)


def blur(on):
    """Standard deviation of the blur (0.7 px) in the unit of the coordinate `on` (rows, columns)."""
    return 0.7 * np.hypot(*np.gradient(on)) + 1e-9


def edges(on, blur_std):
    """+1 and −1 in turn between whole numbers, blurred."""
    nearest = np.rint(on)
    return np.where(nearest % 2 == 0, 1.0, -1.0) * erf((on - nearest) / (np.sqrt(2.0) * blur_std))


def within(on, blur_std, low, high):
    """1 between two coordinates and 0 outside, blurred."""
    width = np.sqrt(2.0) * blur_std
    return 0.25 * (1.0 + erf((on - low) / width)) * (1.0 + erf((high - on) / width))


def poses(scene, count, seed, tilt=35.0, distance_mm=(330.0, 480.0)):
    """Poses spread over the picture whose corners all lie in it; a tilt of 0 leaves the board facing the camera."""
    rng = np.random.default_rng(seed)
    found = []
    for _ in range(400 * count):
        centre = rng.uniform((0.1 * scene.size[0], 0.1 * scene.size[1]), (0.9 * scene.size[0], 0.9 * scene.size[1]))
        angles = (rng.uniform(-tilt, tilt), rng.uniform(-tilt, tilt), rng.uniform(-30.0, 30.0))
        pose = scene.pose(centre, rng.uniform(*distance_mm), angles)
        there = scene.corners(pose)
        if (there > 14).all() and (there < np.array(scene.size) - 15).all():
            found.append(pose)
        if len(found) == count:
            break
    return found


def write_pictures(folder, count, seed):
    """`count` pictures of a board through PINHOLE, the first one a second time, and one without a board."""
    folder.mkdir()
    scene, rng = Scene("pinhole", PINHOLE), np.random.default_rng(seed)
    there = poses(scene, count, seed)
    for k, pose in enumerate([*there, there[0]]):
        cv2.imwrite(str(folder / f"{k}.png"), scene.picture(pose, rng))
    cv2.imwrite(str(folder / "99.png"), np.full(SIZE[::-1], 128, np.uint8))
    return folder


def ideal_translation(found: PixelTranslation, region: Region, lens: Lens | None) -> PixelTranslation:
    """What was `found` of the target in `region` in pixels of the ideal pinhole camera, as the core must give it.

    Translation = ideal place of the region's middle now - its ideal place in the reference frame. Variances pass
    through the derivatives, the errors along x and y taken as independent. LOST where the model does not reach.
    """
    if lens is None:
        return found
    middle = np.array([region.x + 0.5 * (region.width - 1), region.y + 0.5 * (region.height - 1)])
    (origin, place), slopes = straight(np.stack((middle, middle + np.array([found.x_px, found.y_px]))), lens)
    if not np.isfinite(place).all():
        return replace(lost(found.time_ns, found.events), unseen=found.unseen)
    own = slopes[1] ** 2 @ np.array([found.variance_x_px2, found.variance_y_px2])
    reference = slopes[1] ** 2 @ np.array([found.reference_variance_x_px2, found.reference_variance_y_px2])
    x, y = (place - origin).tolist()
    return replace(
        found,
        x_px=x,
        y_px=y,
        variance_x_px2=float(own[0]),
        variance_y_px2=float(own[1]),
        reference_variance_x_px2=float(reference[0]),
        reference_variance_y_px2=float(reference[1]),
    )
