"""A velocity sensor with a slow displacement: what it adds, and what a wrong one is refused by."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.signal import butter, sosfiltfilt

import midspan
from midspan.errors import UntrustedError

FINE_HZ, LENGTH_S = 1000.0, 100.0
TOML = """[accelerometer]
file = "accel.csv"
unit = "m/s^2"
[displacement]
file = "gnss.csv"
unit = "mm"
noise_time_s = 0
estimate_offset = false
"""
VELOCITY = '[velocity]\nfile = "velocity.csv"\nvalue = "v"\nunit = "mm/s"\n'
LATE_S = 0.02


def moving(rng):
    """Displacement (m) of two modes and of slow load, on a grid of 1 kHz."""
    n = int(LENGTH_S * FINE_HZ)
    bands = ((0.02, 0.2, 5e-3), (1.9, 2.1, 3e-3), (5.8, 6.2, 5e-4))
    parts = [
        sosfiltfilt(butter(2, band[:2], "bandpass", fs=FINE_HZ, output="sos"), rng.normal(size=n)) for band in bands
    ]
    return sum(band[2] * part / np.std(part) for band, part in zip(bands, parts, strict=True))


def write(folder, rng, *, sign=1.0, unit=1.0, spoilt=lambda time_s, value: value):
    """A recording of an accelerometer (20 mm/s²), GNSS (1 mm once a second) and a vibrometer (0.1 mm/s, 50 Hz)."""
    x = moving(rng)
    grid = np.arange(len(x)) / FINE_HZ
    v = np.gradient(x, grid)
    a = np.gradient(v, grid)
    at = lambda rate, start, values: (  # noqa: E731
        (time := start + np.arange(int(rate * (LENGTH_S - 2.0))) / rate),
        np.interp(time, grid, values),
    )
    time_a, accel = at(100.0, 0.5, a)
    time_d, slow = at(1.0, 0.6, x)
    time_v, fast = at(50.0, 0.7, v)
    fast = spoilt(time_v, sign * unit * (1e3 * fast + rng.normal(0.0, 0.1, len(fast))))
    columns = {
        "accel.csv": ("time_s,acc", time_a, accel + 0.05 + rng.normal(0.0, 0.02, len(accel))),
        "gnss.csv": ("time_s,disp", time_d, 1e3 * (slow + rng.normal(0.0, 1e-3, len(slow)))),
        "velocity.csv": ("time_s,v", time_v - LATE_S, fast),
    }
    for name, (header, *values) in columns.items():
        np.savetxt(folder / name, np.column_stack(values), header=header, comments="", delimiter=",", fmt="%.9g")
    (folder / "recording.toml").write_text(TOML + VELOCITY)
    (folder / "plain.toml").write_text(TOML)
    return grid, x


def error_of(result, grid, x):
    """Root mean square error (mm) without the mean, and the share inside the band."""
    off = result.estimate.displacement_m - np.interp(result.estimate.time_ns / 1e9, grid, x)
    off -= off.mean()
    inside = np.mean(np.abs(off) < 1.96 * np.sqrt(result.estimate.variance_m2))
    return 1e3 * float(np.sqrt(np.mean(off**2))), float(inside)


@pytest.mark.parametrize("seed", [1, 2])
def test_a_velocity_sensor_halves_the_error_of_a_slow_displacement(tmp_path, seed):
    grid, x = write(tmp_path, np.random.default_rng(seed))
    with_it, without = midspan.estimate(tmp_path), midspan.estimate(tmp_path / "plain.toml")
    (error, inside), (before, _) = error_of(with_it, grid, x), error_of(without, grid, x)
    # The accelerometer leads by itself for 2 s, the vibrometer, whose zero drifts little, for ten times as long.
    assert error < 0.5 * before
    assert inside > 0.9
    found = with_it.calibration.helped_by("velocity")
    assert_allclose(found.offset.value_s, LATE_S, atol=2e-4)
    # 0.1 mm/s, and what the integrated acceleration differs by from value to value.
    assert_allclose(found.noise_std, 1e-4, rtol=1.5)
    stored = midspan.load_calibration(with_it.calibration.save(tmp_path / "calibration.json"))
    assert stored.auxiliary == with_it.calibration.auxiliary
    again = midspan.estimate(tmp_path, calibration=stored)
    assert error_of(again, grid, x)[0] < 0.6 * before


def test_a_causal_method_takes_it_too(tmp_path):
    grid, x = write(tmp_path, np.random.default_rng(3))
    error, inside = error_of(midspan.estimate(tmp_path, method="kalman"), grid, x)
    before, _ = error_of(midspan.estimate(tmp_path / "plain.toml", method="kalman"), grid, x)
    assert error < 0.7 * before
    assert inside > 0.9


@pytest.mark.parametrize(
    ("wrong", "said"),
    [({"sign": -1.0}, "opposite"), ({"unit": 1e-3}, r"velocity\.unit"), ({"unit": -1e-3}, "opposite")],
)
def test_a_wrong_sign_or_unit_is_refused(tmp_path, wrong, said):
    write(tmp_path, np.random.default_rng(4), **wrong)
    with pytest.raises(UntrustedError, match=said):
        midspan.estimate(tmp_path)


def frozen(time_s, value):
    held = (time_s > 40.0) & (time_s < 60.0)
    return np.where(held, value[np.flatnonzero(held)[0]], value)


def gone(time_s, value):
    return np.where((time_s > 40.0) & (time_s < 60.0), np.nan, value)


def far_off(time_s, value):
    return np.where(np.random.default_rng(5).random(len(value)) < 0.05, 1e3, value)


@pytest.mark.parametrize("spoilt", [frozen, gone, far_off])
def test_a_spoilt_stretch_costs_what_it_told(tmp_path, spoilt):
    grid, x = write(tmp_path, np.random.default_rng(6), spoilt=spoilt)
    result = midspan.estimate(tmp_path)
    error, inside = error_of(result, grid, x)
    before, _ = error_of(midspan.estimate(tmp_path / "plain.toml"), grid, x)
    assert error < 0.8 * before
    assert inside > 0.9
    assert (spoilt is frozen) == any(event.kind == "frozen" for event in result.events)


def test_one_that_has_nothing_to_help_is_refused(tmp_path):
    write(tmp_path, np.random.default_rng(7))
    (tmp_path / "alone.toml").write_text('[accelerometer]\nfile = "accel.csv"\nunit = "m/s^2"\n' + VELOCITY)
    with pytest.raises(midspan.UsageError, match="measures displacement"):
        midspan.estimate(tmp_path / "alone.toml")
