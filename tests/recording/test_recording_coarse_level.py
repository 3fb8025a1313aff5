"""A level whose steps are coarser than the motion: an answer or a refusal with a reason, never a crash."""

import numpy as np
import pytest

import midspan
from recording_edits import append, set_keys, write_displacement
from repeats import slow


def write(folder, seed, size_mm):
    """Two modes of a size rms, read in whole millimetres at 5 Hz."""
    rng = np.random.default_rng(seed)
    hertz = np.concatenate([mode * (1 + 0.02 * rng.normal(size=8)) for mode in (1.1, 2.3)])
    omega, phase = 2 * np.pi * hertz, rng.uniform(0, 2 * np.pi, len(hertz))

    def moved(time, shrunk=1.0):
        return size_mm / 2 / np.sqrt(2) * np.sin(np.outer(time, omega) + phase) @ np.broadcast_to(shrunk, omega.shape)

    time, met = np.arange(0.0, 60.0, 0.01), np.arange(0.503, 59.5, 0.2)
    accel = 1e-3 * moved(time, -(omega**2)) + rng.normal(0.0, 2e-3, len(time))
    write_displacement(folder, (time, accel), (met, np.rint(moved(met) + 0.2)))
    return lambda time: moved(time) + 0.2


def estimated(folder):
    """The result, or None and why it was refused."""
    try:
        return midspan.estimate(folder), ""
    except midspan.MidspanError as refused:
        return None, str(refused)


@pytest.mark.parametrize("keys", [{}, {"estimate_scale": True, "estimate_offset": True}])
@pytest.mark.parametrize("seed", [0, *slow(1, 2)])
def test_a_level_of_coarse_steps(keys, tmp_path, seed):
    truth = write(tmp_path, seed, 0.4)
    set_keys(tmp_path, "displacement", **keys)
    append(tmp_path, "[calibration]\nmax_offset_s = 0.2")
    result, reason = estimated(tmp_path)
    assert "inf" not in reason
    assert "nan" not in reason
    if result is None:
        # Rounding goes with the motion: clock or scale may be refused, on one clock and in mm there is a result.
        assert keys
        return
    error = result.displacement_mm - truth(result.time_s)
    # What moves within a step the accelerometer knows: the result is far better than the readings, 0.28 mm rms.
    rounding = np.rint(truth(result.time_s)) - truth(result.time_s)
    assert np.std(error) < 0.6 * np.std(rounding)


def test_a_level_that_never_changes_tells_no_scale(tmp_path):
    write(tmp_path, 0, 0.4)
    table = np.genfromtxt(tmp_path / "d.csv", delimiter=",", skip_header=1)
    table[:, 1] = np.arange(len(table)) == 100
    np.savetxt(tmp_path / "d.csv", table, "%.6f", ",", header="time_s,value", comments="")
    set_keys(tmp_path, "displacement", estimate_scale=True, estimate_offset=True)
    with pytest.raises(midspan.UntrustedError, match=r"are constant .* determine no scale"):
        midspan.estimate(tmp_path)
