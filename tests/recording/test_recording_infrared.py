"""Recordings with a thermal camera, alone and with a camera of light that goes blind at night."""

import json
import shutil
from itertools import pairwise

import numpy as np
import pytest

import midspan
from midspan.calibration.camera.best_range import compared_band
from midspan.cli.main import run as command_line
from midspan.errors import DataError, UntrustedError, UsageError
from midspan.recording.inspect import inspect_recording
from midspan.recording.tracking.track import track
from midspan.records import Region, Source, Status
from midspan.settings.stored.calibration import load_calibration
from midspan.simulate.motion.motion import Sines
from midspan.simulate.scene.texture import textured_scene
from midspan.simulate.scene.thermal import Course, ThermalCamera, ThermalView, WarmBody
from midspan.thermal.temperature_range import ROUGH, THINNED, band_error
from plain_data import assert_plain
from recording_edits import read_columns, set_keys
from repeats import slow

LENGTH_S, RATE_HZ = 40.0, 6.0
DUSK_S, DAWN_S = 20.0, 30.0
CAMERA_LATE_S, INFRARED_LATE_S = -0.03, 0.07
MM_PER_PX = {"camera": -1.0, "infrared": -2.0}


def light(time_s):
    """Share of full light: night from DUSK_S to DAWN_S, each with two seconds of twilight."""
    return np.clip(np.where(time_s < 25.0, (DUSK_S - time_s) / 2.0, (time_s - DAWN_S) / 2.0), 0.0, 1.0)


def filmed(motion, folder, rng):
    """Writes both cameras' stacks; a shutter closes at 12 s and a warm body passes at 26 s."""
    stamps = np.arange(0.3, LENGTH_S - 0.2, 1.0 / RATE_HZ)
    moved = 1e3 * motion.displacement(stamps) / MM_PER_PX["infrared"]
    scene = textured_scene("natural", (80, 88), rng=rng, reach_px=6.0, lens_px=1.0)
    body = WarmBody(start_s=26.0, left_px=-30.0, width_px=24.0, height_px=40.0, speed_px_s=60.0)
    view = ThermalView((scene,), bodies=(body,), camera=ThermalCamera(shutters_s=(12.0,), closed_s=0.7))
    celsius = np.array(list(view.film(np.column_stack((0.0 * moved, moved)), stamps, rng=rng)))
    np.savez(folder / "infrared.npz", celsius=celsius, time_s=stamps - INFRARED_LATE_S)
    moved = 1e3 * motion.displacement(stamps) / MM_PER_PX["camera"]
    scene = textured_scene("natural", (80, 88), rng=rng, reach_px=10.0)
    pictures = []
    for y_px, share in zip(moved, light(stamps), strict=True):
        signal = share * scene.render(0.0, float(y_px))
        noise = np.sqrt(2.0 + 0.02 * np.maximum(signal, 0.0)) * rng.standard_normal(signal.shape)
        pictures.append(np.clip(np.rint(signal + noise + 2.0), 0, 255).astype(np.uint8))
    np.savez(folder / "camera.npz", frames=np.array(pictures), time_s=stamps - CAMERA_LATE_S)


@pytest.fixture(scope="module")
def day(tmp_path_factory):
    """A compressed day: accelerometer, camera, infrared camera, truth; not to be changed."""
    folder = tmp_path_factory.mktemp("day") / "Tag und Nacht"
    folder.mkdir()
    rng = np.random.default_rng(4)
    motion = Sines(np.array([1.5e-3, 0.8e-3, 0.5e-3]), np.array([0.9, 1.7, 3.1]), phase_rad=np.array([0.0, 1.0, 2.0]))
    time_s = np.arange(0.0, LENGTH_S, 0.01)
    accel = motion.acceleration(time_s) + rng.normal(0.0, 2.5e-3, time_s.size) + 0.03
    table = np.column_stack((time_s, accel))
    np.savetxt(folder / "accel.csv", table, delimiter=",", header="time_s,accel", comments="")
    zero = motion.displacement(np.array([0.3]))[0]
    truth = np.column_stack((time_s, 1e3 * (motion.displacement(time_s) - zero)))
    np.savetxt(folder / "truth.csv", truth, delimiter=",", header="time_s,displacement_mm", comments="")
    filmed(motion, folder, rng)
    roi = "roi = [14, 10, 60, 60]\n\n"
    (folder / "recording.toml").write_text(
        '[accelerometer]\nfile = "accel.csv"\nunit = "m/s^2"\n\n'
        f'[camera]\nfile = "camera.npz"\n{roi}[infrared]\nfile = "infrared.npz"\n{roi}'
        "[calibration]\nwindow_s = [0.0, 18.0]\n",
        encoding="utf-8",
    )
    return folder


@pytest.fixture
def day_copy(day, tmp_path):
    folder = tmp_path / "copy"
    shutil.copytree(day, folder)
    return folder


@pytest.fixture(scope="module")
def result(day):
    return midspan.estimate(midspan.open_recording(day))


@pytest.fixture(scope="module")
def alone(day, tmp_path_factory):
    """The same recording without its camera, and its result."""
    folder = tmp_path_factory.mktemp("alone") / "night"
    shutil.copytree(day, folder)
    text = (folder / "recording.toml").read_text(encoding="utf-8")
    text = text.replace('[camera]\nfile = "camera.npz"\nroi = [14, 10, 60, 60]\n\n', "")
    (folder / "recording.toml").write_text(text, encoding="utf-8")
    return folder, midspan.estimate(midspan.open_recording(folder))


def error_mm(folder, result):
    truth = read_columns(folder / "truth.csv")
    return result.displacement_mm - np.interp(result.time_s, truth[:, 0], truth[:, 1])


def test_a_night_without_the_camera_leaves_no_gap_no_step_and_one_source_a_row(day, result):
    error, rows = error_mm(day, result), result.estimate
    assert np.all(np.diff(rows.time_ns) == 10_000_000)
    # Both cameras are noisy by 0.005 px, which the accelerometer halves; the zero is one frame's.
    assert np.sqrt(np.mean(error**2)) < 0.02
    # The zero is one draw for all rows; about it the band holds what it says.
    assert abs(error.mean()) < 3.0 * np.median(result.displacement_std_mm)
    assert np.mean(np.abs(error - error.mean()) <= 1.96 * result.displacement_std_mm) > 0.9
    assert np.mean(rows.status == Status.TRACKING) > 0.98
    assert not [event for event in result.events if event.kind == "switch"]
    for at in (DUSK_S, DAWN_S):
        before, after = (error[(result.time_s > at + a) & (result.time_s < at + a + 3.0)] for a in (-3.0, 0.0))
        assert abs(after.mean() - before.mean()) < 0.05
    night = (result.time_s > DUSK_S + 3.0) & (result.time_s < DAWN_S - 0.5)
    # While the shutter is closed by day the camera goes on; at night only infrared is left.
    assert set(rows.source[night]) <= {Source.INFRARED, Source.PREDICTION}
    # By day both see; their frames are alike in noise (0.0045 and 0.0042 mm as estimated), so each makes rows.
    by_day = rows.source[(result.time_s > 5.0) & (result.time_s < 17.0)]
    assert set(by_day) <= {Source.CAMERA, Source.INFRARED}
    assert 0.2 < np.mean(by_day == Source.CAMERA) < 0.8


def test_each_camera_has_its_own_scale_factor_and_clock(result):
    for found, late_s in zip(result.cameras, (CAMERA_LATE_S, INFRARED_LATE_S), strict=True):
        camera = found.calibrations[0]
        known = MM_PER_PX[found.sensor]
        assert abs(1e3 * camera.scale.value_m_per_px - known) < 4.0 * 1e3 * np.sqrt(camera.scale.variance)
        assert 1e3 * camera.scale.value_m_per_px == pytest.approx(known, rel=0.01)
        assert camera.offset.value_s == pytest.approx(late_s, abs=2e-3)


def test_the_result_of_two_cameras_is_plain_data(result):
    assert_plain(result)
    assert len(result.cameras) == len(result.measured) == 2


def test_a_black_or_covered_camera_gives_lost_frames_and_never_wrong_ones(result, day):
    camera, infrared = (found.track for found in result.cameras)
    dark = light(camera.time_ns / 1e9 + CAMERA_LATE_S) == 0.0
    assert np.count_nonzero(dark) > 40
    assert np.all(camera.status[dark] == Status.LOST)
    assert np.all(np.isnan(camera.y_px[dark]))
    closed = [event for event in result.events if event.kind == "shutter"]
    assert len(closed) == 1
    at = infrared.time_ns / 1e9 + INFRARED_LATE_S
    assert np.all(infrared.status[(at > 12.3) & (at < 12.6)] == Status.LOST)
    # The warm body that covers the target for a while costs no frame.
    assert np.all(infrared.status[(at > 24.0) & (at < 29.0)] == Status.TRACKING)


@pytest.mark.parametrize("tracker", ["registration", *slow("hybrid", "template")])
def test_a_hand_before_the_lens_is_no_displacement(day_copy, tracker):
    stored = np.load(day_copy / "camera.npz")
    pictures, stamps = stored["frames"][:90].copy(), stored["time_s"][:90]
    covered = np.arange(50, 80)
    rng = np.random.default_rng(0)
    pictures[covered] = np.clip(90 + 2 * rng.standard_normal(pictures[covered].shape), 0, 255).astype(np.uint8)
    np.savez(day_copy / "camera.npz", frames=pictures, time_s=stamps)
    found = track(day_copy, tracker=tracker).track
    assert np.all(found.status[covered] == Status.LOST)
    assert np.all(found.status[:50] == Status.TRACKING)


def test_the_calibration_file_keeps_both_cameras_and_gives_the_same_result(day, result, tmp_path):
    file = result.calibration.save(tmp_path)
    tree = json.loads(file.read_text(encoding="utf-8"))
    assert {"scale_mm_per_px", "scale_std_mm_per_px", "time_offset_s", "roi", "temperature_range_c"} <= set(
        tree["infrared"]
    )
    low, high = tree["infrared"]["temperature_range_c"]
    assert 15.0 < low < 20.0 < high < 25.0  # a wall of 20 ± 1 °C, not the body of 33 °C
    again = load_calibration(file)
    assert again.infrared.source is Source.INFRARED
    assert again.camera.source is Source.CAMERA
    assert again.infrared.scale.value_m_per_px == pytest.approx(result.calibration.infrared.scale.value_m_per_px)
    second = midspan.estimate(midspan.open_recording(day), again)
    np.testing.assert_allclose(second.displacement_mm, result.displacement_mm, atol=0.01)


def test_a_thermal_camera_alone_makes_a_result_of_its_own(alone):
    folder, result = alone
    assert set(result.estimate.source) <= {Source.INFRARED, Source.PREDICTION}
    assert result.calibration.camera is None
    assert result.axis == "y"
    assert np.sqrt(np.mean(error_mm(folder, result) ** 2)) < 0.03
    assert "infrared" in repr(result.recording)
    assert result.to_pandas()["source"].iloc[500] == "infrared"


def test_a_given_range_shows_the_tracker_grey_levels_and_features_find_their_own(alone):
    folder, _ = alone
    given = midspan.open_recording(folder, infrared={"temperature_range_c": (16.0, 24.0), "tracker": "template"})
    calibration = midspan.calibrate(given)
    assert calibration.infrared.temperature_range_c == (16.0, 24.0)
    assert 1e3 * calibration.infrared.scale.value_m_per_px == pytest.approx(-2.0, rel=0.01)


@pytest.mark.parametrize(
    ("rate", "given"),
    [(2.0, None), (4.0, None), (25.0, None), (3.0, (0.1, 2.0)), (4.0, (0.5, 1.4)), (25.0, (0.5, 3.0))],
)
def test_the_band_of_the_ranges_is_one_that_the_frames_can_show_even_with_a_fifth_of_them_lost(rate, given):
    band, count = compared_band(given, rate)
    # A band that was asked for is not changed.
    assert band[0] == (min(0.5, 0.05 * rate) if given is None else given[0])
    whole = np.arange(count) / rate
    frames = whole[: ROUGH * THINNED : THINNED] if count >= ROUGH * THINNED else whole
    for time_s in (whole, frames):
        swing = np.sin(2 * np.pi * 1.2 * band[0] * time_s)
        swing[::5] = np.nan
        assert np.isfinite(band_error(time_s, swing, band))


def test_a_band_that_the_frames_cannot_show_is_refused():
    with pytest.raises(UntrustedError, match=r"for frames at 2 Hz.*received 0\.5 Hz"):
        compared_band((0.5, 3.0), 2.0)


def with_scales(result, factors, file):
    """The result's calibration with other scale factors, and without the cameras whose factor is 0."""
    tree = result.calibration.to_dict()
    for sensor, factor in factors.items():
        if factor == 0.0:
            del tree[sensor]
            continue
        for part in (tree[sensor], *tree[sensor].get("targets", ())):
            part["scale_mm_per_px"] *= factor
    file.write_text(json.dumps(tree), encoding="utf-8")
    return load_calibration(file)


def test_a_reversed_sign_of_one_of_two_cameras_is_refused_and_named(day, result, tmp_path):
    wrong = with_scales(result, {"camera": -1.0}, tmp_path / "wrong.json")
    with pytest.raises(UntrustedError, match=r"camera: its displacement is -.*scale_mm_per_px .*sign is reversed"):
        midspan.estimate(midspan.open_recording(day), wrong)


def test_a_scale_of_one_of_two_cameras_2_percent_off_is_reported_and_in_the_band(day, result, tmp_path):
    found = midspan.estimate(
        midspan.open_recording(day), with_scales(result, {"camera": 1.02}, tmp_path / "wrong.json")
    )
    (line,) = [line for line in found.warnings if "its displacement is" in line]
    assert line.startswith("camera: its displacement is 1.0")
    assert np.mean(np.abs(error_mm(day, found)) < 1.96 * found.displacement_std_mm) > 0.9


def test_a_camera_that_the_given_calibration_does_not_have_is_left_out_and_reported(day, result, tmp_path):
    found = midspan.estimate(
        midspan.open_recording(day), with_scales(result, {"infrared": 0.0}, tmp_path / "half.json")
    )
    (line,) = [line for line in found.warnings if "[infrared] is left out" in line]
    assert "has no infrared part" in line
    assert Source.INFRARED not in found.estimate.source
    same = midspan.estimate(midspan.open_recording(day), with_scales(result, {}, tmp_path / "whole.json"))
    assert not [line for line in same.warnings if "left out" in line or "its displacement is" in line]


def test_where_no_range_can_be_chosen_for_features_the_calibration_tells_why(alone):
    folder, _ = alone
    # Frames at 6 Hz show nothing above 2.7 Hz. The motion nearly repeats itself after 10 s: so the range is stated.
    band = {"band_hz": (2.8, 8.0), "max_offset_s": 0.5}
    found = midspan.calibrate(midspan.open_recording(folder, infrared={"tracker": "features"}, calibration=band))
    reported = [line for line in found.warnings if "no temperature range" in line]
    assert len(reported) == 1
    for words in ("infrared:", "'features'", "2.8 Hz", "infrared.temperature_range_c"):
        assert words in reported[0]


def test_switching_by_matches_uses_one_camera_at_a_time(day, result):
    recording = midspan.open_recording(day, fusion={"switching": "matches"})
    found = midspan.estimate(recording, result.calibration)
    met, rows = found.innovation.time_ns, found.estimate
    row = np.minimum(np.searchsorted(rows.time_ns, met), len(rows.time_ns) - 1)
    for series in found.measured:
        # Rows within a sample of a switch belong to the other camera.
        own = np.isin(met, series.time_ns)
        assert np.mean(rows.source[row[own]] == series.source) > 0.95
    seen = sum(np.count_nonzero(np.isfinite(series.value_m)) for series in result.measured)
    assert len(met) < 0.7 * seen
    # The camera goes blind for a night: one switch there and one back at least, none of them to the same camera.
    reported = [event.text.split(":")[0] for event in found.events if event.kind == "switch"]
    assert {"camera → infrared", "infrared → camera"} <= set(reported)
    assert all(one != other for one, other in pairwise(reported))
    assert np.sqrt(np.mean(error_mm(day, found) ** 2)) < 0.03


def test_a_printed_filter_takes_the_camera_that_the_rule_lets_measure(day, result):
    rule = {"switching": "matches", "method": "adaptive-kalman", "literal": True}
    found = midspan.estimate(midspan.open_recording(day, fusion=rule), result.calibration)
    switches = [event for event in found.events if event.kind == "switch"]
    rows = found.estimate
    assert len(switches) >= 2
    kinds = {"camera": Source.CAMERA, "infrared": Source.INFRARED}
    chosen = np.full(len(rows.time_ns), kinds[switches[0].text.split(" → ")[0]])
    for event in switches:
        chosen[rows.time_ns > event.time_ns] = kinds[event.text.split(" → ")[1].split(":")[0]]
    # The rows about a switch, up to two frames of 0.17 s, may rest on the frame before it.
    near = np.min(np.abs(rows.time_ns[:, None] - [event.time_ns for event in switches]), axis=1) < 4e8
    measured = np.isin(rows.source, (Source.CAMERA, Source.INFRARED)) & ~near
    assert np.mean(measured) > 0.5
    assert np.mean(rows.source[measured] == chosen[measured]) > 0.99


def test_a_camera_that_is_dark_in_the_window_is_calibrated_where_it_sees(day):
    night = midspan.open_recording(day, calibration={"window_s": (DUSK_S, DAWN_S + 1.0)})
    found = midspan.calibrate(night)
    assert len([line for line in found.warnings if "the bright part from" in line]) == 1
    assert 1e3 * found.camera.scale.value_m_per_px == pytest.approx(-1.0, rel=0.02)
    # Infrared is calibrated in the window that was asked for, ten seconds of it.
    assert 1e3 * found.infrared.scale.value_m_per_px == pytest.approx(-2.0, rel=0.02)


def test_a_camera_that_is_black_all_the_time_is_left_out_with_a_warning(day_copy):
    stored = np.load(day_copy / "camera.npz")
    rng = np.random.default_rng(1)
    noise = 2.0 + 1.5 * rng.standard_normal(stored["frames"].shape)
    np.savez(day_copy / "camera.npz", frames=np.clip(noise, 0, 255).astype(np.uint8), time_s=stored["time_s"])
    found = midspan.calibrate(midspan.open_recording(day_copy))
    assert found.camera is None
    assert any(line.startswith("[camera] is left out of the result. All frames are dark") for line in found.warnings)


@pytest.fixture(scope="module")
def crossover(tmp_path_factory):
    """Sixty seconds in which one pattern of temperature gives way to another, as from afternoon to night."""
    folder = tmp_path_factory.mktemp("crossover")
    rng = np.random.default_rng(5)
    motion = Sines(np.array([1.5e-3, 0.8e-3]), np.array([0.9, 1.7]), phase_rad=np.array([0.0, 1.0]))
    time_s, stamps = np.arange(0.0, 60.0, 0.01), np.arange(0.0, 59.8, 0.2)
    accel = motion.acceleration(time_s) + rng.normal(0.0, 2.5e-3, time_s.size)
    np.savetxt(
        folder / "accel.csv", np.column_stack((time_s, accel)), delimiter=",", header="time_s,accel", comments=""
    )
    zero = motion.displacement(np.zeros(1))[0]
    truth = np.column_stack((time_s, 1e3 * (motion.displacement(time_s) - zero)))
    np.savetxt(folder / "truth.csv", truth, delimiter=",", header="time_s,displacement_mm", comments="")
    scenes = tuple(textured_scene("natural", (80, 88), rng=rng, reach_px=8.0, lens_px=1.0) for _ in range(2))
    moved = 1e3 * motion.displacement(stamps) / MM_PER_PX["infrared"]
    view = ThermalView(scenes, course=Course(20.0, 6.0, 280.0))
    celsius = np.array(list(view.film(np.column_stack((0.0 * moved, moved)), stamps, rng=rng)))
    np.savez(folder / "infrared.npz", celsius=celsius, time_s=stamps)
    (folder / "recording.toml").write_text(
        '[accelerometer]\nfile = "accel.csv"\nunit = "m/s^2"\n\n[infrared]\nfile = "infrared.npz"\n'
        'roi = [14, 10, 60, 60]\ntracker = "template"\n\n[calibration]\nwindow_s = [0.0, 25.0]\n',
        encoding="utf-8",
    )
    return folder


def test_key_frames_follow_a_wall_that_cools_and_their_own_error_does_not_average_out(crossover):
    result = midspan.estimate(midspan.open_recording(crossover))
    assert not np.any(result.track.status == Status.LOST)
    reported = [event for event in result.events if event.kind == "reference"]
    assert len(reported) >= 3
    error, std = error_mm(crossover, result), result.displacement_std_mm
    assert np.mean(np.abs(error) <= 1.96 * std) > 0.9
    # Noise of 0.05 K leaves 0.005 mm after fusion; the places of new references stay uncertain for all frames alike.
    assert np.median(std[-500:]) > 0.02


def test_with_the_first_frame_alone_the_same_wall_is_lost(crossover, tmp_path):
    shutil.copytree(crossover, tmp_path / "first")
    set_keys(tmp_path / "first", "infrared", reference="first")
    found = track(tmp_path / "first").track
    assert np.mean(found.status == Status.LOST) > 0.4


def test_inspect_names_the_temperatures(day):
    tree = inspect_recording(midspan.open_recording(day))
    assert tree["overlap"]["streams"] == ["accelerometer", "camera", "infrared"]
    assert 14.0 < tree["infrared"]["coldest_c"] < 18.0
    assert 30.0 < tree["infrared"]["warmest_c"] < 35.0
    assert "coldest_c" not in tree["camera"]


def test_a_file_of_temperatures_can_be_tracked_by_itself(day, alone):
    region = Region(14, 10, 60, 60)
    found = track(day / "infrared.npz", roi=region)
    assert np.mean(found.track.status == Status.TRACKING) > 0.95
    events = found.table().metadata["events"]
    assert [event["kind"] for event in events if event["kind"] == "shutter"] == ["shutter"]
    by_recording = track(alone[0], roi=region).track
    np.testing.assert_array_equal(by_recording.y_px, found.track.y_px)


@pytest.fixture
def run(capsys):
    """Runs a command in this process; its exit code and all that it printed."""

    def command(*arguments):
        code = command_line([str(argument) for argument in arguments])
        return code, "".join(capsys.readouterr())

    return command


def test_what_cannot_be_temperatures_is_reported_by_the_command_line(run, alone, tmp_path):
    folder = tmp_path / "wrong"
    shutil.copytree(alone[0], folder)
    stored = np.load(folder / "infrared.npz")
    celsius, stamps = stored["celsius"], stored["time_s"]
    np.savez(folder / "infrared.npz", celsius=celsius + 273.15, time_s=stamps)
    code, reported = run("estimate", folder)
    assert code == 3
    assert "which are kelvin" in reported
    assert not (folder / "result.csv").exists()
    levels = np.clip(np.rint(30.0 * (celsius - 16.0)), 0, 255).astype(np.uint8)
    np.savez(folder / "infrared.npz", frames=levels, time_s=stamps)
    code, reported = run("calibrate", folder)
    assert code == 0
    assert "8-bit grey levels, not temperatures" in reported
    set_keys(folder, "infrared", temperature_range_c=[16.0, 24.0])
    code, reported = run("calibrate", folder)
    assert code == 2
    assert "infrared.temperature_range_c" in reported


def test_pictures_of_two_sizes_are_reported_with_the_frame(run, alone, tmp_path):
    import cv2

    folder = tmp_path / "sizes"
    shutil.copytree(alone[0], folder)
    (folder / "pictures").mkdir()
    counts = np.rint((np.load(folder / "infrared.npz")["celsius"] + 273.15) * 100).astype(np.uint16)
    for k in range(30):
        picture = counts[k] if k < 20 else counts[k][:70]
        cv2.imwrite(str(folder / "pictures" / f"{k:03d}.tiff"), picture)
    set_keys(folder, "infrared", file="pictures", rate_hz=RATE_HZ)
    code, reported = run("calibrate", folder)
    assert code == 3
    assert "020.tiff" in reported


def test_messages_name_the_section_and_the_key(alone, day_copy):
    with pytest.raises(UsageError, match=r"infrared\.roi must lie inside the image"):
        midspan.calibrate(midspan.open_recording(alone[0], infrared={"roi": (500, 0, 40, 40)}))
    with pytest.raises(UsageError, match=r'direction = "x" or "y"'):
        midspan.open_recording(day_copy, infrared={"direction": "xy"})
    with pytest.raises(UsageError, match=r"infrared\.reference = 'last'"):
        midspan.open_recording(day_copy, infrared={"reference": "last"})
    with pytest.raises(DataError, match=r"infrared\.file = 'no\.npz'"):
        midspan.calibrate(midspan.open_recording(alone[0], infrared={"file": "no.npz"}))
