"""Several targets of one camera at different distances: each with its own scale factor, one displacement in all."""

import re
import shutil

import av
import numpy as np
import pytest
from scipy import ndimage

import midspan
from midspan.recording.calibrate import calibrate_and_track
from midspan.recording.tracking.track import track
from midspan.records import Region
from midspan.simulate.motion.motion import random_motion
from midspan.simulate.scene.camera import Camera
from midspan.simulate.scene.disturbances import Panel
from midspan.simulate.scene.texture import textured_scene
from plain_data import assert_plain
from recording_edits import error_mm, frames, set_keys, write_stack
from repeats import slow

NEAR, MIDDLE, SWINGING, WALL = (
    Region(12, 16, 48, 48),
    Region(88, 16, 48, 48),
    Region(12, 88, 48, 48),
    Region(88, 88, 48, 48),
)
TARGETS = (("near", NEAR), ("middle", MIDDLE), ("swinging", SWINGING), ("wall", WALL))
TRUE_SCALES = {"near": -0.75, "middle": -1.0, "wall": -1.5}
TRUE_OFFSET = 0.137


def around(region):
    return Region(region.x - 12, region.y - 12, 68, 68)


def panels(rng):
    near, middle, swinging, swing = rng.spawn(4)
    return (
        Panel(around(NEAR), textured_scene("natural", (68, 68), rng=near), 2.0),
        Panel(around(MIDDLE), textured_scene("natural", (68, 68), rng=middle), 1.5),
        Panel(
            around(SWINGING),
            textured_scene("natural", (68, 68), rng=swinging),
            own_px=random_motion((0.5, 0.9), 0.8, rng=swing, lines=16),
        ),
    )


@pytest.fixture(scope="module")
def site(simulated):
    return simulated("targets", camera={"size_px": (152, 152), "panels": panels, "targets": TARGETS})


@pytest.fixture
def site_copy(site, tmp_path):
    return shutil.copytree(site, tmp_path / "site")


@pytest.fixture(scope="module")
def result(site):
    return midspan.estimate(midspan.open_recording(site))


def std_of_error(folder, result):
    return float(np.std(error_mm(folder, result.time_s, result.displacement_mm)))


def only(folder, *names):
    """Keep these targets in recording.toml."""
    regions = dict(TARGETS)
    listed = [{"name": n, "roi": [r.x, r.y, r.width, r.height]} for n in names for r in (regions[n],)]
    set_keys(folder, "camera", target=listed)


def test_each_target_gets_its_own_scale_factor_and_all_share_one_clock_offset(result):
    camera = result.calibration.camera
    found = {target.name: target for target in camera.targets}
    for name, scale in TRUE_SCALES.items():
        assert found[name].used
        # 0.3 % is promised where the motion allows, which this motion does.
        assert 1e3 * found[name].scale.value_m_per_px == pytest.approx(scale, rel=3e-3)
    assert camera.offset.value_s == pytest.approx(TRUE_OFFSET, abs=1e-3)


def test_a_target_that_moves_by_itself_is_left_out_with_a_reason(result):
    (swinging,) = [target for target in result.calibration.camera.targets if target.name == "swinging"]
    assert not swinging.used
    assert swinging.reason
    assert any("swinging" in line and "left out" in line for line in result.warnings)
    assert [target.name for target in result.cameras[0].targets] == ["near", "middle", "wall"]


def test_the_result_is_plain_data_and_shows_the_targets_together(site, result):
    assert_plain(result)
    (measured,) = result.measured
    camera = result.cameras[0]
    blocks = [camera.displacement(number) for number in range(3)]
    single = np.sqrt([np.nanmedian(block.variance_m2) for block in blocks])
    # The mean by inverse variance of independent targets; frames with all three are the usual ones.
    assert np.nanmedian(measured.std_m) == pytest.approx(np.sum(single**-2.0) ** -0.5, rel=0.1)
    error = 1e3 * measured.value_m - np.interp(measured.time_ns / 1e9, result.time_s, result.displacement_mm)
    alone = [1e3 * b.value_m - np.interp(b.time_ns / 1e9, result.time_s, result.displacement_mm) for b in blocks]
    # The result itself leans on the best target.
    assert np.nanstd(error) <= 1.01 * min(np.nanstd(one) for one in alone)


@pytest.mark.parametrize("listed", [("swinging", "wall"), pytest.param(("wall", "swinging"), marks=pytest.mark.slow)])
def test_of_two_targets_the_accelerometer_tells_which_one_moves_by_itself(listed, simulated, tmp_path):
    camera = {"size_px": (152, 152), "panels": panels, "targets": TARGETS}
    folder = shutil.copytree(simulated("targets, seed 1", seed=1, duration_s=20.0, camera=camera), tmp_path / "site")
    only(folder, *listed)
    found = midspan.calibrate(midspan.open_recording(folder))
    assert [target.name for target in found.camera.used] == ["wall"]


def test_the_camera_keys_of_the_file_are_those_of_the_sharpest_target(result):
    camera = result.calibration.to_dict()["camera"]
    listed = {target["name"]: target for target in camera["targets"]}
    noise = {n: abs(t["scale_mm_per_px"]) * t["noise_std_px"] for n, t in listed.items() if t["used"]}
    best = min(noise, key=noise.get)
    assert camera["roi"] == listed[best]["roi"]
    assert camera["scale_mm_per_px"] == listed[best]["scale_mm_per_px"]
    assert [target["name"] for target in camera["targets"]] == [name for name, _ in TARGETS]


def test_several_targets_are_at_least_as_sharp_as_the_best_alone_and_the_band_knows(site_copy, result):
    together = std_of_error(site_copy, result)
    only(site_copy, "wall")
    wall = midspan.estimate(midspan.open_recording(site_copy))
    only(site_copy, "near")
    near = midspan.estimate(midspan.open_recording(site_copy))
    # The near target moves twice as many pixels and so has half the noise in mm; the three together know more. One
    # recording's rms scatters by some 5 %.
    assert together < 1.05 * std_of_error(site_copy, near) < std_of_error(site_copy, wall)
    assert np.median(result.displacement_std_mm) < np.median(near.displacement_std_mm)
    ratio = error_mm(site_copy, result.time_s, result.displacement_mm) / result.displacement_std_mm
    assert np.mean(np.abs(ratio) < 4.0) > 0.99


def test_a_target_that_is_hidden_for_a_while_makes_no_step(site_copy):
    stack = frames(site_copy).copy()
    rng = np.random.default_rng(0)
    hidden = np.s_[100:160, NEAR.y - 4 : NEAR.y + 52, NEAR.x - 4 : NEAR.x + 52]
    stack[hidden] = rng.integers(60, 190, (1, 56, 56))
    write_stack(site_copy, stack)
    only(site_copy, "near", "middle", "wall")
    found = midspan.estimate(midspan.open_recording(site_copy))
    error = error_mm(site_copy, found.time_s, found.displacement_mm)
    inside = (found.time_s > 10.6) & (found.time_s < 15.9)
    # Dropping a target changes the mean by the error of the relative zeros, each a mean over some 200 frames.
    assert abs(np.mean(error[inside]) - np.mean(error[~inside])) < 0.003
    assert np.std(error) < 0.006


def test_a_target_that_slips_for_good_is_left_out_from_then_on(site_copy):
    stack = frames(site_copy).copy()
    # From 15 s on the near panel's picture is taken from two rows further down: a permanent jump of 2 px, 1.5 mm.
    panel = np.s_[150:, NEAR.y - 2 : NEAR.y + 50, NEAR.x : NEAR.x + 48]
    lower = np.s_[150:, NEAR.y : NEAR.y + 52, NEAR.x : NEAR.x + 48]
    stack[panel] = stack[lower].copy()
    write_stack(site_copy, stack)
    only(site_copy, "near", "middle", "wall")
    set_keys(site_copy, "calibration", window_s=[0.0, 14.5])
    found = midspan.estimate(midspan.open_recording(site_copy))
    error = error_mm(site_copy, found.time_s, found.displacement_mm)
    late, early = found.time_s > 15.5, found.time_s < 14.5
    assert abs(np.mean(error[late]) - np.mean(error[early])) < 0.006
    assert any("near" in line and "shifted" in line for line in found.warnings)


def slid(folder, shift_px):
    """Slide the near target's picture down by `shift_px` (n,) more than the structure's motion does."""
    stack = frames(folder).copy()
    region = np.s_[NEAR.y - 10 : NEAR.y + 56, NEAR.x - 10 : NEAR.x + 56]
    for picture, amount in zip(stack, shift_px(np.arange(len(stack))), strict=True):
        moved = ndimage.shift(picture[region].astype(float), (amount, 0.0), mode="nearest")
        picture[region] = np.clip(np.rint(moved), 0, 255)
    write_stack(folder, stack)


@pytest.mark.parametrize(
    ("listed", "step_px"),
    [
        (("near", "middle", "wall"), 0.5),
        (("wall", "near"), 0.5),
        *slow(
            (("near", "wall"), 2.0), (("near", "middle", "wall"), 2.0), (("near", "wall"), 0.5), (("wall", "near"), 2.0)
        ),
    ],
)
def test_the_target_that_steps_while_it_is_calibrated_is_the_one_left_out(listed, step_px, site_copy):
    # The near target is the sharpest, and a step leaves its noise as it was: only its own innovations betray it.
    slid(site_copy, lambda n: np.where(n >= 150, step_px, 0.0))
    only(site_copy, *listed)
    found = midspan.calibrate(midspan.open_recording(site_copy))
    assert {target.name for target in found.camera.used} == set(listed) - {"near"}


@pytest.mark.parametrize("listed", [("wall", "near"), pytest.param(("near", "wall"), marks=pytest.mark.slow)])
def test_two_targets_that_drift_apart_are_refused_and_a_third_decides(listed, site_copy):
    # An accelerometer does not feel a constant velocity: 0.02 px more in every frame is in neither's innovations.
    slid(site_copy, lambda n: 0.02 * n)
    only(site_copy, *listed)
    with pytest.raises(midspan.UntrustedError, match="contradict each other along y"):
        midspan.calibrate(midspan.open_recording(site_copy))
    only(site_copy, *listed, "middle")
    found = midspan.calibrate(midspan.open_recording(site_copy))
    assert {target.name for target in found.camera.used} == {"wall", "middle"}


@pytest.mark.parametrize("listed", [("near", "wall"), pytest.param(("wall", "near"), marks=pytest.mark.slow)])
def test_a_camera_that_tilts_is_named_with_what_it_makes_of_each_target(listed, site_copy):
    # A tilt moves the whole picture by the same number of pixels: 0.3 px rms, in periods of 20 and 13 s.
    n = np.arange(len(frames(site_copy)))
    tilt_px = 0.3 * (np.sin(2 * np.pi * n / 200.0) + np.sin(2 * np.pi * n / 130.0))
    shifted = [
        np.clip(np.rint(ndimage.shift(picture.astype(float), (amount, 0.0), mode="nearest")), 0, 255).astype(np.uint8)
        for picture, amount in zip(frames(site_copy), tilt_px, strict=True)
    ]
    write_stack(site_copy, np.array(shifted))
    only(site_copy, *listed)
    with pytest.raises(midspan.UntrustedError, match="either the camera tilts") as refused:
        midspan.calibrate(midspan.open_recording(site_copy))
    said = re.search(r"displacement errors of ([\d.]+) mm rms at near and ([\d.]+) mm rms at wall", str(refused.value))
    window = tilt_px - tilt_px.mean()
    # The mean over the window is the zero's; the tilt's fast part, a tenth, goes into the structure's path.
    np.testing.assert_allclose(float(said[1]), 0.75 * np.std(window), rtol=0.25)
    np.testing.assert_allclose(float(said[2]), 1.5 * np.std(window), rtol=0.25)


def test_a_scale_factor_that_compression_makes_vague_is_refused(simulated, tmp_path):
    folder = shutil.copytree(simulated("far away", camera={"scale_mm_per_px": -8.0}), tmp_path / "site")
    # At a fifth of a pixel of motion the codec holds on to much of the picture before: it comes out too small.
    stack = frames(folder)
    with av.open(str(folder / "compressed.mkv"), "w") as container:
        stream = container.add_stream("libx264", rate=10, options={"crf": "23"})
        stream.height, stream.width, stream.pix_fmt = *stack.shape[1:], "yuv420p"
        for picture in stack:
            container.mux(stream.encode(av.VideoFrame.from_ndarray(picture, format="gray").reformat(format="yuv420p")))
        container.mux(stream.encode())
    set_keys(folder, "camera", file="compressed.mkv")
    with pytest.raises(midspan.UntrustedError, match=r"Too much compression to calibrate the scale factor: .* 5 %"):
        midspan.calibrate(midspan.open_recording(folder))


def test_a_calibration_from_its_file_gives_the_same_result(site, result, tmp_path):
    recording = midspan.open_recording(site)
    calibration, tracking = calibrate_and_track(recording)
    tracking.close()
    loaded = midspan.load_calibration(calibration.save(tmp_path / "calibration.json"))
    listed, again = (item.to_dict()["camera"]["targets"] for item in (calibration, loaded))
    for before, after in zip(listed, again, strict=True):
        for key, value in before.items():
            # Going to mm and back rounds the last of sixteen digits.
            assert after[key] == (pytest.approx(value, rel=1e-14) if isinstance(value, float) else value)
    again = midspan.estimate(recording, loaded)
    # With the file, no frame is tracked without a prediction first; where the search begins moves each target by a
    # tenth of its standard deviation, and now and then one is left out of a frame that was in.
    np.testing.assert_array_less(
        np.abs(again.displacement_mm - result.displacement_mm), 1.5 * result.displacement_std_mm
    )


def test_a_calibration_of_other_targets_is_refused(site_copy, result):
    listed = [{"roi": [NEAR.x + 1, NEAR.y, 48, 48]}, {"roi": [WALL.x, WALL.y, 48, 48]}]
    set_keys(site_copy, "camera", target=listed)
    with pytest.raises(midspan.UsageError, match=r"camera\.target: the targets must be the 4 of the calibration"):
        midspan.estimate(midspan.open_recording(site_copy), result.calibration)


def test_when_every_target_is_refused_all_reasons_are_reported(site_copy):
    stack = frames(site_copy)
    write_stack(site_copy, np.random.default_rng(0).permutation(stack[:200]))
    with pytest.raises(midspan.UntrustedError, match=r"Target near: ") as refused:
        midspan.calibrate(midspan.open_recording(site_copy))
    assert "Target wall: " in refused.value.more


def test_track_writes_the_columns_of_every_target_and_the_first_has_the_plain_names(site):
    found = track(site)
    table = found.table()
    columns = list(table.columns)
    assert columns[:6] == ["time_s", "x_px", "y_px", "std_x_px", "std_y_px", "status"]
    assert columns[6:11] == ["x_px_middle", "y_px_middle", "std_x_px_middle", "std_y_px_middle", "status_middle"]
    # The near target moves 4/3 as far in the picture as the middle one; both noises are below a hundredth of that.
    ratio = np.polyfit(table.columns["y_px_middle"], table.columns["y_px"], 1)[0]
    assert ratio == pytest.approx(2.0 / 1.5, rel=5e-3)
    assert [t["name"] for t in table.metadata["targets"]] == [name for name, _ in TARGETS]


def test_a_rolling_shutter_dates_each_target_by_its_own_rows(simulated):
    targets = (("top", Region(20, 14, 48, 48)), ("bottom", Region(84, 90, 48, 48)))
    camera = {"size_px": (152, 152), "targets": targets, "camera": Camera(readout_s=0.03)}
    folder = simulated("shutter", camera=camera)
    found = midspan.estimate(midspan.open_recording(folder))
    assert all(target.used for target in found.calibration.camera.targets)
    # The rows of the two are 76 of 151 apart, 15 ms, in which the structure moves by up to 0.3 mm.
    late = found.cameras[0].targets[1].track.time_ns - found.cameras[0].targets[0].track.time_ns
    assert np.median(late) / 1e9 == pytest.approx(0.03 * 76 / 151, abs=5e-4)
    assert found.calibration.camera.offset.value_s == pytest.approx(TRUE_OFFSET, abs=1e-3)
    assert std_of_error(folder, found) < 0.006
