import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from midspan.errors import UsageError
from midspan.simulate.scene.scene import LENS_PX, SAMPLES, canvas_shape, scene_of
from midspan.simulate.scene.texture import TEXTURES, textured_scene

ROWS, COLUMNS, REACH = 40, 56, 4.0
TALL, WIDE = (size // SAMPLES for size in canvas_shape(ROWS, COLUMNS, reach_px=REACH))
MARGIN = (TALL - ROWS) // 2


def wave_numbers(cycles_px_x, cycles_px_y):
    """The nearest frequencies in cycles/px that fit the periodic canvas a whole number of times."""
    return round(cycles_px_x * WIDE) / WIDE, round(cycles_px_y * TALL) / TALL


def wave_scene(f_x, f_y):
    down = np.arange(TALL * SAMPLES)[:, None] / SAMPLES - MARGIN
    across = np.arange(WIDE * SAMPLES) / SAMPLES - MARGIN
    return scene_of(120 + 60 * np.cos(2 * np.pi * (f_x * across + f_y * down) + 0.4), reach_px=REACH)


def seen_wave(f_x, f_y, x_px, y_px):
    """Closed form: lens Gaussian times pixel box, translated by x to the right and y down; and its derivatives."""
    size = 60 * np.sinc(f_x) * np.sinc(f_y) * np.exp(-2 * (np.pi * LENS_PX) ** 2 * (f_x**2 + f_y**2))
    row, column = np.arange(ROWS)[:, None], np.arange(COLUMNS)
    angle = 2 * np.pi * (f_x * (column - x_px) + f_y * (row - y_px)) + 0.4
    slope = 2 * np.pi * size * np.sin(angle)
    return 120 + size * np.cos(angle), f_x * slope, f_y * slope


@settings(max_examples=40)
@given(
    cycles=st.tuples(st.floats(-0.45, 0.45), st.floats(0.05, 0.45)),
    shift=st.tuples(st.floats(-3.9, 3.9), st.floats(-3.9, 3.9)),
)
def test_a_wave_is_rendered_where_the_closed_form_puts_it(cycles, shift):
    f_x, f_y = wave_numbers(*cycles)
    image = wave_scene(f_x, f_y).render(*shift)
    expected, g_x, g_y = seen_wave(f_x, f_y, *shift)
    # Single precision of 60 DN is 4e-6 DN a coefficient; 36 of them are summed.
    np.testing.assert_allclose(image, expected, atol=6e-5)
    error = image.astype(np.float64) - expected
    for gradient in (g_x, g_y):
        power = np.sum(gradient**2)
        if power > 1e3:  # a wave along one axis says nothing about the other
            assert abs(np.sum(gradient * error) / power) < 1e-6  # px


def test_a_wave_above_the_sampling_limit_keeps_its_place_too():
    f_x, f_y = wave_numbers(0.0, 0.7)
    image = wave_scene(f_x, f_y).render(0.0, 0.37).astype(np.float64)
    expected, _, g_y = seen_wave(f_x, f_y, 0.0, 0.37)
    assert (
        abs(np.sum(g_y * (image - expected)) / np.sum(g_y**2)) < 1e-5
    )  # at 0.09 cycles a sample the spline gives 1e-7


def test_the_gradient_is_the_derivative_of_the_rendering():
    f_x, f_y = wave_numbers(0.2, 0.3)
    g_x, g_y = wave_scene(f_x, f_y).gradient(0.3, -1.2)
    _, expected_x, expected_y = seen_wave(f_x, f_y, 0.3, -1.2)
    np.testing.assert_allclose(g_x, expected_x, atol=1e-3)  # single precision, times 8 samples a pixel
    np.testing.assert_allclose(g_y, expected_y, atol=1e-3)


def test_a_positive_translation_moves_the_picture_right_and_down():
    scene = textured_scene("blocks", (ROWS, COLUMNS), rng=np.random.default_rng(0), reach_px=REACH)
    still, moved = scene.render(0.0, 0.0), scene.render(3.0, 2.0)
    np.testing.assert_allclose(moved[2:, 3:], still[:-2, :-3], atol=1e-4)


def test_several_moments_give_the_mean_of_their_pictures():
    scene = textured_scene("natural", (ROWS, COLUMNS), rng=np.random.default_rng(0), reach_px=REACH)
    moments = np.array([-1.3, -0.2, 0.1, 2.9])
    single = np.mean([scene.render(0.5, y) for y in moments], axis=0)
    np.testing.assert_allclose(scene.render(0.5, moments), single, atol=2e-4)


def test_a_rolling_shutter_takes_each_row_from_its_own_picture():
    scene = textured_scene("natural", (ROWS, COLUMNS), rng=np.random.default_rng(0), reach_px=REACH)
    shifts = np.linspace(-2.0, 2.0, ROWS)
    rolled = scene.render(shifts[:, None], 0.0)
    for row in (0, 7, ROWS - 1):
        np.testing.assert_allclose(rolled[row], scene.render(shifts[row], 0.0)[row], atol=2e-4)


@pytest.mark.parametrize("name", TEXTURES)
def test_a_texture_has_contrast_stays_in_range_and_repeats_with_its_seed(name):
    image = textured_scene(name, (96, 96), rng=np.random.default_rng(3)).render(0.0, 0.0)
    again = textured_scene(name, (96, 96), rng=np.random.default_rng(3)).render(0.0, 0.0)
    np.testing.assert_array_equal(image, again)
    assert image.min() > 0
    assert image.max() < 255
    slope = np.diff(image, axis=0).std()
    low, high = (0.5, 2.5) if name == "weak" else (5.0, 30.0)  # DN/px: what makes a texture weak or good
    assert low < slope < high


def test_a_translation_beyond_the_reach_is_refused():
    scene = textured_scene("weak", (16, 16), rng=np.random.default_rng(0), reach_px=2.0)
    with pytest.raises(UsageError, match="reach_px"):
        scene.render(0.0, 2.5)


def test_an_unknown_texture_names_the_nearest():
    with pytest.raises(UsageError, match="'facade'"):
        textured_scene("fasade", (16, 16), rng=np.random.default_rng(0))
