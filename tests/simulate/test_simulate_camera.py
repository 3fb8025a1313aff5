import numpy as np
import pytest

from midspan.errors import UsageError
from midspan.records import Region
from midspan.simulate.motion.motion import Rest, Sines, Sum
from midspan.simulate.scene.camera import Camera, Light, View, cramer_rao_std_px
from midspan.simulate.scene.disturbances import Car, Foliage
from midspan.simulate.scene.scene import scene_of
from midspan.simulate.scene.texture import textured_scene

FLAT = np.full((200, 250), 100.3, dtype=np.float32)


class Steady:
    """A motion at constant speed."""

    def __init__(self, speed_m_s):
        self.speed_m_s = speed_m_s

    def displacement(self, time_s):
        return self.speed_m_s * np.asarray(time_s)

    def velocity(self, time_s):
        return np.full_like(time_s, self.speed_m_s)

    def acceleration(self, time_s):
        return np.zeros_like(time_s)


@pytest.mark.parametrize("bits", [8, 16])
def test_pixel_noise_is_shot_read_and_rounding_noise(bits):
    camera = Camera(bits=bits)
    pictures = np.stack([camera.expose(FLAT, rng=np.random.default_rng(k)) for k in range(4)]) / camera.counts_per_dn
    electrons = 10_000 / 255
    variance = 100.3 / electrons + (6 / electrons) ** 2 + 1 / (12 * camera.counts_per_dn**2)
    assert pictures.var() == pytest.approx(variance, rel=5 * np.sqrt(2 / pictures.size))
    assert pictures.mean() == pytest.approx(100.3, abs=5 * np.sqrt(variance / pictures.size))
    assert pictures.dtype == np.float64


def test_a_saturated_picture_is_white_and_a_dark_one_black():
    camera = Camera()
    assert camera.expose(np.full((9, 9), 400.0, dtype=np.float32), rng=np.random.default_rng(0)).min() == 255
    assert camera.expose(np.full((9, 9), -50.0, dtype=np.float32), rng=np.random.default_rng(0)).max() == 0


def test_other_bits_are_refused():
    with pytest.raises(UsageError, match="8 or 16"):
        Camera(bits=12).expose(FLAT, rng=np.random.default_rng(0))


def test_the_stamp_is_the_middle_of_the_exposure():
    scene = textured_scene("natural", (48, 48), rng=np.random.default_rng(0), reach_px=8.0)
    view = View(scene, -1.5e-3, camera=Camera(exposure_s=0.04))
    # At a constant speed the blurred picture is symmetric about the stamp: its first moment equals the sharp one's.
    blurred = view.mean_image(Steady(0.030), 0.2).astype(np.float64)
    translation = 0.030 * 0.2 / -1.5e-3
    g_y = scene.gradient(0.0, translation)[1].astype(np.float64)
    error = np.sum(g_y * (blurred - scene.render(0.0, translation))) / np.sum(g_y**2)
    blur_px = 0.030 * 0.04 / 1.5e-3
    assert abs(error) < 0.01 * blur_px  # a start or end stamp would be off by half the blur


def test_displacement_is_the_scale_times_the_translation_along_the_direction():
    scene = textured_scene("natural", (32, 40), rng=np.random.default_rng(0), reach_px=8.0)
    for direction, place in (("x", (-2.0, 0.0)), ("y", (0.0, -2.0))):
        image = View(scene, -1.5e-3, direction).mean_image(Rest(3e-3), 0.0)
        np.testing.assert_allclose(image, scene.render(*place), atol=1e-3)


def test_a_rolling_shutter_sees_the_first_row_at_the_stamp_and_the_last_after_the_readout():
    scene = textured_scene("natural", (32, 40), rng=np.random.default_rng(0), reach_px=8.0)
    camera = Camera(exposure_s=0.0, readout_s=0.02)
    image = View(scene, -1.0e-3, "x", camera).mean_image(Steady(0.1), 0.01)
    np.testing.assert_allclose(image[0], scene.render(-1.0, 0.0)[0], atol=1e-3)
    np.testing.assert_allclose(image[-1], scene.render(-3.0, 0.0)[-1], atol=1e-3)


def test_the_bound_is_reached_by_a_linear_estimator_that_knows_the_template():
    scene = textured_scene("natural", (48, 64), rng=np.random.default_rng(2), reach_px=2.0)
    camera, region, frames = Camera(), Region(8, 4, 40, 36), 500
    bound = cramer_rao_std_px(scene, camera, region=region)
    part = np.s_[4:40, 8:48]
    template = scene.render(0.0, 0.0)
    weight = 1 / (camera.noise_std_dn(template)[part].astype(np.float64) ** 2 + 1 / 12)
    design = np.stack([g[part].ravel() for g in scene.gradient(0.0, 0.0)], axis=1).astype(np.float64)
    solver = np.linalg.solve((design.T * weight.ravel()) @ design, design.T * weight.ravel())
    rng = np.random.default_rng(5)
    found = [solver @ (camera.expose(template, rng=rng)[part] - template[part]).ravel() for _ in range(frames)]
    # The standard deviation of 500 draws is known to 1/√1000 = 3.2 %.
    np.testing.assert_allclose(np.std(found, axis=0), bound, rtol=4 * 0.032)


def test_four_times_the_pixels_halve_the_bound():
    # A texture that repeats every 32 px, so that each part of the picture tells the same.
    places = np.arange(8 * 128) / 8
    canvas = 128 + 40 * np.cos(2 * np.pi * places / 8)[:, None] + 40 * np.cos(2 * np.pi * places / 16)
    scene = scene_of(canvas, reach_px=14.0)
    small = cramer_rao_std_px(scene, Camera(), region=Region(0, 0, 32, 32))
    large = cramer_rao_std_px(scene, Camera(), region=Region(16, 0, 64, 64))
    np.testing.assert_allclose(np.array(small) / large, 2.0, rtol=1e-4)  # single-precision gradients


def test_the_bound_of_stripes_across_one_axis_only_is_refused():
    places = np.arange(8 * 64) / 8
    canvas = np.broadcast_to(128 + 40 * np.cos(2 * np.pi * places / 8), (512, 512))
    with pytest.raises(UsageError, match="textured along both axes"):
        cramer_rao_std_px(scene_of(canvas, reach_px=14.0), Camera())


def test_a_region_outside_the_picture_is_refused():
    scene = textured_scene("weak", (32, 40), rng=np.random.default_rng(0), reach_px=2.0)
    with pytest.raises(UsageError, match="40 × 32 px"):
        cramer_rao_std_px(scene, Camera(), region=Region(20, 0, 32, 32))


def test_light_changes_from_its_start_over_its_ramp():
    light = Light(10.0, gain=0.5, offset_dn=20.0, ramp_s=2.0)
    image = np.full((2, 2), 100.0, dtype=np.float32)
    assert light.change(image, 10.0)[0, 0] == 100.0
    assert light.change(image, 11.0)[0, 0] == pytest.approx(85.0)
    assert light.change(image, 30.0)[0, 0] == pytest.approx(70.0)


def test_a_car_moves_at_its_speed_and_touches_only_its_rows():
    early, late = (np.full((60, 200), 150.0, dtype=np.float32) for _ in range(2))
    car = Car(top_px=30, height_px=20, width_px=40, speed_px_s=50.0)
    car.disturb(early, 1.5)
    car.disturb(late, 2.5)
    assert np.all(early[:30] == 150.0)
    assert np.all(early[50:] == 150.0)
    np.testing.assert_allclose(late[30:50, 50:], early[30:50, :-50], atol=1e-3)
    assert np.any(early[30:50] != 150.0)


def test_foliage_flickers_with_its_strength_inside_its_region_only():
    foliage = Foliage(Region(5, 8, 30, 20), std_dn=18.0, rng=np.random.default_rng(0))
    pictures = np.zeros((400, 40, 50), dtype=np.float32)
    for k, picture in enumerate(pictures):
        foliage.disturb(picture, 0.1 * k)
    inside = pictures[:, 8:28, 5:35].copy()
    pictures[:, 8:28, 5:35] = 0.0
    assert not pictures.any()
    # Six sines over 40 s: their mean squares are within a few per cent of a half, their cross terms within a few more.
    assert inside.std() == pytest.approx(18.0, rel=0.1)


def test_a_film_repeats_with_its_seed():
    scene = textured_scene("weak", (24, 24), rng=np.random.default_rng(0), reach_px=6.0)
    view = View(scene, -1.5e-3)
    motion = Sum((Sines([3e-3], [1.9]), Rest(1e-3)))
    films = [np.stack(list(view.film(motion, np.arange(4) / 10, rng=np.random.default_rng(7)))) for _ in range(2)]
    np.testing.assert_array_equal(*films)
