"""A part of the picture at another distance: nearer things move further in the image, and some move on their own."""

from dataclasses import dataclass

import numpy as np

from midspan.records import Floats, Region
from midspan.simulate.motion.motion import Motion
from midspan.simulate.scene.scene import Image, Scene


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
        image[r.y : r.y + r.height, r.x : r.x + r.width] = self.scene.render(self.nearness * x, self.nearness * y + own)
