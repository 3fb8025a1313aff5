"""A band-limited scene that can be seen at any sub-pixel translation, exactly.

A texture is drawn at eight samples a pixel, blurred in the Fourier domain by the lens (a Gaussian) and by the pixel (a
box), and interpolated by a quintic B-spline whose coefficients are exact for the periodic image.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from midspan import _core
from midspan.checks import positive, refuse
from midspan.records import Floats

SAMPLES = 8  # a pixel, along each axis
LENS_PX = 0.6  # standard deviation of the lens blur of a good camera, px
REACH_PX = 16.0  # largest translation that can be rendered, px, unless stated

Image = NDArray[np.float32]


@dataclass(frozen=True, slots=True)
class Scene:
    """What the camera looks at: `rows` by `columns` pixels, ready to be rendered at translations up to `reach_px`.

    Make it with `scene_of`. `coefficients` (samples down, SAMPLES, columns) are the spline's, about `mean_dn`.
    """

    coefficients: NDArray[np.float32]
    rows: int
    columns: int
    mean_dn: float
    reach_px: float = REACH_PX

    def render(self, x_px: Floats | float, y_px: Floats | float) -> Image:
        """Image (rows, columns) of mean DN with the scene translated by x (right) and y (down) px.

        A number: one translation. An array (sub,): the mean over as many moments, that is motion blur. An array
        (rows, sub): each row has its own moments, that is a rolling shutter. Raises UsageError beyond `reach_px`.
        """
        return self._evaluate(x_px, y_px, order=(0, 0)) + np.float32(self.mean_dn)

    def at_points(self, down_px: Floats, across_px: Floats) -> Image:
        """Mean DN (…) at points (…) in rows and columns from the first pixel; within `reach_px` beyond the picture."""
        points = (np.ascontiguousarray(one, dtype=np.float64).reshape(-1) for one in (down_px, across_px))
        found = _core.warp_scene(self.coefficients, _margin(self.reach_px), *points)
        return found.reshape(np.shape(down_px)) + np.float32(self.mean_dn)

    def gradient(self, x_px: float, y_px: float) -> tuple[Image, Image]:
        """Derivatives (rows, columns) of the rendered image with the translation along x and y, DN/px."""
        scale = np.float32(-SAMPLES)  # a translation to the right reads the scene further to the left
        return (
            scale * self._evaluate(x_px, y_px, order=(1, 0)),
            scale * self._evaluate(x_px, y_px, order=(0, 1)),
        )

    def _evaluate(self, x_px: Floats | float, y_px: Floats | float, *, order: tuple[int, int]) -> Image:
        x, y = np.broadcast_arrays(np.atleast_2d(np.float64(x_px)), np.atleast_2d(np.float64(y_px)))
        furthest = max(float(np.abs(x).max()), float(np.abs(y).max()))
        if not furthest <= self.reach_px:
            raise refuse("translation", f"within ±{self.reach_px:g} px of this scene", furthest, "Enlarge reach_px.")
        shape = self.rows, self.columns
        return _core.render_scene(self.coefficients, shape, _margin(self.reach_px), x, y, order)


def _margin(reach_px: float) -> int:
    """Whole pixels around the picture, so that a spline of six samples is never short of them."""
    return int(np.ceil(reach_px)) + 2


def canvas_shape(rows: int, columns: int, *, reach_px: float = REACH_PX) -> tuple[int, int]:
    """Samples (down, across) of the texture that a scene of rows by columns px needs, margins included."""
    return tuple(SAMPLES * (size + 2 * _margin(reach_px)) for size in (rows, columns))  # type: ignore[return-value]


def scene_of(canvas: Floats, *, lens_px: float = LENS_PX, reach_px: float = REACH_PX) -> Scene:
    """The scene that a texture shows through a lens and pixels.

    `canvas` (samples down, samples across) in DN, eight samples a pixel, shape from `canvas_shape`, taken as periodic;
    `lens_px` the standard deviation of the lens blur in px.
    """
    from scipy import fft

    positive("reach_px", reach_px, "px")
    if canvas.ndim != 2 or any(size % SAMPLES for size in canvas.shape):
        raise refuse("canvas", f"of two axes, each a multiple of {SAMPLES} samples", canvas.shape)
    mean = float(canvas.mean())
    spectrum = fft.rfft2(canvas - mean, workers=2)
    down, across = fft.fftfreq(canvas.shape[0]), fft.rfftfreq(canvas.shape[1])
    spectrum *= (_seen(down, lens_px) / _prefilter(down))[:, None] * (_seen(across, lens_px) / _prefilter(across))
    samples = fft.irfft2(spectrum, s=canvas.shape, workers=2).astype(np.float32)
    margin = _margin(reach_px)
    rows, columns = (size // SAMPLES - 2 * margin for size in canvas.shape)
    # Columns are parted by their place within the pixel, so that the inner loop of rendering reads neighbours.
    parted = samples.reshape(canvas.shape[0], -1, SAMPLES).transpose(0, 2, 1)
    return Scene(np.ascontiguousarray(parted), rows, columns, mean, reach_px)


def _seen(frequency: Floats, lens_px: float) -> Floats:
    """What lens and pixel leave of frequencies in cycles a sample: the modulation transfer function."""
    per_px = SAMPLES * frequency
    result: Floats = np.sinc(per_px) * np.exp(-2 * (np.pi * lens_px * per_px) ** 2)
    return result


def _prefilter(frequency: Floats) -> Floats:
    """The quintic B-spline's own response at frequencies in cycles a sample, 1 at 0."""
    omega = 2 * np.pi * frequency
    result: Floats = (66 + 52 * np.cos(omega) + 2 * np.cos(2 * omega)) / 120
    return result
