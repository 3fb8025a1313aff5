"""The first frame used of a thermal camera: not the shutter, not a cover, no frame with a body in front of it all."""

import numpy as np
import pytest

from midspan.engine.first_frame import begun
from midspan.records import Region
from midspan.sources.camera.frames import FrameRequest
from midspan.sources.thermal.formats import open_thermal
from midspan.sources.thermal.temperatures import ThermalRequest

FRAMES, TARGET = 60, Region(20, 16, 30, 28)


def wall(rng):
    """A wall of 1.5 K contrast, 0.05 K noise, (frames, rows, columns) in °C."""
    texture = np.kron(rng.normal(15.0, 1.5, (15, 18)), np.ones((4, 4)))
    return texture + rng.normal(0.0, 0.05, (FRAMES, *texture.shape))


def shutter(stack, rng):
    stack[:3] = 22.0 + rng.normal(0.0, 0.05, stack[:3].shape)


def body(stack, rng):
    stack[:10, :, 20:32] = 33.0


def fog(stack, rng):
    share = np.clip(0.2 + 0.02 * np.arange(FRAMES), 0.0, 1.0)
    stack[:] = 15.0 + share[:, None, None] * (stack - 15.0) + rng.normal(0.0, 0.05, stack.shape)


def dusk(stack, rng):
    share = np.linspace(1.0, -1.0, FRAMES)
    stack[:] = 15.0 + share[:, None, None] * (stack - 15.0) + rng.normal(0.0, 0.05, stack.shape)


def cooling(stack, rng):
    stack += np.linspace(0.0, -12.0, FRAMES)[:, None, None]


def body_that_comes_later(stack, rng):
    stack[20:50, :, 10:60] = 33.0


def body_that_stays(stack, rng):
    stack[:, :, 20:32] = 33.0


def body_beside_the_target(stack, rng):
    stack[:10, :, 60:] = 33.0


@pytest.mark.parametrize(
    ("change", "skipped", "reason"),
    [
        (lambda stack, rng: None, 0, ""),
        (shutter, 3, "the first 3 frames show a closed shutter or a cover; they were skipped"),
        (body, 10, "the first 10 frames have 40 % of a target occluded; they were skipped"),
        (fog, 0, ""),
        (dusk, 0, ""),
        (cooling, 0, ""),
        (body_that_comes_later, 0, ""),
        (body_that_stays, 0, ""),
        (body_beside_the_target, 0, ""),
    ],
    ids=["wall", "shutter", "body", "fog", "dusk", "cooling", "later", "stays", "beside"],
)
def test_the_first_frame_used_is_the_first_that_shows_the_target(tmp_path, change, skipped, reason):
    rng = np.random.default_rng(5)
    stack = wall(rng)
    change(stack, rng)
    np.savez(tmp_path / "infrared.npz", celsius=stack.astype(np.float32))
    source = open_thermal(tmp_path / "infrared.npz", ThermalRequest(FrameRequest(rate_hz=6.0)))
    found = begun(source, 0, None, [TARGET])
    assert found.skipped == skipped
    assert found.reason.startswith(reason)
    assert bool(found.reason) == bool(skipped)
    assert [frame.index for frame in found.frames] == list(range(skipped, FRAMES))


def test_a_shutter_at_the_start_and_a_body_after_it_are_both_waited_for(tmp_path):
    rng = np.random.default_rng(5)
    stack = wall(rng)
    body(stack, rng)
    shutter(stack, rng)
    np.savez(tmp_path / "infrared.npz", celsius=stack.astype(np.float32))
    source = open_thermal(tmp_path / "infrared.npz", ThermalRequest(FrameRequest(rate_hz=6.0)))
    found = begun(source, 0, None, [TARGET])
    assert next(found.frames).index == 10
    assert found.reason.startswith(
        "the first 3 frames show a closed shutter or a cover and then 7 frames have 40 % of a target occluded"
    )
