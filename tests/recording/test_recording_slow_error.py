"""A displacement sensor whose error is slow, as that of a GNSS receiver: estimated or given, it is in the band."""

import re

import numpy as np
import pytest

import midspan
from recording_edits import set_keys, write_displacement
from repeats import slow

WHITE_M, SLOW_M, ACCELERATION_NOISE = 1e-3, 2e-3, 2e-3


def motion(time_s, rng):
    """Three modes whose size breathes, and a sway at 0.05 Hz: 2 to 4 mm each."""
    moved = 2e-3 * np.sin(2 * np.pi * 0.05 * time_s + rng.uniform(0, 6.28))
    for size, hertz in ((4e-3, 0.7), (3e-3, 1.9), (1.5e-3, 3.7)):
        wave = np.sin(2 * np.pi * (hertz + rng.normal(0, 0.05)) * time_s + rng.uniform(0, 6.28))
        moved += size * wave * (1.0 + 0.3 * np.sin(2 * np.pi * rng.uniform(0.01, 0.05) * time_s))
    return moved


def write(folder, seed, lasting_s, length_s=120.0, rate_hz=10.0, cross=0.0):
    """A recording of a sensor with white noise and a first-order Gauss-Markov error; returns its truth (s, mm).

    cross: the motion fills but the middle, and so much of another one of its size is in the acceleration.
    """
    rng = np.random.default_rng(seed)
    time = np.arange(0.0, length_s, 0.5e-3)
    shaken = np.clip(time / length_s - 0.4, 0.0, 0.4) / 0.4
    lively = np.sin(np.pi * shaken) ** 2 if cross else np.ones(len(time))
    moved = lively * motion(time, rng)
    path = moved + (cross * lively * motion(time, rng) if cross else 0.0)
    accelerated = np.gradient(np.gradient(path, time), time)
    met = np.arange(1000, len(time) - 1000, round(2000 / rate_hz)) + 7
    slow = np.zeros(len(met))
    if lasting_s:
        kept, slow[0] = np.exp(-1.0 / rate_hz / lasting_s), rng.normal(0.0, SLOW_M)
        for k in range(1, len(met)):
            slow[k] = kept * slow[k - 1] + np.sqrt(1.0 - kept**2) * rng.normal(0.0, SLOW_M)
    accel = accelerated[::20] + 0.03 + rng.normal(0.0, ACCELERATION_NOISE, len(time[::20]))
    height = 1e3 * (moved[met] + slow + rng.normal(0.0, WHITE_M, len(met)))
    write_displacement(folder, (time[::20], accel), (time[met], height))
    return time, 1e3 * moved


def inside(folder, known, method):
    result = midspan.estimate(folder, method=method)
    error = result.displacement_mm - np.interp(result.time_s, *known)
    return float(np.mean(np.abs(error) < 1.96 * result.displacement_std_mm)), result.calibration.displacement


@pytest.mark.parametrize(
    ("lasting_s", "method"), [(1.0, "kalman"), (10.0, "smoother"), *slow((1.0, "smoother"), (10.0, "kalman"))]
)
def test_a_slow_error_is_estimated_and_in_the_band(lasting_s, method, tmp_path):
    shares = []
    for seed in range(2):
        share, found = inside(tmp_path, write(tmp_path, seed, lasting_s), method)
        shares.append(share)
        # How fast it drifts is shown, variance over time; its size and time hardly where it is slow.
        drift = found.slow_std_m**2 / found.slow_time_s
        assert 0.3 < drift / (SLOW_M**2 / lasting_s) < 3.0
        assert found.noise_std_m == pytest.approx(WHITE_M, rel=0.15)
    # The error is correlated: a record holds some twenty draws. With white noise alone 14 to 33 % were inside.
    assert np.mean(shares) > 0.85


@pytest.mark.parametrize("seed", [0, *slow(1, 2)])
def test_white_noise_is_no_slow_error(tmp_path, seed):
    write(tmp_path, seed, 0.0)
    assert midspan.calibrate(tmp_path).displacement.slow_std_m == 0.0


@pytest.mark.parametrize("seed", [0, *slow(1, 2)])
def test_an_error_that_goes_with_the_motion_is_no_slow_error(seed, tmp_path):
    known = write(tmp_path, seed, 0.0, cross=0.4)
    share, found = inside(tmp_path, known, "smoother")
    assert found.slow_std_m == 0.0
    assert share > 0.85


def test_a_time_that_the_record_does_not_tell_can_be_given(tmp_path):
    known = write(tmp_path, 0, 30.0)
    set_keys(tmp_path, "displacement", noise_time_s=30.0)
    share, found = inside(tmp_path, known, "smoother")
    assert share > 0.85
    assert found.slow_time_s == pytest.approx(30.0)


def test_what_a_record_does_not_tell_is_stated(tmp_path):
    # Slow with a noisy accelerometer: drifts by 2 mm · sqrt(2 (1 - exp(-10/60))) = 1.1 mm in 10 s.
    write(tmp_path, 0, 60.0, rate_hz=2.0)
    result = midspan.estimate(tmp_path)
    assert result.calibration.displacement.slow_std_m == 0.0
    stated = next(one for one in result.not_in_band if "slow error" in one)
    assert float(re.search(r"of up to ([\d.]+) mm in 10 s", stated)[1]) >= 1.1
    set_keys(tmp_path, "displacement", noise_time_s=0)
    declared = midspan.estimate(tmp_path)
    assert declared.calibration.displacement.slow_std_m == 0.0
    assert not any("slow error" in one for one in declared.not_in_band)


def test_with_its_time_given_the_band_holds_what_the_record_does_not_exclude(tmp_path):
    held = []
    for seed in range(3):
        known = write(tmp_path, seed, 60.0, rate_hz=2.0)
        set_keys(tmp_path, "displacement", noise_time_s=60.0)
        held.append(inside(tmp_path, known, "smoother")[0])
    assert np.mean(held) > 0.85


def test_it_is_stored_and_read_again(tmp_path):
    write(tmp_path, 1, 1.0)
    own = midspan.calibrate(tmp_path)
    again = midspan.load_calibration(own.save(tmp_path / "calibration.json")).displacement
    assert again.slow_std_m == pytest.approx(own.displacement.slow_std_m)
    assert again.slow_time_s == pytest.approx(own.displacement.slow_time_s)


def test_an_accelerometer_that_drifts_is_named_and_the_unit_is_not(tmp_path):
    # The bias walks by 30 mm/s² in a minute, by far more than motion of 1 mm rms accelerates below 0.2 Hz.
    rng, time = np.random.default_rng(11), np.arange(0.0, 120.0, 0.01)
    turn = 2 * np.pi * 0.5 * time + 3.0 * np.sin(2 * np.pi * 0.01 * time)
    moved = 1.4e-3 * np.sin(turn)
    accelerated = np.gradient(np.gradient(moved, time), time)
    walk = np.cumsum(rng.normal(0.0, 0.03 / np.sqrt(6000.0), len(time)))
    met = np.arange(50, len(time) - 50, 50)
    accel = accelerated + walk + rng.normal(0.0, ACCELERATION_NOISE, len(time))
    height = 1e3 * (moved[met] + rng.normal(0.0, 1.5e-4, len(met)))
    for name, table in (("a", (time, accel)), ("d", (time[met], height))):
        np.savetxt(tmp_path / f"{name}.csv", np.column_stack(table), "%.9f", ",", header="time_s,value", comments="")
    (tmp_path / "recording.toml").write_text(
        '[accelerometer]\nfile = "a.csv"\nunit = "m/s^2"\n[displacement]\nfile = "d.csv"\nunit = "mm"\n'
    )
    result = midspan.estimate(tmp_path)
    assert not any("displacement.unit" in line for line in result.warnings)
    error = result.displacement_mm - 1e3 * np.interp(result.time_s, time, moved)
    assert np.mean(np.abs(error) < 1.96 * result.displacement_std_mm) > 0.85


def test_noise_of_a_receiver_warns_of_slow_errors_until_the_settings_say_what_they_are(tmp_path):
    write(tmp_path, 0, 0.0, length_s=40.0)
    found = midspan.estimate(tmp_path)
    (warned,) = (one for one in found.warnings if one.code == "slow-error")
    assert warned.severity == "warning"
    assert "the error band does not contain them" in warned
    assert 'displacement.receiver = "gnss"' in warned
    assert "look first at the warning on the displacement (slow-error)" in found.verdict
    assert warned in found.calibration.warnings
    for keys in ({"receiver": "gnss"}, {"receiver": None, "noise_time_s": 0.0}):
        set_keys(tmp_path, "displacement", **keys)
        assert not [one for one in midspan.calibrate(tmp_path).warnings if one.code == "slow-error"]
