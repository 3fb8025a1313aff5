"""Figures of a comparison against closed forms."""

import numpy as np
import pytest

from midspan.errors import DataError, UsageError
from midspan.evaluate.metrics import Band, compare, coverage, normalised_innovation, piecewise
from midspan.records import Innovation, TimeSeries, nanoseconds


def series(value, rate_hz=100.0, start_s=0.0):
    value = np.asarray(value, dtype=np.float64)
    return TimeSeries(nanoseconds(start_s + np.arange(len(value)) / rate_hz), value)


def tones(t):
    """Two incommensurate tones, so that only one lag fits; 1.3 mm at most."""
    return 1e-3 * np.sin(2 * np.pi * 1.3 * t) + 0.3e-3 * np.sin(2 * np.pi * 4.1 * t + 1.0)


@pytest.mark.parametrize("late_s", [0.0, 0.0123, -0.31, 0.7777])
def test_a_late_estimate_has_its_delay_as_positive_lag_far_below_a_sample(late_s):
    t = np.arange(4000) / 100.0
    found = compare(series(tones(t - late_s)), series(tones(t)))
    # The spline's error at 4.1 Hz and 100 Hz is 5/384 (2π·0.041)⁴ = 6e-5 of 0.3 mm; over the slope of the curves that
    # is some microseconds at most.
    assert found.lag_s == pytest.approx(late_s, abs=1e-5)


def test_the_lag_of_a_pure_tone_is_the_smallest_of_its_many():
    t = np.arange(6000) / 100.0
    found = compare(series(np.sin(2 * np.pi * 3.0 * (t - 0.04))), series(np.sin(2 * np.pi * 3.0 * t)))
    assert found.lag_s == pytest.approx(0.04, abs=1e-5)


def test_the_lag_survives_noise_and_a_reference_of_another_rate_and_start():
    rng = np.random.default_rng(5)
    t, other = np.arange(20_000) / 100.0, np.arange(9000) / 51.2
    own = series(tones(t - 0.05) + 1e-5 * rng.standard_normal(len(t)))
    found = compare(own, series(tones(other + 3.3), 51.2, 3.3))
    # Standard error of a delay: noise / (slope rms · sqrt(samples)) = 1e-5 / (8e-3 · sqrt(5000)) = 2e-5 s; six of them.
    assert found.lag_s == pytest.approx(0.05, abs=1.2e-4)


def test_a_constant_offset_is_the_bias_and_nothing_else():
    t = np.arange(3000) / 100.0
    found = compare(series(tones(t) + 0.25e-3), series(tones(t)))
    # Both series share their instants, so that only rounding is left.
    assert found.bias_mm == pytest.approx(0.25, abs=1e-9)
    assert found.rmse_mm == pytest.approx(0.25, abs=1e-9)
    assert found.largest_error_mm == pytest.approx(0.25, abs=1e-9)
    assert found.rmse_without_bias_mm == pytest.approx(0.0, abs=1e-9)
    assert found.correlation == pytest.approx(1.0, abs=1e-12)
    assert found.count == 3000


def test_a_wrong_scale_of_a_sine_gives_its_closed_form():
    # 40 whole periods of amplitude 2 mm: the error is 3 % of it, its rms 0.03·2/sqrt(2), its largest value 0.06 mm.
    t = np.arange(4000) / 100.0
    sine = 2e-3 * np.sin(2 * np.pi * t)
    found = compare(series(1.03 * sine), series(sine))
    assert found.rmse_mm == pytest.approx(0.03 * 2 / np.sqrt(2), rel=1e-9)
    assert found.largest_error_mm == pytest.approx(0.06, rel=1e-9)
    assert (found.largest_error_at_s - 0.25) % 0.5 == pytest.approx(0.0, abs=1e-9)
    assert found.peak_to_peak_mm == pytest.approx(1.03 * 4.0, rel=1e-9)
    assert found.reference_peak_to_peak_mm == pytest.approx(4.0, rel=1e-9)
    assert found.normalised_rmse_percent == pytest.approx(100 * 0.03 / np.sqrt(2) / 2, rel=1e-9)
    assert found.lag_s == pytest.approx(0.0, abs=1e-6)


def test_interpolation_keeps_the_error_bound_of_the_cubic_spline():
    frequency, rate = 2.0, 20.0
    t = np.arange(400) / rate
    at = np.arange(1000, 9000) / 500.0
    error = piecewise(series(np.sin(2 * np.pi * frequency * t), rate)).at(at) - np.sin(2 * np.pi * frequency * at)
    bound = 5.0 / 384.0 * (2 * np.pi * frequency / rate) ** 4
    assert np.max(np.abs(error)) < bound
    # Not idle: the error is of the bound's size.
    assert np.max(np.abs(error)) > 0.1 * bound


def test_nothing_is_compared_across_a_gap_of_the_reference():
    t = np.arange(3000) / 100.0
    whole = series(tones(t))
    kept = (t <= 10.0) | (t >= 12.0)
    broken = TimeSeries(whole.time_ns[kept], whole.value[kept])
    wrong_inside = np.where(kept, tones(t), 5.0)
    found = compare(series(wrong_inside), broken)
    assert found.count == np.count_nonzero(kept)
    assert found.rmse_mm == pytest.approx(0.0, abs=1e-9)
    assert any("1 gap;" in note for note in found.notes)


def test_missing_values_count_on_neither_side():
    t = np.arange(3000) / 100.0
    own, other = tones(t), tones(t)
    own[100:110], other[500:560] = np.nan, np.nan
    found = compare(series(own), series(other))
    assert found.count == 3000 - 10 - 60
    assert found.rmse_mm == pytest.approx(0.0, abs=1e-9)


def test_constant_signals_have_neither_correlation_nor_lag():
    found = compare(series(np.zeros(1000)), series(np.full(1000, 1e-3)))
    assert found.correlation is None
    assert found.lag_s is None
    assert found.normalised_rmse_percent is None
    assert found.bias_mm == pytest.approx(-1.0, abs=1e-12)


def test_epoch_stamps_lose_nothing():
    t = np.arange(2000) / 100.0
    start = 1_750_000_000.0
    a, b = series(tones(t - 0.02)), series(tones(t))
    late = [TimeSeries(s.time_ns + int(start) * 1_000_000_000, s.value) for s in (a, b)]
    assert compare(*late).lag_s == pytest.approx(compare(a, b).lag_s, abs=1e-9)
    assert compare(*late).rmse_mm == pytest.approx(compare(a, b).rmse_mm, rel=1e-9)


def test_series_without_common_instants_are_refused_with_both_spans():
    t = np.arange(1000) / 100.0
    with pytest.raises(DataError, match=r"0\.000 s to 9\.990 s.*100\.000 s to 109\.990 s"):
        compare(series(tones(t)), series(tones(t), start_s=100.0))


def test_an_honest_band_covers_what_its_level_says():
    rng = np.random.default_rng(3)
    std = rng.uniform(0.5, 2.0, 40_000)
    error = std * rng.standard_normal(len(std))
    for level in (0.5, 0.6827, 0.95, 0.99):
        # A share of 40000 draws scatters by sqrt(p(1-p)/40000) <= 0.0025; four of them.
        assert coverage(error, std, level) == pytest.approx(level, abs=0.01)
    assert coverage(error, std / 2.0, 0.95) == pytest.approx(0.673, abs=0.01)
    t = np.arange(len(std)) / 100.0
    found = compare(series(tones(t) + 1e-3 * error), series(tones(t)), band=Band(1e-3 * std))
    assert found.coverage_95 == coverage(error, std, 0.95)


def test_a_level_that_is_no_probability_is_refused():
    with pytest.raises(UsageError, match=r"between 0 and 1; received 95"):
        coverage(np.zeros(3), np.ones(3), 95)


def test_normalised_innovations_leave_rejected_ones_out_and_have_unit_power():
    rng = np.random.default_rng(8)
    variance = rng.uniform(1e-8, 4e-8, 20_000)
    value = np.sqrt(variance) * rng.standard_normal(len(variance))
    verdict = np.zeros(len(value), dtype=np.int8)
    value[::10], verdict[::10] = 1.0, 1
    found = normalised_innovation(Innovation(np.arange(len(value)), value, variance, verdict))
    assert len(found) == 18_000
    # The mean square of n normal draws scatters by sqrt(2/n) = 0.0105; four of them.
    assert np.mean(found**2) == pytest.approx(1.0, abs=0.042)


def test_another_zero_and_another_clock_are_named_and_taken_off():
    """A reference 12 mm and 20 ms off is another datum and another clock, not a wrong displacement."""
    rng, t = np.random.default_rng(5), np.arange(6000) / 100.0
    zero_std, own_std, off = 0.1e-3, 0.02e-3, 12.3e-3
    value = tones(t - 0.02) + rng.normal(0.0, own_std, len(t)) + 0.15e-3
    band = Band(np.full(len(t), np.hypot(zero_std, own_std)), zero_std)
    found = compare(series(value), series(tones(t) - off), band=band)
    assert found.plain.coverage_95 == 0.0
    assert found.plain.rmse_mm > 12.0
    assert found.without_zero_and_lag.zero_mm == pytest.approx(12.45, abs=1e-3)
    assert found.without_zero_and_lag.late_s == pytest.approx(0.02, abs=1e-3)
    # What is left is the displacement's own noise, and the band without the zero's part covers it: 5 % of 5996 ± 3 σ.
    assert found.without_zero_and_lag.rmse_mm == pytest.approx(0.02, rel=0.03)
    assert found.without_zero_and_lag.coverage_95 == pytest.approx(0.95, abs=0.01)
    assert [line.split(":")[0] for line in found.notes] == [
        "The reference has another zero",
        "The reference has another clock",
    ]
    assert f"0.0 % inside ±1.96 σ; zero removed: RMSE {found.without_zero.rmse_mm:.4g} mm, " in repr(found)
    headline = compare(series(value), series(tones(t) - off), band=band, align="zero+lag")
    assert headline.to_dict()["rmse_mm"] == found.without_zero_and_lag.rmse_mm
    assert np.sqrt(np.mean(headline.error_mm**2)) == pytest.approx(headline.rmse_mm)


def test_a_comparison_on_one_zero_and_clock_explains_nothing_away():
    rng, t = np.random.default_rng(6), np.arange(3000) / 100.0
    value = tones(t) + rng.normal(0.0, 0.02e-3, len(t))
    assert compare(series(value), series(tones(t))).notes == ()


def test_a_mean_error_that_the_zero_s_band_contains_is_no_other_zero():
    t = np.arange(3000) / 100.0
    value = tones(t) + np.random.default_rng(7).normal(0.0, 0.02e-3, len(t)) + 0.12e-3
    own = np.full(len(t), 0.02e-3)
    for zero_std, notes in ((0.1e-3, 0), (0.05e-3, 1)):
        found = compare(series(value), series(tones(t)), band=Band(np.hypot(own, zero_std), zero_std))
        assert len(found.notes) == notes


def test_an_alignment_that_is_none_is_refused():
    with pytest.raises(UsageError, match="align"):
        compare(series(tones(np.arange(100) / 100)), series(tones(np.arange(100) / 100)), align="lag")
