"""What moves in a picture although the structure does not: a car that passes, foliage that flickers."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from midspan.records import Floats, Region
from midspan.simulate.motion.motion import Motion
from midspan.simulate.scene.scene import Image, Scene


@dataclass(frozen=True, slots=True)
class Car:
    """A striped box that passes from left to right again and again, `speed_px_s`, once every `period_s`.

    Its top edge is at row `top_px`; `height_px` and `width_px` are its size.
    """

    top_px: int
    height_px: int = 24
    width_px: int = 60
    speed_px_s: float = 80.0
    period_s: float = 11.0

    def disturb(self, image: Image, time_s: float) -> None:
        """Paint the car over `image`; an edge between two pixels covers its part of the pixel."""
        left = (time_s % self.period_s) * self.speed_px_s - self.width_px
        column = np.arange(image.shape[1])
        cover = np.clip(column + 0.5 - left, 0, 1) - np.clip(column + 0.5 - (left + self.width_px), 0, 1)
        # The stripes move with the car; their period of 7 px is far below the sampling limit.
        tone = 70.0 + 35 * np.sin(2 * np.pi * (column - left) / 7.0)
        rows = image[self.top_px : self.top_px + self.height_px]
        rows += ((tone - rows) * cover).astype(np.float32)


@dataclass(frozen=True, slots=True)
class Breathing:
    """A lens whose focus moves: the picture grows about `middle_px` (x, y) by a share, a function of time (s)."""

    grown: Callable[[Floats], Floats]
    middle_px: tuple[float, float]

    def disturb(self, image: Image, time_s: float) -> None:
        """Magnify `image`; what was outside shows as its rim, a pixel at most."""
        from scipy.ndimage import affine_transform

        size = 1.0 / (1.0 + float(self.grown(np.array([time_s]))[0]))
        shift = [(1.0 - size) * middle for middle in self.middle_px[::-1]]
        image[:] = affine_transform(image, np.array([size, size]), shift, order=5, mode="nearest")


class Water:
    """Ripples in `region`: waves of `std_dn` and some pixels' length that run over it in all directions."""

    __slots__ = ("amplitude_dn", "angle", "region", "speed_rad_s")

    def __init__(self, region: Region, *, std_dn: float, rng: np.random.Generator, count: int = 12) -> None:
        self.region = region
        length_px, heading = rng.uniform(3.0, 14.0, count), rng.uniform(0, 2 * np.pi, count)
        y, x = np.mgrid[0 : region.height, 0 : region.width]
        across = x[None] * np.cos(heading)[:, None, None] + y[None] * np.sin(heading)[:, None, None]
        self.angle = 2 * np.pi * (across / length_px[:, None, None] + rng.uniform(0, 1, count)[:, None, None])
        # Waves on deep water: short ones are slower, the frequency falls with the root of the length.
        self.speed_rad_s: Floats = 2 * np.pi * 3.0 / np.sqrt(length_px)
        self.amplitude_dn = std_dn * np.sqrt(2 / count)

    def disturb(self, image: Image, time_s: float) -> None:
        """Paint the water of the moment, which hides what is behind it."""
        waves = self.amplitude_dn * np.sin(self.angle - (self.speed_rad_s * time_s)[:, None, None]).sum(axis=0)
        image[self.region.slices] = (110.0 + waves).astype(np.float32)


class Foliage:
    """Leaves in the wind: smooth patterns of `std_dn` in `region` that swing at 0.4 to 3 Hz, each on its own."""

    __slots__ = ("frequency_hz", "patterns", "phase_rad", "region")

    def __init__(self, region: Region, *, std_dn: float, rng: np.random.Generator, count: int = 6) -> None:
        from scipy.ndimage import gaussian_filter

        self.region = region
        fields = [gaussian_filter(rng.standard_normal((region.height, region.width)), 1.5) for _ in range(count)]
        # Half of each sine's power and `count` patterns: the sum then has the standard deviation that was asked for.
        self.patterns = np.array([f * (std_dn * np.sqrt(2 / count) / f.std()) for f in fields])
        self.frequency_hz: Floats = rng.uniform(0.4, 3.0, count)
        self.phase_rad: Floats = rng.uniform(0, 2 * np.pi, count)

    def disturb(self, image: Image, time_s: float) -> None:
        """Add the pattern of the moment to the region of `image`."""
        swing = np.sin(2 * np.pi * self.frequency_hz * time_s + self.phase_rad)
        image[self.region.slices] += np.tensordot(swing, self.patterns, 1).astype(np.float32)


# What changes a picture of mean DN in place, as it is at a moment.
Disturbance = Breathing | Car | Water | Foliage


@dataclass(frozen=True, slots=True)
class Panel:
    """A scene seen in a fixed `region` of the picture, whose size it has.

    nearness: its translation over that of the rest (2 at half the distance); own_px: what it moves on its own, down,
    as a motion in px instead of m.
    """

    region: Region
    scene: Scene
    nearness: float = 1.0
    own_px: Motion | None = None

    def paint(self, image: Image, moved_px: tuple[Floats, Floats], moments_s: Floats) -> None:
        """Paint it into `image`; moved_px: translation (x, y) of the rest at the moments (1 or rows, sub)."""
        r = self.region
        x, y = (np.broadcast_to(axis, moments_s.shape) for axis in moved_px)
        if len(moments_s) > 1:
            x, y, moments_s = (values[r.y : r.y + r.height] for values in (x, y, moments_s))
        own = 0.0 if self.own_px is None else self.own_px.displacement(moments_s)
        image[r.slices] = self.scene.render(self.nearness * x, self.nearness * y + own)
