"""A small thermal camera before a wall: what the tests of this folder look at."""

import numpy as np

from midspan.records import Frame, PixelTrack, Region
from midspan.simulate.scene.texture import textured_scene
from midspan.simulate.scene.thermal import ThermalView
from midspan.vision.tracker import open_tracker, tracker_settings

REGION = Region(20, 14, 72, 60)
RATE_HZ = 30.0


def wall(seed=1, size=(90, 112)):
    """Temperature differences like natural scenes, through a thermal camera's soft lens."""
    return textured_scene("natural", size, rng=np.random.default_rng(seed), reach_px=8.0, lens_px=1.0)


def swing(frames, amplitude_px=4.0):
    """Translation (n, 2) of an ellipse at 1 Hz, from zero."""
    angle = 2 * np.pi * np.arange(frames) / RATE_HZ
    moved = amplitude_px * np.stack([0.4 * np.sin(0.7 * angle), np.sin(angle)], axis=1)
    return moved - moved[0]


def filmed(view: ThermalView, moved, seed=3):
    stamps = np.arange(len(moved)) / RATE_HZ
    pictures = view.film(moved, stamps, rng=np.random.default_rng(seed))
    return [Frame(round(1e9 * s), p, k) for k, (s, p) in enumerate(zip(stamps, pictures, strict=True))]


def followed(frames, name="template", region=REGION, **settings):
    tracker = open_tracker(name, frames[0], region, tracker_settings(name, **settings))
    return PixelTrack.stack([tracker.push(frame) for frame in frames])


def error_px(track, moved):
    return np.stack([track.x_px, track.y_px], axis=1) - moved
