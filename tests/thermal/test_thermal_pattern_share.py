"""By how much a fixed pattern draws translations to zero, compared with scenes moved in the Fourier domain."""

import numpy as np
import pytest

from midspan.engine.target_opening import ThermalTarget
from midspan.records import Frame, Region
from midspan.thermal.pattern import Pictured, estimate_pattern, kept_share
from midspan.vision.tracker import open_tracker
from repeats import slow

SIZE_PX, CANVAS_PX, NOISE_K = 72, 112, 0.05
REGION = Region(10, 10, 52, 52)


def scene(rng, moved_px):
    """A periodic texture of 1 K like 1/f, seen through a lens of 0.8 px, moved down by each translation (px)."""
    f = np.hypot(*np.meshgrid(np.fft.fftfreq(CANVAS_PX), np.fft.fftfreq(CANVAS_PX)))
    shape = np.exp(-2.0 * (np.pi * 0.8 * f) ** 2) / np.maximum(f, 1 / 24)
    spectrum = np.fft.fft2(rng.normal(size=(CANVAS_PX, CANVAS_PX))) * shape * (f > 0) * (f < 0.5)
    spectrum /= np.std(np.fft.ifft2(spectrum).real)
    down = np.fft.fftfreq(CANVAS_PX)[:, None]
    films = [np.fft.ifft2(spectrum * np.exp(-2j * np.pi * down * y)).real for y in moved_px]
    return np.array([film[20 : 20 + SIZE_PX, 20 : 20 + SIZE_PX] for film in films])


def frames_of(celsius):
    return [Frame(round(k / 8.0 * 1e9), picture.astype(np.float32), k) for k, picture in enumerate(celsius)]


def filmed(seed, *, contrast_k, pattern_k, rms_px, count):
    """Frames (n, rows, columns) in °C and the true translations (n,) down, the first at zero."""
    rng = np.random.default_rng(seed)
    place = np.arange(count)
    moved = rms_px * (np.sin(1.1 * place) + np.sin(0.43 * place + 1.0))
    moved -= moved[0]
    pattern = pattern_k * rng.normal(size=(SIZE_PX, SIZE_PX))
    noise = NOISE_K * rng.normal(size=(count, SIZE_PX, SIZE_PX))
    return 20.0 + contrast_k * scene(rng, moved) + pattern + noise, moved


def share_of(found, moved):
    """By which share the translations found are too small."""
    return 1.0 - np.polyfit(moved, found, 1)[0]


def target_on(frames):
    return ThermalTarget(frames[0], REGION, lambda frame: open_tracker("registration", frame, REGION))


@pytest.mark.parametrize(("contrast_k", "rms_px"), [(0.5, 0.6), *slow((1.0, 1.0))])
def test_what_a_learned_pattern_leaves_is_within_what_is_stated(contrast_k, rms_px):
    z, before = [], []
    for seed in range(4):
        celsius, moved = filmed(seed, contrast_k=contrast_k, pattern_k=0.1, rms_px=rms_px, count=90)
        frames = frames_of(celsius)
        target = target_on(frames)
        target.learn(frames[: target.frames_to_learn])
        share = share_of([target.push(frame).y_px for frame in frames], moved)
        z.append(share / target.scale_share_std)
        plain = open_tracker("registration", frames[0], REGION)
        before.append(share_of([plain.push(frame).y_px for frame in frames], moved))
        # A tenth of what the pattern did, and three deviations: the pattern is out from the first frame on.
        assert abs(share) < 0.1 * before[-1] + 3.0 * target.scale_share_std
    # Four draws of variance 1: their mean square exceeds 2.4 once in twenty.
    assert np.mean(np.square(z)) < 2.4
    assert np.mean(before) > 0.002


@pytest.mark.parametrize("pattern_k", [0.1, 0.2])
def test_a_quiet_scene_states_the_share_that_the_pattern_may_take(pattern_k):
    celsius, moved = filmed(5, contrast_k=0.5, pattern_k=pattern_k, rms_px=0.08, count=60)
    frames = frames_of(celsius)
    tracker = open_tracker("registration", frames[0], REGION)
    share = share_of([tracker.push(frame).y_px for frame in frames], moved)
    found = estimate_pattern(celsius[:24], np.column_stack((np.zeros(24), moved[:24])))
    assert not found.known
    # The pattern's power over both powers in the gradients; fine texture of the scene counts as pattern. A template
    # made of frames at several places has about half of the pattern averaged away, which is not counted on.
    assert 0.4 * found.share_std < share < 1.3 * found.share_std


def test_the_share_of_a_pattern_follows_its_power_over_the_scenes():
    rng = np.random.default_rng(2)
    celsius = scene(rng, np.zeros(1))[0]
    moved = 0.01 * rng.normal(size=(24, 2))
    slope = np.mean([np.mean(part[1:-1, 1:-1] ** 2) for part in np.gradient(celsius)])
    for spread in (0.01, 0.1):
        known = Pictured(celsius, moved, NOISE_K, spread)
        # The difference of a pixel's two neighbours, halved, has half the variance of white noise. The axes differ.
        assert kept_share(known) == pytest.approx(0.5 * spread**2 / slope, rel=0.2)


def test_without_a_pattern_the_share_is_nearly_none():
    celsius, moved = filmed(7, contrast_k=1.0, pattern_k=0.0, rms_px=0.8, count=24)
    found = estimate_pattern(celsius, np.column_stack((np.zeros(24), moved)))
    # Noise of 0.05 K in 24 frames is 0.01 K; half of it taken for pattern would be 0.005 K.
    assert np.std(found.values_k) < 0.005
    assert found.share_std < 2e-3
