"""Calibration of recordings: what is found, what is refused, and its file."""

import json
import shutil

import numpy as np
import pytest

import midspan
from midspan.errors import DataError, UntrustedError, UsageError
from midspan.settings.stored.calibration import calibration_from_dict
from midspan.simulate.motion.motion import Rest, Sines
from midspan.simulate.scene.camera import Camera
from recording_edits import acceleration, frames, read_columns, set_keys, write_acceleration, write_stack
from repeats import slow


def sine(frequency_hz, amplitude_m):
    return lambda rng: Sines(np.array([amplitude_m]), np.array([frequency_hz]))


def scale_error(camera):
    """Relative standard deviation of a scale factor."""
    return np.sqrt(camera.scale.variance) / abs(camera.scale.value_m_per_px)


@pytest.fixture(scope="module")
def calibration(footbridge):
    return midspan.calibrate(midspan.open_recording(footbridge))


def test_values_lie_within_their_own_standard_deviations(calibration):
    camera = calibration.camera
    error = 1e3 * camera.scale.value_m_per_px + 1.5
    # Four standard deviations: one chance in 16 000; and they are sharp enough to be of use.
    assert abs(error) < 4e3 * np.sqrt(camera.scale.variance) < 4 * 0.003 * 1.5
    assert abs(camera.offset.value_s - 0.137) < 4 * np.sqrt(camera.offset.variance) < 4e-3
    assert calibration.noise_std_m_s2 == pytest.approx(2.5e-3, rel=0.3)
    # The acceleration's noise alone leaves 2.5e-3/√2500 = 5e-5 m/s².
    assert abs(calibration.bias_m_s2 - 0.05) < 4 * calibration.bias_std_m_s2 < 4 * 2e-4


def test_the_file_has_the_keys_that_are_relied_on(calibration, tmp_path):
    tree = json.loads(calibration.save(tmp_path).read_text(encoding="utf-8"))
    assert (tmp_path / "calibration.json").is_file()
    names = {"scale_mm_per_px", "scale_std_mm_per_px", "time_offset_s", "time_offset_std_s", "roi"}
    assert names <= set(tree["camera"])
    assert len(tree["camera"]["roi"]) == 4
    assert tree["accelerometer"]["noise_std_m_s2"] > 0
    assert tree["version"] == midspan.__version__
    assert isinstance(tree["warnings"], list)
    assert tree["created"][:2] == "20"
    # Millimetres in the file, metres inside: the last digit of a double may differ.
    again = midspan.load_calibration(tmp_path).to_dict()
    for name in ("scale_mm_per_px", "scale_std_mm_per_px", "time_offset_s", "time_offset_std_s", "roi"):
        assert again["camera"][name] == pytest.approx(tree["camera"][name], rel=1e-12)
    usual, kept = again["accelerometer"].pop("usual"), tree["accelerometer"].pop("usual")
    for end in ("range_low_m_s2", "range_high_m_s2"):
        # Null: the window showed no end of the range.
        assert usual.pop(end) == kept.pop(end)
    assert usual == pytest.approx(kept, rel=1e-12)
    assert again["accelerometer"].pop("lines") == tree["accelerometer"].pop("lines")
    assert again["accelerometer"] == pytest.approx(tree["accelerometer"], rel=1e-12)
    assert (again["version"], again["created"]) == (tree["version"], tree["created"])


def test_a_file_with_only_the_keys_that_are_relied_on_is_enough(calibration):
    tree = calibration.to_dict()
    kept = {"scale_mm_per_px", "scale_std_mm_per_px", "time_offset_s", "time_offset_std_s", "roi"}
    small = {
        "accelerometer": {"noise_std_m_s2": tree["accelerometer"]["noise_std_m_s2"]},
        "camera": {key: value for key, value in tree["camera"].items() if key in kept},
        "version": tree["version"],
        "created": tree["created"],
        "warnings": [],
    }
    loaded = calibration_from_dict(json.loads(json.dumps(small)))
    assert loaded.camera.scale.value_m_per_px == pytest.approx(calibration.camera.scale.value_m_per_px, rel=1e-12)
    assert loaded.camera.region == calibration.camera.region


@pytest.mark.parametrize("band", [[0.5, 8.0], [0.0, 3.0]])
def test_a_band_may_cost_sharpness_but_does_not_bend_the_scale(band, footbridge_copy):
    set_keys(footbridge_copy, "calibration", band_hz=band)
    camera = midspan.calibrate(midspan.open_recording(footbridge_copy)).camera
    relative = np.sqrt(camera.scale.variance) / 1.5e-3
    # Modes at 1.9 and 4.6 Hz: each band holds at least the stronger one.
    assert camera.scale.value_m_per_px == pytest.approx(-1.5e-3, rel=max(4 * relative, 3e-3))
    assert relative < 0.01
    assert camera.offset.value_s == pytest.approx(0.137, abs=1e-3)


def test_a_window_uses_only_its_part(footbridge_copy):
    time, value = acceleration(footbridge_copy)
    # Nonsense after 18 s has no say where the window ends at 17 s.
    value[time > 18.0] = 0.3 * np.random.default_rng(0).standard_normal(np.count_nonzero(time > 18.0))
    write_acceleration(footbridge_copy, time, value)
    set_keys(footbridge_copy, "calibration", window_s=[2.0, 17.0])
    camera = midspan.calibrate(midspan.open_recording(footbridge_copy)).camera
    assert camera.scale.value_m_per_px == pytest.approx(-1.5e-3, rel=3e-3)
    assert camera.offset.value_s == pytest.approx(0.137, abs=1e-3)


def test_a_region_is_used_as_given(footbridge_copy):
    set_keys(footbridge_copy, "camera", roi=[20, 24, 50, 44])
    camera = midspan.calibrate(midspan.open_recording(footbridge_copy)).camera
    assert (camera.region.x, camera.region.y, camera.region.width, camera.region.height) == (20, 24, 50, 44)
    assert camera.scale.value_m_per_px == pytest.approx(-1.5e-3, rel=3e-3)


@pytest.mark.parametrize(("unit", "factor"), [("g", 1 / 9.80665), *slow(("mg", 1e3 / 9.80665), ("gal", 100.0))])
def test_the_unit_of_the_acceleration_does_not_matter_nor_does_gravity(unit, factor, footbridge_copy, calibration):
    time, value = acceleration(footbridge_copy)
    write_acceleration(footbridge_copy, time, factor * (value + 9.80665))
    set_keys(footbridge_copy, "accelerometer", unit=unit)
    found = midspan.calibrate(midspan.open_recording(footbridge_copy))
    # The file keeps seven decimals: 1e-6 m/s² in g, far below the noise of 2.5e-3.
    assert found.camera.scale.value_m_per_px == pytest.approx(calibration.camera.scale.value_m_per_px, rel=1e-4)


def test_a_sensitivity_turns_volts_into_acceleration(footbridge_copy, calibration):
    time, value = acceleration(footbridge_copy)
    write_acceleration(footbridge_copy, time, 0.25 * value)
    set_keys(footbridge_copy, "accelerometer", unit="V", sensitivity=0.25)
    found = midspan.calibrate(midspan.open_recording(footbridge_copy))
    assert found.camera.scale.value_m_per_px == pytest.approx(calibration.camera.scale.value_m_per_px, rel=1e-4)


def test_without_a_time_column_rate_and_start_give_the_clock(footbridge_copy, calibration):
    time, value = acceleration(footbridge_copy)
    np.savetxt(footbridge_copy / "accel.csv", value, header="accel", comments="", fmt="%.7f")
    set_keys(footbridge_copy, "accelerometer", time=None, rate_hz=100.0, start_s=3.0)
    set_keys(footbridge_copy, "camera", start_s=3.0)
    found = midspan.calibrate(midspan.open_recording(footbridge_copy))
    assert found.camera.offset.value_s == pytest.approx(calibration.camera.offset.value_s, abs=1e-6)
    assert time[0] == 0.0


def test_times_of_the_frames_from_a_file_win_over_the_container(footbridge_copy, calibration):
    stamps = np.arange(len(frames(footbridge_copy))) / 10.0 + 0.1
    np.savetxt(footbridge_copy / "times.csv", stamps, header="time_s", comments="", fmt="%.6f")
    set_keys(footbridge_copy, "camera", times="times.csv")
    found = midspan.calibrate(midspan.open_recording(footbridge_copy))
    assert found.camera.offset.value_s == pytest.approx(calibration.camera.offset.value_s - 0.1, abs=2e-4)


def test_rest_is_refused_for_too_little_motion(simulated):
    folder = simulated("rest", duration_s=15.0, motion=lambda rng: Rest())
    with pytest.raises(UntrustedError, match=r"(?i)too little motion"):
        midspan.calibrate(midspan.open_recording(folder))


def test_the_other_image_axis_is_refused(footbridge_copy):
    set_keys(footbridge_copy, "camera", direction="x")
    with pytest.raises(UntrustedError):
        midspan.calibrate(midspan.open_recording(footbridge_copy))


@pytest.mark.parametrize(
    ("frequency", "amplitude", "most"),
    [(3.1, 0.5e-3, 0.5), *slow((2.0, 1e-3, 0.2), (2.0, 1e-3, 0.5), (2.0, 1e-3, 0.3))],
)
def test_a_single_tone_is_refused_where_half_a_period_more_fits_as_well(
    frequency, amplitude, most, simulated, tmp_path
):
    tone = sine(frequency, amplitude)
    folder = tmp_path / "tone"
    shutil.copytree(simulated(f"tone{frequency}", motion=tone), folder)
    set_keys(folder, "calibration", max_offset_s=most)
    # Half a period later the sign is the other one: -0.113 and 0.387 s fit like 0.137 s at 2 Hz.
    with pytest.raises(UntrustedError, match="max_offset_s"):
        midspan.calibrate(midspan.open_recording(folder))


def test_a_single_tone_is_calibrated_where_only_one_offset_is_possible(simulated, tmp_path):
    folder = tmp_path / "slow tone"
    shutil.copytree(simulated("tone0.5", motion=sine(0.5, 5e-3)), folder)
    set_keys(folder, "calibration", max_offset_s=0.4)
    camera = midspan.calibrate(midspan.open_recording(folder)).camera
    # Half a period is 1 s. A slow tone accelerates little: 0.15 % and 0.5 ms are what the noise leaves.
    assert camera.scale.value_m_per_px == pytest.approx(-1.5e-3, rel=8e-3)
    assert camera.offset.value_s == pytest.approx(0.137, abs=2.5e-3)


def test_an_offset_beyond_the_stated_search_is_refused_and_names_the_key(simulated, tmp_path):
    folder = tmp_path / "offset"
    shutil.copytree(simulated("offset 0.6", camera={"time_offset_s": 0.6}), folder)
    # Where no range is stated it is found.
    assert midspan.calibrate(midspan.open_recording(folder)).camera.offset.value_s == pytest.approx(0.6, abs=1e-3)
    set_keys(folder, "calibration", max_offset_s=0.5)
    with pytest.raises(UntrustedError, match="max_offset_s"):
        midspan.calibrate(midspan.open_recording(folder))


def test_an_offset_of_seconds_is_found_when_it_may_be_that_large(footbridge_copy):
    set_keys(footbridge_copy, "camera", start_s=2.0)
    set_keys(footbridge_copy, "calibration", max_offset_s=3.0)
    camera = midspan.calibrate(midspan.open_recording(footbridge_copy)).camera
    assert camera.offset.value_s == pytest.approx(0.137 - 2.0, abs=1e-3)


@pytest.mark.parametrize("readout", [0.03, *slow(0.015)])
def test_a_rolling_shutter_that_is_reported_does_not_bend_the_scale(readout, simulated):
    folder = simulated(f"readout{readout}", camera={"camera": Camera(readout_s=readout)})
    camera = midspan.calibrate(midspan.open_recording(folder)).camera
    # The region's rows are exposed over 18 ms of 30 ms: left alone, this average shrinks 1.9 Hz by 0.2 % and 4.6 Hz by
    # 1 %.
    assert camera.scale.value_m_per_px == pytest.approx(-1.5e-3, rel=max(1e-3, 4 * scale_error(camera)))


def test_acceleration_of_another_event_is_refused(footbridge_copy, simulated):
    other = simulated("band1", seed=1, duration_s=15.0)
    (footbridge_copy / "accel.csv").write_bytes((other / "accel.csv").read_bytes())
    with pytest.raises(UntrustedError):
        midspan.calibrate(midspan.open_recording(footbridge_copy))


def test_a_picture_that_stands_still_is_refused_and_named(footbridge_copy):
    stack = frames(footbridge_copy)
    write_stack(footbridge_copy, np.repeat(stack[:1], len(stack), axis=0))
    with pytest.raises((UntrustedError, DataError)):
        midspan.calibrate(midspan.open_recording(footbridge_copy))


def test_a_window_outside_the_recording_is_wrong_use(footbridge_copy):
    set_keys(footbridge_copy, "calibration", window_s=[1000.0, 1010.0])
    with pytest.raises(UsageError, match="window_s"):
        midspan.calibrate(midspan.open_recording(footbridge_copy))


def test_noise_that_is_given_is_taken(footbridge_copy):
    set_keys(footbridge_copy, "accelerometer", noise_std=0.0025)
    assert midspan.calibrate(midspan.open_recording(footbridge_copy)).noise_std_m_s2 == pytest.approx(0.0025)


def test_a_simulated_recording_knows_what_calibration_should_find(footbridge):
    known = json.loads((footbridge / "known.json").read_text(encoding="utf-8"))
    assert known["camera"]["scale_mm_per_px"] == -1.5
    assert known["camera"]["time_offset_s"] == 0.137
    assert read_columns(footbridge / "truth.csv").shape[1] == 3


@pytest.mark.parametrize("tracker", ["phase", "hybrid"])
def test_phase_trackers_give_a_phase_scale_factor(tracker, footbridge_copy, calibration, tmp_path):
    found = midspan.calibrate(midspan.open_recording(footbridge_copy, camera={"tracker": tracker}))
    # The gain is negative: a target that moves along the axis meets an earlier phase of the fixed filter.
    assert found.camera.phase_scale_m_per_rad * found.camera.scale.value_m_per_px < 0
    found.save(tmp_path)
    stored = json.loads((tmp_path / "calibration.json").read_text(encoding="utf-8"))["camera"]
    assert stored["phase_scale_mm_per_rad"] == pytest.approx(1e3 * found.camera.phase_scale_m_per_rad)
    again = midspan.load_calibration(tmp_path).camera
    assert again.phase_scale_m_per_rad == pytest.approx(found.camera.phase_scale_m_per_rad)
    assert calibration.camera.phase_scale_m_per_rad is None
    # Phase and correlation see the same motion; without learning the gain is good to some per cent.
    assert found.camera.scale.value_m_per_px == pytest.approx(calibration.camera.scale.value_m_per_px, rel=0.05)
