"""Scenes with a closed form: sums of sinusoids, exact at any shift."""

from dataclasses import dataclass

import numpy as np
import pytest
from numpy.typing import NDArray

from midspan.records import Frame, Region

FRAME_NS = 33_000_000


@dataclass(frozen=True)
class SinusoidScene:
    """Random plane waves (n,): amplitude, phase, frequencies in cycles/px; the mean level is 120."""

    fx: NDArray[np.float64]
    fy: NDArray[np.float64]
    phase: NDArray[np.float64]
    amplitude: NDArray[np.float64]

    @classmethod
    def random(cls, seed, *, highest=0.35, rms=30.0, waves=150, lens_px=0.0):
        """Equal power per octave up to `highest` cycles/px; `lens_px` adds a Gaussian lens and a square pixel."""
        rng = np.random.default_rng(seed)
        f = np.exp(rng.uniform(np.log(0.01), np.log(highest), waves))
        angle = rng.uniform(0, 2 * np.pi, waves)
        fx, fy = f * np.cos(angle), f * np.sin(angle)
        blur = np.exp(-2 * (np.pi * lens_px * f) ** 2) * np.sinc(fx) * np.sinc(fy) if lens_px else np.ones(waves)
        amplitude = blur * rms / np.sqrt(np.sum(blur**2) / 2)
        return cls(fx, fy, rng.uniform(0, 2 * np.pi, waves), amplitude)

    def _sum(self, columns, rows, dx, dy, factor):
        ex = np.exp(2j * np.pi * np.outer(np.arange(columns) - dx, self.fx))
        ey = np.exp(1j * (2 * np.pi * np.outer(np.arange(rows) - dy, self.fy) + self.phase))
        return ((ey * (self.amplitude * factor)) @ ex.T).real

    def image(self, columns, rows, dx=0.0, dy=0.0):
        """The scene moved by dx to the right and dy down: (rows, columns), float64."""
        return 120.0 + self._sum(columns, rows, dx, dy, 1.0)

    def gradients(self, columns, rows):
        """Exact gradients along x and y."""
        return (
            self._sum(columns, rows, 0.0, 0.0, 2j * np.pi * self.fx),
            self._sum(columns, rows, 0.0, 0.0, 2j * np.pi * self.fy),
        )

    def bound(self, columns, rows, region: Region, noise_std):
        """Cramér-Rao bound (px) x and y for a known template under white noise, with free level and gain."""
        part = np.s_[region.y : region.y + region.height, region.x : region.x + region.width]
        g = np.stack([a[part].ravel() for a in self.gradients(columns, rows)])
        free = np.stack([np.ones(g.shape[1]), self.image(columns, rows)[part].ravel()])
        g = g - (g @ np.linalg.pinv(free)) @ free
        return np.sqrt(np.diag(np.linalg.inv(g @ g.T / noise_std**2)))


def frame(pixels, index=0):
    return Frame(time_ns=index * FRAME_NS, pixels=pixels, index=index)


def eight_bit(pixels, rng=None, noise_std=0.0):
    noise = rng.normal(0.0, noise_std, pixels.shape) if rng is not None else 0.0
    return np.clip(np.rint(pixels + noise), 0, 255).astype(np.uint8)


@pytest.fixture(scope="session")
def make_scene():
    return SinusoidScene.random


@pytest.fixture(scope="session")
def make_frame():
    return frame


@pytest.fixture(scope="session")
def camera():
    """Rounds to 8 bit, with noise when a generator is given."""
    return eight_bit
