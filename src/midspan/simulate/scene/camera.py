"""A camera on the structure: exposure, rolling shutter, light, noise and rounding; and the bound they set."""

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from midspan.checks import option, refuse
from midspan.records import Floats, Region
from midspan.simulate.motion.motion import Motion
from midspan.simulate.scene.disturbances import Disturbance, Panel
from midspan.simulate.scene.fisheye import BentScene
from midspan.simulate.scene.scene import Image, Scene

WHITE_DN = 255.0
_MOMENTS = 9  # of the motion within one exposure; their mean is off by less than 1/900 of the blur's own curvature

Pixels = NDArray[np.uint8] | NDArray[np.uint16]


@dataclass(frozen=True, slots=True)
class Camera:
    """How an image is taken: exposure and read-out in s, the sensor's full well and read noise in electrons, its bits.

    White (255 DN) is `full_well_e` electrons. With 16 bits the same range is written as 0 … 65535.
    """

    exposure_s: float = 0.004
    readout_s: float = 0.0
    full_well_e: float = 10_000.0
    read_noise_e: float = 6.0
    bits: int = 8

    @property
    def counts_per_dn(self) -> float:
        """Counts in the file for one DN (1 of 255)."""
        return float(2**self.bits - 1) / WHITE_DN

    def moments(self, stamp_s: float, rows: int, count: int = _MOMENTS) -> Floats:
        """Times in s at which the picture is taken: (1, sub), or (rows, sub) with a rolling shutter.

        The stamp is the middle of the exposure; with a rolling shutter, of the first row's.
        """
        within = ((np.arange(count) + 0.5) / count - 0.5) * self.exposure_s
        if self.readout_s == 0.0:
            return stamp_s + within[None, :]
        return stamp_s + self.readout_s * np.linspace(0, 1, rows)[:, None] + within

    def noise_std_dn(self, mean_dn: Image) -> Image:
        """Standard deviation in DN of a pixel of mean `mean_dn`: shot and read noise, without rounding."""
        electrons = self.full_well_e / WHITE_DN
        variance = np.maximum(mean_dn, 0) / electrons + (self.read_noise_e / electrons) ** 2
        result: Image = np.sqrt(variance).astype(np.float32)
        return result

    def expose(self, mean_dn: Image, *, rng: np.random.Generator) -> Pixels:
        """A picture as it is stored, uint8 or uint16 (rows, columns), of a mean image in DN.

        Shot noise is taken as Gaussian: at the hundreds of electrons of any lit pixel it is indistinguishable.
        """
        if self.bits not in (8, 16):
            raise refuse("bits", "8 or 16", self.bits)
        noise = rng.standard_normal(mean_dn.shape, dtype=np.float32)
        counts = np.rint((mean_dn + noise * self.noise_std_dn(mean_dn)) * np.float32(self.counts_per_dn))
        clipped = np.clip(counts, 0, 2**self.bits - 1)
        return clipped.astype(np.uint8) if self.bits == 8 else clipped.astype(np.uint16)


@dataclass(frozen=True, slots=True)
class Light:
    """A change of the light: brightness goes to `gain` times, plus `offset_dn`, from `start_s` on over `ramp_s`."""

    start_s: float
    gain: float = 1.0
    offset_dn: float = 0.0
    ramp_s: float = 1.0

    def change(self, image: Image, time_s: float) -> Image:
        """The image (rows, columns) in DN in the light at `time_s`."""
        part = float(np.clip((time_s - self.start_s) / self.ramp_s, 0, 1))
        return image * np.float32(1 + part * (self.gain - 1)) + np.float32(part * self.offset_dn)


@dataclass(frozen=True, slots=True)
class View:
    """A camera that looks at a scene: displacement = scale_m_per_px × translation along `direction` ("x" or "y").

    panels: parts of the picture at other distances; across: the motion along the other axis, at the same scale.
    """

    scene: Scene | BentScene
    scale_m_per_px: float
    direction: str = "y"
    camera: Camera = field(default_factory=Camera)
    light: Light | None = None
    disturbances: tuple[Disturbance, ...] = ()
    panels: tuple[Panel, ...] = ()
    across: Motion | None = None

    def mean_image(self, motion: Motion, stamp_s: float) -> Image:
        """The noise-free picture (rows, columns) in DN stamped `stamp_s` (true time) while the structure moves."""
        option("direction", self.direction, ("x", "y"))
        moments = self.camera.moments(stamp_s, self.scene.rows)
        along = motion.displacement(moments) / self.scale_m_per_px
        other = np.zeros_like(along) if self.across is None else self.across.displacement(moments) / self.scale_m_per_px
        moved = (along, other) if self.direction == "x" else (other, along)
        image = self.scene.render(*moved)
        for panel in self.panels:
            panel.paint(image, moved, moments)
        for disturbance in self.disturbances:
            disturbance.disturb(image, stamp_s)
        return image if self.light is None else self.light.change(image, stamp_s)

    def film(self, motion: Motion, stamps_s: Floats, *, rng: np.random.Generator) -> Iterator[Pixels]:
        """The pictures at the true times `stamps_s` (n,), one after the other."""
        for stamp in stamps_s:
            yield self.camera.expose(self.mean_image(motion, float(stamp)), rng=rng)


def cramer_rao_std_px(scene: Scene | BentScene, camera: Camera, *, region: Region | None = None) -> tuple[float, float]:
    """The least standard deviation (x, y) in px that an unbiased estimate of a translation from one frame can have.

    For a known template in `region` (all of the picture without one): F = Σ g gᵀ / σ² over the pixels, with g the
    gradient and σ² shot, read and rounding noise (1/12 of a count squared). Raises UsageError outside the picture.
    """
    if region is None:
        region = Region(0, 0, scene.columns, scene.rows)
    if not region.inside(scene.columns, scene.rows):
        raise refuse("region", f"inside the picture of {scene.columns} × {scene.rows} px", region)
    g_x, g_y = (g[region.slices].astype(np.float64) for g in scene.gradient(0.0, 0.0))
    rounding = 1 / (12 * camera.counts_per_dn**2)
    variance = camera.noise_std_dn(scene.render(0.0, 0.0))[region.slices].astype(np.float64) ** 2 + rounding
    xx, yy, xy = (float(np.sum(a * b / variance)) for a, b in ((g_x, g_x), (g_y, g_y), (g_x, g_y)))
    determinant = xx * yy - xy**2
    # Single-precision gradients leave about 1e-12 where there is nothing; a real texture has well above 1e-8.
    if not determinant > 1e-8 * max(xx, yy) ** 2:
        raise refuse("region", "textured along both axes", region, "Nothing in it shows a translation.")
    return float(np.sqrt(yy / determinant)), float(np.sqrt(xx / determinant))
