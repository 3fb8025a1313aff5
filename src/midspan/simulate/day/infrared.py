"""A thermal camera before the same wall: surfaces that warm and cool with the day, and turn their contrast around."""

from dataclasses import dataclass

import numpy as np

from midspan.records import Floats
from midspan.simulate.day.sky import Drops, Sky
from midspan.simulate.scene.scene import Image
from midspan.simulate.scene.thermal import Course, ThermalView


@dataclass(frozen=True, slots=True)
class DayCourse(Course):
    """Warming from noon (time 0) on: what lies in the sun is warmer by day and colder by night than the rest.

    In between, at dusk and at dawn, only what keeps its heat is distinguished, by `kept` of the contrast. Surfaces and
    air are warmest `lag_rad` and `air_lag_rad` of a day of 2π after noon: 1.3 and 2.3 hours.
    """

    lag_rad: float = 0.35
    air_lag_rad: float = 0.6
    kept: float = 0.5

    def level_c(self, time_s: float) -> float:
        """Mean temperature in °C, highest some hours after noon."""
        return self.mean_c + self.swing_k * float(np.cos(2 * np.pi * time_s / self.period_s - self.air_lag_rad))

    def weights(self, time_s: float) -> tuple[float, float]:
        """Weights of the pattern of sun and of the one that keeps its heat."""
        angle = 2 * np.pi * time_s / self.period_s - self.lag_rad
        return float(np.cos(angle)), self.kept * float(np.sin(angle))


@dataclass(frozen=True, slots=True)
class DayInfrared:
    """A thermal camera under a sky; every picture can be had by its number, whatever came before.

    view: what it looks at and what it adds itself; `drops` hang on its lens. seed: pictures are the same for the same.
    fog_share: of the fog's optical depth that heat meets.
    """

    view: ThermalView
    sky: Sky
    drops: Drops | None = None
    seed: int = 0
    fog_share: float = 0.25

    @property
    def size_px(self) -> tuple[int, int]:
        """Rows and columns of the picture."""
        return self.view.scenes[0].rows, self.view.scenes[0].columns

    def closing(self, time_s: float) -> tuple[int, bool]:
        """How many times the shutter has opened again before `time_s`, and whether it is closed."""
        closed_s = self.view.camera.closed_s
        opened = sum(time_s >= start + closed_s for start in self.view.camera.shutters_s)
        return opened, any(start <= time_s < start + closed_s for start in self.view.camera.shutters_s)

    def true_image(self, moved_px: tuple[float, float], time_s: float) -> Image:
        """Temperature (rows, columns) in °C in front of the camera, the scene moved by (x, y) px."""
        image = self.view.temperature(*moved_px, time_s)
        level = np.float32(self.view.course.level_c(time_s))
        if (depth := self.sky.depth(time_s)) > 0.0:
            image = level + np.float32(np.exp(-self.fog_share * depth)) * (image - level)
        cover = None if self.drops is None else self.drops.cover(time_s)
        if cover is not None:
            # Water lets no heat through, and is 2 K colder than the air.
            image = image + np.float32(0.8) * cover * (level - np.float32(2.0) - image)
        return image

    def picture(self, number: int, moved_px: Floats, time_s: float) -> Image:
        """Picture `number` (rows, columns) in °C, float32, the scene moved by `moved_px` (2,): x, y; shutter open."""
        camera = self.view.camera
        opened, _ = self.closing(time_s)
        since = max([0.0, *(s + camera.closed_s for s in camera.shutters_s if s + camera.closed_s <= time_s)])
        pattern = camera.pattern(self.size_px, np.random.default_rng((self.seed, 1, opened)))
        noise = np.random.default_rng((self.seed, 2, number)).standard_normal(self.size_px, dtype=np.float32)
        drift = np.float32(camera.drift_k_per_s * (time_s - since))
        image = self.true_image((float(moved_px[0]), float(moved_px[1])), time_s)
        return image + pattern + drift + np.float32(camera.netd_k) * noise

    def film_number(self, number: int, moved_px: Floats, times_s: Floats) -> Image:
        """The same for any moment of a film at `times_s` (n,), the scene moved by `moved_px` (n, 2).

        With the shutter closed it is the last picture before, or the shutter's, as the camera does.
        """
        time_s = float(times_s[number])
        if self.view.camera.shutter == "closed" and self.closing(time_s)[1]:
            noise = np.random.default_rng((self.seed, 2, number)).standard_normal(self.size_px, dtype=np.float32)
            return (
                np.float32(self.view.course.level_c(time_s) + 3.0) + np.float32(0.3 * self.view.camera.netd_k) * noise
            )
        shown = number
        while shown > 0 and self.closing(float(times_s[shown]))[1]:
            shown -= 1
        return self.picture(shown, moved_px[shown], float(times_s[shown]))
