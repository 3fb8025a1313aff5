"""What light does to a fixed reference: its picture tells, steady light and what passes by cost nothing."""

import numpy as np
import pytest

from midspan import _core
from midspan._core import LIGHT_PX
from midspan.records import Frame, PixelTranslation, Region, Status
from midspan.signals.health import runs
from midspan.simulate.scene.texture import textured_scene
from midspan.vision.target import translation_of

REGION = Region(16, 14, 60, 54)


@pytest.fixture(scope="module")
def scenes():
    """One wall under light from two sides: textures that have nothing in common."""
    return tuple(textured_scene("natural", (84, 92), rng=np.random.default_rng(seed), reach_px=4.0) for seed in (1, 2))


def opened(frame):
    """What looks at the light of a target."""
    place = REGION.x, REGION.y, REGION.width, REGION.height
    return _core.TargetChain(frame.pixels, place, picture=False, light=True, lossless=False)


def added(watch, frame, found):
    """The variance (px²) that light adds to what was found in a frame."""
    return translation_of(watch.push(frame.pixels, frame.time_ns, found)).reference_variance_x_px2


def watched(scenes, turned, gain=lambda t: 1.0, front=lambda t: False, seconds=60):
    """Standard deviation (n,) px at one frame a second; turned, gain, front: functions of the time in s."""
    rng = np.random.default_rng(0)
    watch, reported = None, []
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
            watch = opened(frame)
        found = PixelTranslation(frame.time_ns, 0.0, y, 1e-5, 1e-5, 1.0, Status.TRACKING)
        reported.append(np.sqrt(added(watch, frame, found)))
    return np.array(reported)


def unlike(reference, seen):
    """The share by the core of two pictures whose pixels are enlarged to the squares that it takes means of."""
    one, other = (
        np.pad(np.kron(picture, np.ones((3, 3))), (0, 1)).astype(reference.dtype) for picture in (reference, seen)
    )
    place = (0, 0, 3 * reference.shape[1], 3 * reference.shape[0])
    return _core.LightReference(one, place).unlike(other, 0.0, 0.0)


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


def by_the_block(reference, seen, full):
    """The same share by NumPy's own cutting into blocks and its means."""
    side = int(np.clip(min(reference.shape) // 5, 1, 4))
    shares, weights = [], []
    for strip, other in zip(np.array_split(reference, side), np.array_split(seen, side), strict=True):
        for own, its in zip(np.array_split(strip, side, axis=1), np.array_split(other, side, axis=1), strict=True):
            clear = np.maximum(own, its) < full
            if clear.any():
                a, b = own[clear] - own[clear].mean(), its[clear] - its[clear].mean()
                alike = max(np.sum(a * b), 0.0) ** 2 / max(np.sum(a * a) * np.sum(b * b), 1e-12)
                shares.append(1.0 - min(alike, 1.0))
                weights.append(np.sum(a * a))
    if not shares:
        return 0.0
    order = np.argsort(shares)
    reached = np.cumsum(np.array(weights)[order])
    return np.array(shares)[order][np.searchsorted(reached, 0.5 * reached[-1])]


@pytest.mark.parametrize("shape", [(5, 5), (8, 21), (21, 33), (40, 43)])
@pytest.mark.parametrize("level", [100.0, 240.0, 400.0])
def test_the_share_in_one_pass_is_that_of_the_blocks_one_by_one(shape, level):
    rng = np.random.default_rng(1)
    one = level + 30.0 * rng.standard_normal(shape)
    other = 0.5 * one + 20.0 * rng.standard_normal(shape)
    # Sums of squares instead of means taken off first: rounding at 1e5 of 1e16.
    assert unlike(one, other) == pytest.approx(by_the_block(one, other, np.inf), abs=1e-10)
    one, other = (np.clip(np.rint(picture), 0, 255).astype(np.uint8) for picture in (one, other))
    assert unlike(one, other) == pytest.approx(
        by_the_block(*(p.astype(np.float64) for p in (one, other)), 250.0), abs=1e-10
    )


def test_a_watch_goes_on_from_a_state(scenes):
    rng = np.random.default_rng(5)
    frames = []
    for t in range(40):
        one, other = (scene.render(0.0, 0.0) for scene in scenes)
        picture = (1 - t / 80) * one + t / 80 * other + rng.standard_normal(one.shape)
        frames.append(Frame(t * 500_000_000, np.clip(picture, 0, 255).astype(np.uint8), t))
    found = PixelTranslation(0, 0.0, 0.0, 1e-5, 1e-5, 1.0, Status.TRACKING)
    whole, first, second = (opened(frames[0]) for _ in range(3))
    expected = [added(whole, frame, found) for frame in frames]
    assert expected[-1] > 0.0
    got = [added(first, frame, found) for frame in frames[:17]]
    second.restore(first.state())
    assert got + [added(second, frame, found) for frame in frames[17:]] == expected


@pytest.mark.parametrize("black", [0, 16])
def test_black_is_dark_in_full_and_in_limited_range_and_a_dim_picture_is_not(black):
    rng = np.random.default_rng(1)
    noise = np.clip(np.rint(black + rng.normal(0.0, 1.0, (120, 160))), 0, 255).astype(np.uint8)
    assert _core.is_dark(noise, 1)
    dim = np.clip(black + rng.uniform(0.0, 60.0, (120, 160)), 0, 255).astype(np.uint8)
    assert not _core.is_dark(dim, 1)
    lamp = noise.copy()
    lamp[20:60, 30:80] = 180
    assert not _core.is_dark(lamp, 1)


def test_an_even_grey_of_full_range_is_not_dark():
    assert not _core.is_dark(np.full((120, 160), 40, dtype=np.uint8), 1)
