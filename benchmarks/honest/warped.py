"""Pictures of a texture that may be moved, magnified and warped from pixel to pixel.

The texture has four samples a pixel and a lens that leaves nothing above half a cycle a pixel, so that a cubic spline
between its samples errs by less than a thousandth of a pixel.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from benchmarks.honest.oscillators import gauss_markov
from midspan.records import Floats

SAMPLES = 4  # a pixel, along each axis
MARGIN_PX = 24  # how far the texture goes beyond the picture


def texture(rng: np.random.Generator, size_px: int) -> Floats:
    """Spline coefficients of a texture of standard deviation 1, like 1/f, behind a lens of 0.8 px."""
    from scipy.ndimage import spline_filter

    count = SAMPLES * (size_px + 2 * MARGIN_PX)
    f = SAMPLES * np.hypot(np.fft.fftfreq(count)[:, None], np.fft.rfftfreq(count)[None, :])
    blur = np.exp(-2 * (np.pi * 0.8 * f) ** 2) / np.maximum(f, 1 / 24) * (f > 0) * (f < 0.5)
    values = np.fft.irfft2(np.fft.rfft2(rng.normal(size=(count, count))) * blur, s=(count, count))
    return np.asarray(spline_filter(values / np.std(values), order=3, mode="grid-wrap"))


@dataclass(frozen=True)
class Course:
    """Where a camera shows the points of a picture of `size_px`, frame by frame (n,).

    down_px (n, rows): translation of each row's points by the structure; shift_px (n, 2): by what is before or in the
    camera, down and right; magnified (n,): relative to 1, about the optical axis, which is at `axis_px` (down, right)
    from the picture's middle; bend: what the air adds.
    """

    size_px: int
    down_px: Floats
    shift_px: Floats
    magnified: Floats
    axis_px: Floats
    bend: "Bend | None" = None

    def pictures(self, coefficients: Floats) -> Iterator[Floats]:
        """The texture as seen in each frame (size_px, size_px)."""
        from scipy.ndimage import map_coordinates

        place = np.arange(self.size_px) - (self.size_px - 1) / 2
        middle = (self.size_px - 1) / 2 + MARGIN_PX
        for k in range(len(self.down_px)):
            down, right = (
                axis + (place - shift - axis) / (1 + self.magnified[k])
                for axis, shift in zip(self.axis_px, self.shift_px[k], strict=True)
            )
            y, x = np.meshgrid(down - self.down_px[k], right, indexing="ij")
            if self.bend is not None:
                y, x = y - self.bend.at(k, 0), x - self.bend.at(k, 1)
            points = (SAMPLES * (y + middle), SAMPLES * (x + middle))
            yield np.asarray(map_coordinates(coefficients, points, order=3, prefilter=False, mode="grid-wrap"))


class Bend:
    """Hot air: a smooth field of translations, some waves across the picture whose sizes come and go."""

    WAVES = 6

    def __init__(self, rng: np.random.Generator, size_px: int, time_s: Floats, *, std_px: float, correlation_s: float):
        y, x = np.mgrid[0:size_px, 0:size_px]
        length, heading = rng.uniform(40, 120, self.WAVES), rng.uniform(0, 2 * np.pi, self.WAVES)
        phase = rng.uniform(0, 2 * np.pi, self.WAVES)
        turns = np.multiply.outer(np.cos(heading) / length, y) + np.multiply.outer(np.sin(heading) / length, x)
        self.waves = np.cos(2 * np.pi * turns + phase[:, None, None])
        size = std_px * np.sqrt(2 / self.WAVES)
        self.size_px = np.array(
            [
                [gauss_markov(rng, time_s, std=size, correlation_s=correlation_s) for _ in range(2)]
                for _ in range(self.WAVES)
            ]
        )

    def at(self, frame: int, axis: int) -> Floats:
        """Translation of each pixel (rows, columns) in a frame down (0) or right (1), px."""
        return np.tensordot(self.size_px[:, axis, frame], self.waves, 1)
