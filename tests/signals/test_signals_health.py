"""Rate, gaps, frozen and clipped segments of constructed signals."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from midspan.signals.clipping import clipped
from midspan.signals.health import bridged, clock, dominant_frequency, frozen, runs


def stamps(*steps_s):
    return np.concatenate(([0], np.cumsum(np.rint(np.array(steps_s) * 1e9)))).astype(np.int64)


def test_rate_and_gaps_of_a_regular_clock_with_two_pauses():
    found = clock(stamps(*[0.01] * 50, 0.5, *[0.01] * 50, 0.031, *[0.01] * 20))
    assert found.rate_hz == pytest.approx(100.0)
    assert found.jitter_s == pytest.approx(0.0, abs=1e-12)
    np.testing.assert_array_equal(found.gaps, [50, 101])
    np.testing.assert_allclose(found.gap_s, [0.5, 0.031])


def test_jitter_is_the_deviation_of_the_steps():
    rng = np.random.default_rng(1)
    found = clock(stamps(*(0.01 + rng.normal(0, 5e-4, 20_000))))
    assert found.rate_hz == pytest.approx(100.0, rel=1e-3)
    assert found.jitter_s == pytest.approx(5e-4, rel=0.03)
    assert len(found.gaps) == 0


@given(st.lists(st.booleans(), max_size=40))
def test_runs_are_the_segments_of_true(mask):
    mask = np.array(mask, dtype=bool)
    again = np.zeros(len(mask), dtype=bool)
    for start, end in runs(mask):
        assert start < end
        assert not again[start:end].any()
        again[start:end] = True
        assert start == 0 or not mask[start - 1]
        assert end == len(mask) or not mask[end]
    np.testing.assert_array_equal(again, mask)


def test_a_run_longer_than_chance_makes_it_is_frozen_from_its_first_repeated_sample():
    rng = np.random.default_rng(2)
    value = rng.normal(size=6000)
    value[3000:3010] = value[3000]
    value[5000:5300] = value[5000]
    expected = np.zeros(6000, dtype=bool)
    expected[3001:3010] = expected[5001:5300] = True
    np.testing.assert_array_equal(frozen(value, 100.0), expected)
    # Where every second neighbour is equal thirty are a chance of 1e-9, and ten are not rare.
    coarse = np.round(0.6 * value)
    coarse[3000:3010] = coarse[3000]
    found = frozen(coarse, 100.0)
    assert found[5001:5300].all()
    assert not found[:4990].any()
    assert frozen(np.zeros(100), 100.0).all()
    assert not frozen(np.full(500, np.nan), 100.0).any()


def test_a_sensor_that_is_slower_than_its_column_is_not_frozen():
    value = np.repeat(np.random.default_rng(3).normal(size=600), 10)
    assert not frozen(value, 100.0).any()


def test_clipping_is_found_at_both_ends_and_only_there():
    time = np.arange(2000) / 100.0
    wave = 3.0 * np.sin(2 * np.pi * 0.7 * time) + 0.5 * np.sin(2 * np.pi * 7.1 * time)
    cut = np.clip(wave, -2.0, 2.5)
    mask = clipped(cut)
    held = (cut == -2.0) | (cut == 2.5)
    assert np.mean(mask[held]) > 0.9  # the first of each run and single samples at the end of the range do not count
    assert not mask[~held].any()
    assert not clipped(wave).any()
    assert not clipped(np.full(10, np.nan)).any()


@pytest.mark.parametrize("resolution", [0.001, 0.01, 0.05])
def test_the_crests_of_a_steady_sine_of_a_coarse_channel_are_not_clipped(resolution):
    # Near a crest a quantised sine stays on its highest level for several samples; that is no end of the range.
    time = np.arange(6000) / 100.0
    assert np.mean(clipped(np.round(np.sin(2 * np.pi * 1.0 * time + 0.3) / resolution) * resolution)) < 0.01


@pytest.mark.parametrize(("offset", "noise"), [(0.0, 0.3), (0.3, 0.3), (0.5, 0.2), (0.5, 0.5)])
def test_a_quiet_channel_that_flickers_between_two_levels_is_not_clipped(offset, noise):
    value = np.round(np.random.default_rng(3).normal(offset, noise, 6000))
    assert np.mean(clipped(value)) < 0.01


def test_bridging_draws_straight_lines_and_holds_the_ends():
    value = np.array([np.nan, 1.0, np.nan, np.nan, 4.0, 5.0, np.nan])
    np.testing.assert_allclose(bridged(value, np.isnan(value)), [1.0, 1.0, 2.0, 3.0, 4.0, 5.0, 5.0])
    known = np.array([1.0, 2.0])
    assert bridged(known, np.zeros(2, dtype=bool)) is known


@pytest.mark.parametrize("frequency", [0.5, 3.3, 20.0])
def test_the_dominant_frequency_is_that_of_a_sine_with_an_offset(frequency):
    time = np.arange(6000) / 100.0
    value = 9.81 + 0.2 * np.sin(2 * np.pi * frequency * time + 0.1)
    assert dominant_frequency(value, 100.0) == pytest.approx(frequency, abs=0.02)


def test_the_dominant_frequency_of_band_noise_is_rices():
    # Rice: zero crossings of a Gaussian process with an even spectrum up to B come at B/sqrt(3) cycles a second.
    rng = np.random.default_rng(4)
    spectrum = np.fft.rfft(rng.normal(size=200_000))
    spectrum[np.fft.rfftfreq(200_000, 0.01) > 12.0] = 0.0
    found = dominant_frequency(np.fft.irfft(spectrum), 100.0)
    assert found == pytest.approx(12.0 / np.sqrt(3.0), rel=0.03)
