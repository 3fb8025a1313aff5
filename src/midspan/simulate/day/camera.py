"""A camera before a wall in relief, by day and by night: shading and shadows that move, gain that ends, noise."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from midspan.records import Floats
from midspan.simulate.day.sky import Drops, Headlights, Light, Sky
from midspan.simulate.scene.camera import WHITE_DN, Camera
from midspan.simulate.scene.scene import SAMPLES, Image, Scene, canvas_shape, scene_of
from midspan.simulate.scene.texture import natural


@dataclass(frozen=True, slots=True)
class Wall:
    """A wall that reflects and has bumps: three scenes that move together, and what throws shadows on it.

    reflection: DN of 255; slope_right, slope_down: the surface's slopes in hundredths, about 0. A post stands
    `post_px` before the wall at column `post_at_px`, `post_wide_px` wide; eaves reach out as far above row 0.
    """

    reflection: Scene
    slope_right: Scene
    slope_down: Scene
    post_at_px: float
    post_px: float
    post_wide_px: float
    eaves_px: float

    @property
    def size_px(self) -> tuple[int, int]:
        """Rows and columns of the picture."""
        return self.reflection.rows, self.reflection.columns

    def brightness(self, moved_px: tuple[float, float], light: Light, lamps: Image | None) -> Image:
        """What the wall sends back (rows, columns) relative to a white one in full sun, moved by `moved_px` (x, y).

        lamps: light (rows, columns) thrown by others, which comes straight from the front.
        """
        own: Image = np.maximum(self.reflection.render(*moved_px), 0.0) * np.float32(1.0 / WHITE_DN)
        received: Image = np.full(self.size_px, light.sky, dtype=np.float32)
        if light.beam > 0.0:
            right, down = (scene.render(*moved_px) * np.float32(0.01) for scene in (self.slope_right, self.slope_down))
            facing = np.maximum(light.out - right * np.float32(light.right) - down * np.float32(light.down), 0.0)
            received += np.float32(light.beam) * facing * self._sunlit(moved_px, light)
        if lamps is not None:
            received += lamps
        return own * received

    def _sunlit(self, moved_px: tuple[float, float], light: Light) -> Image:
        """The share (rows, columns) of the sun that shadows leave; they are as sharp as a function of the place."""
        rows, columns = self.size_px
        x = np.arange(columns, dtype=np.float32) - np.float32(moved_px[0])
        y = np.arange(rows, dtype=np.float32) - np.float32(moved_px[1])
        out = max(light.out, 0.05)  # a sun that grazes the wall throws shadows without end
        # A shadow falls away from the sun, as far as its object stands out.
        post = self.post_at_px - self.post_px * light.right / out
        neighbours = np.abs(x - post) - 0.5 * self.post_wide_px
        below = y - self.eaves_px * max(-light.down, 0.0) / out
        sunlit: Image = _soft(below)[:, None] * _soft(neighbours)[None, :]
        return sunlit


def _soft(outside_px: Image) -> Image:
    """From 0 well inside a shadow to 1 well outside; its border is 3 px wide."""
    place = np.clip(outside_px / np.float32(3.0) + np.float32(0.5), 0.0, 1.0)
    soft: Image = place * place * (3 - 2 * place)
    return soft


def wall_in_relief(
    size_px: tuple[int, int], *, rng: np.random.Generator, reach_px: float = 16.0, slope: float = 0.08
) -> Wall:
    """A wall of `size_px` (rows, columns): natural reflection, bumps whose slopes have a standard deviation `slope`."""
    from scipy.ndimage import gaussian_filter

    shape = canvas_shape(*size_px, reach_px=reach_px)
    height = gaussian_filter(natural(shape, 1.0, rng=rng), 1.2 * SAMPLES, mode="wrap")
    reflection = scene_of(natural(shape, 26.0, rng=rng), reach_px=reach_px)
    rises = [np.roll(height, -1, axis) - np.roll(height, 1, axis) for axis in (1, 0)]
    right, down = (scene_of(rise * (100.0 * slope / rise.std()), reach_px=reach_px) for rise in rises)
    rows, columns = size_px
    return Wall(
        reflection,
        right,
        down,
        post_at_px=0.45 * columns,
        post_px=0.13 * columns,
        post_wide_px=0.03 * columns,
        eaves_px=0.08 * rows,
    )


@dataclass(frozen=True, slots=True)
class DayCamera:
    """A camera before a wall under a sky; every picture can be had by its number, whatever came before.

    gain: by so much at most the signal is raised when light falls, until then the mean stays; 1 or more. `drops` hang
    on its lens, `cars` pass. seed: pictures are the same for the same one.
    """

    wall: Wall
    sky: Sky
    camera: Camera = field(default_factory=Camera)
    gain: float = 16.0
    drops: Drops | None = None
    cars: Headlights = field(default_factory=Headlights)
    seed: int = 0

    def mean_image(self, moved_px: tuple[float, float], time_s: float) -> Image:
        """The picture without noise (rows, columns) relative to full well at gain 1, the scene moved by (x, y) px."""
        light = self.sky.light(time_s)
        lamps = self.cars.lights(self.wall.size_px, time_s)
        image = self.wall.brightness(moved_px, light, None if lamps is None else lamps[0])
        if (depth := self.sky.depth(time_s)) > 0.0:
            clear = np.float32(np.exp(-depth))
            image = clear * image + (1 - clear) * np.float32(0.5 * light.mean)
        if lamps is not None:
            image += lamps[1]
        cover = None if self.drops is None else self.drops.cover(time_s)
        if cover is not None:
            from scipy.ndimage import gaussian_filter

            image += cover * (gaussian_filter(image, 5.0) - image)
        return image

    def picture(self, number: int, moved_px: Floats, time_s: float) -> NDArray[np.uint8]:
        """Picture `number` as it is stored (rows, columns), the scene moved by `moved_px` (2,): x, y."""
        mean = self.mean_image((float(moved_px[0]), float(moved_px[1])), time_s)
        # Automatic gain keeps the mean where a smooth wall in full sun has it, as long as there is gain left.
        gain = float(np.clip(0.5 / max(float(mean.mean()), 1e-9), 0.8, self.gain))
        rng = np.random.default_rng((self.seed, number))
        full = self.camera.full_well_e
        noise = np.sqrt(np.maximum(mean, 0.0) / full + (self.camera.read_noise_e / full) ** 2)
        raised = gain * (mean + noise * rng.standard_normal(mean.shape, dtype=np.float32))
        stored: NDArray[np.uint8] = np.clip(np.rint(WHITE_DN * raised), 0, 255).astype(np.uint8)
        return stored
