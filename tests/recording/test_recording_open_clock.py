"""Clocks that are farther apart than the range of 0.5 s, where at half a period another sign fits as well."""

import json

import numpy as np
import pytest

import midspan
from lively_recordings import Lively, write

# Half a period of 0.7 Hz is 0.71 s: the clock is 1.1 s late, and within ±0.5 s the best fit is a mirror image.
MIRRORED = Lively(duration_s=30.0, band_hz=(0.55, 0.85), rms_m=4e-3, late_s=1.1, mm_per_px=-1.5)
GRAVITY_M_S2 = 9.80665


@pytest.fixture(scope="module")
def mirrored(tmp_path_factory):
    return write(tmp_path_factory.mktemp("mirrored"), MIRRORED, "camera")


def test_a_film_whose_clock_is_out_of_range_is_no_mirror_image(mirrored, tmp_path):
    found = midspan.estimate(mirrored)
    camera = json.loads(found.calibration.save(tmp_path).read_text())["camera"]
    # By the formula of the documentation; both to five of their own standard deviations.
    assert abs(camera["time_offset_s"] - MIRRORED.late_s) < 5.0 * camera["time_offset_std_s"]
    assert abs(camera["scale_mm_per_px"] - MIRRORED.mm_per_px) < 5.0 * camera["scale_std_mm_per_px"]
    error_mm = found.displacement_mm - MIRRORED.from_zero_mm(found.time_s)
    assert np.mean(np.abs(error_mm) < 1.96 * found.displacement_std_mm) > 0.85
    assert any(line.code == "clock-corrected" and "offset is +1.1 s by the motion" in line for line in found.warnings)
    # The file says the same again.
    again = midspan.estimate(mirrored, midspan.load_calibration(tmp_path / "calibration.json"))
    np.testing.assert_allclose(
        again.displacement_mm, found.displacement_mm, atol=float(np.max(found.displacement_std_mm))
    )


def test_a_stated_range_that_excludes_the_best_offset_is_said(mirrored):
    recording = midspan.open_recording(mirrored, calibration={"max_offset_s": 0.5})
    with pytest.raises(
        midspan.UntrustedError,
        match=r"within ±0.5 s: their clocks seem to differ by \+1.1 s.*raise calibration.max_offset_s above it",
    ):
        midspan.calibrate(recording)


def test_a_tone_whose_half_period_is_out_of_range_needs_a_stated_range(tmp_path):
    tone = Lively(tones=((4e-3, 0.45),), late_s=0.1)
    folder = write(tmp_path, tone, "camera")
    with pytest.raises(midspan.UntrustedError, match=r"ambiguous: .* Set calibration.max_offset_s"):
        midspan.calibrate(folder)
    stated = midspan.calibrate(midspan.open_recording(folder, calibration={"max_offset_s": 0.5})).camera
    # Known to its own deviation, five times at most.
    assert abs(stated.offset.value_s - tone.late_s) < 5.0 * np.sqrt(stated.offset.variance)


def flown(folder, offset_s):
    """Metres of motion, an accelerometer whose attitude errs by 3 degrees, a sensor of 1 mm: truth (n, 2) in s, mm."""
    rng = np.random.default_rng(0)
    hertz = rng.uniform(0.05, 1.2, 60)
    amplitude_m, phase, omega = 0.25 / (1.0 + (hertz / 0.3) ** 2), rng.uniform(0, 2 * np.pi, 60), 2 * np.pi * hertz
    wrong, turned = 2 * np.pi * rng.uniform(0.1, 1.0, 25), rng.uniform(0, 2 * np.pi, 25)

    def moved(at):
        return np.sin(np.multiply.outer(at, omega) + phase) @ amplitude_m

    time_s, seen_s = np.arange(0.0, 60.0, 0.01), np.arange(0.5, 59.0, 0.1)
    tilt = np.sin(np.multiply.outer(time_s, wrong) + turned).sum(axis=1)
    value = -np.sin(np.multiply.outer(time_s, omega) + phase) @ (amplitude_m * omega**2)
    value += GRAVITY_M_S2 * np.deg2rad(3.0) * tilt / np.std(tilt) + rng.normal(0.0, 0.015, len(time_s))
    shown = 1e3 * moved(seen_s + offset_s) + rng.normal(0.0, 1.0, len(seen_s))
    for name, at, column in (("accel", time_s, value), ("vicon", seen_s, shown)):
        np.savetxt(folder / f"{name}.csv", np.column_stack((at, column)), delimiter=",", header="t,v", comments="")
    (folder / "recording.toml").write_text(
        '[accelerometer]\nfile = "accel.csv"\ntime = "t"\nvalue = "v"\nunit = "m/s^2"\n'
        '[displacement]\nfile = "vicon.csv"\ntime = "t"\nvalue = "v"\nunit = "mm"\nestimate_offset = true\n'
    )
    return folder


def test_a_clock_that_alone_explains_the_motion_is_taken_whatever_the_accelerometer_errs_by(tmp_path):
    offset = midspan.calibrate(flown(tmp_path, 0.2)).displacement.offset
    # What is left is the attitude's error, which moves the offset by some ms: within four of its own deviations.
    assert abs(offset.value_s - 0.2) < 4.0 * np.sqrt(offset.variance) < 0.02
