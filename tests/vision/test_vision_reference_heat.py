"""Key frames of temperatures: a wall whose bright and dark change places, poor pictures, places that cannot be."""

import numpy as np
import pytest

from midspan.records import Frame, Prediction, Region, Status
from midspan.simulate.scene.texture import textured_scene
from midspan.vision.reference.policy import KeyFrameSettings
from midspan.vision.reference.records import clear_share, contrast, exchanged
from midspan.vision.reference.tracker import KeyFrameTracker

REGION = Region(14, 12, 48, 44)
FRAMES, RATE_HZ = 150, 5.0
NETD_K = 0.05


def turning(seed: int, course: np.ndarray) -> tuple[list[Frame], np.ndarray]:
    """Frames of a wall with a contrast of `course` (n,) in K that sways by 2 px, and its translation (n, 2)."""
    rng = np.random.default_rng(seed)
    scene = textured_scene("natural", (70, 78), rng=rng, reach_px=6.0, lens_px=1.0)
    spread = float(np.std(scene.coefficients))
    angle = 2 * np.pi * 0.31 * np.arange(len(course)) / RATE_HZ
    moved = 2.0 * np.stack([0.3 * np.sin(0.8 * angle), np.sin(angle)], axis=1)
    frames = []
    for k, ((x, y), share) in enumerate(zip(moved, course, strict=True)):
        clean = 12.0 + share * (scene.render(float(x), float(y)) - scene.mean_dn) / spread
        noisy = clean + NETD_K * rng.standard_normal(clean.shape)
        frames.append(Frame(round(1e9 * k / RATE_HZ), noisy.astype(np.float32), k))
    return frames, moved


@pytest.mark.parametrize("tracker", ["template", "registration"])
@pytest.mark.parametrize("seed", [1, 2])
def test_a_wall_that_fades_and_comes_back_inverted_is_found_where_it_was(tracker: str, seed: int) -> None:
    course = np.linspace(1.0, -1.0, FRAMES)
    frames, moved = turning(seed, course)
    target = KeyFrameTracker(frames[0], REGION, KeyFrameSettings(tracker=tracker, heat=True))
    rows = [target.push(frame) for frame in frames]
    events = [event.text for row in rows for event in row.events]
    assert any("are inverted" in text for text in events)
    error = np.array([(row.x_px, row.y_px) for row in rows]) - moved
    seen = np.isfinite(error[:, 0])
    # Less than noise in the picture: nobody could tell where it is. Else it is tracked.
    assert np.all(seen[np.abs(course) > 3.0 * NETD_K])
    # Never elsewhere, not even while it hardly shows: 0.4 px, or 2.5 of the deviation stated in a frame of mere noise.
    own = np.array([(row.variance_x_px2, row.variance_y_px2) for row in rows])
    std = np.sqrt(own + [(row.reference_variance_x_px2, row.reference_variance_y_px2) for row in rows])
    assert np.all(np.abs(error[seen]) < np.fmax(0.4, 2.5 * std[seen]))
    # And exactly once it stands out again.
    assert np.sqrt(np.mean(error[course < -0.4] ** 2)) < 0.02


def test_an_inverted_wall_is_not_looked_for_where_it_cannot_be() -> None:
    frames, moved = turning(4, np.concatenate([np.ones(20), -np.ones(20)]))
    target = KeyFrameTracker(frames[0], REGION, KeyFrameSettings(tracker="template", heat=True))
    for frame in frames[:20]:
        target.push(frame)
    # A prediction that is sure of a place 6 px away: what looks like the target here is another thing.
    there = Prediction(float(moved[20, 0]) + 6.0, float(moved[20, 1]) - 6.0, 0.3, 0.3)
    assert target.push(frames[20], there).status is Status.LOST
    found = target.push(frames[21], Prediction(float(moved[21, 0]), float(moved[21, 1]), 0.3, 0.3))
    assert abs(found.y_px - moved[21, 1]) < 0.05


def test_frames_that_have_only_noise_in_common_make_no_picture() -> None:
    rng = np.random.default_rng(5)
    picture = rng.standard_normal((40, 40)).astype(np.float32)
    for share in (0.0, 0.5, 2.0):
        windows = [share * picture + rng.standard_normal((40, 40)).astype(np.float32) for _ in range(10)]
        # By definition the share of the target's energy; 1600 pixels tell it to a few percent.
        assert clear_share(windows) == pytest.approx(share**2 / (1.0 + share**2), abs=0.03)


def test_exchanged_is_its_own_inverse_and_keeps_the_contrast() -> None:
    frames, _ = turning(6, np.ones(1))
    there = exchanged(frames[0])
    np.testing.assert_array_equal(exchanged(there).pixels, frames[0].pixels)
    assert contrast(there, REGION) == pytest.approx(contrast(frames[0], REGION), rel=1e-6)
