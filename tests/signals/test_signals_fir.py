"""Filters, integration and interpolation against closed forms, scipy and numpy."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.interpolate import CubicSpline
from scipy.signal import freqz

from midspan.errors import UsageError
from midspan.fusion.methods import SPLINE_FRAMES
from midspan.papers.printed.filters import Transition, complement, equiripple_low_pass, response
from midspan.papers.printed.integrate import integrating
from midspan.papers.printed.resample import filtered_at, local_spline, spline_reach

PAIR = Transition(0.5, 1.0)


def scipy_amplitude(taps, frequency_hz, rate_hz):
    """The real amplitude about the middle tap by scipy."""
    _, whole = freqz(taps, worN=np.asarray(frequency_hz), fs=rate_hz)
    return (whole * np.exp(2j * np.pi * np.asarray(frequency_hz) / rate_hz * (len(taps) // 2))).real


@pytest.mark.parametrize(
    ("band", "rate_hz"),
    [
        (PAIR, 100.0),
        (Transition(1.0, 5.0), 100.0),
        (PAIR, 200.0),
        (PAIR, 1000.0),
        (Transition(0.5, 1.0, 5e-3), 100.0),
        (Transition(2.0, 3.0, 1e-4), 128.0),
    ],
)
def test_an_equiripple_low_pass_keeps_its_ripple_in_both_bands(band, rate_hz):
    taps = equiripple_low_pass(band, rate_hz)
    passed = scipy_amplitude(taps, np.linspace(0, band.pass_hz, 700), rate_hz)
    stopped = scipy_amplitude(taps, np.linspace(band.stop_hz, 0.5 * rate_hz, 20_000), rate_hz)
    # Between the points of the design's own grid the ripple may be a few thousandths of itself higher.
    assert np.max(np.abs(passed - 1)) <= 1.01 * band.ripple
    assert np.max(np.abs(stopped)) <= 1.01 * band.ripple


def test_the_equiripple_filter_is_nearly_as_short_as_kaisers_estimate():
    # Kaiser's estimate without any flatness is 645 taps at 1e-3; flatness at zero costs a sixth.
    assert 645 <= len(equiripple_low_pass(PAIR, 100.0)) <= 1.2 * 645


@pytest.mark.parametrize("rate_hz", [50.0, 100.0, 1000.0])
def test_a_low_pass_keeps_parabolas_and_its_complement_takes_them_away(rate_hz):
    taps = equiripple_low_pass(PAIR, rate_hz)
    index = np.arange(len(taps)) - len(taps) // 2
    assert np.sum(taps) == pytest.approx(1.0, abs=1e-12)
    # The second moment of a filter that were not flat is of the order of its length squared.
    assert abs(np.sum(taps * index**2)) < 1e-9 * len(taps) ** 2
    assert np.sum(complement(taps) * (3.0 + 2.0 * index)) == pytest.approx(0.0, abs=1e-9)


def test_low_pass_and_complement_add_to_a_pure_delay():
    taps = equiripple_low_pass(PAIR, 100.0)
    both = taps + complement(taps)
    assert both[len(taps) // 2] == pytest.approx(1.0, abs=1e-15)
    assert np.count_nonzero(np.abs(both) > 1e-15) == 1


def test_response_agrees_with_scipy():
    taps = equiripple_low_pass(Transition(2.0, 5.0, 1e-2), 100.0)
    frequency = np.linspace(0, 50, 333)
    np.testing.assert_allclose(response(taps, frequency, 100.0), scipy_amplitude(taps, frequency, 100.0), atol=1e-12)


def test_integration_and_high_pass_in_one_have_the_product_of_both_responses():
    rate_hz, low = 100.0, equiripple_low_pass(PAIR, 100.0)
    taps = integrating(complement(low), 1 / rate_hz)
    frequency = np.linspace(0.2, 49.0, 400)
    # The trapezoidal rule twice: −dt² / (4 tan²) of half a turn.
    rule_response = -(0.01**2) / (4 * np.tan(np.pi * frequency / rate_hz) ** 2)
    expected = (1 - scipy_amplitude(low, frequency, rate_hz)) * rule_response
    # The double sum of 749 taps loses some 1e-12 of the largest sum, 0.1 s².
    np.testing.assert_allclose(scipy_amplitude(taps, frequency, rate_hz), expected, atol=1e-11)
    assert abs(np.sum(taps)) < 1e-9


def splined(at, knots, value, longest=0.25):
    return local_spline(at, knots, value, longest, 0.1 * spline_reach(SPLINE_FRAMES))


def test_the_local_spline_follows_the_spline_through_all_knots():
    # Four knots on each side forget all but 0.268^4 = 0.5 % of what is beyond: a tenth of the spline's own error here.
    rng = np.random.default_rng(1)
    knots = np.cumsum(0.1 * rng.uniform(0.7, 1.3, 300))
    at = np.arange(2.0, 28.0, 0.01)
    rows, good = splined(at, knots, np.sin(2 * np.pi * knots))
    assert good.all()
    whole = CubicSpline(knots, np.sin(2 * np.pi * knots))(at)
    np.testing.assert_allclose(rows, whole, atol=5e-4)


@given(a=st.floats(-5, 5), b=st.floats(-5, 5), c=st.floats(-5, 5), seed=st.integers(0, 50))
def test_the_local_spline_reproduces_parabolas_up_to_its_ends(a, b, c, seed):
    knots = np.cumsum(0.1 * np.random.default_rng(seed).uniform(0.7, 1.3, 20))
    at = np.linspace(knots[0], knots[-1], 200)
    rows, good = splined(at, knots, a + b * knots + c * knots**2)
    assert good.all()
    np.testing.assert_allclose(rows, a + b * at + c * at**2, atol=1e-11)


def test_the_local_spline_bridges_no_gap_and_no_missing_value():
    knots = np.arange(60) / 10.0
    knots[30:] += 0.5
    value = np.where(np.arange(60) == 10, np.nan, 1.0)
    at = np.arange(0, 6.5, 0.01)
    rows, good = splined(at, knots, value)
    hidden = ((at > 0.9) & (at < 1.1)) | ((at > 2.9) & (at < 3.5)) | (at > knots[-1])
    assert not good[hidden].any()
    assert good[(at > 0.001) & (at < 0.89)].all()
    assert np.all(rows[good] == pytest.approx(1.0, abs=1e-12))
    assert np.all(rows[~good] == 0.0)


def test_a_filter_is_read_between_samples_as_its_own_cubic():
    rate_hz, high = 100.0, complement(equiripple_low_pass(Transition(1.0, 5.0), 100.0))
    taps = integrating(high, 0.01), 0.01**2 * high
    time, omega = np.arange(600) / 100.0, 2 * np.pi * 10.3
    index = np.arange(100, 500)
    fraction = np.random.default_rng(0).uniform(0, 1, len(index))
    found = filtered_at(-(omega**2) * np.sin(omega * time), index, fraction, taps)
    gain = response(high, np.array([10.3]), rate_hz)[0]
    # At the samples the trapezoidal rule makes the amplitude too small by 6.9 %; between them a cubic with right second
    # derivatives errs by up to 5/384 (w dt)^4 = 0.23 %, and by (w dt)²/8 of these 6.9 %, as its ends are too small and
    # its bend is not.
    gain *= (angle := omega * 0.005) ** 2 / np.tan(angle) ** 2
    np.testing.assert_allclose(found, gain * np.sin(omega * (index + fraction) / rate_hz), atol=6.2e-3)


@pytest.mark.parametrize(
    "wrong",
    [
        lambda: Transition(1.0, 0.5),
        lambda: Transition(0.0, 1.0),
        lambda: Transition(0.5, 1.0, 0.0),
        lambda: equiripple_low_pass(Transition(1.0, 60.0), 100.0),
        lambda: integrating(np.ones(5), 0.01),
        lambda: integrating(complement(np.full(4, 0.25)), 0.01),
        lambda: integrating(complement(np.full(5, 0.2)), 0.0),
    ],
)
def test_wrong_settings_are_reported(wrong):
    with pytest.raises(UsageError, match="must be"):
        wrong()
