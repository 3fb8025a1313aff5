"""A radar's clock that was set is told from frames that were lost, by the phase that is still wrapped."""

import numpy as np
import pytest

import midspan
from midspan.calibration.radar.clock_steps import ClockStep, Phase, clock_steps, irregular, lateness_ns
from midspan.records import NANOSECONDS
from midspan.simulate.motion.motion import random_motion

FRAMES_HZ, CARRIER_HZ, LIGHT_M_S = 50.0, 77e9, 299_792_458.0
RAD_PER_M = 4 * np.pi * CARRIER_HZ / LIGHT_M_S
TRUE_S = 0.7 + np.arange(2900) / FRAMES_HZ
FACTOR, OFFSET_S = 1.4, 0.11


def motion(seed=0):
    """4 mm rms at 0.5 to 4 Hz: by several cycles from frame to frame, so that nothing is unwrapped without help."""
    return random_motion((0.5, 4.0), 4e-3, rng=np.random.default_rng(seed))


def samples(moving, seed=0):
    """Samples (n, 2) of an accelerometer of 2 mm/s² and 100 Hz."""
    time_s = np.arange(6000) / 100.0
    noise = np.random.default_rng(seed).normal(0, 2e-3, len(time_s))
    return np.column_stack((time_s, moving.acceleration(time_s) + noise))


def phase(moving, ahead_s, seed=0):
    """Phase of noise 0.05 rad, whose stamps are ahead by ahead_s (n,)."""
    turned = RAD_PER_M * moving.displacement(TRUE_S) / FACTOR
    noise = np.random.default_rng(seed).normal(0, 0.05, len(TRUE_S))
    stamps = np.rint((TRUE_S - OFFSET_S + ahead_s) * NANOSECONDS).astype(np.int64)
    return Phase(stamps, np.angle(np.exp(1j * (turned + noise))), RAD_PER_M)


def stepped(moving, ahead_s, lost=slice(0, 0)):
    """The steps that are found; lost: frames that are left out."""
    seen = phase(moving, ahead_s)
    kept = np.delete(np.arange(len(TRUE_S)), lost)
    seen = Phase(seen.time_ns[kept], seen.phase_rad[kept], RAD_PER_M)
    own = samples(moving) - np.array([seen.time_ns[0] / NANOSECONDS, 0.0])
    return clock_steps(seen, own, 1.5)


@pytest.mark.parametrize("step_s", [0.02, 0.083, 0.3, -0.018])
def test_a_clock_that_was_set_is_found_to_the_rounding_of_its_stamps(step_s):
    (found,) = stepped(motion(), np.where(np.arange(len(TRUE_S)) >= 1500, step_s, 0.0))
    assert found.frame == 1500
    assert found.late_s == pytest.approx(-step_s, abs=1e-6)


def test_lost_frames_are_no_step():
    assert stepped(motion(), np.zeros(len(TRUE_S)), lost=slice(1500, 1504)) == []


def test_frames_lost_while_the_clock_is_set_leave_its_step():
    ahead_s = np.where(np.arange(len(TRUE_S)) >= 1503, 0.0937, 0.0)
    (found,) = stepped(motion(), ahead_s, lost=slice(1500, 1503))
    assert found.late_s == pytest.approx(-0.0937, abs=1e-6)


def test_without_motion_nothing_is_said():
    still = random_motion((0.5, 4.0), 1e-7, rng=np.random.default_rng(0))
    assert stepped(still, np.where(np.arange(len(TRUE_S)) >= 1500, 0.1, 0.0)) == []


def test_stamps_that_jitter_or_are_lost_all_the_time_are_not_looked_at():
    even = np.arange(1000, dtype=np.int64) * 20_000_000
    jitter = np.random.default_rng(0).integers(-2_000_000, 2_000_000, 1000)
    assert irregular(even + jitter) == []
    assert irregular(np.delete(even, np.arange(5, 990, 20))) == []
    assert irregular(np.delete(even, [500])) == [500]


def test_lateness_adds_up_from_frame_to_frame():
    late_ns = lateness_ns([ClockStep(2, -0.1), ClockStep(4, 0.03)], 6)
    assert late_ns.tolist() == [0, 0, -100_000_000, -100_000_000, -70_000_000, -70_000_000]


def test_a_recording_whose_clock_was_set_is_as_good_as_one_whose_was_not(tmp_path):
    """The step is 90 ms, in which the structure moves by some millimetres; it was refused, or off by a cycle."""
    import h5py

    moving = motion()
    ahead_s = np.where(np.arange(len(TRUE_S)) >= 1500, 0.09, 0.0)
    seen = phase(moving, ahead_s)
    np.savetxt(tmp_path / "accel.csv", samples(moving), "%.9f", ",", header="time_s,a", comments="")
    with h5py.File(tmp_path / "radar.h5", "w") as file:
        file.create_dataset("iq", data=np.exp(1j * seen.phase_rad).astype(np.complex64)[:, None, None])
        file.attrs["carrier_hz"] = CARRIER_HZ
        file["time_s"] = seen.time_ns / NANOSECONDS
    (tmp_path / "recording.toml").write_text(
        '[accelerometer]\nfile = "accel.csv"\ntime = "time_s"\nvalue = "a"\nunit = "m/s^2"\n[radar]\n'
        'file = "radar.h5"\n'
    )
    result = midspan.estimate(tmp_path)
    zero = moving.displacement(TRUE_S[:1])[0]
    error = result.displacement_mm - 1e3 * (moving.displacement(result.time_s) - zero)
    assert np.sqrt(np.mean(error**2)) < 0.05
    assert np.mean(np.abs(error) < 1.96 * result.displacement_std_mm) > 0.9
    (text,) = (line for line in result.warnings if line.code == "clock-corrected")
    assert "-90 ms" in text
    # A calibration that is given knows nothing of this record's clock.
    again = midspan.estimate(tmp_path, calibration=midspan.calibrate(tmp_path), method="kalman")
    assert any(line.code == "clock-corrected" for line in again.warnings)
