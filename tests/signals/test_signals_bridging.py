"""Acceleration with missing, frozen and clipped segments: refused, or bridged with a band that holds the truth."""

import numpy as np
import pytest

from midspan.errors import DataError
from midspan.fusion.streams import smooth
from midspan.records import Displacement, TimeSeries
from midspan.signals.acceleration import prepare_acceleration
from midspan.simulate.motion.motion import random_motion

WHERE = "accelerometer (accel.csv)"
NOISE_A, NOISE_M = 2e-3, 1e-4
TIME_NS = np.arange(6000, dtype=np.int64) * 10_000_000


def channel(seed=0):
    motion = random_motion((0.5, 6.0), 2e-3, rng=np.random.default_rng(seed), flat="velocity")
    noise = np.random.default_rng(1000 + seed).normal(0, NOISE_A, len(TIME_NS))
    return motion, motion.acceleration(TIME_NS / 1e9) + 0.03 + noise


def prepared(value, time_ns=TIME_NS):
    return prepare_acceleration(TimeSeries(time_ns, value), WHERE)


def test_a_whole_channel_is_left_as_it_is():
    _, value = channel()
    found = prepared(value)
    np.testing.assert_array_equal(found.value_m_s2, value)
    assert not found.bridging_density.any()
    assert not found.missing.any()
    assert found.events == ()
    assert found.warnings == ()
    np.testing.assert_array_equal(found.with_noise(3.0).noise_density, 3.0)


def with_hole(value, kind, start=3000, stop=3040):
    value, time_ns = value.copy(), TIME_NS
    if kind == "nan":
        value[start:stop] = np.nan
    elif kind == "frozen":
        value[start : start + 150] = value[start]
    elif kind == "gap":
        kept = np.r_[0:start, stop : len(value)]
        value, time_ns = value[kept], TIME_NS[kept]
    return value, time_ns


@pytest.mark.parametrize("kind", ["nan", "frozen", "gap"])
def test_a_hole_is_bridged_marked_and_reported(kind):
    value, time_ns = with_hole(channel()[1], kind)
    found = prepared(value, time_ns)
    assert np.all(np.isfinite(found.value_m_s2))
    assert np.all(np.diff(found.time_ns) > 0)
    (event,) = found.events
    assert event.kind == ("gap" if kind == "gap" else "bridged")
    assert event.time_ns == pytest.approx(30.0e9, abs=2e7)
    (warning,) = found.warnings
    assert WHERE in warning
    assert {"nan": "are not numbers", "frozen": "are frozen", "gap": "gaps in time"}[kind] in warning
    assert np.count_nonzero(found.missing) == {"nan": 40, "frozen": 149, "gap": 0}[kind]
    raised = np.flatnonzero(found.bridging_density)
    assert abs(int(raised[0]) - 3000) <= 1
    # The interval that follows the last missing sample starts from an unknown acceleration, too.
    assert raised[-1] == {"nan": 3040, "frozen": 3150, "gap": 3000}[kind]


@pytest.mark.parametrize("length", [10, 50, 200])
@pytest.mark.parametrize("kind", ["nan", "gap"])
def test_in_a_bridged_segment_the_band_widens_and_holds_the_truth(kind, length):
    inside, wider = [], []
    for seed in range(12):
        motion, value = channel(seed)
        value, time_ns = with_hole(value, kind, 3000, 3000 + length)
        met_ns = np.arange(0, 60_000_000_000, 100_000_000, dtype=np.int64) + 4_000_000
        measured = motion.displacement(met_ns / 1e9) + np.random.default_rng(seed).normal(0, NOISE_M, len(met_ns))
        variance = np.full(len(met_ns), NOISE_M**2)
        displacement = Displacement(met_ns, measured, variance, np.full(len(met_ns), 4, dtype=np.uint8))
        done = smooth(prepared(value, time_ns).with_noise(NOISE_A**2 / 100.0), displacement)
        rows = done.estimate
        near = np.abs(rows.time_ns / 1e9 - 30.0 - length / 200.0) <= length / 200.0 + 0.2
        error = rows.displacement_m - motion.displacement(rows.time_ns / 1e9)
        inside.append(np.mean(np.abs(error[near]) < 1.96 * np.sqrt(rows.variance_m2[near])))
        hole = np.abs(rows.time_ns / 1e9 - 30.0 - length / 200.0) <= length / 200.0
        wider.append(np.sqrt(np.max(rows.variance_m2[hole | near]) / np.median(rows.variance_m2)))
        # Right measurements are not rejected for the filter's being sure of a bridge.
        assert np.mean(done.innovation.verdict == 1) < 0.01
        assert not done.events
    # The density stands for a motion of unknown phase; the band may be too wide, never too narrow (95 % of 12 holes).
    assert np.mean(inside) > 0.90
    assert np.mean(wider) > 1.0


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (lambda v: np.where(np.arange(6000) % 4 == 0, np.nan, v), ("25.0 %", "missing", "at most 20 %")),
        (lambda v: np.where(np.arange(6000) < 1500, 0.1, v), ("25.0 %", "frozen", "at most 20 %")),
        (lambda v: np.clip(v, -0.2 * np.ptp(v), 0.12 * np.ptp(v)), ("clipped", "at most 5 %", "end of its range")),
        (lambda v: np.full(6000, np.nan), ("100.0 %", "missing")),
        (lambda v: np.zeros(6000), ("100.0 %", "frozen")),
    ],
)
def test_what_cannot_be_bridged_is_refused_with_share_limit_and_remedy(spoil, words):
    with pytest.raises(DataError) as caught:
        prepared(spoil(channel()[1]))
    for word in (*words, WHERE, "Check the sensor"):
        assert word in str(caught.value)


def test_just_below_the_limits_is_bridged():
    value = channel()[1]
    value[:1199] = np.nan
    assert np.count_nonzero(prepared(value).missing) == 1199


def test_calibration_rows_have_no_mean_and_count_bridged_samples_for_next_to_nothing():
    value, _ = with_hole(channel()[1], "nan", 3000, 3100)
    rows = prepared(value).rows(int(TIME_NS[1000]), slice(1000, 5000))
    assert np.mean(rows[:, 1]) == pytest.approx(0.0, abs=1e-12)
    np.testing.assert_allclose(rows[:, 0], np.arange(4000) / 100.0, atol=1e-9)
    assert np.all(rows[2000:2100, 2] > 100.0 * rows[:1900, 2].max())
    np.testing.assert_allclose(rows[:1900, 2], 1.0)


def test_white_noise_is_no_fast_motion():
    rng, time = np.random.default_rng(0), np.arange(4000) / 100.0
    for fast_hz, reported in ((None, False), (25.0, True), (40.0, True)):
        value = rng.normal(0.0, 1e-3, len(time))
        if fast_hz is not None:
            value = value + np.sin(2 * np.pi * fast_hz * time)
        series = TimeSeries(np.rint(1e9 * time).astype(np.int64), value)
        assert any("too close" in line for line in prepare_acceleration(series, "a").warnings) is reported
