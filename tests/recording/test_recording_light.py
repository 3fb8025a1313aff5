"""What light does to a fixed reference: its picture tells, steady light and what passes by cost nothing."""

import numpy as np
import pytest

from midspan.recording.tracking.light import LIGHT_PX, LightWatch, light_warnings, unlike
from midspan.records import Frame, PixelTranslation, Region, Status
from midspan.signals.health import runs
from midspan.simulate.scene.texture import textured_scene

REGION = Region(16, 14, 60, 54)


@pytest.fixture(scope="module")
def scenes():
    """One wall under light from two sides: textures that have nothing in common."""
    return tuple(textured_scene("natural", (84, 92), rng=np.random.default_rng(seed), reach_px=4.0) for seed in (1, 2))


def watched(scenes, turned, gain=lambda t: 1.0, front=lambda t: False, seconds=60):
    """Standard deviation (n,) px at one frame a second; turned, gain, front: functions of the time in s."""
    rng = np.random.default_rng(0)
    watch, told = None, []
    for t in range(seconds):
        y = 1.3 * np.sin(1.7 * t)
        one, other = (scene.render(0.0, y) - 110.0 for scene in scenes)
        angle = turned(t)
        picture = gain(t) * (110.0 + np.cos(angle) * one + np.sin(angle) * other)
        if front(t):
            picture[:, :36] = 30.0
        picture = np.clip(np.rint(picture + rng.standard_normal(picture.shape)), 0, 255).astype(np.uint8)
        frame = Frame(t * 1_000_000_000, picture, t)
        if watch is None:
            watch = LightWatch(frame, REGION)
        found = PixelTranslation(frame.time_ns, 0.0, y, 1e-5, 1e-5, 1.0, Status.TRACKING)
        told.append(np.sqrt(watch.push(frame, found)))
    return np.array(told)


def test_the_share_that_is_not_the_reference_s_is_the_sine_s_square_of_the_turn():
    rng = np.random.default_rng(3)
    # One block, so that the two pictures can be made orthogonal in it.
    one, other = (field - field.mean() for field in rng.standard_normal((2, 8, 8)))
    other -= one * np.sum(one * other) / np.sum(one * one)
    other *= np.sqrt(np.sum(one * one) / np.sum(other * other))
    for angle in (0.0, 0.3, 1.0):
        seen = 50.0 + 7.0 * (np.cos(angle) * one + np.sin(angle) * other)
        assert unlike(one, seen) == pytest.approx(np.sin(angle) ** 2, abs=1e-9)


def test_steady_light_a_change_of_exposure_and_what_passes_by_add_nothing(scenes):
    assert not watched(scenes, lambda t: 0.0).any()
    assert not watched(scenes, lambda t: 0.0, gain=lambda t: 0.6 if t > 20 else 1.0).any()
    # Too bright by so much that a part of the picture is cut off at 255.
    assert watched(scenes, lambda t: 0.0, gain=lambda t: 1.6 if t > 20 else 1.0).max() < 0.1 * LIGHT_PX
    # A third of the target is hidden for half a minute.
    assert not watched(scenes, lambda t: 0.0, front=lambda t: 15 < t < 45).any()


def test_light_that_turns_widens_by_the_sine_and_gives_back_what_it_took(scenes):
    std = watched(scenes, lambda t: 0.8 * np.sin(np.pi * t / 60.0))
    (part,) = runs(std > 0.0)
    assert part[0] < 12
    # Seen two seconds late; the blocks' pictures are not quite orthogonal.
    assert std.max() == pytest.approx(LIGHT_PX * np.sin(0.8), rel=0.15)
    assert std[-1] < 0.35 * std.max()


def test_changed_light_is_told_with_when_it_began():
    std = np.array([0.0, 0.01, 0.06, 0.09, 0.02])
    (line,) = light_warnings(np.column_stack((std, std)) ** 2, np.arange(5) * 10**9)
    assert "from 2.000 s on" in line
    assert "0.09 px" in line
    assert "key-frames" in line
    assert not light_warnings(np.full((5, 2), 0.01**2), np.arange(5) * 10**9)
    assert not light_warnings(np.empty((0, 2)), np.empty(0, np.int64))
