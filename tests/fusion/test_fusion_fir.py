"""`fir` against a dense least-squares solution, closed forms, and truth."""

import numpy as np
import pytest
from fusion_oracles import acceleration_block, displacement_block

from midspan.errors import UsageError
from midspan.fusion.streams import KalmanSettings, smooth
from midspan.papers.printed.branches import NoiseGain, Rates
from midspan.papers.printed.complementary import smoothed_record
from midspan.papers.printed.filters import response
from midspan.papers.printed.fir import (
    FirSettings,
    cut_off_weight,
    design,
    fir,
    noise_weight,
    window_filters,
)
from midspan.records import Status, joined, part

STEP_S = 0.01
RATES = Rates(STEP_S, 0.1, 4e-8, 1e-8)


def noisy(seed, rate_hz=10.0, tones=((8e-3, 0.1), (3e-3, 2.2)), *, length_s=40.0, bias=0.05, jitter_s=0.0):
    """Both sensors on a few tones, and the truth: 2 mm/s² and 0.1 mm of noise."""
    rng = np.random.default_rng(seed)
    time, met = np.arange(0, length_s, STEP_S), np.arange(0, length_s, 1 / rate_hz) + 0.0037
    time = np.round(time + jitter_s * np.random.default_rng([1, seed]).normal(size=len(time)), 9)
    phase = rng.uniform(0, 2 * np.pi, len(tones))

    def summed(at, order):
        return sum(
            a * (2 * np.pi * f) ** order * np.sin(2 * np.pi * f * at + p + order * np.pi / 2)
            for (a, f), p in zip(tones, phase, strict=True)
        )

    acceleration = acceleration_block(time, summed(time, 2) + bias + rng.normal(0, 2e-3, len(time)), 4e-8)
    displacement = displacement_block(met, summed(met, 0) + rng.normal(0, 1e-4, len(met)), 1e-8)
    return acceleration, displacement, summed(time, 0), summed(time, 1)


def dense_rows(half, weight, *, average, free_bias):
    """Middle rows of the least-squares solution by a QR decomposition of the stacked problem, nothing banded."""
    n = 2 * half + 1
    difference = np.diff(np.eye(n), 2, axis=0)
    ends = np.ones(n - 2)
    ends[[0, -1]] = np.sqrt(0.5)
    left = np.vstack((ends[:, None] * difference, weight * np.eye(n)))
    if free_bias:
        left = np.column_stack((left, np.concatenate((ends, np.zeros(n)))))
    # Unknowns u* (and dt² bias); right side for a unit of each acceleration, of each displacement.
    averaged = np.array([np.convolve(np.eye(n)[k], average, mode="same")[1:-1] for k in range(n)]).T
    right_a = np.vstack((STEP_S**2 * ends[:, None] * averaged, np.zeros((n, n))))
    right_u = np.vstack((np.zeros((n - 2, n)), weight * np.eye(n)))
    return (
        np.linalg.lstsq(left, right_u, rcond=None)[0][half],
        np.linalg.lstsq(left, right_a, rcond=None)[0][half],
    )


@pytest.mark.parametrize("free_bias", [False, True])
@pytest.mark.parametrize(
    ("rule", "average"), [("central-difference", (0.0, 1.0, 0.0)), ("numerov", (1 / 12, 10 / 12, 1 / 12))]
)
@pytest.mark.parametrize("half", [20, 50])
def test_the_filters_are_the_middle_row_of_the_least_squares_solution(half, rule, average, free_bias):
    weight = cut_off_weight(2.0, 0.97, STEP_S)
    low, high = window_filters(half, weight, STEP_S, rule=rule, free_bias=free_bias)
    dense_low, dense_high = dense_rows(half, weight, average=average, free_bias=free_bias)
    # The stacked problem has the condition 4/lambda = 1500.
    np.testing.assert_allclose(low, dense_low, atol=1e-11)
    np.testing.assert_allclose(high, dense_high, atol=1e-9 * np.max(np.abs(dense_high)))


def test_a_long_window_has_the_closed_response_of_the_papers():
    weight = cut_off_weight(1.0, 0.97, STEP_S)
    low, high = window_filters(900, weight, STEP_S, rule="central-difference", free_bias=False)
    frequency = np.linspace(0.0, 50.0, 300)
    turn = 2 - 2 * np.cos(2 * np.pi * frequency * STEP_S)
    # 900 samples are 14 time constants of the filter: e^-14 is 1e-6, at the window's ends times its own amplitude.
    np.testing.assert_allclose(response(low, frequency, 100.0), weight**2 / (turn**2 + weight**2), atol=1e-5)
    expected = -turn * STEP_S**2 / (turn**2 + weight**2)
    np.testing.assert_allclose(response(high, frequency, 100.0), expected, atol=1e-5 * np.max(np.abs(expected)))


def test_the_target_frequency_gets_the_wanted_accuracy():
    for target, accuracy in ((1.0, 0.97), (0.5, 0.9)):
        half = round(9 / (target * STEP_S))
        weight = cut_off_weight(target, accuracy, STEP_S)
        low, _ = window_filters(half, weight, STEP_S, rule="central-difference", free_bias=True)
        assert 1 - response(low, np.array([target]), 100.0)[0] == pytest.approx(accuracy, abs=1e-3)


def test_both_branches_add_to_a_pure_delay():
    # The high branch integrates; times the second difference over the rule it is a high-pass again.
    frequency = np.linspace(0.0, 50.0, 200)
    turn = 2 - 2 * np.cos(2 * np.pi * frequency * STEP_S)
    for rule, beta in (("central-difference", 0.0), ("numerov", 1 / 12)):
        low, high = window_filters(150, 7e-4, STEP_S, rule=rule, free_bias=True)
        averaged = 1 - 2 * beta + 2 * beta * np.cos(2 * np.pi * frequency * STEP_S)
        passed = response(low, frequency, 100.0) * averaged - response(high, frequency, 100.0) * turn / STEP_S**2
        np.testing.assert_allclose(passed, averaged, atol=1e-8)


def test_the_printed_filter_lets_a_bias_through_and_the_free_bias_takes_it_away():
    weight = cut_off_weight(1.0, 0.97, STEP_S)
    printed = window_filters(150, weight, STEP_S, rule="central-difference", free_bias=False)[1]
    free = window_filters(150, weight, STEP_S, rule="central-difference", free_bias=True)[1]
    assert np.sum(printed) == pytest.approx(-0.0223, abs=1e-4)
    assert abs(np.sum(free)) < 1e-9


def test_the_weight_from_noise_is_the_best_of_all():
    # The response of a row's variance to the weight has its least at the noises' crossover.
    def variance(weight):
        low, high = window_filters(700, weight, STEP_S, rule="numerov", free_bias=True)
        return np.sum(low**2) * 1e-8 * 10.0 + np.sum(high**2) * 4e-8 * 100.0

    best = noise_weight(RATES)
    assert variance(best) < min(variance(best * factor) for factor in (0.7, 0.85, 1.15, 1.4))


def test_the_variance_is_the_theory_of_matched_noises():
    # Non-causal optimum: S_d w / (2 sqrt 2); the spline's own response costs a little near the corner.
    gain = NoiseGain(design(RATES, FirSettings()), RATES)
    n = 4001
    found = gain.rows(np.full(n, 1e-8), np.full(n, 4e-8))[0]
    corner = (4e-8 / 1e-9) ** 0.25
    assert found == pytest.approx(1e-9 * corner / (2 * np.sqrt(2)), rel=0.03)


@pytest.mark.parametrize("literal", [False, True])
def test_varying_noise_takes_the_same_way_as_constant_noise(literal):
    gain = NoiseGain(design(RATES, FirSettings(literal=literal)), RATES)
    n = 2001
    constant = gain.rows(np.full(n, 1e-8), np.full(n, 4e-8))
    nearly = gain.rows(np.linspace(1e-8, 1.0000001e-8, n), np.full(n, 4e-8))
    np.testing.assert_allclose(nearly, constant, rtol=1e-5)
    raised = np.full(n, 1e-8)
    raised[1000] = 1e-4
    assert gain.rows(raised, np.full(n, 4e-8)).argmax() == len(constant) // 2


@pytest.mark.parametrize("settings_", [FirSettings(), FirSettings(literal=True)], ids=["noise", "literal"])
def test_the_band_covers_with_and_without_folding(settings_):
    # Three records of 40 s hold some 100 independent errors: ± 4 %. With folding at 3.3 Hz on 3 Hz (error 1 to 2 mm)
    # the band holds the aliased part itself and is too wide rather than too narrow.
    for rate_hz, tone, least, most in ((10.0, 2.2, 0.91, 0.99), (3.0, 3.3, 0.95, 1.0)):
        inside, found, reported = [], [], []
        for seed in range(3):
            acceleration, displacement, truth, _ = noisy(seed, rate_hz, ((8e-3, 0.1), (3e-3, tone)))
            estimate = fir(acceleration, displacement, settings_)
            error = (estimate.displacement_m - truth)[600:-600]
            inside.append(np.mean(np.abs(error) <= 1.96 * np.sqrt(estimate.variance_m2[600:-600])))
            found.append(np.mean(error**2))
            reported.append(np.mean(estimate.variance_m2[600:-600]))
        assert least <= np.mean(inside) <= most
        # Also the size is reported: the mean variance is the mean square error.
        assert 0.8 < np.sqrt(np.mean(reported) / np.mean(found)) < 1.3


@pytest.mark.parametrize("settings_", [FirSettings(), FirSettings(literal=True)], ids=["noise", "literal"])
def test_gravity_and_a_high_level_show_nowhere(settings_):
    one = noisy(3, bias=0.0)
    plain = fir(one[0], one[1], settings_)
    acceleration, displacement, _, _ = noisy(3, bias=9.80665)
    raised = displacement_block(displacement.time_ns / 1e9, displacement.value_m + 123.0, 1e-8)
    moved = fir(acceleration, raised, settings_)
    # Rounding: 1e-12 of 9.8 m/s² times the filter of 1 s², and 1e-14 of 123 m.
    np.testing.assert_allclose(moved.displacement_m - 123.0, plain.displacement_m, atol=1e-10)
    np.testing.assert_allclose(moved.velocity_m_s, plain.velocity_m_s, atol=1e-6)
    # Behind the wide prior the first rows' variance is a small difference.
    np.testing.assert_allclose(moved.variance_m2, plain.variance_m2, rtol=1e-3)


def test_the_noise_matched_filter_is_as_good_as_the_smoother_without_folding():
    acceleration, displacement, truth, velocity = noisy(5)
    inner = slice(600, -600)
    ours, best = fir(acceleration, displacement), smooth(acceleration, displacement).estimate
    errors = [np.sqrt(np.mean((e.displacement_m - truth)[inner] ** 2)) for e in (ours, best)]
    assert errors[0] < 1.06 * errors[1]
    speeds = [np.sqrt(np.mean((e.velocity_m_s - velocity)[inner] ** 2)) for e in (ours, best)]
    assert speeds[0] < 1.1 * speeds[1]


@pytest.mark.parametrize("literal", [False, True])
def test_rows_beside_gaps_are_those_of_the_smoother(literal):
    acceleration, displacement, _, _ = noisy(0, length_s=60.0)
    kept = np.ones(len(acceleration.time_ns), dtype=bool)
    kept[2000:2030] = False
    met = np.ones(len(displacement.time_ns), dtype=bool)
    met[400:420] = False
    acceleration, displacement = part(acceleration, kept), part(displacement, met)
    found = fir(acceleration, displacement, FirSettings(literal))
    path = smoothed_record(acceleration, displacement, KalmanSettings()).estimate
    np.testing.assert_array_equal(found.time_ns, acceleration.time_ns)
    np.testing.assert_array_equal(found.status, path.status)
    same = found.displacement_m == path.displacement_m
    time = found.time_ns / 1e9
    # Half the window: 0.5 s of the printed form and some 2 s of the other; the spline looks on from there.
    reach_s = 0.5 if literal else 1.0
    companions = (
        ((time > 20.0 - reach_s) & (time < 20.3 + reach_s)) | ((time > 40.0) & (time < 42.0)) | (time < reach_s)
    )
    assert np.all(same[companions])
    assert not np.any(same[(time > 24.0) & (time < 36.0)])


def test_single_frames_left_out_and_outliers_cost_next_to_nothing():
    acceleration, displacement, truth, _ = noisy(0, tones=((8e-3, 0.1), (3e-3, 3.3)), length_s=120.0)
    rng = np.random.default_rng(5)
    value = displacement.value_m + np.where(rng.random(len(displacement.value_m)) < 0.03, 5e-3, 0.0)
    met = rng.random(len(value)) > 0.03
    spoilt = part(displacement_block(displacement.time_ns / 1e9, value, 1e-8), met)
    clean, dirty = (np.std((fir(acceleration, d).displacement_m - truth)[600:-600]) for d in (displacement, spoilt))
    # A seventeenth of the frames is missing.
    assert dirty < 1.06 * clean


def test_truly_stamped_jitter_of_the_acceleration_costs_nothing():
    # Taken as even, 0.2 ms on 3 mm at 8.3 Hz would turn into 0.06 m/s² of noise: thirty times the sensor's.
    found = []
    for jitter_s in (0.0, 2e-4):
        acceleration, displacement, truth, velocity = noisy(1, tones=((8e-3, 0.1), (3e-3, 8.3)), jitter_s=jitter_s)
        estimate = fir(acceleration, displacement)
        error = (estimate.displacement_m - truth)[600:-600]
        found.append((np.std(error), np.std((estimate.velocity_m_s - velocity)[600:-600])))
        assert np.mean(np.abs(error) <= 1.96 * np.sqrt(estimate.variance_m2[600:-600])) > 0.9
    assert found[1][0] < 1.2 * found[0][0]
    assert found[1][1] < 1.5 * found[0][1]


def test_measurements_of_two_sensors_at_nearly_one_instant_do_not_swing_the_spline():
    acceleration, displacement, truth, _ = noisy(4)
    rng = np.random.default_rng(0)
    companions = displacement_block(
        displacement.time_ns / 1e9 + 1e-4,
        np.interp(displacement.time_ns, acceleration.time_ns, truth) + rng.normal(0, 1e-4, len(displacement.time_ns)),
        1e-8,
        source=3,
    )
    both = joined([displacement, companions])
    both = part(both, np.argsort(both.time_ns))
    inner = slice(600, -600)
    one, two = (np.std((fir(acceleration, d).displacement_m - truth)[inner]) for d in (displacement, both))
    # Any swing would be tenfold.
    assert two < 1.05 * one


def test_rows_come_for_every_sample_however_little_there_is():
    acceleration, displacement, truth, _ = noisy(6)
    for n in (2, 50, 300, 900):
        estimate = fir(part(acceleration, slice(n)), displacement)
        assert len(estimate.time_ns) == n
        error = estimate.displacement_m - truth[:n]
        assert np.all(np.abs(error) < 5 * np.sqrt(estimate.variance_m2))
    nothing = fir(part(acceleration, slice(500)), part(displacement, slice(0)))
    assert np.all(nothing.status == Status.LOST)
    assert np.all(nothing.variance_m2 > 0.1**2)


@pytest.mark.parametrize(
    "wrong",
    [{"cut_off_hz": 0.0}, {"accuracy": 1.0}, {"accuracy": 0.0}, {"half_window": 2}, {"spline_frames": -1}],
)
def test_wrong_settings_are_reported(wrong):
    with pytest.raises(UsageError, match="must be"):
        FirSettings(**wrong)
