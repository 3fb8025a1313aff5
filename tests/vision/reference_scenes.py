"""A wall in relief under a light that turns: shading moves from one flank of each bump to the other."""

from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from midspan.records import Frame, Region
from midspan.simulate.scene.texture import textured_scene

REGION = Region(18, 18, 52, 52)
SIZE = (88, 88)
RATE_HZ = 5.0


@dataclass(frozen=True)
class Sky:
    """Where the light goes besides the sweep: `aside` at its beginning and end (tangent of the direction across the
    sweep); `ambient` share that comes from everywhere; `cast`: bumps throw shadows on each other.
    """

    aside: tuple[float, float] = (0.3, 0.3)
    ambient: float = 0.0
    cast: bool = False


@cache
def _relief(seed):
    rng = np.random.default_rng(seed)
    height = textured_scene("natural", SIZE, rng=rng, reach_px=7.0, lens_px=1.2)
    tone = textured_scene("blocks", SIZE, rng=rng, reach_px=7.0, lens_px=0.7)
    return height, tone, 0.5 / float(np.std(height.gradient(0.0, 0.0)[0]))


OVERHEAD = Sky()


def shaded(seed, moved, angle, level, aside=0.3, sky=OVERHEAD):
    """Lambert's law on the relief moved by `moved` px, light at `angle` rad from the normal: about 130 DN · level."""
    height, tone, steep = _relief(seed)
    gx, gy = (-steep * g for g in height.gradient(*moved))
    shade = np.maximum(np.cos(angle) - (gx + aside * gy) * np.sin(angle), 0.0) / np.sqrt(1 + gx**2 + gy**2)
    if sky.cast:
        shade = shade * _lit(steep * height.render(*moved), angle)
    shade = (1.0 - sky.ambient) * shade + sky.ambient / np.sqrt(1 + gx**2 + gy**2)
    # Stones of different tone: a fifth of their contrast is left of the picture's.
    return 130.0 * level * shade * (1.0 + 0.2 * (tone.render(*moved) / 128.0 - 1.0))


def _lit(height, angle):
    """Share of the light that reaches each pixel past the bumps on the light's side; edges as soft as the sun's."""
    side, rise = (1 if angle > 0 else -1), 1.0 / max(abs(np.tan(angle)), 1e-3)
    above = np.full(height.shape, -np.inf)
    for step in range(1, 13):
        beyond = np.roll(height, -side * step, axis=1)
        above = np.maximum(above, beyond - height - step * rise)
    return 1.0 / (1.0 + np.exp(np.clip(above / 0.1, -50.0, 50.0)))


def swept(seed, angles_deg, levels=None, amplitude_px=2.5, sky=OVERHEAD):
    """Frames (8 bit, noise of 2 DN) and true translations (n, 2) under a light at the angles given."""
    count = len(angles_deg)
    levels = np.ones(count) if levels is None else levels
    time = np.arange(count) / RATE_HZ
    moved = amplitude_px * np.stack([0.3 * np.sin(2.0 * time), np.sin(1.3 * time) * np.cos(0.1 * time)], axis=1)
    moved -= moved[0]
    rng = np.random.default_rng(seed + 50)
    frames = []
    aside = np.linspace(*sky.aside, count)
    for k, (d, angle, level) in enumerate(zip(moved, np.deg2rad(angles_deg), levels, strict=True)):
        picture = shaded(seed, d, angle, level, float(aside[k]), sky) + rng.normal(0.0, 2.0, SIZE)
        frames.append(Frame(round(1e9 * k / RATE_HZ), np.clip(np.rint(picture), 0, 255).astype(np.uint8), k))
    return frames, moved


def track(tracker, frames, events=None):
    """Translations (n, 2), their standard deviations (n, 2); what happened is added to the list `events`."""
    rows = [tracker.push(frame) for frame in frames]
    if events is not None:
        events += [event for row in rows for event in row.events]
    xy = np.array([(r.x_px, r.y_px) for r in rows])
    own = np.array([(r.variance_x_px2, r.variance_y_px2) for r in rows])
    return xy, np.sqrt(own + [(r.reference_variance_x_px2, r.reference_variance_y_px2) for r in rows])


@dataclass(frozen=True)
class Body:
    """A thing in front of `share` of the target: from `start_s` it crosses from left to right, parked midway; `kind`:
    even, blocks, or another piece of wall; `with_target`: it moves in the image as the target does.
    """

    share: float
    start_s: float
    crossing_s: float
    parked_s: float = 0.0
    kind: str = "blocks"
    with_target: bool = False
    leaves: bool = True

    @property
    def size(self):
        """Rows and columns, px."""
        rows = round(REGION.height * min(1.0, 1.15 * self.share**0.5))
        return rows, round(self.share * REGION.height * REGION.width / rows)

    def left(self, seconds):
        """Column of its left edge this many seconds after its start; None once it has gone."""
        half = 0.5 * self.crossing_s
        way = REGION.width + self.size[1] + 20
        gone = min(seconds, half)
        if self.leaves and seconds >= half:
            gone = max(seconds - self.parked_s, half)
        return None if gone > self.crossing_s else REGION.x - 10 - self.size[1] + way * gone / self.crossing_s


def _looks(body):
    rng = np.random.default_rng(5)
    rows, columns = body.size
    if body.kind == "even":
        return 60.0 + rng.normal(0.0, 2.0, (rows, columns))
    if body.kind == "wall":
        return np.clip(shaded(71, (0.0, 0.0), 0.35, 1.0)[:rows, :columns], 0, 255)
    return np.kron(rng.uniform(30, 220, (rows // 5 + 1, columns // 5 + 1)), np.ones((5, 5)))[:rows, :columns]


def crossed(frames, moved, body):
    """The frames with the body in front."""
    looks, made = _looks(body).astype(np.uint8), []
    for frame, (dx, dy) in zip(frames, moved, strict=True):
        seconds = frame.index / RATE_HZ - body.start_s
        left = None if seconds < 0.0 else body.left(seconds)
        if left is not None:
            x, y = round(left), REGION.y + (REGION.height - body.size[0]) // 2
            if body.with_target:
                x, y = x + round(dx), y + round(dy)
            picture = np.pad(frame.pixels, 120)
            picture[120 + y : 120 + y + looks.shape[0], 120 + x : 120 + x + looks.shape[1]] = looks
            frame = replace(frame, pixels=picture[120:-120, 120:-120].copy())
        made.append(frame)
    return made
