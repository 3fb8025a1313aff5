"""The scale of a displacement sensor that is not calibrated: right, with an honest deviation, and refused where due."""

from dataclasses import replace

import numpy as np
import pytest
from calibration_cases import OFFSET, broadband, observed, spoilt, tones

from midspan.calibration.sensor_scale import calibrate_sensor_scale
from midspan.errors import UntrustedError
from repeats import slow


def read(motion, seed, *, factor=1.0, noise_m=1e-4, offset_s=0.0, rate_hz=10.0):
    """A minute of readings that must be multiplied by `factor`, with noise that nobody declared."""
    pair = observed(motion, seed, rate_hz=rate_hz, scale=1.0, noise_px=noise_m, offset_s=offset_s)
    return replace(pair, rows=np.column_stack((pair.rows[:, 0], pair.rows[:, 1] / factor, np.ones(len(pair.rows)))))


def deviation(found, factor):
    return (found.factor - factor) / found.factor_std


@pytest.mark.parametrize(
    ("factor", "rate_hz", "one_clock", "draws"),
    [
        (25.4, 5.0, True, 16),
        (-1.0, 10.0, False, 16),
        *slow((25.4, 5.0, True, 64), (-1.0, 10.0, False, 64), (-0.37, 1.0, True, 64)),
    ],
)
def test_the_scale_is_right_and_its_deviation_covers(factor, rate_hz, one_clock, draws):
    offset_s = 0.0 if one_clock else OFFSET
    found = [
        calibrate_sensor_scale(
            read(broadband(s), 900 + s, factor=factor, rate_hz=rate_hz, offset_s=offset_s), 0.15, one_clock=one_clock
        )
        for s in range(draws)
    ]
    z = np.array([deviation(f, factor) for f in found])
    # 64 draws: the rms of z is known to ± 9 %, its mean to ± 0.13; 16 draws: to the double.
    scatter = 8.0 / np.sqrt(draws)
    assert 1.0 - 0.2 * scatter < np.sqrt(np.mean(z**2)) < 1.0 + 0.25 * scatter
    assert abs(np.mean(z)) < 0.4 * scatter
    # Noise and accelerometer noise are reported in true metres, whatever the readings' unit.
    assert np.sqrt(np.mean([f.variance_factor for f in found])) == pytest.approx(1e-4, rel=0.1)
    if not one_clock:
        late = np.array([(f.offset.value_s - OFFSET) / np.sqrt(f.offset.variance) for f in found])
        assert 1.0 - 0.2 * scatter < np.sqrt(np.mean(late**2)) < 1.0 + 0.25 * scatter


def test_the_deviation_is_that_of_a_regression_on_the_true_motion():
    # 2 mm of noise on 590 readings of a motion of 3 mm rms far above the accelerometer's noise: a regression on the
    # motion itself would tell the scale to 2 / (3 · √590) = 2.7 %; the corner between the two noises costs a little.
    found = [calibrate_sensor_scale(read(tones(s, (4.24e-3, 1.0)), s, noise_m=2e-3), 0.0, one_clock=True)
             for s in range(4)]  # fmt: skip
    assert np.mean([f.factor_std / f.factor for f in found]) == pytest.approx(0.027, rel=0.15)


def test_one_hertz_that_aliases_a_tone_tells_the_scale_with_its_sign():
    # 0.8 Hz shows as 0.2 Hz; 60 readings of 5 mm amplitude and 0.3 mm of noise: 0.3 / (3.5 · √59) = 1.1 %.
    z = [
        deviation(calibrate_sensor_scale(
            read(tones(s, (5e-3, 0.8)), 40 + s, factor=-25.4, noise_m=3e-4, rate_hz=1.0), 0.3, one_clock=True), -25.4)
        for s in range(24)
    ]  # fmt: skip
    # The rms of 24 is known to ± 14 %.
    assert 0.7 < np.sqrt(np.mean(np.square(z))) < 1.3


def test_a_tone_that_stands_still_in_the_readings_is_refused_with_the_reason():
    pair = read(tones(3, (5e-3, 2.0)), 3, rate_hz=1.0)
    with pytest.raises(UntrustedError, match=r"main tone of 2 Hz is aliased to 0\S* Hz at 1 measurements per second"):
        calibrate_sensor_scale(pair, 0.2, one_clock=True)


def test_offset_and_scale_of_a_single_tone_are_ambiguous_together():
    # Half a period later the tone is the same with the other sign.
    pair = read(tones(5, (3e-3, 5.0)), 5, rate_hz=30.0, offset_s=0.01)
    with pytest.raises(UntrustedError, match=r"ambiguous.*single tone"):
        calibrate_sensor_scale(pair, 0.3, one_clock=False)
    # Each alone is reported: one clock, or a search within a quarter of a period.
    close = calibrate_sensor_scale(pair, 0.04, one_clock=False)
    assert close.factor == pytest.approx(1.0, abs=4.0 * close.factor_std)
    alone = calibrate_sensor_scale(read(tones(5, (3e-3, 5.0)), 5, rate_hz=30.0), 0.3, one_clock=True)
    assert alone.factor == pytest.approx(1.0, abs=4.0 * alone.factor_std)
    assert alone.offset.value_s == 0.0


def test_too_little_motion_is_refused_with_the_figures():
    with pytest.raises(UntrustedError, match=r"estimate_scale: the motion does not determine .* at most ± 5 %"):
        calibrate_sensor_scale(read(broadband(1, 1e-4), 1, noise_m=2e-3), 0.2, one_clock=True)


@pytest.mark.parametrize("one_clock", [False, True])
def test_another_events_motion_is_refused(one_clock):
    pair = replace(read(broadband(1), 1), rows=read(broadband(101), 2).rows)
    with pytest.raises(UntrustedError, match="estimate_scale"):
        calibrate_sensor_scale(pair, 0.3, one_clock=one_clock)


def test_clocks_that_differ_are_named_where_one_clock_was_meant():
    with pytest.raises(UntrustedError, match=r"clock differs .* \+0\.2\d* s.*estimate_offset"):
        calibrate_sensor_scale(read(broadband(2), 2, offset_s=0.2), 0.5, one_clock=True)


@pytest.mark.parametrize(
    ("one_clock", "seeds"), [(False, (0,)), (True, (1,)), *slow((False, range(4)), (True, range(4)))]
)
def test_outliers_and_gaps_move_the_scale_by_less_than_its_deviation(one_clock, seeds):
    for seed in seeds:
        clean = read(broadband(seed), seed, factor=25.4)
        rows = clean.rows * [1.0, 1e3 * 25.4, 1.0]
        dirty, bad = spoilt(replace(clean, rows=rows), seed)
        kept = (dirty.rows[:, 0] < 20.0) | (dirty.rows[:, 0] > 28.0)
        pair = replace(dirty, rows=(dirty.rows / [1.0, 1e3 * 25.4, 1.0])[kept])
        expected = calibrate_sensor_scale(clean, 0.2, one_clock=one_clock)
        found = calibrate_sensor_scale(pair, 0.2, one_clock=one_clock)
        assert bad.sum() > 15
        assert abs(found.factor - expected.factor) < 1.5 * expected.factor_std
        assert found.factor_std < 1.4 * expected.factor_std
