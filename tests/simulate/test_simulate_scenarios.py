import json
import tomllib
from dataclasses import replace

import av
import cv2
import numpy as np
import pytest
from scipy.interpolate import CubicSpline
from scipy.optimize import least_squares

from midspan.errors import UsageError
from midspan.records import Region
from midspan.simulate.files.folder import exact_in_video, write_video
from midspan.simulate.motion.motion import Sines, Window
from midspan.simulate.scenarios.stage import stage
from midspan.simulate.scenarios.table import NAMES, SCENARIOS, pixel_bound
from midspan.simulate.scenarios.write import write
from midspan.simulate.scene.camera import Camera
from repeats import slow


def table(path):
    return np.genfromtxt(path, delimiter=",", names=True)


def decoded(path):
    with av.open(str(path)) as container:
        frames = list(container.decode(video=0))
    return np.stack([frame.to_ndarray() for frame in frames]), np.array([frame.time for frame in frames])


@pytest.fixture
def small(monkeypatch):
    """A short scenario with a small picture under the name `footbridge`."""

    def put(**changes):
        base = SCENARIOS["footbridge"]
        camera = replace(base.camera, size_px=(64, 72), **changes)
        motion = Window(Sines([2.5e-3], [1.9]), start_s=0.5)
        scenario = replace(base, duration_s=12.0, camera=camera, motion=lambda rng: motion)
        monkeypatch.setitem(SCENARIOS, "footbridge", scenario)

    return put


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("seed", [0, *slow(7)])
def test_every_scenario_stays_within_its_scene_and_its_streams_overlap(name, seed):
    scenario = SCENARIOS[name]
    staged = stage(scenario, seed)
    truth = staged.truth_mm()
    assert truth[0, 0] == 0.0
    curve = CubicSpline(truth[:, 0], truth[:, 1])
    if scenario.camera is None:
        return
    stamps = staged.frame_stamps_s(scenario.camera)
    true_times = stamps + scenario.camera.time_offset_s
    assert true_times[0] >= 0.0
    assert true_times[-1] <= truth[-1, 0]
    assert abs(scenario.camera.time_offset_s) < 0.5  # the largest offset that calibration searches for on its own
    mm_per_px = abs(scenario.camera.scale_mm_per_px)
    if staged.posed is not None:
        mm_per_px = 1e3 * min(plane.distance_m for plane in staged.posed.planes) / staged.posed.focal_px
    assert np.abs(truth[:, 1]).max() / mm_per_px < 16  # px, the scene's reach
    # The zero is the first frame's, between two samples as well: a cubic meets 4 mm at 3 Hz to 2e-4 mm at 50 Hz.
    assert curve(true_times[0]) == pytest.approx(0.0, abs=5e-4)


def test_some_scenarios_begin_in_lively_motion_between_two_samples():
    for name in ("lively-start", "radar-lively-start"):
        staged = stage(SCENARIOS[name], 0)
        camera, radar = staged.scenario.camera, staged.scenario.radar
        first_s = radar.first_s if camera is None else staged.frame_stamps_s(camera)[0] + camera.time_offset_s
        assert first_s * staged.accelerometer.rate_hz % 1.0 == pytest.approx(0.5, abs=0.01)
        truth = staged.truth_mm()
        # 4 mm rms at 2 to 3 Hz is 63 mm/s rms; the first second is as lively as any other.
        assert truth[:50, 2].std() > 20.0
        assert CubicSpline(truth[:, 0], truth[:, 1])(first_s) == pytest.approx(0.0, abs=5e-4)


def test_a_recording_holds_what_its_settings_promise(tmp_path):
    folder = write("gaps", tmp_path / "gaps", seed=3)
    settings = tomllib.loads((folder / "recording.toml").read_text())
    assert settings["camera"]["file"] == "camera.mkv"
    assert "roi" not in settings["camera"]
    assert settings["reference"] == {"file": "truth.csv", "time": "time_s", "value": "displacement_mm", "unit": "mm"}
    acceleration, truth = table(folder / "accel.csv"), table(folder / "truth.csv")
    assert len(truth) == 6000
    assert len(acceleration) == 6000 - 120  # the missing 1.2 s at 100 Hz
    assert np.count_nonzero(np.isnan(acceleration["accel"])) == 25  # the unreadable 0.25 s
    frames, stamps = decoded(folder / "camera.mkv")
    assert np.diff(stamps).max() == pytest.approx(1.6)  # 1.5 s dropped
    dark = frames.max(axis=(1, 2)) == 0
    assert np.count_nonzero(dark) == 30  # 3 s at 10 Hz
    known = json.loads((folder / "known.json").read_text())
    assert known["camera"]["scale_mm_per_px"] == -1.5
    at_first_frame = np.interp(stamps[0] + known["camera"]["time_offset_s"], truth["time_s"], truth["displacement_mm"])
    assert at_first_frame == pytest.approx(0.0, abs=1e-6)


def test_truth_velocity_is_the_slope_of_truth_displacement(small, tmp_path):
    small()
    truth = table(write("footbridge", tmp_path / "a") / "truth.csv")
    slope = CubicSpline(truth["time_s"], truth["displacement_mm"]).derivative()(truth["time_s"])
    # The cubic's slope errs by about h³ x⁗/60 = 1e-6 × 5e4 / 60 mm/s, more at the ramp.
    np.testing.assert_allclose(truth["velocity_mm_s"][5:-5], slope[5:-5], atol=0.01)


def test_the_video_is_the_film_bit_for_bit_with_exact_stamps(small, tmp_path):
    small()
    folder = write("footbridge", tmp_path / "a", seed=4)
    frames, stamps = decoded(folder / "camera.mkv")
    staged = stage(SCENARIOS["footbridge"], 4)
    setup = SCENARIOS["footbridge"].camera
    expected = staged.view(setup).film(staged.motion, stamps + setup.time_offset_s, rng=staged.rng_sensor)
    np.testing.assert_array_equal(frames, np.stack(list(expected)))
    np.testing.assert_array_equal(stamps, np.arange(len(stamps)) / 10)


@pytest.mark.parametrize(("rate_hz", "offset_s", "start_s"), [(10.0, 0.137, 0.0), (12.5, -0.2, 0.3), (30.0, 0.05, 0.0)])
def test_scale_and_offset_are_those_that_an_independent_tracker_finds(small, tmp_path, rate_hz, offset_s, start_s):
    small(rate_hz=rate_hz, time_offset_s=offset_s, start_s=start_s)
    folder = write("footbridge", tmp_path / "a", seed=2)
    frames, stamps = decoded(folder / "camera.mkv")
    if (folder / "camera_times.csv").exists():
        stamps = table(folder / "camera_times.csv")["time_s"]
    step, criteria = max(1, round(rate_hz / 10)), (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 60, 1e-6)
    warp, moved = np.eye(2, 3, dtype=np.float32), []
    for frame in frames[::step]:
        _, warp = cv2.findTransformECC(frames[0], frame, warp, cv2.MOTION_TRANSLATION, criteria, None, 1)
        moved.append(warp[1, 2])
    truth = table(folder / "truth.csv")
    curve = CubicSpline(truth["time_s"], truth["displacement_mm"])
    fit = least_squares(lambda p: p[0] * np.array(moved) + p[2] - curve(stamps[::step] + p[1]), [-1.0, offset_s, 0.0])
    # That tracker is good to some 0.02 px a frame (0.03 mm): over 110 frames at 20 mm/s rms 0.15 ms and 0.2 %.
    assert fit.x[0] == pytest.approx(-1.5, rel=0.006)
    assert fit.x[1] == pytest.approx(offset_s, abs=6e-4)


def test_acceleration_on_file_twice_integrated_from_rest_is_the_truth(small, tmp_path):
    small()
    folder = write("footbridge", tmp_path / "a")
    acceleration, truth = table(folder / "accel.csv"), table(folder / "truth.csv")
    spline = CubicSpline(acceleration["time_s"], acceleration["accel"] - 0.05)
    moved = 1e3 * spline.antiderivative(2)(acceleration["time_s"])
    drift = np.polynomial.Polynomial.fit(truth["time_s"], moved - truth["displacement_mm"], 5)
    # White noise of 2.5 mm/s² integrates to a drift of some millimetres that a quintic follows to 0.1 mm.
    rest = moved - truth["displacement_mm"] - drift(truth["time_s"])
    assert rest.std() < 0.15
    assert truth["displacement_mm"].std() > 1.0


def test_the_same_seed_writes_the_same_files_and_another_seed_others(small, tmp_path):
    small()
    first, again, other = (write("footbridge", tmp_path / n, seed=s) for n, s in (("a", 1), ("b", 1), ("c", 2)))
    for name in ("accel.csv", "truth.csv", "recording.toml", "known.json"):
        assert (first / name).read_bytes() == (again / name).read_bytes()
    np.testing.assert_array_equal(decoded(first / "camera.mkv")[0], decoded(again / "camera.mkv")[0])
    assert (first / "accel.csv").read_bytes() != (other / "accel.csv").read_bytes()


def test_progress_counts_every_frame(small, tmp_path):
    small()
    calls = []
    folder = write("footbridge", tmp_path / "a", progress=lambda done, total: calls.append((done, total)))
    total = len(decoded(folder / "camera.mkv")[0])
    assert calls == [(k, total) for k in range(1, total + 1)]


def test_its_own_folder_is_written_anew_but_a_foreign_one_is_left_alone(small, tmp_path):
    small()
    folder = write("gnss", tmp_path / "site")
    write("footbridge", folder)
    assert not (folder / "gnss.csv").exists()
    (folder / "notes.txt").write_text("mine")
    with pytest.raises(UsageError, match=r"notes\.txt"):
        write("gnss", folder)
    assert (folder / "camera.mkv").exists()
    other = tmp_path / "other"
    other.mkdir()
    (other / "recording.toml").write_text("")
    with pytest.raises(UsageError, match="did not write"):
        write("gnss", other)


def test_a_failure_leaves_nothing_behind(small, tmp_path):
    small()

    def fail(done, total):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write("footbridge", tmp_path / "a", progress=fail)
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_cannot_be_made_is_a_usage_error(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(UsageError):
        write("gnss", tmp_path / "file" / "below")


def test_an_unknown_scenario_names_the_nearest(tmp_path):
    with pytest.raises(UsageError, match="'footbridge'"):
        write("footbrige", tmp_path / "a")


def test_gnss_heights_have_their_noise_and_gaps(tmp_path):
    folder = write("gnss", tmp_path / "g", seed=1)
    heights, truth = table(folder / "gnss.csv"), table(folder / "truth.csv")
    assert len(heights) == 180 - 12
    assert np.count_nonzero(np.isnan(heights["height"])) == 4
    error = heights["height"] - np.interp(heights["time_s"], truth["time_s"], truth["displacement_mm"])
    assert np.nanstd(error) == pytest.approx(2.0, rel=5 / np.sqrt(2 * 164))


def test_the_bound_of_a_region_is_above_that_of_the_whole_picture(small):
    small()
    whole = pixel_bound("footbridge")
    part = pixel_bound("footbridge", Region(0, 0, 32, 32))
    assert 0 < whole[0] < part[0]
    assert 0 < whole[1] < part[1]


def test_sixteen_bit_frames_survive_the_video(tmp_path):
    flat = np.full((16, 24), 90.0, dtype=np.float32)
    frames = [Camera(bits=16).expose(flat, rng=np.random.default_rng(k)) for k in range(3)]
    write_video(tmp_path / "v.mkv", frames, stamps_s=np.arange(3) / 10, rate_hz=10.0, done=lambda count: None)
    back, _ = decoded(tmp_path / "v.mkv")
    np.testing.assert_array_equal(back, np.stack(frames))


def test_only_whole_milliseconds_from_zero_are_left_to_the_video():
    assert exact_in_video(np.arange(100) / 10)
    assert not exact_in_video(np.arange(100) / 30)
    assert not exact_in_video(0.3 + np.arange(100) / 10)
