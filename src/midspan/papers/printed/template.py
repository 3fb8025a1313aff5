"""The template tracker as printed: ZNCC at every whole pixel of a window, and a spline through that matrix.

Ma, Liu, Choi and Sohn (two-stage FIR), section 3, equation 2: the template is cut from the first frame, the matrix of
its ZNCC with the subsets of a frame is made, "the ZNCC matrix is spline interpolated". Frames are taken as they are,
each frame alone: no smoothing, prediction, region that follows, new template or least correlation.

The paper leaves open where the matrix ends, which spline, and how finely it is interpolated. Here the matrix reaches so
many pixels to each side of the template's place in the first frame, the spline is bicubic, and its maximum next to the
largest entry is found by Newton's method, to which ever finer interpolation would tend. An entry on the rim has no such
maximum: the target is lost in that frame. The variance is not the paper's.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from midspan import _core
from midspan._core import Fix
from midspan.records import Floats, Frame, PixelTranslation, Prediction, Region
from midspan.vision.matching import without_values
from midspan.vision.region import check_size
from midspan.vision.search import Span, cut
from midspan.vision.template import TemplateSettings, TemplateTracker

# The spline is laid through the entries within this of the largest: one farther away counts by 0.268 to that power.
SPLINE_PX = 20
NEWTON_STEPS, SETTLED_PX = 30, 1e-10


@dataclass(frozen=True, slots=True)
class PrintedTemplate:
    """The template's region, its pixels (h, w) less their mean, the level that all pixels are counted from, and the
    sum of g gᵀ (2, 2) of its gradients along x and y.
    """

    region: Region
    pixels: Floats
    offset: float
    information: Floats


class PrintedTemplateTracker(TemplateTracker):
    """The template tracker that takes each frame alone; see `midspan.vision.tracker.Tracker` for its interface."""

    def __init__(self, reference: Frame, region: Region, settings: TemplateSettings) -> None:
        super().__init__(reference, region, settings)
        self._printed = printed_template(reference.pixels, region, self.template.offset)

    def push(self, frame: Frame, prediction: Prediction | None = None) -> PixelTranslation:
        """Measure the translation (px) of the target in `frame`; LOST with NaN without a maximum."""
        check_size(frame, self.reference)
        return self._seen(frame, match_printed(frame.pixels, self._printed, self.settings.search_px))


def printed_template(image: NDArray[np.generic], region: Region, offset: float) -> PrintedTemplate:
    """The template of `region` in the first frame's `image`, which has a texture; offset: a level near its mean.

    Raises DataError where more than 2 % of its pixels have no value.
    """
    place = Span(region.x, region.x, region.y, region.y)
    raw = cut(image, place, (region.height, region.width), 0, offset)
    if raw is None:
        raise without_values(region)
    pixels = raw.astype(np.float64)
    slopes = np.stack([one.ravel() for one in np.gradient(pixels)[::-1]])
    return PrintedTemplate(region, pixels - pixels.mean(), offset, slopes @ slopes.T)


def match_printed(image: NDArray[np.generic], template: PrintedTemplate, search_px: float) -> Fix | None:
    """The template's place in a frame's `image`; None without a maximum within `search_px` of the first place."""
    region, rows, columns = template.region, *image.shape
    whole, radius = Span(0, columns - region.width, 0, rows - region.height), int(search_px)
    span = whole.around(region.x, region.y, radius, radius)
    patch = cut(image, span, template.pixels.shape, 0, template.offset)
    peak = None if patch is None else spline_peak(zncc_matrix(patch.astype(np.float64), template.pixels))
    if peak is None:
        return None
    x, y, correlation = peak
    var_x, var_y = _variance(template, correlation)
    return Fix(x + span.x0 - region.x, y + span.y0 - region.y, var_x, var_y, correlation)


def spline_peak(surface: Floats) -> tuple[float, float, float] | None:
    """Column, row and value of the bicubic spline's maximum next to the largest entry of `surface` (rows, columns).

    None where that entry lies on the rim, or the spline has no maximum within a pixel of it.
    """
    from scipy.ndimage import spline_filter

    row, column = divmod(int(np.argmax(surface)), surface.shape[1])
    if not (0 < row < surface.shape[0] - 1 and 0 < column < surface.shape[1] - 1):
        return None
    top, left = max(row - SPLINE_PX, 0), max(column - SPLINE_PX, 0)
    near = surface[top : row + SPLINE_PX + 1, left : column + SPLINE_PX + 1]
    knots = np.pad(spline_filter(near, order=3, output=np.float64, mode="mirror"), 2, mode="reflect")
    start = np.array([row - top, column - left], dtype=np.float64)
    at = start.copy()
    for _ in range(NEWTON_STEPS):
        slope, bend = _derivatives(knots, at)
        if not (bend[0, 0] < 0.0 and np.linalg.det(bend) > 0.0):
            return None
        step = np.linalg.solve(bend, -slope)
        at = at + np.clip(step, -0.5, 0.5)
        if np.max(np.abs(at - start)) > 1.0:
            return None
        if np.max(np.abs(step)) < SETTLED_PX:
            value = float(_weights(at[0], 0) @ _knots_at(knots, at) @ _weights(at[1], 0))
            return left + float(at[1]), top + float(at[0]), value
    return None


def _weights(at: float, derivative: int) -> Floats:
    """Weights (4,) of the knots before and after `at` in a cubic B-spline, or their first or second derivative."""
    t = at - np.floor(at)
    powers = np.array([1.0, t, t * t, t**3])
    for _ in range(derivative):
        powers = np.array([0.0, *(np.arange(1, 4) * powers[:3])])
    return np.asarray(powers @ CUBIC)


# Coefficients of 1, t, t² and t³ in the weights of the four knots around a place t after the second one.
CUBIC = np.array([[1.0, 4.0, 1.0, 0.0], [-3.0, 0.0, 3.0, 0.0], [3.0, -6.0, 3.0, 0.0], [-1.0, 3.0, -3.0, 1.0]]) / 6.0


def _knots_at(knots: Floats, at: Floats) -> Floats:
    """The 4 by 4 coefficients around a place (row, column); `knots` have 2 more on every side."""
    row, column = (int(np.floor(one)) + 1 for one in at)
    return knots[row : row + 4, column : column + 4]


def _derivatives(knots: Floats, at: Floats) -> tuple[Floats, Floats]:
    """Slopes (2,) and second derivatives (2, 2) of the spline along rows and columns at a place (row, column)."""
    near = _knots_at(knots, at)
    y, x = ([_weights(one, k) for k in range(3)] for one in at)
    cross = y[1] @ near @ x[1]
    bend = np.array([[y[2] @ near @ x[0], cross], [cross, y[0] @ near @ x[2]]])
    return np.array([y[1] @ near @ x[0], y[0] @ near @ x[1]]), bend


def _variance(template: PrintedTemplate, correlation: float) -> tuple[float, float]:
    """Variances x and y (px²): what the correlation leaves of the frame, as white noise, by linear theory."""
    count = template.pixels.size
    left = max(1.0 - correlation**2, 0.0) * float(np.sum(template.pixels**2)) / (count - 4)
    inverse = left * np.linalg.inv(template.information)
    return float(inverse[0, 0]), float(inverse[1, 1])


def zncc_matrix(patch: Floats, template: Floats) -> Floats:
    """ZNCC (-1 to 1) of `template` (h, w) at every whole-pixel position in `patch` by the Fourier transform.

    Equation 2 of the two-stage paper. Returns (rows - h + 1, columns - w + 1); 0 where a window is constant.
    """
    from scipy.fft import irfft2, next_fast_len, rfft2

    rows, columns = template.shape
    size = [next_fast_len(length, real=True) for length in patch.shape]
    product = irfft2(rfft2(patch, size) * np.conj(rfft2(template, size)), size)
    energy = _core.window_energies(patch, rows, columns)
    product = product[: energy.shape[0], : energy.shape[1]]
    seen = energy > 1e-12 * (np.max(energy) + 1e-30)
    norm = np.sqrt(np.where(seen, energy, 1.0) * np.sum(template**2))
    return np.where(seen, product / norm, 0.0)
