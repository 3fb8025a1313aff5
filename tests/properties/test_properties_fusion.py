"""Whatever the stamps and however the input is cut: the same output, a proper covariance, time that only goes on."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from midspan.fusion.streams import NO_ERRORS, KalmanFilter, KalmanSettings, filtered, no_innovation, smooth
from midspan.records import Acceleration, Displacement, Estimate, Event, Innovation, joined, part

# Loose numbers in a short record; the outliers split the hypotheses.
SETTINGS = KalmanSettings(displacement_std=0.3, velocity_std=0.5, bias_std=0.1)


def record(seed, rate_hz=50.0, length=300, count=80):
    rng = np.random.default_rng(seed)
    steps = rng.uniform(0.3, 1.7, length) / rate_hz * 1e9
    steps[rng.integers(0, length, 2)] *= rng.uniform(1, 60)
    time_ns = 1_700_000_000_000_000_000 + np.cumsum(steps).astype(np.int64)
    acceleration = Acceleration(time_ns, rng.normal(0.3, 1.0, length), 10 ** rng.uniform(-8, -1, length))
    lead = round(0.05e9)
    met_ns = np.sort(rng.integers(time_ns[0] - lead, time_ns[-1] + lead, count))
    met_ns[5] = met_ns[6]  # two at one instant
    value = rng.normal(0, 0.01, count) + np.where(rng.random(count) < 0.2, rng.normal(0, 5, count), 0.0)
    variance = 10 ** rng.uniform(-10, -2, count)
    variance[rng.random(count) < 0.1] = np.inf
    value[rng.random(count) < 0.1] = np.nan
    return acceleration, Displacement(met_ns, value, variance, rng.integers(1, 5, count).astype(np.uint8))


def collected(outputs):
    innovations = [item for item in outputs if isinstance(item, Innovation)]
    return (
        joined([item for item in outputs if isinstance(item, Estimate)]),
        joined([no_innovation(), *innovations]),
        # Of one push they are in the order of time.
        sorted((item for item in outputs if isinstance(item, Event)), key=lambda one: (one.time_ns, one.text)),
    )


def assert_same(got, expected):
    for block, other in zip(got[:2], expected[:2], strict=True):
        for name in block.__slots__:
            np.testing.assert_array_equal(getattr(block, name), getattr(other, name), err_msg=name)
    assert got[2] == expected[2]


def whole(acceleration, displacement, settings=SETTINGS):
    stream = KalmanFilter(settings)
    stream.push(displacement)
    return collected([*stream.push(acceleration), *stream.finish()])


CUTS = st.lists(st.integers(1, 299), unique=True, max_size=12).map(sorted)


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 10_000), cuts=CUTS, choices=st.randoms(use_true_random=False))
def test_any_cutting_and_interleaving_equals_the_whole(seed, cuts, choices):
    acceleration, displacement = record(seed)
    stream, outputs, pushed = KalmanFilter(SETTINGS), [], 0
    for start, stop in zip([0, *cuts], [*cuts, 300], strict=True):
        block = part(acceleration, slice(start, stop))
        # What this block covers must have come; any number of later measurements may have come already, in pieces.
        due = int(np.searchsorted(displacement.time_ns, block.time_ns[-1], side="right"))
        until = choices.randint(min(due, 80), 80)
        while pushed < until:
            size = choices.randint(1, until - pushed)
            assert stream.push(part(displacement, slice(pushed, pushed + size))) == []
            pushed += size
        outputs += stream.push(block)
    assert_same(collected([*outputs, *stream.finish()]), whole(acceleration, displacement))


@pytest.mark.parametrize("rate_hz", [20.0, 100.0, 997.0])
def test_sample_by_sample_equals_the_whole(rate_hz):
    acceleration, displacement = record(11, rate_hz)
    stream, outputs = KalmanFilter(SETTINGS), []
    for i in range(80):
        stream.push(part(displacement, slice(i, i + 1)))
    for k in range(300):
        outputs += stream.push(part(acceleration, slice(k, k + 1)))
    assert_same(collected([*outputs, *stream.finish()]), whole(acceleration, displacement))


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 10_000), cut=st.integers(1, 298), lag=st.sampled_from([0, 20]))
def test_a_restored_filter_goes_on_as_the_one_that_was_saved(seed, cut, lag):
    acceleration, displacement = record(seed)
    first = KalmanFilter(SETTINGS, lag_samples=lag)
    first.push(displacement)
    first.push(part(acceleration, slice(cut)))
    second = KalmanFilter(SETTINGS, lag_samples=lag)
    second.restore(first.state)
    rest = part(acceleration, slice(cut, None))
    assert_same(collected([*second.push(rest), *second.finish()]), collected([*first.push(rest), *first.finish()]))


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 10_000), cuts=CUTS)
def test_the_covariance_stays_positive_and_time_only_goes_on(seed, cuts):
    acceleration, displacement = record(seed)
    stream, before = KalmanFilter(SETTINGS), -np.inf
    stream.push(displacement)
    for start, stop in zip([0, *cuts], [*cuts, 300], strict=True):
        stream.push(part(acceleration, slice(start, stop)))
        state = stream._estimator.core.filter()
        if state is None:
            continue
        time_s, _, whole_p = state
        assert time_s > before
        before = time_s
        p = whole_p[:3, :3]
        deviation = np.sqrt(np.diag(p))
        # As correlations, so that metres and m/s² weigh alike; below 1e-9 a variance of 1e-10 is lost in rounding.
        assert np.linalg.eigvalsh(p / np.outer(deviation, deviation)).min() > -1e-9


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 10_000))
def test_the_smoother_is_never_less_certain_than_the_filter(seed):
    acceleration, displacement = record(seed)
    # The smoother takes the noise as the filter ends with it; both as declared are comparable row by row.
    declared = replace(SETTINGS, rates=NO_ERRORS, noise_memory=np.inf)
    causal, both = (method(acceleration, displacement, declared).estimate for method in (filtered, smooth))
    assert np.all(both.variance_m2 > 0)
    assert np.all(both.variance_m2 <= causal.variance_m2 * (1 + 1e-9))
    # At the end both know the same.
    assert both.displacement_m[-1] == pytest.approx(causal.displacement_m[-1], rel=1e-9, abs=1e-12)
    assert both.variance_m2[-1] == pytest.approx(causal.variance_m2[-1], rel=1e-9)


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 10_000), factor=st.floats(0.01, 100.0))
def test_results_scale_with_the_unit_of_length(seed, factor):
    # Metres or any other unit: all lengths times a factor give the result times that factor.
    acceleration, displacement = record(seed)
    scaled_settings = KalmanSettings(
        bias_walk=SETTINGS.bias_walk * factor**2,
        displacement_std=SETTINGS.displacement_std * factor,
        velocity_std=SETTINGS.velocity_std * factor,
        bias_std=SETTINGS.bias_std * factor,
    )
    scaled = smooth(
        Acceleration(
            acceleration.time_ns, acceleration.value_m_s2 * factor, acceleration.noise_density * factor * factor
        ),
        Displacement(
            displacement.time_ns,
            displacement.value_m * factor,
            displacement.variance_m2 * factor * factor,
            displacement.source,
        ),
        scaled_settings,
    )
    plain = smooth(acceleration, displacement, SETTINGS)
    size = np.max(np.abs(plain.estimate.displacement_m))
    np.testing.assert_allclose(
        scaled.estimate.displacement_m / factor, plain.estimate.displacement_m, rtol=1e-6, atol=1e-8 * size
    )
    np.testing.assert_array_equal(scaled.innovation.verdict, plain.innovation.verdict)
