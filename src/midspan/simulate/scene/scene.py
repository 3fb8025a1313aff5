"""A band-limited scene that can be seen at any sub-pixel translation, exactly.

A texture is drawn at eight samples a pixel, blurred in the Fourier domain by the lens (a Gaussian) and by the pixel (a
box), and interpolated by a quintic B-spline whose coefficients are exact for the periodic image.
"""

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from midspan.checks import positive, refuse
from midspan.records import Floats

SAMPLES = 8  # a pixel, along each axis
LENS_PX = 0.6  # standard deviation of the lens blur of a good camera, px
REACH_PX = 16.0  # largest translation that can be rendered, px, unless told

Image = NDArray[np.float32]


@njit(cache=True)
def _spline(x: float) -> float:
    """The quintic B-spline at x."""
    a = abs(x)
    if a < 1.0:
        return 11.0 / 20 - a**2 / 2 + a**4 / 4 - a**5 / 12
    if a < 2.0:
        return 17.0 / 40 + 5 * a / 8 - 7 * a**2 / 4 + 5 * a**3 / 4 - 3 * a**4 / 8 + a**5 / 24
    return (3 - a) ** 5 / 120 if a < 3.0 else 0.0


@njit(cache=True)
def _spline_slope(x: float) -> float:
    """The derivative of the quintic B-spline at x."""
    a = abs(x)
    if a < 1.0:
        slope = -a + a**3 - 5 * a**4 / 12
    elif a < 2.0:
        slope = 5.0 / 8 - 7 * a / 2 + 15 * a**2 / 4 - 3 * a**3 / 2 + 5 * a**4 / 24
    else:
        slope = -((3 - a) ** 4) / 24 if a < 3.0 else 0.0
    return slope if x >= 0 else -slope


@njit(cache=True)
def _weights(places: Floats, derivative: bool, first: int, out: Floats) -> None:
    """Weights `out` (sub, taps) of the samples first, first + 1 … for reading at each of `places` (sub,)."""
    for s in range(places.shape[0]):
        for j in range(out.shape[1]):
            x = places[s] - (first + j)
            out[s, j] = _spline_slope(x) if derivative else _spline(x)


@njit(cache=True, fastmath=True)
def _gather(coefficients: NDArray[np.float32], weight: Image, starts: NDArray[np.int64], out: Image) -> None:
    """Sum weighted coefficients (samples down, SAMPLES phases, columns) into `out` (rows, columns).

    `weight` (1 or rows, taps down, taps across) and `starts` (1 or rows, 2: down, across) serve all rows or one each.
    """
    columns = out.shape[1]
    for r in range(out.shape[0]):
        k = r if weight.shape[0] > 1 else 0
        row = out[r]
        for j in range(weight.shape[1]):
            layer = coefficients[SAMPLES * r + starts[k, 0] + j]
            for i in range(weight.shape[2]):
                w = weight[k, j, i]
                if w != 0:
                    place = starts[k, 1] + i
                    # Places count from 0 here, so that Numba sees none below it and takes several of a line at once.
                    line = layer[place % SAMPLES, place // SAMPLES : place // SAMPLES + columns]
                    for c in range(columns):
                        row[c] += w * line[c]


def _taps(x_px: Floats, y_px: Floats, margin: int, order: tuple[int, int]) -> tuple[Image, NDArray[np.int64]]:
    """Weights (rows, taps, taps) and starts (rows, 2) for the mean over sub-exposures at x_px, y_px (rows, sub)."""
    down, across = SAMPLES * (margin - y_px), SAMPLES * (margin - x_px)
    low = np.stack([np.floor(down.min(axis=1)), np.floor(across.min(axis=1))], axis=1).astype(np.int64) - 2
    high = np.stack([np.floor(down.max(axis=1)), np.floor(across.max(axis=1))], axis=1).astype(np.int64) + 3
    rows, (tall, wide) = len(down), (high - low).max(axis=0) + 1
    weight = np.empty((rows, tall, wide), dtype=np.float32)
    for r in range(rows):
        w_down, w_across = np.empty((down.shape[1], tall)), np.empty((down.shape[1], wide))
        _weights(down[r], order[1] == 1, int(low[r, 0]), w_down)
        _weights(across[r], order[0] == 1, int(low[r, 1]), w_across)
        weight[r] = w_down.T @ w_across / down.shape[1]
    return weight, low


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
        weight, starts = _taps(x, y, _margin(self.reach_px), order)
        image = np.zeros((self.rows, self.columns), dtype=np.float32)
        _gather(self.coefficients, weight, starts, image)
        return image


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
