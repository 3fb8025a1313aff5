"""A ratio of translation and acceleration that depends on frequency: found and taken out, or in the deviations."""

import numpy as np
import pytest

from midspan.calibration.agreement import misfit
from midspan.calibration.fit import Pair, best_corner, with_corner_doubt
from midspan.calibration.frequency_shapes import Kind
from midspan.calibration.own_noise import contradiction
from midspan.calibration.scale import calibrate_scale
from midspan.calibration.whitening import integrated
from midspan.signals.acceleration import GRAVITY_M_S2
from repeats import slow

SCALE, OFFSET_S, NOISE_PX, NOISE_M_S2 = -2e-3, 0.03, 0.005, 2e-3
BROAD = (0.6, 1.4, 2.6, 3.7)


def low_pass(corner_hz, order):
    """An analogue Butterworth low-pass without its delay at 0 Hz, as a function of s."""
    angle = np.pi * (2 * np.arange(1, order + 1) + order - 1) / (2 * order)
    poles = 2 * np.pi * corner_hz * np.exp(1j * angle)
    delay_s = float(np.sum(-1 / poles).real)
    return lambda s: np.prod(-poles / (s[:, None] - poles), axis=1) * np.exp(s * delay_s)


def first_order(corner_hz):
    """Four first-order low-passes without their delay at 0 Hz: they weaken fast motion long before their corner."""
    return lambda s: (np.exp(s / (2 * np.pi * corner_hz)) / (1.0 + s / (2 * np.pi * corner_hz))) ** 4


def observed(seed, *, exposure_s=0.0, slope=0.0, logger=None, modes_hz=BROAD, frames_hz=10.0, shake_hz=None):
    """A minute of sines about each mode: every sensor is a factor on each sine, so that all is exact."""
    rng = np.random.default_rng(seed)
    f = np.concatenate([mode + 0.02 * mode * rng.normal(size=12) for mode in modes_hz])
    c = 2e-3 / f * (rng.normal(size=len(f)) + 1j * rng.normal(size=len(f))) / np.sqrt(12)
    s = 2j * np.pi * f

    def at(time, amplitude, hertz=f):
        return (np.exp(2j * np.pi * np.outer(time, hertz)) @ amplitude).real

    time, met = np.arange(0.0, 60.0, 0.01), np.arange(0.553, 59.4, 1 / frames_hz)
    felt = c * (s**2 - GRAVITY_M_S2 * slope) * (1.0 if logger is None else logger(s))
    value = at(time, felt) + rng.normal(0.0, NOISE_M_S2, len(time))
    moved = at(met + OFFSET_S, c * np.sinc(f * exposure_s))
    if shake_hz is not None:
        moved += at(met + OFFSET_S, np.array([2e-4 + 0j]), np.array([shake_hz]))
    px = moved / SCALE + rng.normal(0.0, NOISE_PX, len(met))
    return Pair(
        np.column_stack((time, value - value.mean(), np.ones(len(time)))),
        np.column_stack((met, px - px[0], np.full(len(met), NOISE_PX**2))),
    )


def of_scale(found):
    """Error of the scale factor over its deviation, widened by what depends on frequency and by the misfit."""
    wide = found.scale.wider(found.response.relative_std).variance * misfit(found.search.pair, found.search.fit).factor
    return (found.scale.value_m_per_px - SCALE) / np.sqrt(wide)


def known_offset(pair):
    """The pair in units of the frames' variance and its fit at the true clock offset."""
    pair = Pair(pair.samples, pair.rows / np.array([1.0, 1.0, NOISE_PX**2]))
    return pair, best_corner(pair, OFFSET_S)


@pytest.mark.parametrize(
    ("broken", "kind"),
    [
        ({"exposure_s": 0.06}, Kind.EXPOSURE),
        ({"slope": 1.5 / 60}, Kind.LEAN),
        ({"logger": low_pass(12.0, 8)}, Kind.LAG),
        ({"logger": first_order(40.0)}, Kind.DROOP),
        *slow(
            ({"exposure_s": 0.09}, Kind.EXPOSURE),
            ({"slope": 1.5 / 20}, Kind.LEAN),
            ({"logger": low_pass(6.0, 4)}, Kind.LAG),
            ({"logger": first_order(20.0)}, Kind.DROOP),
        ),
    ],
)
@pytest.mark.parametrize("seed", [0, *slow(1, 2)])
def test_what_depends_on_frequency_is_found(broken, kind, seed):
    found = calibrate_scale(observed(seed, **broken), 0.1)
    assert kind in found.response.known
    assert abs(of_scale(found)) < 3.0
    # Without it the scale factor was wrong by 1 % and more in most of these.
    assert abs(found.scale.value_m_per_px / SCALE - 1.0) < 6e-3
    assert found.search.offset.value_s == pytest.approx(OFFSET_S, abs=5e-4)


@pytest.mark.parametrize("seed", [0, *slow(1)])
def test_the_exposure_and_the_slope_are_those_that_were_drawn(seed):
    exposure_s = calibrate_scale(observed(seed, exposure_s=0.07), 0.1).response.exposure_s
    slope = calibrate_scale(observed(seed, slope=0.04), 0.1).response.slope
    assert exposure_s == pytest.approx(0.07, rel=0.02)
    assert slope == pytest.approx(0.04, rel=0.1)


@pytest.mark.parametrize("seed", [0, *slow(1)])
def test_a_declared_exposure_is_taken_off_exactly(seed):
    pair = observed(seed, exposure_s=0.06)
    found = calibrate_scale(Pair(pair.samples, pair.rows, None, 0.06), 0.1, exposure_declared=True)
    assert not found.response.known
    statistical = (found.scale.value_m_per_px - SCALE) / np.sqrt(found.scale.variance)
    # The first term alone, exposure²/24 of the acceleration, was off by 0.3 %, many deviations.
    assert abs(statistical) < 3.0


def test_where_nothing_depends_on_frequency_the_estimate_stays_and_the_deviation_grows_a_little():
    grown = []
    for seed in range(6):
        found = calibrate_scale(observed(seed), 0.1)
        assert not found.response.known
        own = np.sqrt(found.scale.variance) / abs(found.scale.value_m_per_px)
        grown.append(np.hypot(own, found.response.relative_std) / own)
    assert 1.0 < np.median(grown) < 3.0


@pytest.mark.parametrize("broken", [{"exposure_s": 0.03}, {"slope": 0.03}])
@pytest.mark.parametrize("seed", [0, *slow(1, 2)])
def test_one_narrow_band_does_not_tell_it_and_the_deviation_holds_it(broken, seed):
    found = calibrate_scale(observed(seed, modes_hz=(1.5,), **broken), 0.05)
    assert abs(found.scale.value_m_per_px / SCALE - 1.0) > 1e-3
    assert abs(of_scale(found)) < 4.0


def test_a_shake_above_half_the_frame_rate_is_no_noise_of_the_accelerometer():
    # At 9.1 Hz with 10 frames/s it shows at 0.9 Hz.
    found = calibrate_scale(observed(0, shake_hz=9.1), 0.1)
    plain = calibrate_scale(observed(0), 0.1)
    apart_m = abs(SCALE) * contradiction(found.search.pair, found.search.fit)
    took_it, own_m = (abs(SCALE) * one for one in (found.noise.std, found.own.std if found.own else 0.0))
    assert max(apart_m, took_it, own_m) > 0.5 * 2e-4 / np.sqrt(2.0)
    assert contradiction(plain.search.pair, plain.search.fit) == 0.0
    assert not found.response.known


@pytest.mark.parametrize("hertz", [8.0, 12.0])
@pytest.mark.parametrize("seed", [0, *slow(1)])
def test_a_mounting_that_resonates_is_no_error_of_the_scale(hertz, seed):
    found = calibrate_scale(observed(seed, logger=lambda s: 1.0 / (1.0 + (s / (2 * np.pi * hertz)) ** 2)), 0.1)
    # It makes the accelerometer feel 3.7 Hz by 10 and 27 % too strongly; an exposure looks nearly alike.
    assert {Kind.EXPOSURE, Kind.RESONANCE} & set(found.response.known)
    assert abs(of_scale(found)) < 3.0
    assert abs(found.scale.value_m_per_px / SCALE - 1.0) < 6e-3


@pytest.mark.parametrize("times", [2.0, 4.0])
def test_the_noise_of_the_accelerometer_does_not_enlarge_the_scale(times):
    # Where a tenth and more of what is integrated is noise, a regression without a correction shrinks by as much.
    off = []
    for seed in range(6):
        pair = observed(seed, modes_hz=(0.15, 0.35))
        samples = pair.samples.copy()
        samples[:, 1] += np.random.default_rng(100 + seed).normal(0.0, times * 10e-3, len(samples))
        fit = with_corner_doubt(*known_offset(Pair(samples, pair.rows)), disputed=False)
        off.append((SCALE * fit.ratio - 1.0) / fit.relative_std)
    # The mean of six has a deviation of 0.4, and none is beyond four of its own.
    assert abs(np.mean(off)) < 1.5
    assert np.max(np.abs(off)) < 4.0


@pytest.mark.parametrize(("hertz", "damping"), [(6.0, 0.05), (6.4, 0.027)])
def test_a_railing_below_the_accelerometer_is_one_shape(hertz, damping):
    def railing(s):
        # The absolute acceleration of a mass on a spring and damper, over that of its foot.
        r = s / (2 * np.pi * hertz)
        return (1.0 + 2.0 * damping * r) / (1.0 + 2.0 * damping * r + r * r)

    found = calibrate_scale(observed(1, logger=railing, frames_hz=8.0), 0.1)
    # An exposure, a lean and a low-pass together made up for it, with a scale that was 5 to 21 deviations off.
    assert set(found.response.known) == {Kind.RESONANCE, Kind.LAG}
    assert 1.0 / (2 * np.pi * np.sqrt(found.response.resonance_s2)) == pytest.approx(hertz, rel=0.01)
    assert abs(of_scale(found)) < 3.0
    assert abs(found.scale.value_m_per_px / SCALE - 1.0) < 1e-3
    texts = " ".join(str(one) for one in found.response.texts(found.search.fit.motion_hz))
    assert "railing" in texts
    assert "low-pass" not in texts


def test_an_acceleration_between_its_samples_is_not_weaker():
    # Straight lines between 100 samples a second weaken 8 Hz by (2π 8/100)²/12 = 2 %, cubics by its square: 0.1 %.
    time, hertz = np.arange(0.0, 10.0, 0.01), 8.0
    path = integrated(np.column_stack((time, np.sin(2 * np.pi * hertz * time), np.ones(len(time)))))
    at = np.arange(1.0, 9.0, 0.0137)
    turn = 2 * np.pi * hertz * at
    assert np.sin(turn) @ path.shaken(at, 0) / np.sum(np.sin(turn) ** 2) == pytest.approx(1.0, abs=3e-3)
    slope = np.cos(turn) @ path.shaken(at, 1) / np.sum(np.cos(turn) ** 2)
    assert slope / (2 * np.pi * hertz) == pytest.approx(1.0, abs=0.05)
