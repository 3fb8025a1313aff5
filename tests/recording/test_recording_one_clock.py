"""A clock that jumps in the middle of a recording: corrected and reported, in the band where it is not certain."""

import re
from dataclasses import replace

import numpy as np
import pytest

import midspan
from lively_recordings import Lively, write
from midspan.calibration.one_clock import _refuse_contradiction, one_clock
from midspan.errors import UntrustedError
from midspan.fusion.streams import KalmanSettings
from midspan.records import Acceleration, Displacement, Floats, Source, nanoseconds
from midspan.simulate.motion.motion import Sines
from recording_edits import set_keys, write_displacement
from repeats import slow

ACCELERATION_NOISE, NOISE_M = 3e-3, 2e-5
BRIDGE = Sines(np.array([5e-3, 2e-3, 1e-3]), np.array([0.41, 1.3, 0.07]), phase_rad=np.array([0.3, 1.0, 0.0]))
TONE = Sines(np.array([4e-3]), np.array([2.0]))


def record(stamps: Floats, true_s: Floats, motion: Sines = BRIDGE) -> tuple[Displacement, Acceleration]:
    """A sensor that measured at `true_s` (m,) and says that it was at `stamps` (m,); 100 Hz of acceleration."""
    rng = np.random.default_rng(8)
    time = np.arange(0.0, true_s[-1] + 1.0, 0.01)
    pushed = motion.acceleration(time) + rng.normal(0.0, ACCELERATION_NOISE, time.size)
    value = motion.displacement(true_s) + rng.normal(0.0, NOISE_M, true_s.size)
    source = np.full(stamps.size, Source.CAMERA, dtype=np.uint8)
    return (
        Displacement(nanoseconds(stamps), value, np.full(stamps.size, NOISE_M**2), source),
        Acceleration(nanoseconds(time), pushed, np.full(time.size, ACCELERATION_NOISE**2 / 100.0)),
    )


def test_the_stamps_after_a_jump_are_moved_and_it_is_reported_once():
    true_s = np.arange(0.5, 40.0, 0.125)
    measured, acceleration = record(true_s + np.where(true_s >= 25.0, 0.05, 0.0), true_s)
    found = one_clock(measured, acceleration, KalmanSettings(), "camera")
    sure = np.abs(true_s - 25.0) > 1.0
    (jump,) = found.jumps
    assert np.abs(found.measured.time_ns / 1e9 - true_s)[sure].max() < 5.0 * jump.std_s
    assert [event.kind for event in found.events] == ["clock"]
    assert abs(found.events[0].time_ns / 1e9 - 25.0) < 1.0
    assert found.warnings == (found.events[0].text,)
    reported = re.search(r": (\S+) ± \S+ ms were added", found.warnings[0])
    assert reported is not None
    assert float(reported[1]) == pytest.approx(-50.0, abs=5e3 * jump.std_s)
    assert "frames" not in found.warnings[0]
    # The other axis of the same frames goes by the same clock and says nothing again.
    companions = found.also(measured)
    np.testing.assert_array_equal(companions.measured.time_ns, found.measured.time_ns)
    assert companions.warnings == companions.events == ()


@pytest.mark.parametrize(
    ("from_s", "to_s", "late_s"), [(15.0, 30.0, -0.125), (25.0, 60.0, 0.25), *slow((12.0, 28.0, 0.125))]
)
def test_two_jumps_are_right_or_refused_but_never_silently_wrong(from_s, to_s, late_s):
    true_s = np.arange(0.5, to_s + 12.0, 0.125)
    off = (true_s >= from_s) & (true_s < to_s)
    # A frame is doubled and another lost later: between them all stamps are off.
    measured, acceleration = record(true_s + np.where(off, late_s, 0.0), true_s)
    try:
        found = one_clock(measured, acceleration, KalmanSettings(), "camera")
    except UntrustedError:
        return
    sure = (np.abs(true_s - from_s) > 1.0) & (np.abs(true_s - to_s) > 1.0)
    assert np.abs(found.measured.time_ns / 1e9 - true_s)[sure].max() < 2e-3


def test_a_segment_that_no_jump_explains_is_refused():
    true_s = np.arange(0.5, 40.0, 0.125)
    off = (true_s >= 15.0) & (true_s < 25.0)
    measured, acceleration = record(true_s + np.where(off, 0.2, 0.0), true_s)
    right = replace(measured, time_ns=nanoseconds(true_s))
    _refuse_contradiction(right, acceleration, KalmanSettings(), "camera")
    with pytest.raises(UntrustedError, match="more often than the motion can show"):
        _refuse_contradiction(measured, acceleration, KalmanSettings(), "camera")


def test_a_lost_frame_is_named():
    true_s = np.delete(np.arange(0.5, 40.0, 0.125), 196)
    measured, acceleration = record(0.5 + 0.125 * np.arange(true_s.size), true_s)
    found = one_clock(measured, acceleration, KalmanSettings(), "camera")
    assert "as if 1 of its frames was lost" in found.warnings[0]


def test_a_jump_beside_a_drift_is_taken_out_and_the_drift_too():
    true_s = np.arange(0.5, 180.0, 0.125)
    late = 40e-6 * true_s + np.where(true_s >= 100.0, 0.03, 0.0)
    measured, acceleration = record(true_s - late, true_s)
    found = one_clock(measured, acceleration, KalmanSettings(), "camera")
    std_s = np.hypot(found.jumps[0].std_s, found.course.std_at(measured.time_ns).max())
    assert np.abs(found.measured.time_ns / 1e9 - true_s)[np.abs(true_s - 100.0) > 1.0].max() < 5.0 * std_s + 1e-4
    assert len(found.events) == 1


def test_where_a_tone_leaves_two_jumps_their_difference_stands_in_the_band():
    true_s = np.arange(0.5, 40.0, 0.125)
    measured, acceleration = record(true_s - np.where(true_s >= 20.0, 0.1, 0.0), true_s, TONE)
    found = one_clock(measured, acceleration, KalmanSettings(), "camera")
    assert len(found.levels) == 1
    assert not found.levels[0].std_m[true_s < 19.0].any()
    assert "fits the motion almost as well" in found.warnings[0]


def test_a_good_clock_is_left_alone():
    true_s = np.arange(0.5, 60.0, 0.125)
    measured, acceleration = record(true_s, true_s)
    found = one_clock(measured, acceleration, KalmanSettings(), "camera")
    assert found.measured is measured
    assert (found.warnings, found.events, found.levels) == ((), (), ())


@pytest.mark.parametrize("broken", ["set", "lost", "doubled"])
def test_a_displacement_sensor_whose_clock_jumps_stays_in_its_band(broken, tmp_path):
    stamps, rng = np.arange(0.5, 59.0, 0.1), np.random.default_rng(5)
    true_s = {
        "set": stamps - np.where(stamps >= 40.0, 0.05, 0.0),
        "lost": stamps + np.where(stamps >= 40.0, 0.1, 0.0),
        "doubled": stamps - np.where(stamps >= 40.0, 0.1, 0.0),
    }[broken]
    time = np.arange(0.0, 60.0, 0.01)
    pushed = BRIDGE.acceleration(time) + rng.normal(0.0, ACCELERATION_NOISE, time.size)
    value = 1e3 * (BRIDGE.displacement(true_s) + rng.normal(0.0, NOISE_M, true_s.size))
    write_displacement(tmp_path, (time, pushed), (stamps, value))
    set_keys(tmp_path, "calibration", window_s=[0.0, 35.0])
    found = midspan.estimate(midspan.open_recording(tmp_path))
    error = found.displacement_mm - 1e3 * BRIDGE.displacement(found.time_s)
    assert np.mean(np.abs(error) < 1.96 * found.displacement_std_mm) > 0.85
    # Without the correction it is off by millimetres.
    assert np.abs(error).max() < 0.1
    assert [event.kind for event in found.events if event.kind == "clock"] == ["clock"]


def test_the_zero_stays_at_the_first_frame_where_the_calibration_holds_after_a_jump(tmp_path):
    # Three of 10 frames a second are lost after 6 s: most of the window, and so the calibrated offset, is 0.3 s late.
    case = Lively(duration_s=60.0, rate_hz=10.0, band_hz=(0.5, 4.0), rms_m=3e-3, seed=3)
    write(tmp_path, case, "camera")
    frames = np.load(tmp_path / "camera.npy")
    np.save(tmp_path / "camera.npy", np.delete(frames, [60, 61, 62], axis=0))
    result = midspan.estimate(tmp_path)
    error = result.displacement_mm - case.from_zero_mm(result.time_s)
    # A zero 0.3 s off would be wrong by millimetres, hundreds of standard deviations, in every row.
    assert np.mean(np.abs(error) < 1.96 * result.displacement_std_mm) > 0.85
    assert abs(np.mean(error)) < 0.3
