"""Missing frames before the FIR branches: values that are no numbers, and frames that an even series left out."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from fir_records import METHODS, moving, two_tones
from fusion_oracles import displacement_block
from hypothesis import given, settings
from hypothesis import strategies as st

from midspan.fusion.complementary import run
from midspan.fusion.fir import FirFilter, FirSettings
from midspan.fusion.missing import MissingFrames, is_even
from midspan.fusion.smoother import collected
from midspan.fusion.two_stage import TwoStageFir, TwoStageSettings
from midspan.records import Status, nanoseconds, part

TIME, MET = np.arange(6000) / 100.0, np.arange(599) / 10.0 + 0.0043
NUMBER = np.arange(len(MET))
KINDS = ("no number", "infinite variance", "left out")
SEEDS = range(12)


@cache
def clean(seed):
    return two_tones(TIME, MET, seed)


def missing(displacement, gone, kind):
    if kind == "left out":
        return part(displacement, ~gone)
    if kind == "no number":
        return replace(displacement, value_m=np.where(gone, np.nan, displacement.value_m))
    return replace(displacement, variance_m2=np.where(gone, np.inf, displacement.variance_m2))


def fused(make, acceleration, displacement):
    return collected(run(make(), acceleration, displacement))


def near(gone):
    """Rows within a frame of a missing one, away from the ends."""
    found = np.zeros(len(TIME), dtype=bool)
    for at in MET[gone]:
        found |= np.abs(TIME - at) <= 0.1
    return found & (TIME > 8.0) & (TIME < 52.0)


def errors(found, where):
    error = (found.estimate.displacement_m - moving(TIME, 0))[where]
    return error, np.abs(error) <= 1.96 * np.sqrt(found.estimate.variance_m2[where])


def rms(values):
    return float(np.sqrt(np.mean(np.square(np.concatenate(values)))))


@pytest.mark.parametrize("count", [1, 2, 3])
@pytest.mark.parametrize("method", METHODS)
def test_a_few_missing_frames_are_filled_from_the_acceleration_and_the_band_stays_honest(method, count):
    gone = np.isin(NUMBER % 40, range(count)) & (NUMBER > 140)
    error, inside, usual = [], [], []
    for seed in SEEDS:
        acceleration, displacement = clean(seed)
        found = fused(METHODS[method], acceleration, missing(displacement, gone, "no number"))
        one, within = errors(found, near(gone))
        error.append(one)
        inside.append(within)
        usual.append(errors(fused(METHODS[method], acceleration, displacement), near(gone))[0])
        # The third prediction in a row is as good as a measurement, but for some: they are told as a gap.
        assert len(found.events) <= (2 if count == 3 else 0)
        assert np.all(found.estimate.status[near(gone)] == Status.TRACKING)
    # A spline through the frames beside makes 7 times the usual error of one missing frame.
    assert rms(error) <= 1.5 * rms(usual)
    # Twelve records with ten places each: 93.3 to 95 % over fifty records, here ± 2.5 %.
    assert np.mean(np.concatenate(inside)) >= 0.89


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("count", [1, 3, 12])
def test_however_frames_are_missing_the_rows_are_the_same(method, count):
    acceleration, displacement = clean(1)
    gone = np.isin(NUMBER % 100, range(count)) & (NUMBER > 100)
    rows = [fused(METHODS[method], acceleration, missing(displacement, gone, kind)) for kind in KINDS]
    for other in rows[1:]:
        # The raster's instants are learnt from the stamps to some nanoseconds: 100 mm/s make 1e-10 m of it.
        np.testing.assert_allclose(other.estimate.displacement_m, rows[0].estimate.displacement_m, atol=1e-9)
        np.testing.assert_allclose(other.estimate.variance_m2, rows[0].estimate.variance_m2, rtol=1e-3)
        np.testing.assert_array_equal(other.estimate.status, rows[0].estimate.status)
        assert other.events == rows[0].events


@pytest.mark.parametrize("method", METHODS)
def test_a_long_gap_is_told_and_its_rows_are_the_smoothers(method):
    acceleration, displacement = clean(2)
    gone = (NUMBER >= 300) & (NUMBER < 320)
    found = fused(METHODS[method], acceleration, missing(displacement, gone, "no number"))
    (event,) = found.events
    assert event.kind == "gap"
    # From the last measured frame, not from the last one that was filled.
    assert event.time_ns == nanoseconds(MET[299:300])[0]
    assert "for 2.1 s" in event.text
    during = np.abs(TIME - 0.5 * (MET[300] + MET[320])) < 0.45
    assert np.all(found.estimate.status[during] == Status.COASTING)
    # One curve: a single draw of an error that is alike all through the gap.
    ratio = errors(found, during)[0] / np.sqrt(found.estimate.variance_m2[during])
    assert np.max(np.abs(ratio)) < 3.5
    assert np.median(found.estimate.variance_m2[during]) > 2.0 * found.estimate.variance_m2[2000]


@pytest.mark.parametrize("make", [FirFilter, TwoStageFir])
def test_frames_that_are_only_late_or_of_an_uneven_series_change_nothing(make):
    acceleration, displacement = clean(3)
    rng = np.random.default_rng(0)
    literal = {
        FirFilter: FirFilter(FirSettings(literal=True)),
        TwoStageFir: TwoStageFir(TwoStageSettings(literal=True)),
    }
    assert literal[make]._screen is None
    # Up to 35 ms late, and every second one 45 ms: no instant between two of them is a missing frame.
    for late in (rng.integers(-35_000_000, 35_000_000, len(MET)), 45_000_000 * (NUMBER % 2)):
        moved = replace(displacement, time_ns=displacement.time_ns + late)
        asked = make()
        never = make()
        never._screen.begin = lambda first, every_s, begin=never._screen.begin: begin(first)
        one, other = (collected(run(stream, acceleration, moved)) for stream in (asked, never))
        for name in one.estimate.__slots__:
            np.testing.assert_array_equal(getattr(one.estimate, name), getattr(other.estimate, name))
        for name in one.innovation.__slots__:
            np.testing.assert_array_equal(getattr(one.innovation, name), getattr(other.innovation, name))


def test_an_even_series_is_known_with_single_frames_left_out():
    stamps = nanoseconds(np.array([0.0, 0.1, 0.2, 0.4, 0.501, 0.6]))
    assert is_even(stamps, 0.1)
    assert not is_even(stamps + np.array([0, 0, 30_000_000, 0, 0, 0]), 0.1)
    assert not is_even(stamps[:2], 0.1)


@settings(max_examples=50, deadline=None)
@given(
    gone=st.lists(st.integers(2, 39), unique=True, max_size=20),
    cuts=st.lists(st.integers(1, 4_200), unique=True, max_size=8).map(sorted),
)
def test_the_instants_asked_for_do_not_depend_on_the_cutting(gone, cuts):
    kept = np.setdiff1d(np.arange(40), gone)
    measured = displacement_block(kept / 10.0 + 0.0021 * (kept % 3), np.zeros(len(kept)), 1e-8)
    measured = replace(measured, variance_m2=np.where(kept % 7 == 3, np.inf, 1e-8))
    found = []
    for ends in ([4_200], [*cuts, 4_200]):
        watch, sent, instants = MissingFrames(), 0, []
        watch.begin(0.1, 0.5)
        for end in ends:
            due = int(np.searchsorted(measured.time_ns, end * 1_000_000, side="right"))
            instants += watch.until(part(measured, slice(sent, due)), end * 1_000_000).time_ns.tolist()
            sent = due
        found.append(instants)
    assert found[0] == found[1] == sorted(found[1])


CUTS = st.lists(st.integers(1, 5999), unique=True, max_size=8).map(sorted)


@settings(max_examples=12, deadline=None)
@given(cuts=CUTS, method=st.sampled_from(sorted(METHODS)), kind=st.sampled_from(KINDS), seed=st.integers(0, 99))
def test_any_cutting_equals_the_whole_with_missing_frames(cuts, method, kind, seed):
    acceleration, displacement = clean(0)
    rng = np.random.default_rng(seed)
    gone = np.zeros(len(MET), dtype=bool)
    for at in rng.integers(60, 590, 12):
        gone[at : at + rng.integers(1, 9)] = True
    displacement = missing(displacement, gone, kind)
    whole = fused(METHODS[method], acceleration, displacement)
    stream, outputs, sent = METHODS[method](), [], 0
    for start, stop in zip([0, *cuts], [*cuts, 6000], strict=True):
        due = int(np.searchsorted(displacement.time_ns, acceleration.time_ns[stop - 1], side="right"))
        stream.push(part(displacement, slice(sent, due)))
        sent = due
        outputs += stream.push(part(acceleration, slice(start, stop)))
    pieces = collected([*outputs, *stream.finish()])
    np.testing.assert_array_equal(pieces.estimate.time_ns, acceleration.time_ns)
    np.testing.assert_array_equal(pieces.estimate.status, whole.estimate.status)
    np.testing.assert_array_equal(pieces.estimate.source, whole.estimate.source)
    np.testing.assert_array_equal(pieces.innovation.value_m, whole.innovation.value_m)
    # Transforms of other lengths round differently: 1e-14 of some millimetres.
    np.testing.assert_allclose(pieces.estimate.displacement_m, whole.estimate.displacement_m, atol=1e-13)
    np.testing.assert_allclose(pieces.estimate.variance_m2, whole.estimate.variance_m2, rtol=1e-8)
    assert sorted(e.time_ns for e in pieces.events) == sorted(e.time_ns for e in whole.events)
