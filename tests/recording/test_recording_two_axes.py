"""Both axes of the image: with a two-axis accelerometer, or one axis fused and the other tracked only."""

import json
import shutil

import numpy as np
import pytest

import midspan
from midspan.calibration.camera import calibrate as camera
from midspan.engine.camera import WARM_UP_FRAMES, TargetChain
from midspan.evaluate.result_file import compare
from midspan.recording import messages
from midspan.recording.inspect import inspect_recording
from midspan.simulate.motion.motion import Sum, random_motion
from midspan.simulate.scenarios.table import sideways
from midspan.sources.accelerometer.formats import list_channels
from plain_data import assert_plain
from recording_edits import frames, read_columns, set_keys, write_stack

# As for one axis: a frame of these cameras is good for 0.006 mm, and the zero rests on the first frame.
FRAME_STD_MM = 0.006
TRUE_SCALE, TRUE_OFFSET = 1.5, 0.137


def slow(rng):
    """A motion that 10 frames a second follow on their own."""
    return Sum((random_motion((0.9, 1.0), 1.4e-3, rng=rng, lines=20), random_motion((0.06, 0.14), 0.5e-3, rng=rng)))


@pytest.fixture(scope="module")
def site(simulated):
    return simulated("two axes", across=sideways)


@pytest.fixture
def site_copy(site, tmp_path):
    return shutil.copytree(site, tmp_path / "site")


@pytest.fixture(scope="module")
def result(site):
    return midspan.estimate(midspan.open_recording(site))


def truths(folder):
    """Time (s), displacement along y and along x (mm)."""
    known = read_columns(folder / "truth.csv")
    return known[:, 0], known[:, 1], known[:, 3]


def errors(folder, result):
    """Error (mm) of the main and of the second axis by name."""
    time, y, x = truths(folder)
    true = {"y": y, "x": x}
    return {
        axis: value - np.interp(result.time_s, time, true[axis])
        for axis, value in ((result.axis, result.displacement_mm), (result.across.axis, result.across.displacement_mm))
    }


def assert_right(error):
    assert np.std(error) < FRAME_STD_MM
    assert abs(np.mean(error)) < 4 * FRAME_STD_MM


def test_the_result_along_both_axes_is_plain_data(result):
    assert_plain(result)
    for one, along in ((result, "y"), (result.across, "x")):
        (measured,) = one.measured
        px = result.track.along(along)[0]
        expected = one.calibration.camera.scale.value_m_per_px * px
        # One target alone: what is drawn are its own pixels times the scale factor of the axis, to rounding.
        np.testing.assert_allclose(measured.value_m, expected, atol=1e-15)


def test_both_axes_are_right_with_their_own_scale_and_one_clock(site, result):
    assert (result.axis, result.across.axis, result.across.fused) == ("y", "x", True)
    for error in errors(site, result).values():
        assert_right(error)
    across = result.calibration.across.camera
    assert 1e3 * result.calibration.camera.scale.value_m_per_px == pytest.approx(-TRUE_SCALE, rel=3e-3)
    assert 1e3 * across.scale.value_m_per_px == pytest.approx(-TRUE_SCALE, rel=3e-3)
    assert across.offset == result.calibration.camera.offset
    assert across.offset.value_s == pytest.approx(TRUE_OFFSET, abs=1e-3)


def test_the_clock_offset_of_both_axes_together_is_more_certain_than_of_one(site_copy, result):
    set_keys(site_copy, "accelerometer", value="accel_x", value_x=None, value_y=None)
    set_keys(site_copy, "camera", direction="x")
    alone = midspan.calibrate(midspan.open_recording(site_copy)).camera.offset
    assert result.calibration.camera.offset.variance < alone.variance


def test_one_axis_of_the_two_is_what_it_is_alone(site_copy, result):
    set_keys(site_copy, "accelerometer", value="accel_y", value_x=None, value_y=None)
    set_keys(site_copy, "camera", direction="y")
    alone = midspan.estimate(midspan.open_recording(site_copy))
    # Only the clock offset differs, by its own uncertainty: some 0.02 ms at 15 mm/s are 0.3 µm.
    np.testing.assert_allclose(alone.displacement_mm, result.displacement_mm, atol=2e-3)


def test_an_accelerometer_that_points_the_other_way_turns_only_its_own_axis(site_copy, result):
    rows = read_columns(site_copy / "accel.csv")
    header = (site_copy / "accel.csv").read_text(encoding="utf-8").splitlines()[0]
    column = header.split(",").index("accel_x")
    rows[:, column] *= -1.0
    np.savetxt(site_copy / "accel.csv", rows, delimiter=",", header=header, comments="", fmt="%.7f")
    found = midspan.estimate(midspan.open_recording(site_copy))
    np.testing.assert_allclose(found.across.displacement_mm, -result.across.displacement_mm, atol=1e-4)
    np.testing.assert_allclose(found.displacement_mm, result.displacement_mm, atol=1e-4)


def test_the_trackers_are_reported_where_to_look_along_both_axes(site, result, monkeypatch):
    reported, push = [], TargetChain.push

    def recorded(self, frame, prediction=None):
        reported.append(prediction)
        return push(self, frame, prediction)

    monkeypatch.setattr(TargetChain, "push", recorded)
    track = midspan.estimate(midspan.open_recording(site), result.calibration).track
    # The first frames are gone through once before, to learn what is usual.
    reported = reported[WARM_UP_FRAMES:]
    assert len(reported) == len(track.time_ns)
    settled = np.arange(100, len(reported))
    for name in ("x", "y"):
        seen = getattr(track, f"{name}_px")
        expected = np.array([getattr(reported[k], f"{name}_px") for k in settled])
        # Up to 5 Hz at ten frames a second: where the target was seen last says nothing of where it is now.
        assert np.std(seen[settled] - seen[settled - 1]) > 0.15
        # The acceleration does: over a tenth of a second it is good for a few hundredths of a pixel.
        assert np.std(expected - seen[settled]) < 0.05


def test_the_axis_without_a_column_is_tracked_only_and_its_band_holds(simulated, tmp_path):
    folder = shutil.copytree(simulated("slow across", across=slow), tmp_path / "site")
    set_keys(folder, "accelerometer", value_x=None)
    found = midspan.estimate(midspan.open_recording(folder))
    assert (found.axis, found.across.axis, found.across.fused) == ("y", "x", False)
    error = errors(folder, found)
    assert_right(error["y"])
    # 0.95 Hz and ten frames a second: what a white acceleration makes of the time between them is far above the truth's
    # own error, a frame's noise and the smoother's share of the motion.
    assert np.std(error["x"]) < 0.03
    assert np.mean(np.abs(error["x"]) < 1.96 * found.across.displacement_std_mm) > 0.95
    # Square pixels: the magnitude is the fused axis's, and positive means that the structure moves to the right.
    across, main = found.calibration.across.camera, found.calibration.camera
    assert across.scale.value_m_per_px == -abs(main.scale.value_m_per_px)
    assert found.metadata()["axes"]["x"]["fused"] is False


def test_a_tracked_axis_too_fast_for_the_camera_has_a_wide_band_not_a_wrong_one(site_copy):
    set_keys(site_copy, "accelerometer", value_y=None)
    found = midspan.estimate(midspan.open_recording(site_copy))
    assert (found.axis, found.across.axis) == ("x", "y")
    error = errors(site_copy, found)
    assert_right(error["x"])
    # 4.6 Hz lies next to the Nyquist frequency of 5 Hz and cannot be reported between frames: 0.25 mm rms are missed.
    assert np.mean(np.abs(error["y"]) < 1.96 * found.across.displacement_std_mm) > 0.9
    assert np.median(found.across.displacement_std_mm) > 10 * np.median(found.displacement_std_mm)


def test_the_second_axis_at_rest_is_tracked_only_with_a_warning(site_copy):
    rows = read_columns(site_copy / "accel.csv")
    header = (site_copy / "accel.csv").read_text(encoding="utf-8").splitlines()[0]
    column = header.split(",").index("accel_x")
    rows[:, column] = 2.5e-3 * np.random.default_rng(0).standard_normal(len(rows))
    np.savetxt(site_copy / "accel.csv", rows, delimiter=",", header=header, comments="", fmt="%.7f")
    found = midspan.estimate(midspan.open_recording(site_copy))
    assert not found.across.fused
    assert any("Along x the target is only tracked, without the accelerometer" in line for line in found.warnings)
    assert_right(errors(site_copy, found)["y"])


@pytest.fixture
def shaken(site_copy):
    """After the calibration's window single frames are off, then for two seconds the picture jumps at each frame."""
    stack = frames(site_copy).copy()
    for k in (*range(152, 176, 4), *range(180, 200)):
        stack[k] = np.roll(stack[k], 3 if k % 2 else -3, axis=1)
    write_stack(site_copy, stack)
    set_keys(site_copy, "calibration", window_s=[0.0, 15.0])
    return site_copy


def test_what_the_gate_did_along_the_second_axis_is_reported(shaken):
    found = midspan.estimate(midspan.open_recording(shaken))
    # Single frames 4.5 mm off at 5 µm of noise; the clock is 0.137 s behind. Then the picture jumps at each frame.
    single, jumping = found.across.events
    assert single.kind == "rejected"
    assert single.time_ns / 1e9 == pytest.approx(15.337, abs=0.01)
    assert jumping.time_ns / 1e9 == pytest.approx(18.137, abs=0.15)
    assert f"Along x: {jumping.text}" in found.warnings
    assert any("of the measurements along x were rejected" in line for line in found.warnings)
    # Nothing of it happened along the main axis, and along the second one the band holds all through.
    assert not any("measurements were rejected" in line or "rows are" in line for line in found.warnings)
    assert found.events == ()
    assert_right(errors(shaken, found)["x"])


def test_a_second_axis_that_contradicts_its_acceleration_is_left_out_and_the_first_stays(shaken, monkeypatch):
    recording = midspan.open_recording(shaken)
    before = midspan.estimate(recording)
    share = messages.rejected_share(before.across.innovation)
    monkeypatch.setattr(messages, "MAX_REJECTED", 0.5 * share)
    found = midspan.estimate(recording)
    assert found.across is None
    assert any("The second axis x is left out" in line and "contradict" in line for line in found.warnings)
    np.testing.assert_array_equal(found.displacement_mm, before.displacement_mm)


def test_a_second_axis_with_too_few_frames_is_left_out_and_they_are_counted(site_copy, monkeypatch, tmp_path):
    stack = frames(site_copy).copy()
    stack[100:120] = np.random.default_rng(0).integers(0, 255, stack[100:120].shape)
    write_stack(site_copy, stack)
    set_keys(site_copy, "accelerometer", value_x=None)
    monkeypatch.setattr(camera, "MIN_FRAMES", 10_000)
    recording = midspan.open_recording(site_copy)
    found = midspan.estimate(recording)
    assert found.across is None
    track = found.track
    seen = int(np.count_nonzero(np.isfinite(track.x_px)))
    assert seen <= len(stack) - 20
    assert any(f"The second axis x is left out of the result. {seen} usable" in line for line in found.warnings)
    again = midspan.estimate(recording, midspan.load_calibration(found.calibration.save(tmp_path / "calibration.json")))
    assert again.across is None
    assert any("The second axis x is left out" in line for line in again.warnings)
    # With the file the search begins at a prediction; where the picture is gone the path is only as good as its band.
    apart = np.abs(again.displacement_mm - found.displacement_mm)
    assert np.all(apart < np.maximum(2e-3, found.displacement_std_mm))


def test_columns_metadata_and_data_frame_name_the_axes(result, tmp_path):
    frame = result.to_pandas()
    second = ["displacement_x_mm", "displacement_std_x_mm", "velocity_x_mm_s", "status_x"]
    assert list(frame.columns)[-4:] == second
    assert set(frame["status_x"].unique()) <= {"tracking", "coasting", "lost"}
    saved = result.save(tmp_path / "result.csv")
    tree = json.loads(saved.with_suffix(".json").read_text(encoding="utf-8"))
    assert tree["axes"]["y"]["column"] == "displacement_mm"
    assert tree["axes"]["x"]["column"] == "displacement_x_mm"
    assert set(tree["calibration"]["camera"]["axes"]) == {"x", "y"}


@pytest.mark.parametrize("suffix", [".csv", ".parquet", ".h5", ".mat", ".xlsx", ".tdms", ".mseed", ".uff"])
def test_every_format_holds_the_second_axis(result, suffix, tmp_path):
    path = result.save(tmp_path / f"result{suffix}")
    channels = {channel.name: channel for channel in list_channels(path).channels}
    # CSV keeps a picometre, all others every digit.
    np.testing.assert_allclose(channels["displacement_x_mm"].values, result.across.displacement_mm, atol=1e-8)


@pytest.mark.parametrize("suffix", [".csv", ".mseed"])
@pytest.mark.parametrize("axis", ["x", "y"])
def test_compare_takes_the_axis_of_both_files(site, result, axis, suffix, tmp_path):
    path = result.save(tmp_path / f"result{suffix}")
    error = errors(site, result)[axis]
    for reference in (site, site / "truth.csv"):
        found = compare(path, reference, axis=axis)
        # The reference is interpolated by a spline there and by straight lines here: 0.3 % of 0.25 mm at 4.6 Hz.
        assert found.rmse_mm == pytest.approx(float(np.sqrt(np.mean(error**2))), rel=0.02)


def test_an_axis_is_refused_where_there_is_only_one(footbridge, tmp_path):
    path = midspan.estimate(midspan.open_recording(footbridge)).save(tmp_path / "result.csv")
    with pytest.raises(midspan.UsageError, match="one axis only"):
        compare(path, footbridge, axis="x")


def test_a_calibration_from_its_file_gives_the_same_result(site, result, tmp_path):
    recording = midspan.open_recording(site)
    file = midspan.calibrate(recording).save(tmp_path / "calibration.json")
    again = midspan.estimate(recording, midspan.load_calibration(file))
    # Where the tracker's search begins moves its result by a tenth of a standard deviation, seldom by one.
    for found, before in ((again, result), (again.across, result.across)):
        apart = np.abs(found.displacement_mm - before.displacement_mm) / before.displacement_std_mm
        assert float(np.sqrt(np.mean(apart**2))) < 0.25
        assert apart.max() < 2.0


def test_a_calibration_of_one_axis_is_refused_for_two(site, footbridge):
    calibration = midspan.calibrate(midspan.open_recording(footbridge))
    with pytest.raises(midspan.UsageError, match=r"camera\.direction = 'xy': the calibration was made for 'y'"):
        midspan.estimate(midspan.open_recording(site), calibration)


def test_inspect_shows_both_columns(site):
    tree = inspect_recording(midspan.open_recording(site))
    assert tree["accelerometer"]["channel"] == "accel_y"
    assert tree["accelerometer_x"]["channel"] == "accel_x"


def test_a_result_draws_both_axes(result):
    from matplotlib.figure import Figure

    labels = [line.get_label() for line in result.plot(Figure().subplots()).axes[0].get_lines()]
    assert labels == ["displacement along y", "displacement along x"]


def test_one_direction_takes_its_own_column_of_several(site_copy):
    set_keys(site_copy, "camera", direction="y")
    opened = midspan.open_recording(site_copy)
    assert list(opened.accelerometer_axes) == ["x", "y"]
    known = list_channels(site_copy / opened.accelerometer.file)
    for axis, series in opened.accelerometer_axes.items():
        (column,) = [one for one in known.channels if one.name == f"accel_{axis}"]
        np.testing.assert_array_equal(series.value, column.values)
        np.testing.assert_array_equal(series.time_ns, opened.acceleration.time_ns)
    np.testing.assert_array_equal(opened.acceleration.value, opened.accelerometer_axes["y"].value)
    tree = inspect_recording(opened)
    assert (tree["accelerometer"]["channel"], tree["accelerometer_x"]["channel"]) == ("accel_y", "accel_x")
    several = midspan.estimate(opened)
    set_keys(site_copy, "accelerometer", value="accel_y", value_x=None, value_y=None)
    one = midspan.estimate(site_copy)
    np.testing.assert_array_equal(several.displacement_mm, one.displacement_mm)


def test_the_axis_of_the_main_columns_is_named(site_copy):
    set_keys(site_copy, "accelerometer", axis="x")
    opened = midspan.open_recording(site_copy)
    assert (opened.axis, opened.across.axis) == ("x", "y")
    np.testing.assert_array_equal(opened.acceleration.value, opened.accelerometer_axes["x"].value)
    np.testing.assert_array_equal(opened.across.acceleration.value, opened.accelerometer_axes["y"].value)
