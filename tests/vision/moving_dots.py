"""A row of equal printed dots on a floor that is pulled slowly and released, rendered exactly at any place."""

from dataclasses import dataclass

import numpy as np
from scipy.special import erf

from midspan.records import Frame, Region

RATE_HZ = 22.67
SPACING_PX, RADIUS_PX, EDGE_PX = 160.0, 14.0, 0.7
SUBSTEP_PX = 0.25  # of the motion within an exposure: a tenth of an edge's blur
RENDERED_PX = int(RADIUS_PX + 6 * EDGE_PX) + 2  # beyond, the floor is not changed by a dot


@dataclass(frozen=True)
class Pull:
    """Pulled by `pull_px` in this many frames, held, released to vibrate freely; then again."""

    pull_px: float = -70.0
    frequency_hz: float = 7.7  # the first frame after the release is 108 px away
    damping: float = 0.1
    pulled: int = 25
    held: int = 4
    free: int = 21

    def at(self, frame):
        """Place (px) at `frame` (n,), which need not be whole."""
        since = np.mod(frame, self.pulled + self.held + self.free)
        share = np.clip(since / self.pulled, 0.0, 1.0)
        phase = 2 * np.pi * self.frequency_hz * np.maximum(since - self.pulled - self.held, 0.0) / RATE_HZ
        return self.pull_px * share**2 * (3 - 2 * share) * np.exp(-self.damping * phase) * np.cos(phase)


@dataclass(frozen=True)
class Dots:
    """Dark dots in a row on a moving floor with a texture of `texture` grey levels rms, in the middle of a picture."""

    columns: int = 960
    rows: int = 96
    dots: int = 5
    texture: float = 0.0
    seed: int = 1

    @property
    def middle(self):
        return self.columns / 2 + 0.37, self.rows / 2 - 0.21

    def region(self, dot, side=64):
        """The region of the dot of that number, 0 in the middle of the row."""
        x, y = self.middle
        return Region(round(x + dot * SPACING_PX) - side // 2, round(y) - side // 2, side, side)

    def render(self, moved):
        """The picture (rows, columns) with the floor moved by `moved` px to the right."""
        x, y = np.arange(self.columns) - moved, np.arange(self.rows, dtype=float)
        image = np.full((self.rows, self.columns), 200.0) + self._floor(x, y)
        for k in range(self.dots):
            at = self.middle[0] + (k - self.dots // 2) * SPACING_PX
            near = np.flatnonzero(np.abs(x - at) < RENDERED_PX)
            if len(near):
                across = slice(near[0], near[-1] + 1)
                radius = np.hypot(x[across][None, :] - at, (y - self.middle[1])[:, None])
                share = 0.5 * (1.0 - erf((radius - RADIUS_PX) / (np.sqrt(2.0) * EDGE_PX)))
                image[:, across] += (40.0 - image[:, across]) * share
        return image

    def _floor(self, x, y):
        if self.texture == 0.0:
            return 0.0
        rng = np.random.default_rng(self.seed)
        frequency, angle = np.exp(rng.uniform(np.log(0.005), np.log(0.2), 60)), rng.uniform(0, 2 * np.pi, 60)
        phase = rng.uniform(0, 2 * np.pi, 60)
        across = np.exp(2j * np.pi * np.outer(x, frequency * np.cos(angle)))
        down = np.exp(1j * (2 * np.pi * np.outer(y, frequency * np.sin(angle)) + phase))
        return (down @ across.T).real * self.texture * np.sqrt(2.0 / 60)


def filmed(scene, path, frames, *, exposure_s=1e-3, noise=1.0, seed=0):
    """8-bit frames of the scene on the path, and the target's place in the middle of each exposure, from the first."""
    rng, made, truth = np.random.default_rng(seed), [], []
    for k in range(frames):
        ends = path.at(np.array([k, k + exposure_s * RATE_HZ]))
        steps = max(int(np.ceil(abs(ends[1] - ends[0]) / SUBSTEP_PX)), 1)
        places = path.at(k + exposure_s * RATE_HZ * (np.arange(steps) + 0.5) / steps)
        image = np.mean([scene.render(x) for x in places], axis=0) + rng.normal(0.0, noise, (scene.rows, scene.columns))
        pixels = np.clip(np.rint(image), 0, 255).astype(np.uint8)
        made.append(Frame(time_ns=round(k / RATE_HZ * 1e9), pixels=pixels, index=k))
        truth.append(places.mean())
    return made, np.array(truth) - truth[0]
