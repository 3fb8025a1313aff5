"""The main job end to end: recordings rendered with a known truth, through calibration and fusion."""

import json
import pickle
from itertools import pairwise

import numpy as np
import pytest

import midspan
from midspan.errors import UsageError
from midspan.evaluate.metrics import compare
from midspan.recording.tracking.track import track
from midspan.records import Source, Status, TimeSeries, nanoseconds
from midspan.report.report import report_html
from midspan.simulate.motion.motion import Sum, random_motion
from midspan.simulate.motion.sensors import AccelerometerModel
from midspan.simulate.scene.camera import Camera
from plain_data import assert_plain
from recording_edits import (
    acceleration,
    append,
    error_mm,
    frames,
    set_keys,
    truth,
    write_acceleration,
    write_stack,
)
from repeats import slow

TRUE_SCALE, TRUE_OFFSET = 1.5, 0.137
# One frame of these cameras is good for 0.0035-0.0045 px, which is 0.006 mm; the zero of the displacement rests on the
# first frame alone and is that uncertain, everything else must be better than a single frame.
FRAME_STD_MM = 0.006


def lively(rng):
    """Motion that is under way before the recording starts: nothing may rest on a quiet beginning."""
    parts = (
        random_motion((1.80, 2.00), 1.1e-3, rng=rng, lines=20),
        random_motion((4.45, 4.75), 0.25e-3, rng=rng, lines=30),
        random_motion((0.06, 0.14), 0.8e-3, rng=rng, lines=12),
    )
    return Sum(parts)


def error_of(folder, result):
    return error_mm(folder, result.time_s, result.displacement_mm)


def assert_right(folder, result, *, zero_mm=4 * FRAME_STD_MM):
    """The shape within the noise of one frame, the zero within four standard deviations of one frame."""
    error = error_of(folder, result)
    assert np.std(error) < FRAME_STD_MM
    assert abs(np.mean(error)) < zero_mm


@pytest.fixture(scope="module")
def result(footbridge):
    return midspan.estimate(midspan.open_recording(footbridge))


@pytest.mark.parametrize(("direction", "scale"), [("x", -1.5), ("y", 1.5)])
def test_scale_offset_and_displacement_have_the_right_sign_on_both_axes(direction, scale, simulated):
    name = f"axis-{direction}{scale:+}"
    folder = simulated(name, seed=1, camera={"direction": direction, "scale_mm_per_px": scale})
    found = midspan.estimate(midspan.open_recording(folder))
    camera = found.calibration.camera
    # The figures that are promised: 0.3 % and 1 ms where the motion allows, which this motion does.
    assert 1e3 * camera.scale.value_m_per_px == pytest.approx(scale, rel=3e-3)
    assert camera.offset.value_s == pytest.approx(TRUE_OFFSET, abs=1e-3)
    assert_right(folder, found)


@pytest.mark.parametrize("offset", [-0.45, *slow(0.2, -0.2, 0.45)])
def test_a_clock_offset_does_not_move_the_zero_although_the_structure_moves_from_the_start(offset, simulated):
    folder = simulated(f"lively{offset:+}", seed=100, duration_s=15.0, motion=lively, camera={"time_offset_s": offset})
    found = midspan.estimate(midspan.open_recording(folder))
    assert found.calibration.camera.offset.value_s == pytest.approx(offset, abs=1e-3)
    assert 1e3 * found.calibration.camera.scale.value_m_per_px == pytest.approx(-TRUE_SCALE, rel=3e-3)
    assert_right(folder, found)


def test_the_displacement_is_zero_at_the_first_frame(simulated):
    folder = simulated("lively+0.2", seed=100, duration_s=15.0, motion=lively, camera={"time_offset_s": 0.2})
    found = midspan.estimate(midspan.open_recording(folder))
    first_s = 0.2 + 0.0  # the first frame's stamp is 0 on its own clock
    at_first = float(np.interp(first_s, found.time_s, found.displacement_mm))
    # Rows start at the sample after the first frame; in 10 ms the structure moves by at most 0.2 mm.
    assert abs(at_first) < 0.2
    moved = truth(folder)
    assert abs(at_first - np.interp(found.time_s[0], moved[:, 0], moved[:, 1])) < 4 * FRAME_STD_MM


def test_the_error_band_is_honest_over_several_recordings(simulated):
    ratios, mean_ratios = [], []
    for seed in range(1, 7):
        folder = simulated(f"band{seed}", seed=seed, duration_s=15.0)
        found = midspan.estimate(midspan.open_recording(folder))
        ratio = error_of(folder, found) / found.displacement_std_mm
        ratios.append(ratio)
        mean_ratios.append(np.mean(ratio))
    pooled = np.sqrt(np.mean(np.concatenate(ratios) ** 2))
    # Most of each ratio is the zero that the whole run shares, so there are little more than six independent values:
    # the root of a mean square of six standard normal values lies within 0.3 … 1.8 in 99.8 % of all cases.
    assert 0.3 < pooled < 1.8
    assert np.max(np.abs(mean_ratios)) < 4.0


def test_a_constant_of_the_accelerometer_never_shows(footbridge_copy, result):
    time, value = acceleration(footbridge_copy)
    for bias in (-0.05, 9.80665):
        write_acceleration(footbridge_copy, time, value + bias)
        shifted = midspan.estimate(midspan.open_recording(footbridge_copy))
        # Only rounding of the file (1e-7 m/s²) differs; a thousandth of a frame's noise is far above it.
        np.testing.assert_allclose(shifted.displacement_mm, result.displacement_mm, atol=1e-3 * FRAME_STD_MM * 10)


@pytest.mark.parametrize("start", [-0.25, *slow(0.25)])
def test_another_clock_of_the_same_camera_gives_the_same_displacement(start, footbridge_copy, result):
    set_keys(footbridge_copy, "camera", start_s=start)
    shifted = midspan.estimate(midspan.open_recording(footbridge_copy))
    camera = shifted.calibration.camera
    # The same frames with stamps moved by `start` need an offset moved by -start, and nothing else. The window of the
    # calibration moves by some frames, so the offset differs by its own uncertainty of 0.03 ms.
    assert camera.offset.value_s == pytest.approx(result.calibration.camera.offset.value_s - start, abs=2e-4)
    first, second = (np.std(error_of(footbridge_copy, item)) for item in (result, shifted))
    # No visible effect: less than a twentieth, beyond a twentieth for the calibration's other frames.
    assert second == pytest.approx(first, rel=0.1)


def test_epoch_times_give_the_same_result_as_seconds_from_zero(footbridge_copy, result):
    time, value = acceleration(footbridge_copy)
    epoch = 1_700_000_000.0
    write_acceleration(footbridge_copy, time + epoch, value)
    set_keys(footbridge_copy, "camera", start_s=epoch)
    late = midspan.estimate(midspan.open_recording(footbridge_copy))
    # A double holds an epoch to 0.2 µs, in which the structure moves by 6e-6 mm.
    np.testing.assert_allclose(late.time_s - epoch, result.time_s, atol=1e-6)
    np.testing.assert_allclose(late.displacement_mm, result.displacement_mm, atol=1e-4)


def test_a_calibration_from_its_file_gives_the_same_result(footbridge, result, tmp_path):
    recording = midspan.open_recording(footbridge)
    file = midspan.calibrate(recording).save(tmp_path / "calibration.json")
    again = midspan.estimate(recording, midspan.load_calibration(file))
    # With the file no frame is tracked without a prediction first. Where the tracker's search begins moves its result
    # by a tenth of a standard deviation and seldom by one; what JSON keeps is all digits.
    apart = np.abs(again.displacement_mm - result.displacement_mm) / result.displacement_std_mm
    assert float(np.sqrt(np.mean(apart**2))) < 0.25
    assert apart.max() < 2.0
    np.testing.assert_allclose(again.displacement_std_mm, result.displacement_std_mm, rtol=0.1)


def test_the_same_calibration_file_gives_the_same_result_to_the_last_digit(footbridge, result, tmp_path):
    recording = midspan.open_recording(footbridge)
    first, second = (midspan.estimate(recording, result.calibration) for _ in range(2))
    np.testing.assert_array_equal(first.displacement_mm, second.displacement_mm)


def test_kalman_is_causal_and_less_sharp_than_the_smoother_but_right(footbridge, result):
    recording = midspan.open_recording(footbridge)
    causal = midspan.estimate(recording, result.calibration, method="kalman")
    error, smooth_error = error_of(footbridge, causal), error_of(footbridge, result)
    settled = causal.time_s > 3.0
    assert np.std(smooth_error) < np.std(error[settled]) < 4 * FRAME_STD_MM
    inside = np.abs(error) < 4.0 * causal.displacement_std_mm
    assert np.mean(inside) > 0.99


def test_missing_samples_are_bridged_and_marked(footbridge_copy):
    time, value = acceleration(footbridge_copy)
    hole = (time >= 10.0) & (time < 10.3)
    write_acceleration(footbridge_copy, time, np.where(hole, np.nan, value))
    found = midspan.estimate(midspan.open_recording(footbridge_copy))
    marked = found.time_s[found.estimate.status == Status.COASTING]
    np.testing.assert_allclose(marked, time[hole], atol=1e-9)
    assert any("30 samples" in line for line in found.warnings)
    assert [event.kind for event in found.events].count("bridged") == 1
    # Three frames lie in the hole; between them nothing but a straight acceleration is known of motion up to 4.6 Hz.
    error = error_of(footbridge_copy, found)
    away = (found.time_s < 9.8) | (found.time_s > 10.5)
    assert np.std(error[away]) < FRAME_STD_MM
    assert np.mean(np.abs(error) < 3.0 * found.displacement_std_mm) > 0.99


def test_a_gap_in_time_has_no_rows_and_does_no_harm_behind_it(footbridge_copy):
    time, value = acceleration(footbridge_copy)
    kept = (time < 12.0) | (time > 14.0)
    write_acceleration(footbridge_copy, time[kept], value[kept])
    found = midspan.estimate(midspan.open_recording(footbridge_copy))
    assert not np.any((found.time_s > 12.0) & (found.time_s < 14.0))
    assert any("gap" in line for line in found.warnings)
    error = error_of(footbridge_copy, found)
    assert np.std(error[found.time_s > 14.2]) < FRAME_STD_MM
    assert abs(np.mean(error[found.time_s > 14.2]) - np.mean(error[found.time_s < 11.8])) < FRAME_STD_MM


def test_lost_single_samples_cost_little_and_the_band_knows(footbridge_copy):
    time, value = acceleration(footbridge_copy)
    kept = np.random.default_rng(5).random(len(time)) > 0.2
    write_acceleration(footbridge_copy, time[kept], value[kept])
    found = midspan.estimate(midspan.open_recording(footbridge_copy))
    error = error_of(footbridge_copy, found)
    # Motion up to 4.7 Hz sampled at 100 Hz with single holes: a straight line over 20 ms errs by (2π·4.7·0.02)²/8 = 4 %
    # of the acceleration at its fastest.
    assert np.std(error) < 2 * FRAME_STD_MM
    # The band may widen, but must still say what is known.
    assert np.median(found.displacement_std_mm) < 5 * FRAME_STD_MM


def test_frames_in_the_dark_are_coasted_through(footbridge_copy):
    stack = frames(footbridge_copy)
    stack[100:130] = 0
    write_stack(footbridge_copy, stack)
    found = midspan.estimate(midspan.open_recording(footbridge_copy))
    dark = (found.time_s > TRUE_OFFSET + 10.4) & (found.time_s < TRUE_OFFSET + 12.8)
    assert np.all(found.estimate.status[dark] != Status.TRACKING)
    assert np.all(found.estimate.source[dark] == Source.PREDICTION)
    bright = (found.time_s < 9.5) | (found.time_s > 13.5)
    assert np.mean(found.estimate.status[bright] == Status.TRACKING) == 1.0
    error = error_of(footbridge_copy, found)
    assert np.std(error[bright]) < FRAME_STD_MM
    # In the dark the band widens and still holds.
    assert found.displacement_std_mm[dark].max() > 3 * np.median(found.displacement_std_mm[bright])
    assert np.mean(np.abs(error[dark]) < 3 * found.displacement_std_mm[dark]) > 0.95


def test_a_camera_that_freezes_is_not_believed(footbridge_copy):
    stack = frames(footbridge_copy)
    stack[101:140] = stack[100]
    write_stack(footbridge_copy, stack)
    found = midspan.estimate(midspan.open_recording(footbridge_copy))
    error = error_of(footbridge_copy, found)
    frozen = (found.time_s > TRUE_OFFSET + 10.7) & (found.time_s < TRUE_OFFSET + 13.8)
    assert np.all(found.estimate.status[frozen] != Status.TRACKING)
    assert np.std(error[~frozen & ((found.time_s < 9.5) | (found.time_s > 14.5))]) < FRAME_STD_MM
    assert np.mean(np.abs(error) < 3 * found.displacement_std_mm) > 0.95


@pytest.mark.parametrize(("rate", "limit"), [(25.6, 1.5), *slow((1000.0, 1.0))])
def test_slow_and_fast_accelerometers_give_the_displacement_at_their_own_rate(rate, limit, simulated):
    # 25.6 Hz is 5.6 samples for a period of the upper mode, whose acceleration is then known less well.
    sensor = AccelerometerModel(rate_hz=rate, noise_std_m_s2=2.5e-4 * np.sqrt(rate), bias_m_s2=0.05)
    folder = simulated(f"rate{rate}", accelerometer=sensor)
    found = midspan.estimate(midspan.open_recording(folder))
    np.testing.assert_allclose(np.diff(found.time_s), 1.0 / rate, atol=1e-5)
    error = error_of(folder, found)
    assert np.std(error) < limit * FRAME_STD_MM
    assert found.calibration.camera.scale.value_m_per_px == pytest.approx(-1.5e-3, rel=3e-3)


def test_a_fast_camera_is_used_whole(simulated):
    folder = simulated("240 fps", duration_s=8.0, camera={"rate_hz": 240.0, "size_px": (64, 64)})
    found = midspan.estimate(midspan.open_recording(folder))
    assert len(found.track.time_ns) == pytest.approx(240.0 * (8.0 - 0.1 - TRUE_OFFSET), abs=2)
    # 24 times as many frames: the shape is much better than that of one frame, the zero still rests on the first.
    assert np.std(error_of(folder, found)) < 0.5 * FRAME_STD_MM
    assert abs(np.mean(error_of(folder, found))) < 4 * FRAME_STD_MM


def test_the_camera_may_start_before_the_accelerometer_by_seconds(footbridge_copy):
    time, value = acceleration(footbridge_copy)
    late = time >= 6.0
    write_acceleration(footbridge_copy, time[late], value[late])
    found = midspan.estimate(midspan.open_recording(footbridge_copy))
    assert 6.0 <= found.time_s[0] < 6.5
    error = error_of(footbridge_copy, found)
    # The zero is the first frame used, which is later than the truth's; the rest is the same motion.
    assert np.std(error) < FRAME_STD_MM
    used_s = found.track.time_ns[0] / 1e9 + TRUE_OFFSET
    known = truth(footbridge_copy)
    assert -np.mean(error) == pytest.approx(np.interp(used_s, known[:, 0], known[:, 1]), abs=4 * FRAME_STD_MM)


def test_every_nth_frame_is_the_same_motion_with_fewer_frames(footbridge_copy):
    set_keys(footbridge_copy, "camera", every=3)
    found = midspan.estimate(midspan.open_recording(footbridge_copy))
    assert len(found.track.time_ns) == -(-len(frames(footbridge_copy)) // 3)
    # At 3.3 Hz both modes lie above the Nyquist frequency.
    assert found.calibration.camera.scale.value_m_per_px == pytest.approx(-1.5e-3, rel=3e-3)
    assert np.std(error_of(footbridge_copy, found)) < 1.5 * FRAME_STD_MM


@pytest.mark.parametrize("kind", ["stack of 16 bits", "images of 16 bits"])
def test_the_kind_of_camera_file_does_not_matter(kind, footbridge_copy, result):
    stack = frames(footbridge_copy).astype(np.uint16) * 200
    if kind == "stack of 16 bits":
        write_stack(footbridge_copy, stack)
    else:
        cv2 = pytest.importorskip("cv2")
        folder = footbridge_copy / "bilder groß"
        folder.mkdir()
        for number, picture in enumerate(stack):
            (folder / f"bild_{number}.png").write_bytes(cv2.imencode(".png", picture)[1].tobytes())
        set_keys(footbridge_copy, "camera", file="bilder groß")
    found = midspan.estimate(midspan.open_recording(footbridge_copy))
    # Matching does not depend on the brightness' unit; only rounding differs. Where nearly too few of the four large
    # blocks count, it decides in a frame whether the small ones are asked: a tenth of a frame's noise apart.
    apart = np.abs(found.displacement_mm - result.displacement_mm)
    assert np.quantile(apart, 0.95) < 1e-2 * FRAME_STD_MM
    assert np.max(apart) < 0.1 * FRAME_STD_MM


def test_camera_and_displacement_sensor_together_share_the_cameras_zero(footbridge_copy):
    known = truth(footbridge_copy)
    time = np.arange(0.0, 25.0, 0.1)
    rng = np.random.default_rng(11)
    height = 100.0 + np.interp(time, known[:, 0], known[:, 1]) + 0.05 * rng.standard_normal(len(time))
    table = np.column_stack((time, height))
    np.savetxt(footbridge_copy / "lvdt.csv", table, delimiter=",", header="time_s,height", comments="", fmt="%.6f")
    append(footbridge_copy, '[displacement]\nfile = "lvdt.csv"\ntime = "time_s"\nvalue = "height"\nunit = "mm"')
    set_keys(footbridge_copy, "accelerometer", estimate_scale=False)
    found = midspan.estimate(midspan.open_recording(footbridge_copy))
    assert set(np.unique(found.estimate.source)) == {Source.CAMERA, Source.DISPLACEMENT}
    assert 1e3 * found.calibration.displacement.noise_std_m == pytest.approx(0.05, rel=0.3)
    assert_right(footbridge_copy, found)


def test_an_exposure_that_is_reported_does_not_shrink_the_scale(simulated):
    folder = simulated("exposure", camera={"camera": Camera(exposure_s=0.05)})
    found = midspan.estimate(midspan.open_recording(folder))
    # Averaging over 50 ms shrinks 4.6 Hz by 8.6 % and 1.9 Hz by 1.5 %.
    assert found.calibration.camera.scale.value_m_per_px == pytest.approx(-1.5e-3, rel=3e-3)
    assert np.std(error_of(folder, found)) < 1.5 * FRAME_STD_MM


def test_the_translation_times_the_scale_is_the_displacement(footbridge, result):
    tracked = track(footbridge)
    known = truth(footbridge)
    time_s = tracked.track.time_ns / 1e9 + TRUE_OFFSET
    expected = np.interp(time_s, known[:, 0], known[:, 1])
    # The signs of the public face: mm = scale × px, y down, negative scale where the axis points the same way. The
    # truth is interpolated between samples 10 ms apart, 0.003 mm at 0.25 mm and 4.6 Hz.
    np.testing.assert_allclose(-TRUE_SCALE * tracked.track.y_px, expected, atol=6 * FRAME_STD_MM)
    assert np.std(tracked.track.x_px) < 0.01


def test_a_result_can_be_looked_at_and_kept(result, tmp_path):
    frame = result.to_pandas()
    columns = ["displacement_mm", "displacement_std_mm", "velocity_mm_s", "source", "status"]
    assert list(frame.columns) == columns
    assert frame.index.name == "time_s"
    assert set(frame["source"].unique()) <= {"camera", "infrared", "radar", "displacement", "prediction"}
    assert set(frame["status"].unique()) <= {"tracking", "coasting", "lost"}
    np.testing.assert_array_equal(frame["displacement_mm"], result.displacement_mm)
    saved = result.save(tmp_path / "result.csv")
    header = saved.read_text(encoding="utf-8").splitlines()[0]
    assert header == "time_s,displacement_mm,displacement_std_mm,velocity_mm_s,source,status"
    companions = json.loads(saved.with_suffix(".json").read_text(encoding="utf-8"))
    assert companions["midspan"] == midspan.__version__
    assert companions["settings"]["camera"]["file"] == "camera.mkv"
    assert companions["calibration"]["camera"]["scale_mm_per_px"] == pytest.approx(-1.5, rel=3e-3)


def test_a_result_is_plain_data_that_knows_where_it_came_from(footbridge, result):
    assert_plain(result)
    again = pickle.loads(pickle.dumps(result))
    assert again.recording.file == footbridge / "recording.toml"
    assert again.recording.settings == result.settings
    assert again.name == midspan.open_recording(footbridge).name


def test_the_pixels_of_a_phase_tracker_are_kept(footbridge):
    found = midspan.estimate(midspan.open_recording(footbridge, camera={"tracker": "hybrid"}))
    assert_plain(found)
    active, target = found.cameras[0].targets[0].active_pixels, found.cameras[0].targets[0]
    assert active.x.shape == active.y.shape == (active.region.height, active.region.width)
    # They were estimated along the measured axis, where the phase of single frames follows the motion.
    assert active.y.any()
    assert active.r_squared[1] > 0.99
    assert active.region.x >= target.region.x
    assert 'alt="Active pixels"' in report_html(found)


@pytest.mark.usefixtures("undrawn")
def test_a_result_is_compared_and_reported_by_itself(footbridge, result, tmp_path):
    result.save(tmp_path / "result.csv")
    by_file = midspan.compare(tmp_path / "result.csv", footbridge / "truth.csv")
    direct = midspan.compare(result, footbridge / "truth.csv", unit="mm")
    # The file keeps times to a nanosecond or so and values to a picometre.
    assert direct.rmse_mm == pytest.approx(by_file.rmse_mm, rel=1e-4)
    assert direct.coverage_95 == pytest.approx(by_file.coverage_95, abs=1e-3)
    page = result.report(tmp_path / "report.html")
    assert page == tmp_path / "report.html"
    assert "<th>RMSE as recorded</th>" in page.read_text(encoding="utf-8")
    with pytest.raises(UsageError, match="one axis only"):
        midspan.compare(result, footbridge / "truth.csv", axis="x")


def test_a_result_shows_itself_in_a_notebook_and_on_axes(result):
    from matplotlib.figure import Figure

    axes = Figure().subplots()
    assert result.plot(axes) is axes.figure
    assert "mm" in axes.get_ylabel()
    assert "(s)" in axes.get_xlabel()
    drawn = axes.get_lines()[0].get_ydata()
    assert np.ptp(drawn) == pytest.approx(np.ptp(result.displacement_mm), rel=1e-3)
    axes.figure.canvas.draw()
    # The legend covers no curve.
    assert axes.get_legend().get_window_extent().y0 >= axes.bbox.y1
    shown = result._repr_html_()
    assert "data:image/png;base64," in shown
    assert f"{len(result.time_s)} rows" in shown
    assert shown.startswith(f"<p><b>{result.verdict}</b></p>")


def test_plot_gives_a_figure_that_pyplot_shows_and_a_notebook_shows_once(result, monkeypatch):
    from matplotlib import pyplot

    figure = result.plot()
    # What pyplot knows is shown by `pyplot.show()`.
    assert pyplot.fignum_exists(figure.number)
    pyplot.close(figure)
    before = pyplot.get_fignums()
    # In a notebook open figures are shown at the end of a cell, and so is the figure that a cell returns.
    monkeypatch.setattr(pyplot, "get_backend", lambda: "module://matplotlib_inline.backend_inline")
    assert len(result.plot().axes) == 1
    assert pyplot.get_fignums() == before


def test_velocity_is_the_slope_of_the_displacement(result):
    slope = np.gradient(result.displacement_mm, result.time_s)
    inner = slice(20, -20)
    # The central difference over 20 ms loses (2π·4.6·0.01)²/6 = 1.4 % of the upper mode's 7 mm/s.
    assert np.std(slope[inner] - result.velocity_mm_s[inner]) < 0.02 * np.std(result.velocity_mm_s)


def test_rows_are_the_accelerometers_samples_in_the_common_span(footbridge, result):
    time, _ = acceleration(footbridge)
    assert np.all(np.isin(np.rint(1e6 * result.time_s), np.rint(1e6 * time)))
    assert all(b > a for a, b in pairwise(result.time_s.tolist()))
    # The first frame is 0.137 s after the accelerometer's start, the last one 24.7 s after the first.
    assert result.time_s[0] == pytest.approx(0.14, abs=0.011)
    assert result.time_s[-1] == pytest.approx(24.7 + TRUE_OFFSET, abs=0.011)


def test_a_reference_is_never_looked_at_by_the_estimate(footbridge_copy, result):
    (footbridge_copy / "truth.csv").unlink()
    found = midspan.estimate(midspan.open_recording(footbridge_copy))
    np.testing.assert_array_equal(found.displacement_mm, result.displacement_mm)


def test_the_contract_example_has_the_scale_offset_and_displacement_that_it_names(data_folder, tmp_path):
    folder = data_folder / "contract-example"
    if not folder.is_dir():
        pytest.skip("contract-example is not among the real data")
    recording = midspan.open_recording(folder)
    expected = json.loads((folder / "expected.json").read_text(encoding="utf-8"))["camera"]
    found = midspan.estimate(recording)
    camera = found.calibration.camera
    assert 1e3 * camera.scale.value_m_per_px == pytest.approx(expected["scale_mm_per_px"], rel=3e-3)
    assert camera.offset.value_s == pytest.approx(expected["time_offset_s"], abs=1e-3)
    error = error_mm(folder, found.time_s, found.displacement_mm)
    assert np.sqrt(np.mean(error**2)) < 0.02
    # The public comparison, by a spline of the truth, agrees with the sum above, by straight lines.
    estimate = TimeSeries(found.estimate.time_ns, found.estimate.displacement_m)
    known = truth(folder)
    reference = TimeSeries(nanoseconds(known[:, 0]), 1e-3 * known[:, 1])
    assert compare(estimate, reference).rmse_mm == pytest.approx(np.sqrt(np.mean(error**2)), rel=0.02)
