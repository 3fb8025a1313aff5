"""`lag`: between filter and smoother, equal to dense conditioning on what came within the lag."""

from itertools import pairwise

import numpy as np
import pytest
from fusion_oracles import acceleration_block, chain, displacement_block, filtered
from hypothesis import given, settings
from hypothesis import strategies as st
from test_fusion_oracles import OPEN, short_record

from midspan.errors import UsageError
from midspan.evaluate.bound import KnownNoise, exact_bound
from midspan.fusion.kalman import KalmanSettings
from midspan.fusion.lag import LagSettings, LagSmoother, smooth_with_lag
from midspan.fusion.smoother import collected, smooth
from midspan.records import Estimate, part


def noisy(seed=0, length=1000, count=90):
    rng = np.random.default_rng(seed)
    time = np.arange(length) / 100.0
    acceleration = acceleration_block(time, rng.normal(0, 1.0, length), 1e-4)
    stamps = np.sort(rng.uniform(0, length / 100.0, count))
    value = rng.normal(0, 0.01, count)
    value[30:40] += 3.0  # a run of rejections
    return acceleration, displacement_block(stamps, value, 1e-5)


def test_a_long_lag_is_the_smoother():
    blocks = noisy()
    # The smoother takes the noise as told.
    told = LagSettings(1e6, KalmanSettings(learn_noise=False))
    late, both = smooth_with_lag(*blocks, told), smooth(*blocks)
    np.testing.assert_allclose(late.estimate.displacement_m, both.estimate.displacement_m, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(late.estimate.velocity_m_s, both.estimate.velocity_m_s, rtol=1e-8, atol=1e-9)
    # The first rows' variance is a small difference of the wide start's.
    np.testing.assert_allclose(late.estimate.variance_m2[50:], both.estimate.variance_m2[50:], rtol=1e-6)
    np.testing.assert_array_equal(late.innovation.value_m, both.innovation.value_m)
    np.testing.assert_array_equal(late.estimate.status, both.estimate.status)
    assert late.events == both.events


def test_a_vanishing_lag_is_the_filter():
    blocks = noisy()
    late, causal = smooth_with_lag(*blocks, LagSettings(1e-9)).estimate, filtered(*blocks)[0]
    for name in causal.__slots__:
        np.testing.assert_array_equal(getattr(late, name), getattr(causal, name), err_msg=name)


@pytest.mark.parametrize("lag_s", [0.012, 0.05, 0.11, 0.2])
def test_rows_equal_dense_conditioning_on_what_came_within_the_lag(lag_s):
    acceleration, displacement = short_record(3)
    means, covariance, kinds = chain(acceleration, displacement, OPEN)
    found = smooth_with_lag(acceleration, displacement, LagSettings(lag_s, OPEN)).estimate
    met = [i for i, (kind, _, _) in enumerate(kinds) if kind == "d"]
    rows = [(i, lead) for i, (kind, _, lead) in enumerate(kinds) if kind == "a"]
    for k, (i, lead) in enumerate(rows):
        until = acceleration.time_ns[k] + round(1e9 * lag_s)
        used = [j for j in met if j < i or displacement.time_ns[kinds[j][1]] <= until]
        at, which = 3 * np.array(used, dtype=int), np.array([kinds[j][1] for j in used])
        cross = covariance[3 * i : 3 * i + 3][:, at]
        total = covariance[np.ix_(at, at)] + np.diag(displacement.variance_m2[which])
        gain = np.linalg.solve(total, cross.T).T
        state = means[i] + gain @ (displacement.value_m[which] - means[used, 0])
        left = covariance[3 * i, 3 * i] - gain[0] @ cross[0]
        # As for filter and smoother: the dense solve loses about six digits.
        assert found.displacement_m[k] == pytest.approx(state[0], rel=1e-8, abs=1e-9)
        assert found.velocity_m_s[k] == pytest.approx(state[1] - lead[1], rel=1e-7, abs=1e-7)
        assert found.variance_m2[k] == pytest.approx(left, rel=1e-7)


def test_more_lag_never_knows_less():
    blocks = noisy(1)
    widths = [smooth_with_lag(*blocks, LagSettings(lag)).estimate.variance_m2 for lag in (1e-9, 0.1, 0.3, 1.0, 30.0)]
    for wide, narrow in pairwise(widths):
        assert np.all(narrow[20:] <= wide[20:] * (1 + 1e-9))


def test_a_lag_of_1p6_corner_periods_leaves_three_per_cent_more_than_the_smoother():
    # A frame rate well above the corner, where the share depends on corner times lag alone. The rest of the 3 % is
    # between 1 and 5 %.
    noise = KnownNoise(0.02, 100.0, 3.5e-3, 50.0)
    late = exact_bound(noise, "lag", lag_s=1.6 / noise.corner_rad_s)
    assert 1.01 <= late / exact_bound(noise, "smoother") <= 1.05


@settings(max_examples=25, deadline=None)
@given(
    seed=st.integers(0, 1000),
    lag_s=st.sampled_from([1e-9, 0.03, 0.5, 2.0, 50.0]),
    cuts=st.lists(st.integers(1, 299), unique=True, max_size=8).map(sorted),
)
def test_any_cutting_gives_the_same_rows(seed, lag_s, cuts):
    acceleration, displacement = noisy(seed, 300, 60)
    whole = smooth_with_lag(acceleration, displacement, LagSettings(lag_s))
    stream, outputs = LagSmoother(LagSettings(lag_s)), []
    stream.push(displacement)
    for start, stop in zip([0, *cuts], [*cuts, 300], strict=True):
        outputs += stream.push(part(acceleration, slice(start, stop)))
    cut = collected([*outputs, *stream.finish()])
    for name in whole.estimate.__slots__:
        np.testing.assert_array_equal(getattr(cut.estimate, name), getattr(whole.estimate, name), err_msg=name)
    np.testing.assert_array_equal(cut.innovation.value_m, whole.innovation.value_m)
    assert cut.events == whole.events


def test_a_row_comes_out_with_the_first_sample_that_is_the_delay_later():
    acceleration, displacement = noisy()
    stream = LagSmoother(LagSettings(0.25))
    assert stream.delay_s == 0.25
    stream.push(displacement)
    given = 0
    for k in range(200):
        for item in stream.push(part(acceleration, slice(k, k + 1))):
            given += len(item.time_ns) if isinstance(item, Estimate) else 0
        assert given == max(0, k - 24)
    rest = [item for item in stream.finish() if isinstance(item, Estimate)]
    assert given + len(rest[0].time_ns) == 200
    # Nothing is kept of what was given out.
    assert stream.finish() == []


def test_what_is_held_back_does_not_grow():
    acceleration, displacement = noisy(2, 20000, 1900)
    stream = LagSmoother(LagSettings(0.5))
    held = []
    for start in range(0, 20000, 500):
        due = np.searchsorted(
            displacement.time_ns, [acceleration.time_ns[start] - 10_000_000, acceleration.time_ns[start + 499]]
        )
        stream.push(part(displacement, slice(*(int(i) for i in due))))
        stream.push(part(acceleration, slice(start, start + 500)))
        held.append(len(stream._nodes) + len(stream._used))
    # Fifty samples and the measurements of half a second, some ten.
    assert max(held) < 80


@pytest.mark.parametrize("lag_s", [0.0, -1.0, np.nan, np.inf])
def test_a_lag_that_is_no_positive_number_is_refused(lag_s):
    with pytest.raises(UsageError, match="lag_s"):
        LagSettings(lag_s)


def test_a_record_without_a_measurement_coasts():
    acceleration, displacement = noisy()
    none = part(displacement, slice(0))
    late = smooth_with_lag(acceleration, none, LagSettings(0.5, KalmanSettings()))
    assert len(late.innovation.time_ns) == 0
    assert len(late.estimate.time_ns) == 1000
