"""A thermal camera on the structure: surfaces that warm and cool, bodies that pass, and what the camera adds itself."""

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from midspan.checks import option, positive, refuse
from midspan.records import Floats
from midspan.simulate.scene.scene import Image, Scene

SHUTTERS = {
    "frozen": "the camera repeats its last picture while the shutter is closed",
    "closed": "the camera shows the shutter, which has one temperature",
}


@dataclass(frozen=True, slots=True)
class Course:
    """How surfaces warm and cool: a mean of `mean_c` ± `swing_k` over `period_s`, from its rising middle at time 0.

    Where there are two patterns of temperature they take turns: the first is at its height at time 0, the second a
    quarter of a period later, as what lies in the sun and what keeps its heat do.
    """

    mean_c: float = 20.0
    swing_k: float = 0.0
    period_s: float = 86_400.0

    def level_c(self, time_s: float) -> float:
        """Mean temperature in °C."""
        return self.mean_c + self.swing_k * float(np.sin(2 * np.pi * time_s / self.period_s))

    def weights(self, time_s: float) -> tuple[float, float]:
        """Weights of the first and the second pattern; their squares add up to one."""
        angle = 2 * np.pi * time_s / self.period_s
        return float(np.cos(angle)), float(np.sin(angle))


@dataclass(frozen=True, slots=True)
class WarmBody:
    """A body of `celsius` that passes from left to right, its left edge at column `left_px` at `start_s`.

    Its top is at row `top_px`; it is `height_px` high, `width_px` wide and goes at `speed_px_s`. It is an ellipse, warm
    in its middle and 2 K cooler at its edge.
    """

    start_s: float = 1.0
    left_px: float = -40.0
    top_px: float = 10.0
    width_px: float = 40.0
    height_px: float = 90.0
    speed_px_s: float = 60.0
    celsius: float = 33.0

    def paint(self, image: Image, time_s: float) -> None:
        """Paint the body over `image` (rows, columns) in °C, as it is at `time_s`."""
        left = self.left_px + self.speed_px_s * (time_s - self.start_s)
        rows, columns = image.shape
        across = (np.arange(columns) - left - self.width_px / 2) / (self.width_px / 2)
        down = (np.arange(rows) - self.top_px - self.height_px / 2) / (self.height_px / 2)
        radius = np.hypot(down[:, None], across[None, :])
        # Its outline is soft over about a pixel, as the lens makes it.
        cover = np.clip((1.0 - radius) * min(self.width_px, self.height_px) / 2 + 0.5, 0.0, 1.0)
        image += (cover * (self.celsius - 2.0 * np.minimum(radius, 1.0) ** 2 - image)).astype(np.float32)


@dataclass(frozen=True, slots=True)
class ThermalCamera:
    """What a thermal camera adds: `netd_k` noise of a pixel, a fixed pattern of `pattern_k` a pixel and `column_k` a
    column, all standard deviations in K; a level that drifts by `drift_k_per_s`.

    `shutters_s` are the moments at which it closes its shutter for `closed_s`; each takes the drift back and leaves
    another fixed pattern. Meanwhile it does what `shutter` says, one of SHUTTERS.
    """

    netd_k: float = 0.05
    pattern_k: float = 0.03
    column_k: float = 0.0
    drift_k_per_s: float = 0.0
    shutters_s: tuple[float, ...] = ()
    closed_s: float = 0.4
    shutter: str = "frozen"

    def __post_init__(self) -> None:
        option("shutter", self.shutter, SHUTTERS)
        positive("closed_s", self.closed_s, "s")
        for name in ("netd_k", "pattern_k", "column_k"):
            if not getattr(self, name) >= 0.0:
                raise refuse(name, "0 K or more", getattr(self, name))

    def pattern(self, shape: tuple[int, int], rng: np.random.Generator) -> Image:
        """A fixed pattern (rows, columns) in K."""
        pixels = self.pattern_k * rng.standard_normal(shape)
        return (pixels + self.column_k * rng.standard_normal(shape[1])).astype(np.float32)


@dataclass(frozen=True, slots=True)
class ThermalView:
    """A thermal camera before its scene: one or two patterns of temperature of `contrast_k` (standard deviation, K).

    `scenes` are textures made by `midspan.simulate.scene.texture.textured_scene`; only their contrast is used.
    """

    scenes: tuple[Scene, ...]
    contrast_k: float = 1.0
    course: Course = field(default_factory=Course)
    bodies: tuple[WarmBody, ...] = ()
    camera: ThermalCamera = field(default_factory=ThermalCamera)

    def __post_init__(self) -> None:
        if not 1 <= len(self.scenes) <= 2:
            raise refuse("scenes", "one or two", len(self.scenes))

    def temperature(self, x_px: float, y_px: float, time_s: float) -> Image:
        """True temperature (rows, columns) in °C with the scene moved by x (right) and y (down) px at `time_s`."""
        weights = self.course.weights(time_s) if len(self.scenes) == 2 else (1.0,)
        image = np.full((self.scenes[0].rows, self.scenes[0].columns), self.course.level_c(time_s), dtype=np.float32)
        for scene, weight in zip(self.scenes, weights, strict=True):
            spread = float(np.std(scene.coefficients[::8, ::4]))
            image += np.float32(weight * self.contrast_k / spread) * (
                scene.render(x_px, y_px) - np.float32(scene.mean_dn)
            )
        for body in self.bodies:
            body.paint(image, time_s)
        return image

    def film(self, translation_px: Floats, stamps_s: Floats, *, rng: np.random.Generator) -> Iterator[Image]:
        """Pictures (rows, columns) in °C, float32, at `stamps_s` (n,), the scene moved by `translation_px` (n, 2)."""
        camera, shape = self.camera, (self.scenes[0].rows, self.scenes[0].columns)
        closings = sorted(camera.shutters_s)
        rng_pattern, rng_noise = rng.spawn(2)
        pattern, passed, opened_s = camera.pattern(shape, rng_pattern), 0, float(stamps_s[0]) if len(stamps_s) else 0.0
        last: Image | None = None
        for (x, y), stamp in zip(translation_px, stamps_s, strict=True):
            while passed < len(closings) and stamp >= closings[passed] + camera.closed_s:
                opened_s = closings[passed] + camera.closed_s
                pattern, passed = camera.pattern(shape, rng_pattern), passed + 1
            closed = passed < len(closings) and stamp >= closings[passed]
            noise = camera.netd_k * rng_noise.standard_normal(shape, dtype=np.float32)
            if closed and camera.shutter == "frozen" and last is not None:
                yield last.copy()
                continue
            true = self.temperature(float(x), float(y), float(stamp))
            if closed:
                yield np.float32(self.course.level_c(float(stamp)) + 3.0) + np.float32(0.3) * noise
                continue
            drift = np.float32(camera.drift_k_per_s * (stamp - opened_s))
            last = true + pattern + drift + noise
            yield last
