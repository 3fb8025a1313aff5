import numpy as np
import pytest

from midspan import _core
from midspan._core import read_fine, refined
from midspan.records import Region
from midspan.vision.learning import KeptSamples, Sample, fit, learn_plane
from midspan.vision.plane import best_smoothing_px, first_plane

SIZE = 64


def test_the_finer_spline_continues_the_one_on_the_pixels(make_scene):
    image = make_scene(3).image(SIZE, SIZE)
    coarse, x, y = _core.spline_coefficients(image), 0.31, -0.42
    fine, inner = refined(image), np.s_[8:-8, 8:-8]
    grid = coarse[5:-5, 5:-5].astype(np.float32)
    # Two splines of fifth order through the same samples: what differs is the second one's interpolation, below 1e-3 of
    # the contrast of 30 DN, and single precision.
    for down, across in ((0, 0), (0, 1), (1, 0)):
        got = read_fine(fine, x, y, down, across)
        expected = _core.combine(grid, _core.spline_weights(-y, down), _core.spline_weights(-x, across))
        assert np.abs(got[inner] - expected).max() < 0.03


@pytest.mark.parametrize("highest", [0.35, 0.7])
def test_a_fit_to_frames_at_many_places_shows_what_one_frame_folds(make_scene, highest):
    # Waves up to 0.7 cycles a pixel: beyond 0.5 one frame alone shows them at the wrong frequency.
    scene, rng = make_scene(5, highest=highest), np.random.default_rng(1)
    places = np.vstack([np.zeros(2), rng.uniform(-0.5, 0.5, (30, 2))])
    items = [Sample(scene.image(SIZE, SIZE, *p).astype(np.float32), p) for p in places]
    grid = refined(items[0].pixels.astype(np.float64))
    test, inner = (0.37, -0.23), np.s_[8:-8, 8:-8]
    truth = scene.image(SIZE, SIZE, *test)[inner]

    def error(fine):
        return np.std(read_fine(fine, *test)[inner] - truth)

    for _ in range(4):
        fitted = fit(items, grid, 1e-6)
        if highest < 0.5:
            break
        grid = fitted
    # 30 DN of contrast. Without aliasing the single frame already tells all; with it, it errs by tens of DN.
    assert error(fitted) < (0.05 if highest < 0.5 else 0.6)
    if highest > 0.5:
        assert error(refined(items[0].pixels.astype(np.float64))) > 10.0 * error(fitted)


def test_places_are_renewed_together_with_the_picture(make_scene):
    scene, rng = make_scene(6), np.random.default_rng(2)
    places = rng.uniform(-0.4, 0.4, (20, 2))
    wrong = places + rng.normal(0, 0.02, places.shape)
    samples = KeptSamples()
    for place, put in zip(places, wrong, strict=True):
        samples = samples.plus(Sample(scene.image(SIZE, SIZE, *place).astype(np.float32), put))
    plane = learn_plane(samples)
    shift = wrong.mean(axis=0) - places.mean(axis=0)
    learned = read_fine(plane.grid, 0.0, 0.0)
    expected = scene.image(SIZE, SIZE, *shift)
    gain = np.polyfit(expected[8:-8, 8:-8].ravel(), learned[8:-8, 8:-8].ravel(), 1)
    # Places wrong by 0.02 px would leave 0.3 DN at slopes of 15 DN/px; what all have in common cannot be known.
    assert np.std(learned[8:-8, 8:-8] - np.polyval(gain, expected[8:-8, 8:-8])) < 0.15


def test_frames_at_one_place_are_one_sample(make_scene):
    image = make_scene(7).image(SIZE, SIZE)
    samples = KeptSamples()
    for value in (-2.0, 0.0, 2.0):
        samples = samples.plus(Sample((image + value).astype(np.float32), np.array([0.1, 0.1 + 0.005 * value])))
    (only,) = samples.items
    assert (only.count, samples.frames) == (3, 3)
    assert only.pixels == pytest.approx(image, abs=1e-4)
    assert only.shift == pytest.approx([0.1, 0.1])


def test_more_noise_asks_for_more_low_pass(make_scene):
    image, rng = make_scene(8, highest=0.12, rms=5.0).image(104, 104), np.random.default_rng(3)
    noise, region = rng.normal(size=image.shape), Region(20, 20, SIZE, SIZE)
    found = [best_smoothing_px(first_plane(image + std * noise, region, 120.0), region) for std in (0.02, 2.0, 8.0)]
    assert found[0] < found[1] < found[2]
