"""Several targets along both image axes: the same ones are used, and each axis has its own best one."""

from dataclasses import replace

import numpy as np
import pytest

import midspan
from midspan.calibration.camera.calibrate import used_along_both
from midspan.calibration.sensors.camera import CameraCalibration, TargetCalibration
from midspan.records import Region, ScaleFactor, TimeOffset
from midspan.report.material import gather
from midspan.simulate.motion.motion import random_motion
from midspan.simulate.scenarios.table import sideways
from midspan.simulate.scene.disturbances import Panel
from midspan.simulate.scene.texture import textured_scene
from recording_edits import read_columns

NEAR, SWINGING, WALL = Region(12, 16, 48, 48), Region(12, 88, 48, 48), Region(88, 88, 48, 48)
TARGETS = (("near", NEAR), ("swinging", SWINGING), ("wall", WALL))


def panels(rng):
    """One near panel, and one that swings up and down but not sideways."""
    near, swinging, swing = rng.spawn(3)
    own = random_motion((0.5, 0.9), 0.8, rng=swing, lines=16)
    return (
        Panel(Region(0, 4, 68, 68), textured_scene("natural", (68, 68), rng=near), 2.0),
        Panel(Region(0, 76, 68, 68), textured_scene("natural", (68, 68), rng=swinging), own_px=own),
    )


@pytest.fixture(scope="module")
def site(simulated):
    camera = {"size_px": (152, 152), "panels": panels, "targets": TARGETS}
    return simulated("targets along both axes", across=sideways, camera=camera)


@pytest.fixture(scope="module")
def result(site):
    return midspan.estimate(midspan.open_recording(site))


def test_a_target_that_moves_by_itself_along_one_axis_is_used_along_neither(site, result):
    calibration = result.calibration
    for camera in (calibration.camera, calibration.across.camera):
        assert [target.name for target in camera.used] == ["near", "wall"]
        assert camera.region in [target.region for target in camera.used]
        assert camera.relative_scale_std is not None
    assert [target.name for target in result.cameras[0].targets] == ["near", "wall"]
    (own,) = [target for target in calibration.camera.targets if target.name == "swinging"]
    (other,) = [target for target in calibration.across.camera.targets if target.name == "swinging"]
    assert other.reason == f"not usable along y: {own.reason}"
    known = read_columns(site / "truth.csv")
    for value, column in ((result.displacement_mm, 1), (result.across.displacement_mm, 3)):
        error = value - np.interp(result.time_s, known[:, 0], known[:, column])
        # As for one target: a frame is good for 0.006 mm.
        assert np.std(error) < 0.006


def camera_of(direction, used):
    """The calibration of targets of which these are used."""
    listed = tuple(
        TargetCalibration(
            Region(10 * k, 0, 8, 8), str(k), ScaleFactor(-1e-3, 1e-12), 0.01, 1.0, bool(yes), "" if yes else "no"
        )
        for k, yes in enumerate(used)
    )
    best = next(target for target in listed if target.used)
    return CameraCalibration(
        best.scale, TimeOffset(0.0, 0.0), best.region, direction, "template", 0.01, 1.0, targets=listed
    )


@pytest.mark.parametrize(
    ("main", "across", "both"),
    [((1, 1, 1), (1, 0, 1), (1, 0, 1)), ((0, 1, 1), (1, 1, 0), (0, 1, 0)), ((1, 1), (1, 1), (1, 1))],
)
def test_what_either_axis_leaves_out_neither_uses(main, across, both):
    found = used_along_both([camera_of("y", main), camera_of("x", across)])
    assert [[target.used for target in camera.targets] for camera in found] == [list(map(bool, both))] * 2
    assert all(target.reason for camera in found for target in camera.targets if not target.used)


def test_the_main_axis_keeps_its_targets_where_none_is_of_use_along_both():
    main = camera_of("y", (1, 0))
    assert used_along_both([main, camera_of("x", (0, 1))]) == [main]


def test_the_second_axis_goes_with_the_track_of_its_own_best_target(site, result, tmp_path):
    main, across = result.calibration.camera, result.calibration.across
    # Whichever is the best along the main axis: along the second one it is the other.
    (other,) = [target for target in across.camera.used if target.region != main.region]
    camera = replace(
        across.camera,
        scale=other.scale,
        region=other.region,
        noise_std_px=other.noise_std_px,
        variance_factor=other.variance_factor,
    )
    calibration = replace(result.calibration, across=replace(across, camera=camera))
    loaded = midspan.load_calibration(calibration.save(tmp_path / "calibration.json"))
    assert loaded.across.camera.region == other.region
    found = midspan.estimate(midspan.open_recording(site), loaded)
    (best,) = [target for target in found.cameras[0].targets if target.region == other.region]
    late_ns = round(1e9 * loaded.camera.offset.value_s)
    np.testing.assert_array_equal(found.across.measured[0].time_ns, best.track.time_ns + late_ns)
    measured = gather(found, None).second.measured[0]
    apart = measured.value_mm - np.interp(measured.time_ns / 1e9, found.time_s, found.across.displacement_mm)
    # The frame's own noise; with the other target's pixels it would be half the motion.
    assert np.nanstd(apart) < 0.01 < 0.1 * np.std(found.across.displacement_mm)
