import numpy as np
import pytest

from midspan.vision.surf import (
    SurfSettings,
    describe,
    detect_surf,
    doubled,
    filter_sizes,
    find_blobs,
    haar,
    hessian,
    integral_image,
)


@pytest.fixture(scope="module")
def noise():
    return np.random.default_rng(3).normal(0.0, 20.0, (90, 110)).astype(np.float32)


def blobs_image(centres, sigma, shape=(120, 140), amplitude=80.0):
    y, x = np.mgrid[: shape[0], : shape[1]]
    image = np.zeros(shape)
    for cx, cy in centres:
        image += amplitude * np.exp(-((x - cx) ** 2 + (y - cy) ** 2) / (2 * sigma**2))
    return (image - image.mean()).astype(np.float32)


def test_the_integral_image_holds_the_sums_of_all_corners(noise):
    integral = integral_image(noise)
    for r, c in ((0, 0), (1, 1), (17, 40), (90, 110)):
        # float64 sums of 10^4 values of 20: rounding stays below 1e-9
        assert integral[r, c] == pytest.approx(noise[:r, :c].astype(np.float64).sum(), abs=1e-8)


def box_masks(size):
    """The published filters as dense masks: xx, yy, xy."""
    lobe, half = size // 3, size // 2
    xx, xy = np.zeros((size, size)), np.zeros((size, size))
    band = slice(half - lobe + 1, half + lobe)
    xx[band, :] = 1.0
    xx[band, lobe : 2 * lobe] = -2.0
    for sign, rows, columns in ((1, -1, 1), (1, 1, -1), (-1, -1, -1), (-1, 1, 1)):
        r = slice(half - lobe, half) if rows < 0 else slice(half + 1, half + 1 + lobe)
        c = slice(half - lobe, half) if columns < 0 else slice(half + 1, half + 1 + lobe)
        xy[r, c] = sign
    return xx, xx.T, xy


@pytest.mark.parametrize(("size", "step"), [(9, 1), (15, 1), (27, 2), (39, 4)])
def test_the_box_hessian_equals_direct_sums_with_dense_masks(noise, size, step):
    determinant, trace = hessian(integral_image(noise), size, step)
    masks, half = box_masks(size), size // 2
    for r, c in ((48, 52), (44, 60), (half + (-half) % step, half + (-half) % step)):
        part = noise[r - half : r + half + 1, c - half : c + half + 1].astype(np.float64)
        xx, yy, xy = (float(np.sum(mask * part)) / size**2 for mask in masks)
        # results are stored as float32: seven digits
        assert determinant[r // step, c // step] == pytest.approx(xx * yy - 0.81 * xy * xy, rel=1e-5, abs=1e-6)
        assert trace[r // step, c // step] == pytest.approx(xx + yy, rel=1e-5, abs=1e-5)
    assert np.all(determinant[: half // step] == 0.0)


def test_filter_sizes_are_the_published_ones():
    assert [filter_sizes(k).tolist() for k in range(3)] == [[9, 15, 21, 27], [15, 27, 39, 51], [27, 51, 75, 99]]


def test_doubling_keeps_the_pixels_and_interpolates_a_smooth_wave_between_them():
    x = np.arange(60)

    def wave(c, r):
        return 30 * np.sin(2 * np.pi * (0.08 * c[None, :] + 0.05 * r[:, None]))

    out = doubled(wave(x, x).astype(np.float32))
    assert np.array_equal(out[::2, ::2], wave(x, x).astype(np.float32))
    exact = wave(np.arange(119) / 2, np.arange(119) / 2)
    # six-point interpolation errs by (2 pi f)^6 / 205 = 8e-5 of the amplitude at 0.08 cycles/px; edges are mirrored
    assert np.abs(out - exact)[8:-8, 8:-8].max() < 30 * 2e-4


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


def test_haar_responses_are_differences_of_halves(noise):
    integral = integral_image(noise)
    part = noise[40 - 5 : 40 + 5, 60 - 5 : 60 + 5].astype(np.float64)
    across, down = haar(integral, 60.2, 39.8, 5)
    assert across == pytest.approx(part[:, 5:].sum() - part[:, :5].sum(), abs=1e-6)
    assert down == pytest.approx(part[5:].sum() - part[:5].sum(), abs=1e-6)


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
    settings = SurfSettings()
    whole = integral_image(noise)
    blobs = find_blobs(whole, settings, float(noise.var()))
    inside = blobs[(np.abs(blobs[:, 0] - 55) < 12) & (np.abs(blobs[:, 1] - 45) < 12) & (blobs[:, 2] < 20)]
    moved = inside - np.array([7.0, 5.0, 0, 0, 0])
    same = describe(integral_image(np.ascontiguousarray(noise[5:, 7:])), moved, True)
    here = describe(whole, inside, True)
    assert len(inside) > 3
    assert np.allclose(same, here, atol=1e-5)
    apart = np.linalg.norm(here[:, None] - here[None], axis=2) + 9 * np.eye(len(here))
    assert apart.min() > 0.1


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
