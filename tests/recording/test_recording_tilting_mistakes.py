"""Targets of a tilting camera that are not as they should be: inside the band, or refused with a sentence.

What a footbridge's box does (`pinhole_tracks.TILT`) moves a target at 3 m by 0.13 mm rms and one at 10 m by 0.3.
"""

from dataclasses import replace

import numpy as np
import pytest

import midspan
from pinhole_tracks import MDEG, MODES, TILT, Site, Target, nothing, stacked, times, together, waves
from repeats import slow

SITE = Site()
NEAR, FAR = stacked(3.0, 10.0)
ALL_THREE = stacked(3.0, 5.0, 10.0)
DRIFTS, SWAYS = waves(0.03, 0.2, 0.6e-3, 9), waves(0.5, 0.9, 0.6e-3, 8)
# Slower than an accelerometer of 1 mm/s² tells from rest: at 0.02 Hz its noise in a minute is a millimetre.
SETTLES = waves(0.005, 0.02, 0.3e-3, 11)
# Farther from the optical axis, a target is moved by up to 2 % more of the tilt, a little of it fast.
OFF_AXIS = (Target(3.0, 0.0, -500.0), Target(10.0, 0.0, 500.0), Target(6.0, 170.0, 750.0), Target(4.0, -375.0, -625.0))
# A box that swings about a target 3 m above it, near √(g / 3 m) / 2π = 0.288 Hz: neither picture nor acceleration show
# it.
SWINGS = waves(0.285, 0.291, 1e-3, 7)


def checked(site, folder, more=""):
    """The result, where it is not refused: errors are inside the band, and the zero within three deviations."""
    try:
        result = midspan.estimate(site.write(folder, more))
    except midspan.UntrustedError as error:
        return str(error)
    error = site.error_mm(result.time_s, result.displacement_mm, result.calibration.camera.offset.value_s)
    zero_mm = 1e3 * result.zero_std_m
    own = np.sqrt(np.maximum(result.displacement_std_mm**2 - zero_mm**2, 0.0))
    assert np.mean(np.abs(error - np.mean(error)) < 1.96 * own) > 0.9
    assert abs(np.mean(error)) < 3.0 * zero_mm + 1e-4
    return result


def std_mm(site, result):
    return np.std(site.error_mm(result.time_s, result.displacement_mm))


def used(result):
    return [target.name for target in result.calibration.camera.targets if target.used]


@pytest.mark.parametrize(
    ("distances_m", "declared"),
    [((10.0, 10.0), ()), ((10.0, 10.0), (3.0, 10.0)), *slow(((10.0, 10.0, 10.0), ()), ((3.0, 3.0), (3.0, "far")))],
)
def test_targets_at_one_distance_show_no_tilt_whatever_is_declared(distances_m, declared, tmp_path):
    site = SITE.but(targets=stacked(*distances_m))
    result = checked(site, tmp_path, site.declared(*declared) if declared else "")
    assert result.calibration.camera.tilt_std_px == 0.0
    assert any("at another distance would show the tilt" in line for line in result.warnings)
    assert not any("second target" in line for line in result.warnings)


@pytest.mark.parametrize(
    "declared",
    [
        SITE.declared(10.0, 3.0),
        *slow(SITE.declared(3.0, 10.0, names=("target2", "1")), SITE.declared(3.0, "far"), SITE.declared("far", 3.0)),
    ],
    ids=["distances", "names", "far", "near"],
)
def test_distances_and_names_that_are_exchanged_change_nothing(declared, tmp_path):
    result = checked(SITE, tmp_path, declared)
    # A frame of the difference is good for 0.006 mm.
    assert std_mm(SITE, result) < 0.006


def test_three_targets_in_one_line_are_as_good_as_two(tmp_path):
    site = SITE.but(targets=ALL_THREE)
    result = checked(site, tmp_path)
    assert used(result) == ["1", "target2", "target3"]
    assert std_mm(site, result) < 0.006


@pytest.mark.parametrize(("moving", "own_m"), [(0, DRIFTS), (1, DRIFTS), *slow((2, DRIFTS), (0, SWAYS), (2, SWAYS))])
def test_one_of_three_that_moves_on_its_own_is_found_while_the_camera_tilts(moving, own_m, tmp_path):
    targets = list(ALL_THREE)
    targets[moving] = replace(targets[moving], own_m=own_m)
    site = SITE.but(targets=tuple(targets))
    result = checked(site, tmp_path)
    names = ["1", "target2", "target3"]
    assert used(result) == [name for k, name in enumerate(names) if k != moving]
    assert any(line.code == "part-left-out" and f"Target {names[moving]} " in line for line in result.warnings)
    # Of 3 and 5 m a frame is good for 0.011 mm.
    assert std_mm(site, result) < 0.011


def moving_alone(targets, number, own_m):
    return SITE.but(
        targets=tuple(replace(one, own_m=own_m) if k == number else one for k, one in enumerate(targets)),
        rate_hz=20.0,
        noise_px=0.004,
    )


@pytest.mark.parametrize(("moving", "size"), [(0, 1.0), *slow((1, 1.0), (2, 1.0), (0, 0.2))])
def test_one_of_three_that_moves_more_slowly_than_the_accelerometer_tells_is_not_named(moving, size, tmp_path):
    refused = checked(moving_alone(OFF_AXIS[:3], moving, times(SETTLES, size)), tmp_path)
    assert "one of the targets 1, target2, target3 moves on its own; the accelerometer does not show which" in refused
    assert "Add a fourth target" in refused


@pytest.mark.parametrize("moving", [0, *slow(1, 2, 3)])
def test_one_of_four_that_moves_slowly_is_the_one_without_which_the_others_agree(moving, tmp_path):
    site = moving_alone(OFF_AXIS, moving, SETTLES)
    result = checked(site, tmp_path)
    names = ["1", "target2", "target3", "target4"]
    assert used(result) == [name for k, name in enumerate(names) if k != moving]
    # Of 6 and 4 m a frame is good for 0.014 mm.
    assert std_mm(site, result) < 0.014


def test_one_of_two_that_sways_by_more_than_a_fifth_of_the_motion_is_refused(tmp_path):
    targets = (replace(NEAR, own_m=waves(0.35, 0.45, 0.6e-3, 5)), FAR)
    refused = checked(SITE.but(targets=targets, rate_hz=20.0), tmp_path)
    assert "move against each other" in refused
    assert "Add a third target" in refused


def test_slow_motion_of_one_of_two_targets_is_named_as_not_in_the_band(tmp_path):
    two = midspan.estimate(SITE.write(tmp_path / "two"))
    (line,) = (line for line in two.not_in_band if "slow motion of one target alone" in line)
    # 5000 px · (1 / 3 m − 1 / 10 m) = 1167 px/m.
    assert "1 or target2" in line
    assert "0.1 px is 0.086 mm" in line
    three = midspan.estimate(SITE.but(targets=ALL_THREE).write(tmp_path / "three"))
    assert not any("slow motion of one target alone" in line for line in three.not_in_band)


def test_one_of_two_that_moves_on_its_own_is_said_while_the_camera_tilts(tmp_path):
    said = checked(SITE.but(targets=(NEAR, replace(FAR, own_m=DRIFTS))), tmp_path)
    assert "or one target moves on its own" in said
    assert "add a third target" in said


def test_one_of_two_that_moves_on_its_own_is_found_before_a_camera_at_rest(tmp_path):
    result = checked(SITE.but(targets=(NEAR, replace(FAR, own_m=DRIFTS)), turns=(nothing,) * 3), tmp_path)
    assert used(result) == ["1"]


def test_a_camera_mounted_askew_measures_along_its_own_axis(tmp_path):
    result = checked(SITE.but(roll_deg=1.0), tmp_path)
    assert std_mm(SITE, result) < 0.006


@pytest.mark.parametrize(("near_px", "far_px"), [(0.0, 1340.0), *slow((1250.0, 1400.0))])
def test_what_is_left_of_the_tilt_15_degrees_off_the_axis_is_in_the_band(near_px, far_px, tmp_path):
    # A tilt moves what lies y off the axis by 1 + y² / f² as much: 7 %, or 1.5 % more of one than of the other.
    site = SITE.but(targets=tuple(Target(one, 0.0, at) for one, at in ((3.0, near_px), (10.0, far_px))))
    result = checked(site, tmp_path)
    assert any("is left in the difference" in line for line in result.warnings)


@pytest.mark.parametrize("apart_px", [150.0, *slow(1000.0)])
def test_a_rolling_shutter_of_20_ms_is_in_the_band(apart_px, tmp_path):
    site = SITE.but(targets=stacked(3.0, 10.0, apart_px=apart_px), readout_s=0.02)
    assert used(checked(site, tmp_path)) == ["1", "target2"]


@pytest.mark.parametrize("turns", [(nothing,) * 3, (TILT, nothing, nothing)], ids=["still", "tilting"])
def test_nothing_is_calibrated_without_motion(turns, tmp_path):
    with pytest.raises(midspan.UntrustedError, match=r"[Tt]oo little motion|No agreement"):
        midspan.estimate(SITE.but(motion=nothing, turns=turns).write(tmp_path))


@pytest.mark.parametrize("turns", [nothing, TILT], ids=["alone", "tilting"])
def test_a_swing_that_neither_the_near_target_nor_the_accelerometer_shows_is_refused(turns, tmp_path):
    pitch = together(turns, times(SWINGS, -1.0 / 3.0))
    site = SITE.but(motion=together(MODES, SWINGS), turns=(pitch, nothing, nothing), lateral=1)
    assert "contradict each other" in checked(site, tmp_path)


def test_a_swing_that_the_only_target_does_not_show_is_named_as_not_observed(tmp_path):
    turns = (times(SWINGS, -1.0 / 3.0), nothing, nothing)
    site = SITE.but(targets=(NEAR,), motion=together(MODES, SWINGS), turns=turns, lateral=1)
    result = midspan.estimate(site.write(tmp_path))
    assert any("tilt not observed" in one for one in result.not_in_band)


@pytest.mark.parametrize("apart_px", [300, *slow((1000,))])
def test_a_roll_that_two_targets_apart_across_the_axis_cannot_show_is_in_the_band(apart_px, tmp_path):
    roll = together(waves(3.3, 3.7, 2.0 * MDEG, 31), waves(0.01, 0.05, 5.0 * MDEG, 32))
    targets = (Target(3.0, -0.5 * apart_px, -75.0), Target(10.0, 0.5 * apart_px, 75.0))
    site = Site(targets, turns=(TILT, nothing, roll))
    regions = "".join(
        f'[[camera.target]]\nname = "{name}"\nroi = [{1000 + round(one.x_px)}, {1000 + round(one.y_px)}, 48, 48]\n'
        for name, one in zip(("1", "target2"), targets, strict=True)
    )
    result = midspan.estimate(site.write(tmp_path, regions))
    error = site.error_mm(result.time_s, result.displacement_mm)
    # A roll of 5 mdeg moves targets 300 px apart by 0.026 px, 0.1 mm.
    assert np.std(error) > 0.01
    assert np.mean(np.abs(error) < 1.96 * result.displacement_std_mm) > 0.95
    assert any("a roll of the camera moves them against each other" in one for one in result.warnings)
    again = midspan.estimate(tmp_path, result.calibration, given=False)
    assert np.array_equal(again.displacement_mm, result.displacement_mm)


def test_what_targets_move_against_each_other_by_is_noise_of_their_difference(tmp_path):
    # A roll of 15 mdeg at 1 Hz moves targets 300 px apart by 0.08 px, 0.07 mm; the tilt was taken for it, and the
    # estimator restarted again and again.
    targets = (Target(3.0, -150.0, -75.0), Target(10.0, 150.0, 75.0))
    site = Site(targets, turns=(TILT, nothing, waves(0.95, 1.0, 15.0 * MDEG, 34)))
    result = checked(site, tmp_path)
    assert std_mm(site, result) < 0.03
    assert any("move against each other" in line for line in result.warnings)
    assert not any(event.kind in ("restart", "wrong", "lost") for event in result.events)
