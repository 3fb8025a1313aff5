"""The camera alone, and what `inspect` says of a recording's streams."""

import cv2
import numpy as np
import pytest

import midspan
from midspan.cli.main import run as command_line
from midspan.errors import DataError, UsageError
from midspan.recording.inspect import inspect_recording
from midspan.recording.tracking.track import track
from midspan.records import Region, Status
from midspan.sources.inspect import inspect_file
from recording_edits import acceleration, frames, set_keys, write_acceleration, write_stack


def inspected(folder):
    return inspect_recording(midspan.open_recording(folder))


def test_a_recording_and_its_video_give_the_same_track(footbridge):
    of_recording = track(footbridge)
    of_video = track(footbridge / "camera.mkv")
    assert of_recording.region == of_video.region
    np.testing.assert_array_equal(of_recording.track.y_px, of_video.track.y_px)
    np.testing.assert_array_equal(of_recording.track.time_ns, of_video.track.time_ns)
    columns = list(of_video.table().columns)
    assert columns == ["time_s", "x_px", "y_px", "std_x_px", "std_y_px", "status"]


def test_there_is_one_row_for_each_frame_and_the_first_is_zero(footbridge):
    found = track(footbridge).track
    assert len(found.time_ns) == len(frames(footbridge))
    np.testing.assert_allclose(np.diff(found.time_ns), 1e8, atol=1e6)
    # The first frame is its own reference.
    assert abs(found.y_px[0]) < 1e-6
    assert abs(found.x_px[0]) < 1e-6
    assert np.all(found.status == Status.TRACKING)


def test_every_second_frame_is_every_second_row(footbridge):
    region = Region(16, 16, 57, 57)
    # A tracker that learns would see other frames; this one does not.
    whole = track(footbridge, roi=region, tracker="template").track
    half = track(footbridge, roi=region, tracker="template", every=2).track
    np.testing.assert_array_equal(half.time_ns, whole.time_ns[::2])
    # The search starts elsewhere, the peak is the same to the tracker's resolution.
    np.testing.assert_allclose(half.y_px, whole.y_px[::2], atol=2e-3)


def test_frames_without_times_are_counted_and_this_is_reported(footbridge_copy):
    write_stack(footbridge_copy, frames(footbridge_copy)[:30])
    found = track(footbridge_copy / "camera.npy")
    np.testing.assert_array_equal(found.track.time_ns, np.arange(30) * 1_000_000_000)
    assert any("rate-hz" in line for line in found.warnings)
    timed = track(footbridge_copy / "camera.npy", rate_hz=10.0, start_s=5.0)
    assert timed.track.time_ns[1] == 5_100_000_000


def test_a_region_outside_the_image_is_wrong_use(footbridge):
    with pytest.raises(UsageError, match="96x96"):
        track(footbridge, roi=Region(60, 60, 57, 57))


def test_a_dark_frame_is_lost_and_reported(footbridge_copy):
    stack = frames(footbridge_copy)[:40]
    stack[20:23] = 0
    write_stack(footbridge_copy, stack)
    found = track(footbridge_copy, roi=Region(16, 16, 57, 57))
    assert np.flatnonzero(found.track.status == Status.LOST).tolist() == [20, 21, 22]
    assert np.all(np.isnan(found.track.y_px[20:23]))
    assert any("3 of 40" in line for line in found.warnings)


def test_inspect_names_streams_rates_durations_and_overlap(footbridge):
    tree = inspected(footbridge)
    assert tree["accelerometer"]["rate_hz"] == pytest.approx(100.0)
    assert tree["accelerometer"]["duration_s"] == pytest.approx(24.99)
    assert tree["accelerometer"]["unit"] == "m/s^2"
    assert tree["accelerometer"]["samples"] == 2500
    assert (tree["camera"]["width"], tree["camera"]["height"], tree["camera"]["bit_depth"]) == (96, 96, 8)
    assert tree["camera"]["rate_hz"] == pytest.approx(10.0)
    assert tree["camera"]["lossless"] is True
    assert tree["overlap"]["overlapping"] is True
    # From 0 to the last frame at 24.7 s, on the sensors' own clocks.
    assert tree["overlap"]["duration_s"] == pytest.approx(24.7, abs=1e-6)


def test_inspect_counts_missing_clipped_and_frozen_samples_and_gaps(footbridge_copy):
    time, value = acceleration(footbridge_copy)
    value = np.clip(value, -0.6, None)
    held = int(np.count_nonzero(value == -0.6))
    value[1000:1030] = np.nan
    value[1500:1700] = 0.1234
    kept = (time < 20.0) | (time >= 21.0)
    write_acceleration(footbridge_copy, time[kept], value[kept])
    branch = inspected(footbridge_copy)["accelerometer"]
    assert branch["missing_samples"] == 30
    assert branch["frozen_samples"] == 199
    # Runs of at least three samples at the end of the range count; single ones may be true peaks.
    assert 0 < branch["clipped_samples"] <= held
    assert [round(gap["length_s"], 2) for gap in branch["gaps"]] == [1.01]
    assert branch["gaps"][0]["at_s"] == pytest.approx(19.99)


def test_inspect_counts_frozen_dark_and_saturated_frames(footbridge_copy):
    stack = frames(footbridge_copy)
    stack[50:55] = stack[49]
    stack[100:102] = 0
    stack[150] = 255
    write_stack(footbridge_copy, stack)
    branch = inspected(footbridge_copy)["camera"]
    # Five repeats, and the second of two black frames.
    assert branch["frozen_frames"] == 6
    assert branch["dark_frames"] == 2
    assert branch["saturated_frames"] == 1


def test_a_single_file_of_frames_shows_its_temperatures_size_and_number_whether_timed_or_not(tmp_path, capsys):
    rng = np.random.default_rng(1)
    celsius = rng.uniform(5.0, 25.0, (3, 30, 40))
    celsius[:, 3, 4], celsius[:, 5, 6] = -2.0, 31.0
    counts = np.rint((celsius + 273.15) / 0.01).astype(np.uint16)
    cv2.imwrite(str(tmp_path / "one.tiff"), counts[0])
    cv2.imwritemulti(str(tmp_path / "many.tif"), list(counts))
    np.savez(tmp_path / "stack.npz", celsius=celsius)
    np.savez(tmp_path / "timed.npz", celsius=celsius, time_s=np.arange(3) / 5.0)
    (tmp_path / "folder").mkdir()
    for k in range(3):
        cv2.imwrite(str(tmp_path / "folder" / f"p{k}.png"), counts[k])
    for name, count in {"one.tiff": 1, "many.tif": 3, "stack.npz": 3, "timed.npz": 3, "folder": 3}.items():
        branch = inspect_file(tmp_path / name)["frames"]
        # Half a count of 0.01 K.
        assert (branch["coldest_c"], branch["warmest_c"]) == pytest.approx((-2.0, 31.0), abs=0.006)
        assert (branch["width"], branch["height"], branch["frames_used"]) == (40, 30, count)
        assert branch["rate_hz"] == (pytest.approx(5.0) if name == "timed.npz" else None)
        assert command_line(["inspect", str(tmp_path / name)]) == 0
        shown = capsys.readouterr().out
        assert "-2.00 … 31.00 °C" in shown
        assert ("no time stamps in the file" in shown) == (name != "timed.npz")


def test_pictures_of_light_are_shown_without_temperatures(tmp_path):
    cv2.imwrite(str(tmp_path / "a.png"), np.random.default_rng(1).integers(0, 255, (30, 40)).astype(np.uint8))
    cv2.imwrite(str(tmp_path / "b.png"), np.random.default_rng(1).integers(0, 1024, (30, 40)).astype(np.uint16))
    for name in ("a.png", "b.png"):
        assert "coldest_c" not in inspect_file(tmp_path / name)["frames"]


def test_irregular_times_are_jitter_not_gaps(footbridge_copy):
    time, value = acceleration(footbridge_copy)
    rng = np.random.default_rng(2)
    write_acceleration(footbridge_copy, time + rng.uniform(-2.5e-3, 2.5e-3, len(time)), value)
    branch = inspected(footbridge_copy)["accelerometer"]
    # The difference of two uniform errors of ±2.5 ms has a standard deviation of 2.5·√(2/3) = 2.04 ms.
    assert branch["jitter_ms"] == pytest.approx(2.04, rel=0.05)
    assert branch["gaps"] == []


def test_a_stream_that_cannot_be_read_is_reported_beside_the_others(footbridge_copy):
    (footbridge_copy / "camera.mkv").write_bytes(b"")
    tree = inspected(footbridge_copy)
    assert tree["camera"]["exit_code"] == 3
    assert tree["accelerometer"]["samples"] == 2500


def test_streams_that_do_not_overlap_are_reported(footbridge_copy):
    set_keys(footbridge_copy, "camera", start_s=1000.0)
    overlap = inspected(footbridge_copy)["overlap"]
    assert overlap["overlapping"] is False
    assert overlap["duration_s"] == 0.0


def test_a_single_file_shows_its_channels_or_its_frames(footbridge):
    channels = inspect_file(footbridge / "accel.csv")["channels"]
    assert [channel["name"] for channel in channels] == ["time_s", "accel"]
    assert inspect_file(footbridge / "camera.mkv")["frames"]["frames_used"] == 248
    with pytest.raises(DataError):
        inspect_file(footbridge / "nothing.csv")


def test_a_recording_shows_what_it_holds(footbridge):
    text = repr(midspan.open_recording(footbridge))
    assert "accelerometer" in text
    assert "camera" in text
    assert "small footbridge" in text
