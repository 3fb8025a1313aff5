"""The likelihood of a calibration: against a dense solution, honest deviations, and noise levels of short windows."""

from dataclasses import replace

import numpy as np
import pytest
from calibration_cases import broadband, observed

from midspan.calibration import time_offset
from midspan.calibration.fit import Pair, aligned, best_corner, evaluate, gauss_newton, refine
from midspan.calibration.scale import calibrate_scale
from midspan.calibration.slow_error import likeliest_slow_error
from midspan.calibration.time_offset import curvature, scan, search_offset
from midspan.calibration.whitening import BIAS_WALK_RATIO, NO_SLOW_ERROR, SETTLING, integrated, products_of
from midspan.simulate.motion.motion import Sines
from repeats import slow

SCALE, OFFSET_S = 1.3e-3, -0.07


def record(seed: int) -> Pair:
    """Half a minute of a structure with three modes, at 100 or 200 Hz and 8 to 30 Hz; 1 to 4 mm/s², 0.01 to 0.05 px."""
    rng = np.random.default_rng(seed)
    frequency = rng.uniform((0.4, 1.5, 3.0), (1.2, 2.8, 7.0))
    motion = Sines(rng.uniform(0.5, 2.0, 3) * 1e-2 / frequency**1.5, frequency, phase_rad=rng.uniform(0.0, 6.28, 3))
    rate, noise, noise_px = rng.choice((100.0, 200.0)), rng.uniform(1e-3, 4e-3), rng.uniform(0.01, 0.05)
    time = np.arange(0.0, 30.0, 1.0 / rate)
    pushed = motion.acceleration(time) + rng.normal(0.02, noise, time.size)
    stamps = np.arange(0.2, 29.8, 1.0 / rng.uniform(8.0, 30.0)) + 1e-3 * rng.uniform(-1.0, 1.0)
    value = motion.displacement(stamps + OFFSET_S) / SCALE + rng.normal(0.0, noise_px, stamps.size)
    return Pair(
        np.column_stack((time, pushed - pushed.mean(), np.ones(time.size))),
        np.column_stack((stamps, value - value[0], np.full(stamps.size, noise_px**2))),
    )


@pytest.mark.parametrize("draws", [24, *slow(96)])
def test_scale_and_offset_scatter_by_their_standard_deviations(draws):
    found = [calibrate_scale(record(seed), 0.15) for seed in range(draws)]
    scale = [(one.scale.value_m_per_px - SCALE) / np.sqrt(one.scale.variance) for one in found]
    offset = [(one.search.offset.value_s - OFFSET_S) / np.sqrt(one.search.offset.variance) for one in found]
    for z in (np.array(scale), np.array(offset)):
        # 96 draws: the rms of z is known to ± 7 %, its mean to ± 0.1; 24 draws: to the double.
        scatter = np.sqrt(96 / draws)
        assert 1.0 - 0.15 * scatter < np.sqrt(np.mean(z**2)) < 1.0 + 0.2 * scatter
        assert abs(np.mean(z)) < 0.3 * scatter


def test_what_was_fitted_is_never_that_of_another_noise():
    pair = record(5)
    fit = best_corner(pair, OFFSET_S)
    likeliest_slow_error(pair, fit)
    for error in (NO_SLOW_ERROR, (4.0, 0.5, 0.0), (400.0, 0.5, 0.0), (400.0, 0.5, 3.0)):
        changed = pair.changed(slow=error)
        for corner in (*pair.recent[0].fits, fit.corner, 1.1 * fit.corner):
            kept, fresh = (evaluate(one, OFFSET_S, corner).likelihood for one in (changed, replace(changed)))
            assert kept == fresh
    for corner in pair.recent[0].fits:
        assert evaluate(pair, OFFSET_S, corner).likelihood == evaluate(replace(pair), OFFSET_S, corner).likelihood


@pytest.mark.parametrize(
    "fields", [{"motion_share": 0.4}, {"level": np.linspace(0.5, 1.5, 3000)}, {"bias_drifts": True}, {"ratio": 1.0}]
)
def test_a_changed_pair_is_that_of_its_fields(fields):
    pair = record(6)
    n = len(pair.samples)
    fields = {name: np.resize(one, n) if name == "level" else one for name, one in fields.items()}
    evaluate(pair, OFFSET_S, 2.0)
    kept, fresh = (evaluate(one, OFFSET_S, 2.0) for one in (pair.changed(**fields), replace(pair, **fields)))
    assert (kept.likelihood, kept.ratio) == (fresh.likelihood, fresh.ratio)
    rows, samples = pair.rows[::2], pair.samples * [1.0, 1.1, 1.0]
    for change in ({"rows": rows}, {"samples": samples}, {"rows": rows, "samples": samples}):
        kept, fresh = (evaluate(one, OFFSET_S, 2.0) for one in (pair.changed(**change), replace(pair, **change)))
        assert (kept.likelihood, kept.ratio) == (fresh.likelihood, fresh.ratio)


def test_a_search_that_changes_nothing_of_its_pair_scans_the_offsets_once(monkeypatch):
    scans = []
    monkeypatch.setattr(time_offset, "scan", lambda *given: scans.append(given) or scan(*given))
    pair = record(5)
    pair = replace(pair, rows=pair.rows / np.array([1.0, 1.0, pair.rows[0, 2]]))
    search_offset(pair, 0.15)
    assert len(scans) == 1
    assert pair.changed(motion_share=0.0, rows=pair.rows, ratio=None) is pair


def test_products_are_those_of_the_innovations():
    pair = record(7)
    here = aligned(pair, OFFSET_S)
    corner, columns = 2.0, here.columns
    w = here.whitened(corner)
    sums = products_of(columns.rows, columns.values, pair.pieces, corner**4 / pair.rate_hz, apart=2)
    # Sums of some hundred squares are rounded to a few 1e-15 of their size.
    assert sums.squares == pytest.approx([w.product(one, one) for one in w.columns.T], rel=1e-12)
    assert sums.with_first[1] == pytest.approx(w.product(w.translation, w.response), rel=1e-12)
    assert sums.with_later == pytest.approx([w.product(w.translation, w.columns[:, 2])], rel=1e-12)
    assert (sums.count, sums.entropy, sums.input_share) == (len(w.variance), w.entropy, w.input_share)


def test_whitened_columns_are_those_of_a_dense_solution():
    # Second route: innovations of correlated values are their Cholesky factor's solution; the covariance is that of the
    # start, the accelerometer's noise and the walk of its bias, integrated in closed form.
    pair = record(3)
    pair = replace(pair, rows=pair.rows[:40] / [1.0, 1.0, pair.rows[0, 2]])
    here, corner = aligned(pair, OFFSET_S), 2.0
    t = here.columns.rows[:, 0] - here.columns.rows[0, 0]
    density = corner**4 / pair.rate_hz
    shape = np.column_stack((np.ones(t.size), t, -0.5 * t * t))
    first = np.minimum(t[:, None], t)
    apart = np.abs(t[:, None] - t)
    white = density * first**2 * (first / 3.0 + apart / 2.0)
    walk = density * BIAS_WALK_RATIO * first**3 * (first**2 / 20.0 + first * apart / 8.0 + apart**2 / 12.0)
    covariance = shape @ (1e9 * np.eye(3)) @ shape.T + white + walk + np.eye(t.size)
    factor = np.linalg.cholesky(covariance)
    expected = np.linalg.solve(factor, here.columns.values)[SETTLING:]
    w = here.whitened(corner)
    # The filter lets the bias walk from step to step: 0.1 s, a part in ten thousand.
    np.testing.assert_allclose(w.columns / np.sqrt(w.variance)[:, None], expected, atol=2e-3 * np.std(expected))
    np.testing.assert_allclose(np.sqrt(w.variance), np.diag(factor)[SETTLING:], rtol=1e-3)


def test_the_acceleration_is_integrated_twice():
    motion = Sines(np.array([3e-3]), np.array([2.0]))
    time = np.arange(0.0, 10.0, 0.01)
    response = integrated(np.column_stack((time, motion.acceleration(time), np.ones(time.size))))
    at = np.arange(0.5, 9.5, 0.0137)
    left = response.at(at) - motion.displacement(at)
    left -= np.polynomial.Polynomial.fit(at, left, 1)(at)
    # A straight line is what integration leaves open; the rule errs by (ω dt)⁴/480 = 5e-7 and a sine's chord.
    assert np.abs(left).max() < 1e-4 * 3e-3


def test_the_scan_is_the_likelihood_at_each_offset():
    pair = record(5)
    offsets = np.linspace(-0.1, 0.1, 9)
    curve, corner = scan(pair, offsets)
    for offset, value, at in zip(offsets, curve, corner, strict=True):
        assert value == pytest.approx(evaluate(pair, float(offset), float(at)).likelihood, abs=1e-6)


def test_at_the_maximum_the_score_is_zero_and_the_information_is_the_curvature():
    pair = record(7)
    fit = refine(pair, best_corner(pair, OFFSET_S + 2e-3), 0.005)
    step, information = gauss_newton(pair, fit)
    assert abs(step) * np.sqrt(information) < 0.02
    # The observed curvature scatters about the expected one by a few percent at a thousand measurements.
    assert curvature(pair, fit)[0] == pytest.approx(1.0 / information, rel=0.1)


@pytest.mark.parametrize(("length_s", "draws"), [(5.0, 8), (8.0, 8), *slow((5.0, 16), (8.0, 16))])
def test_a_short_window_does_not_make_an_accelerometer_without_noise(length_s, draws):
    found = []
    for seed in range(draws):
        pair = observed(broadband(seed), seed)
        samples = pair.samples[pair.samples[:, 0] < length_s]
        rows = pair.rows[pair.rows[:, 0] < length_s - 0.3]
        found.append(np.sqrt(100.0 * calibrate_scale(Pair(samples, rows), 0.15).input_noise.density))
    # 50 measurements hardly tell 2 mm/s² of noise; without a prior a third of them would tell 3e-6 m/s².
    assert min(found) > 2e-3 / 10.0
    assert 1.3e-3 < np.median(found) < 4e-3
