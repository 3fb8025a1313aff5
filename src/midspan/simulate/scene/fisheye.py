"""A texture as the frames of a fisheye lens show it, exact in every pixel.

OpenCV's fisheye model: a ray at the angle θ to the axis falls θ (1 + k1 θ² + k2 θ⁴ + k3 θ⁶ + k4 θ⁸) focal lengths from
the principal point, in the ideal pinhole picture tan θ of them. The texture is a sum of plane waves over the ideal
picture, which a displacement translates as a whole.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from midspan.records import Floats, Region
from midspan.simulate.scene.scene import Image

WAVES = 300
CYCLES_PER_PX = (0.005, 0.35)  # of the waves; their logarithms are even, as of a natural scene's 1/f
MEAN_DN, STD_DN = 128.0, 30.0
BLUR_PX = 0.67  # standard deviation of the blur by lens and pixel
_NEWTON_STEPS = 12  # more than ten times what double precision needs within 60° of the axis


@dataclass(frozen=True, slots=True)
class Fisheye:
    """A fisheye lens, and frames of `size_px` (rows, columns) that are black outside the region `lit`.

    matrix: fx, fy, cx, cy in px, from the middle of the first pixel; distortion: k1 … k4; roi: the target's region,
    within `lit`.
    """

    matrix: tuple[float, float, float, float]
    distortion: tuple[float, float, float, float]
    size_px: tuple[int, int]
    lit: Region
    roi: Region

    def ideal(self, x_px: Floats, y_px: Floats) -> tuple[Floats, Floats]:
        """Places (x, y) in px of the ideal pinhole picture of what the frames show at x_px, y_px (any one shape)."""
        fx, fy, cx, cy = self.matrix
        x, y = (x_px - cx) / fx, (y_px - cy) / fy
        radius = np.maximum(np.hypot(x, y), 1e-12)
        model = np.polynomial.Polynomial([0.0, 1.0, *(c for k in self.distortion for c in (0.0, k))])
        slope, angle = model.deriv(), radius
        for _ in range(_NEWTON_STEPS):
            angle = angle - (model(angle) - radius) / slope(angle)
        outward = np.tan(angle) / radius
        return fx * outward * x + cx, fy * outward * y + cy

    def whole(self, lit: NDArray[Any]) -> NDArray[Any]:
        """The whole frame (rows, columns) around the pixels of the region `lit`."""
        frame = np.zeros(self.size_px, dtype=lit.dtype)
        frame[self.lit.slices] = lit
        return frame

    def settings(self) -> dict[str, Any]:
        """Target and lens as the settings' section on the camera states them."""
        lens = {"model": "fisheye", "matrix": list(self.matrix), "distortion": list(self.distortion)}
        roi = [self.roi.x, self.roi.y, self.roi.width, self.roi.height]
        return {"roi": roi, "lens": {**lens, "size": list(self.size_px[::-1])}}


@dataclass(frozen=True, slots=True)
class BentScene:
    """The region `lit` of a fisheye's frames; translations are those of the ideal picture. Make it with `bent_scene`.

    waves (rows, columns, WAVES) in DN: each wave at each pixel, its real part shown; across, down (WAVES,) in rad/px.
    """

    waves: NDArray[np.complex64]
    across: Floats
    down: Floats

    @property
    def rows(self) -> int:
        """Height in px."""
        return int(self.waves.shape[0])

    @property
    def columns(self) -> int:
        """Width in px."""
        return int(self.waves.shape[1])

    def render(self, x_px: Floats | float, y_px: Floats | float) -> Image:
        """As `Scene.render`: the mean over the moments x_px, y_px (1 or rows, sub), or one translation in px."""
        x, y = (np.atleast_2d(np.float64(axis))[..., None] for axis in (x_px, y_px))
        return self._sum(np.exp(-1j * (self.across * x + self.down * y)).mean(axis=1)) + np.float32(MEAN_DN)

    def gradient(self, x_px: float, y_px: float) -> tuple[Image, Image]:
        """As `Scene.gradient`: derivatives with the translation along x and y, DN/px."""
        turned = np.exp(-1j * (self.across * x_px + self.down * y_px))[None]
        return self._sum(-1j * self.across * turned), self._sum(-1j * self.down * turned)

    def _sum(self, weights: NDArray[np.complex128]) -> Image:
        """The waves' sum (rows, columns) with weights (1 or rows, WAVES)."""
        result: Image = (self.waves @ weights.astype(np.complex64)[..., None])[..., 0].real
        return result


def bent_scene(lens: Fisheye, *, rng: np.random.Generator) -> BentScene:
    """A natural texture in the region `lit` of the frames of `lens`."""
    r = lens.lit
    row, column = np.mgrid[r.y : r.y + r.height, r.x : r.x + r.width].astype(np.float64)
    x, y = lens.ideal(column, row)
    lowest, highest = np.log(CYCLES_PER_PX)
    frequency = np.exp(rng.uniform(lowest, highest, WAVES))
    heading, phase = rng.uniform(0, 2 * np.pi, (2, WAVES))
    across, down = (2 * np.pi * frequency * part for part in (np.cos(heading), np.sin(heading)))
    size_dn = STD_DN * np.sqrt(2 / WAVES) * np.exp(-2 * (np.pi * BLUR_PX * frequency) ** 2)
    angle = across * x[..., None] + down * y[..., None] + phase
    return BentScene((size_dn * np.exp(1j * angle)).astype(np.complex64), across, down)
