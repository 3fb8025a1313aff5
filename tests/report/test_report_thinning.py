"""Thinning keeps what the camera must see."""

import numpy as np

from midspan.report.thinning import envelope, logarithmic_means, spans


def test_an_envelope_holds_every_value_and_both_extremes():
    rng = np.random.default_rng(6)
    t, value = np.arange(100_000) / 100.0, rng.standard_normal(100_000).cumsum()
    found = envelope(t, value, value, 500)
    assert len(found.t) == 500
    assert not found.whole
    assert np.max(found.high) == value.max()
    assert np.min(found.low) == value.min()
    segment = np.minimum(np.arange(100_000) // 200, 499)
    assert np.all(value <= found.high[segment])
    assert np.all(value >= found.low[segment])


def test_a_short_series_is_drawn_as_it_is_with_a_break_in_its_pause():
    t = np.concatenate((np.arange(50), np.arange(100, 150))) / 10.0
    found = envelope(t, t, t)
    assert found.whole
    assert np.flatnonzero(np.isnan(found.low)).tolist() == [50]
    np.testing.assert_array_equal(np.delete(found.low, 50), t)


def test_spans_cover_exactly_the_marked_rows_and_never_lose_a_short_one():
    t = np.arange(1000) / 10.0
    mask = np.zeros(1000, dtype=bool)
    mask[100:200], mask[500] = True, True
    found = spans(t, mask)
    np.testing.assert_allclose(found, [(10.0, 10.0), (50.0, 0.1)], atol=1e-9)
    # A single row of a hundred thousand is still there, as long as one of the segments.
    wide = np.zeros(100_000, dtype=bool)
    wide[77_777] = True
    ((start, length),) = spans(np.arange(100_000.0), wide, 1000)
    assert start <= 77_777 < start + length
    assert length == 100.0
    assert spans(t, np.zeros(1000, dtype=bool)) == []


def test_logarithmic_means_keep_the_level_and_the_power_of_a_line():
    frequency = np.arange(1, 40_001) * 1e-3
    flat = np.full(len(frequency), 3.0)
    f, p = logarithmic_means(frequency, flat, 400)
    assert len(f) <= 400
    np.testing.assert_allclose(p, 3.0, rtol=1e-12)
    flat[20_000] += 1e6
    f, p = logarithmic_means(frequency, flat, 400)
    # Averaging spreads a line over its bin, whose width is known: the area stays.
    edges = np.unique(np.searchsorted(frequency, np.geomspace(frequency[0], frequency[-1], 400)))
    edges = np.append(edges[edges < len(frequency)], len(frequency))
    np.testing.assert_allclose(np.sum(p * np.diff(edges)), np.sum(flat), rtol=1e-12)
