"""Range profiles: the true carrier, the phase's reference, and bins straight from the words."""

import numpy as np
import pytest
from radar_cases import CARRIER, CYCLE, SHORT, UNIT, C

from midspan.errors import UsageError
from midspan.radar.chirp import ChirpProfile
from midspan.radar.following import at_places, bins_within
from midspan.radar.layout import ORDERS, Layout, pack, unpack
from midspan.radar.range_profile import (
    averaged,
    bin_kernel,
    hann,
    range_profile,
    slow_time,
)
from midspan.simulate.radar.signal import LONG_RANGE, beat


def test_the_phase_moves_with_the_frequency_at_the_centre_of_the_window_less_the_delay_on_the_ramp() -> None:
    ranges = 7.46 + np.linspace(-1e-3, 1e-3, 21)
    for profile in (SHORT, LONG_RANGE):
        z = range_profile(beat(ranges, profile), profile)[:, round(7.46 / profile.bin_m)]
        slope = np.polyfit(ranges - 7.46, np.unwrap(np.angle(z)), 1)[0]
        # Single precision leaves 1e-7 rad of 8 rad; the residual delay term is 7e-5 of the slope and must be there.
        assert slope == pytest.approx(profile.phase_per_m(7.46), rel=2e-6)
        assert slope * C / (4 * np.pi) / 77e9 == pytest.approx({SHORT: 1.0229, LONG_RANGE: 1.0053}[profile], abs=2e-4)
    assert pytest.approx(CARRIER) == SHORT.carrier_hz
    assert SHORT.axis.cycle_m == pytest.approx(CYCLE)
    assert SHORT.limit_speed_m_s == pytest.approx(CYCLE / 2 * 100)


def test_the_phase_of_a_target_is_the_same_in_every_bin_of_its_main_lobe_and_between_them() -> None:
    place = 24.37
    z = beat(np.array([place * SHORT.bin_m]), SHORT)
    bins = np.array([23.0, 24.0, 24.37, 25.0, 25.5])
    phases = np.angle(z @ bin_kernel(bins, SHORT).T)[0]
    np.testing.assert_allclose(phases, phases[0], atol=1e-9)
    profile = range_profile(z, SHORT)[0]
    np.testing.assert_allclose(np.angle(profile[[23, 24, 25]]), phases[0], atol=1e-5)
    # The amplitude of a target at its own place is 1.
    assert abs(z @ bin_kernel(np.array([place]), SHORT).T)[0, 0] == pytest.approx(1.0, abs=1e-9)


@pytest.mark.parametrize(
    ("lanes", "order"), [(2, "IIQQ"), (2, "QQII"), (2, "IQIQ"), (2, "QIQI"), (4, "IIQQ"), (4, "QQII")]
)
def test_one_bin_straight_from_the_words_equals_the_whole_transform(lanes: int, order: str) -> None:
    layout = Layout(SHORT, order, lanes)
    words = np.random.default_rng(0).integers(-2000, 2000, layout.frame_words * 5).astype(np.int16)
    cube = unpack(words, layout)
    np.testing.assert_array_equal(pack(cube, layout), words)
    whole = averaged(range_profile(cube, SHORT), SHORT)
    # float32 products of 2000 counts over 256 samples
    np.testing.assert_allclose(slow_time(words, layout, np.array([20.0, 139.0])), whole[..., [20, 139]], atol=2e-3)


def test_real_words_of_twelve_bits_go_straight_too() -> None:
    profile = ChirpProfile(77e9, 60e12, 6e6, 64, 0.01, receivers=2, complex_samples=False, bits=12)
    layout = Layout(profile)
    values = np.random.default_rng(1).integers(-2048, 2048, layout.frame_words * 3)
    words = (values % 4096).astype(np.int16)  # the upper bits are not set
    expected = range_profile(values.reshape(3, 1, 2, 64).astype(np.complex64), profile)[:, 0]
    np.testing.assert_allclose(slow_time(words, layout, np.array([9.0]))[..., 0], expected[..., 9], atol=2e-3)


def test_noise_after_the_window_is_a_half_more_than_after_a_rectangle() -> None:
    gain = np.sum(hann(256) ** 2)
    assert gain == pytest.approx(1.5 / 256, rel=1e-3)
    rng = np.random.default_rng(2)
    z = rng.normal(size=(4000, 256)) + 1j * rng.normal(size=(4000, 256))
    power = np.mean(np.abs(z @ bin_kernel(np.array([40.2]), SHORT).T) ** 2)
    assert power == pytest.approx(2 * gain, rel=0.06)  # 4000 draws: 1.6 % of one standard deviation


def test_a_target_that_leaves_its_bin_is_followed_without_a_step_of_the_phase() -> None:
    layout = Layout(SHORT)
    moved = 0.15 * np.sin(np.linspace(0, 4, 400))  # three bins to each side
    place = 37.3 * SHORT.bin_m
    echo = np.repeat(1000 * beat(place + moved, SHORT)[:, None, None, :], 4, axis=2)
    words = pack(echo, layout)
    bins = bins_within(37.3, 3.0)
    z = at_places(slow_time(words, layout, bins)[:, 0], bins, (place + moved) / SHORT.bin_m)
    np.testing.assert_allclose(np.abs(z), 1000, rtol=0.012)
    delay = 2 * (place + moved) / C
    true = 2 * np.pi * CARRIER * delay - np.pi * 64.985e12 * delay**2
    error = np.angle(z * np.exp(-1j * true))
    assert np.std(error) < 0.001  # rounding to whole counts: 3e-5 rad, and no step where the bin changes
    assert np.abs(error).max() < 0.003
    fixed = slow_time(words, layout, np.array([37.3]))[:, 0, 0]
    assert np.abs(fixed).min() < 100  # without following it is gone


def test_products_do_not_depend_on_how_many_frames_come_at_a_time() -> None:
    layout = Layout(SHORT)
    words = np.random.default_rng(4).integers(-2000, 2000, layout.frame_words * 600).astype(np.int16)
    place = np.array([20.3])
    whole = slow_time(words, layout, place)
    parts = [slow_time(words[k * 2048 : (k + 7) * 2048], layout, place) for k in range(0, 600, 7)]
    # The order of additions in single precision differs with the shape.
    np.testing.assert_allclose(np.concatenate(parts), whole, atol=2e-3)


@pytest.mark.parametrize(
    ("changed", "reported"),
    [({"slope_hz_s": 0.0}, "slope_hz_s"), ({"bits": 10}, "12, 14 or 16"), ({"samples": 4}, "8 or more")],
)
def test_profiles_that_cannot_be_are_refused(changed: dict[str, float], reported: str) -> None:
    values = {
        "start_frequency_hz": 77e9,
        "slope_hz_s": 60e12,
        "sample_rate_hz": 6e6,
        "samples": 64,
        "frame_period_s": 0.01,
    }
    with pytest.raises(UsageError, match=reported):
        ChirpProfile(**{**values, **changed})
    assert len(ORDERS) == 4
    assert UNIT > 0
