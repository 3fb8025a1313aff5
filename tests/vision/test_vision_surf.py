from types import SimpleNamespace

import numpy as np
import pytest

from midspan._core import doubled_image as doubled
from midspan._core import surf_blobs
from midspan.vision.keypoints import SurfSettings


def detect_surf(image, settings):
    """The blobs of an image, strongest first, with their descriptors."""
    rows, descriptor, bright = surf_blobs(image, settings)
    x, y, scale, strength = rows.T
    return SimpleNamespace(x=x, y=y, scale=scale, strength=strength, bright=bright, descriptor=descriptor)


@pytest.fixture(scope="module")
def noise():
    return np.random.default_rng(3).normal(0.0, 20.0, (90, 110)).astype(np.float32)


def blobs_image(centres, sigma, shape=(120, 140), amplitude=80.0):
    y, x = np.mgrid[: shape[0], : shape[1]]
    image = np.zeros(shape)
    for cx, cy in centres:
        image += amplitude * np.exp(-((x - cx) ** 2 + (y - cy) ** 2) / (2 * sigma**2))
    return (image - image.mean()).astype(np.float32)


@pytest.mark.parametrize("sigma", [2.0, 3.0, 5.0])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_gaussian_blobs_are_found_at_their_centre_and_scale(sigma, sign):
    centres = [(40.3, 45.7), (95.5, 50.2), (70.85, 85.4)]
    image = doubled(blobs_image(centres, sigma, amplitude=sign * 80.0))
    found = detect_surf(image, SurfSettings(octaves=3, threshold=0.01))
    for cx, cy in centres:
        near = np.hypot(found.x / 2 - cx, found.y / 2 - cy)
        k = int(np.argmin(near))
        assert near[k] < 0.1
        # A Gaussian blob's determinant is largest where the filter is as wide as the blob. A box filter of size L is
        # as wide as a Gaussian of L / 6 along the derivative (three lobes of L / 3) and L / √27 across (one box of
        # 2 L / 3), together 1.34 times the nominal 1.2 L / 9; the quadratic between the sizes errs by some percent.
        assert found.scale[k] / 2 * 9 / 1.2 * np.sqrt(1 / (6 * np.sqrt(27))) == pytest.approx(sigma, rel=0.07)
        assert found.bright[k] == -sign


def test_the_strongest_blobs_come_first_and_only_so_many(noise):
    few = detect_surf(noise, SurfSettings(most=20))
    many = detect_surf(noise, SurfSettings(most=400))
    assert len(few.x) == 20
    assert np.all(np.diff(many.strength) <= 0)
    assert np.array_equal(few.x, many.x[:20])


def test_a_weaker_contrast_lowers_the_threshold_and_a_stronger_one_does_not_raise_it():
    image = doubled(blobs_image([(60.0, 60.0)], 3.0))
    disturbed = image.copy()
    disturbed[:, 220:] += 2000.0  # a bright occluder raises the variance two hundred times
    settings = SurfSettings(threshold=0.05, contrast=float(image.var()))
    for picture in (image, disturbed, image * np.float32(0.3)):
        found = detect_surf(picture, settings)
        assert np.any(np.hypot(found.x / 2 - 60, found.y / 2 - 60) < 0.1)


@pytest.mark.parametrize("upright", [True, False])
def test_descriptors_have_unit_length_and_do_not_change_with_gain_and_offset(noise, upright):
    settings = SurfSettings(upright=upright)
    plain = detect_surf(noise, settings)
    other = detect_surf((0.6 * noise + 20.0).astype(np.float32), settings)
    assert len(plain.x) > 50
    # float32 images: positions and descriptors agree to its rounding, amplified by the differences taken
    assert np.allclose(other.x, plain.x, atol=1e-3)
    assert np.allclose(other.descriptor, plain.descriptor, atol=1e-3)
    assert np.allclose(np.linalg.norm(plain.descriptor, axis=1), 1.0, atol=1e-5)


def test_descriptors_move_with_the_image_and_differ_between_blobs(noise):
    settings = SurfSettings(contrast=1.0, threshold=1e-3 * float(noise.var()))
    whole, moved = detect_surf(noise, settings), detect_surf(np.ascontiguousarray(noise[5:, 7:]), settings)
    apart = np.hypot(whole.x[:, None] - moved.x - 7.0, whole.y[:, None] - moved.y - 5.0)
    apart += np.abs(whole.scale[:, None] - moved.scale)
    inside = (np.abs(whole.x - 55) < 12) & (np.abs(whole.y - 45) < 12) & (whole.scale < 20 * 1.2 / 9)
    here, there = whole.descriptor[inside], moved.descriptor[apart[inside].argmin(axis=1)]
    assert np.count_nonzero(inside) > 3
    # The mean that stands outside the image is another, which no wavelet here reaches.
    assert np.allclose(there, here, atol=1e-4)
    between = np.linalg.norm(here[:, None] - here[None], axis=2) + 9 * np.eye(len(here))
    assert between.min() > 0.1


def test_oriented_descriptors_survive_a_quarter_turn_and_upright_ones_do_not():
    rng = np.random.default_rng(5)
    image = blobs_image(rng.uniform(30, 90, (25, 2)), 3.0, shape=(121, 121))
    turned = np.ascontiguousarray(np.rot90(image))  # (x, y) goes to (y, 120 - x)

    def distances(upright):
        settings = SurfSettings(upright=upright, threshold=0.02)
        a, b = detect_surf(image, settings), detect_surf(turned, settings)
        apart = np.hypot(a.y[:, None] - b.x[None], (120 - a.x)[:, None] - b.y[None])
        pair = apart.argmin(axis=1)
        kept = apart.min(axis=1) < 0.05
        return np.linalg.norm(a.descriptor - b.descriptor[pair], axis=1)[kept]

    assert len(distances(False)) >= 10
    assert np.median(distances(False)) < 0.25
    assert np.median(distances(True)) > 0.5


def test_an_image_smaller_than_the_filters_has_no_blobs():
    found = detect_surf(np.random.default_rng(0).normal(size=(20, 20)).astype(np.float32), SurfSettings())
    assert len(found.x) == 0
    assert found.descriptor.shape == (0, 64)
