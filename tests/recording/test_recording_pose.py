"""Translation and rotation of a camera as columns, from tracks of a pinhole that is written apart from the package."""

import json
from dataclasses import replace

import numpy as np
import pytest
from posed_tracks import FOCAL_PX, FRAME_HZ, LATE_S, NOISE_PX, SIZE, THREE, seen_px, waves, written

import midspan
from midspan.errors import UntrustedError
from midspan.recording.inspect import inspect_recording
from midspan.recording.pose import UNITS
from midspan.recording.streams.recording import open_recording
from midspan.recording.tracking.posed import six_degrees
from midspan.recording.unfelt import smoothed
from midspan.records import Displacement, nanoseconds
from midspan.simulate.scenarios.table import SCENARIOS
from midspan.simulate.scenarios.tilting import SixDegrees
from midspan.simulate.scenarios.write import write

NAMES = [f"translation_{axis}_mm" for axis in "xyz"] + [f"rotation_{axis}_mdeg" for axis in "xyz"]
STDS = [name.replace("_m", "_std_m", 1) for name in NAMES]


def bound(targets=THREE, size=SIZE, focal_px=FOCAL_PX):
    """Cramér-Rao bound (6,) of one frame, mm and mdeg, by differences of the pinhole."""
    places = np.array([one[:2] for one in targets.values()]) - 0.5 * (np.array(size) - 1.0)
    distance_m, step = np.array([one[2] for one in targets.values()]), 1e-5
    slopes = [
        (seen_px(places, distance_m, step * row, focal_px) - seen_px(places, distance_m, -step * row, focal_px)).ravel()
        / (2.0 * step)
        for row in np.eye(6)[:, None]
    ]
    return np.sqrt(np.diag(np.linalg.inv(np.array(slopes) @ np.array(slopes).T))) * NOISE_PX * UNITS


def errors(result, time_s, true):
    """Errors and standard deviations (n, 6) of the columns, mm and mdeg."""
    columns = result.table().columns
    value, std = (np.column_stack([columns[name] for name in names]) for names in (NAMES, STDS))
    expected = np.column_stack([np.interp(result.time_s, time_s, UNITS[k] * true[:, k]) for k in range(6)])
    return value - expected, std


def said(result):
    return [one for one in result.warnings if one.code in ("pose-unseen", "geometry-wrong")]


@pytest.fixture(scope="module")
def three(tmp_path_factory):
    """Distances exactly as declared, a target hidden for two seconds."""
    lost = [("far", 300, 340)]
    folder, time_s, true = written(tmp_path_factory.mktemp("pose"), off_m={}, lost=lost)
    return midspan.estimate(folder), time_s, true


def test_the_columns_are_at_the_bound_and_the_band_holds_the_truth(three):
    result, time_s, true = three
    error, std = errors(result, time_s, true)
    hidden = (result.time_s > LATE_S + 300 / FRAME_HZ - 0.2) & (result.time_s < LATE_S + 340 / FRAME_HZ + 0.2)
    own = error[~hidden] - np.mean(error[~hidden], axis=0)
    # Rows between frames, smoothed: below the bound of a frame, along the accelerometer's axis far below it.
    assert np.all(np.std(own, axis=0) < 1.3 * bound())
    assert np.std(own[:, 1]) < 0.6 * bound()[1]
    assert np.all(np.mean(np.abs(error) < 1.96 * std, axis=0) > 0.93)
    # While a target is hidden nothing but the accelerometer tells.
    assert np.all(std[hidden].max(axis=0)[[0, 2, 3, 4, 5]] > 20.0 * np.median(std, axis=0)[[0, 2, 3, 4, 5]])
    assert std[hidden, 1].max() < 0.3 * std[hidden, 0].max()
    assert said(result) == []


def test_the_metadata_have_the_zeros_and_the_columns_their_units(three, tmp_path):
    result, *_ = three
    tree = json.loads(result.save(tmp_path / "result.csv").with_suffix(".json").read_text())
    zero = np.array(tree["translation_zero_std_mm"] + tree["rotation_zero_std_mdeg"])
    assert np.all((zero > 0.2 * bound()) & (zero < 1.5 * bound()))
    header = (tmp_path / "result.csv").read_text().splitlines()[0].split(",")
    assert header[6:] == [name for pair in zip(NAMES, STDS, strict=True) for name in pair]


@pytest.mark.parametrize(
    ("targets", "words"),
    [
        ({name: THREE[name] for name in ("1", "far")}, "2 targets give 4 equations"),
        ({"1": (40, 100, 10.0), "2": (1660, 100, 10.0), "far": (950, 800, 10.0)}, "at a clearly different distance"),
        # On a line in space: one over the distance goes with the place.
        ({"1": (850, 100, 3.0), "2": (850, 450, 4.615), "far": (850, 800, 10.0)}, "on a line in space"),
    ],
)
def test_targets_that_do_not_show_all_six_give_no_column_and_a_note(targets, words, tmp_path):
    folder, *_ = written(tmp_path, targets=targets, turns=0.02)
    result = midspan.estimate(folder)
    assert result.pose is None
    assert not any(name in result.table().columns for name in NAMES)
    (note,) = said(result)
    assert words in note
    assert "Add a camera.target" in note


@pytest.mark.parametrize("off_m", [{"far": 3.0}, {"1": 0.4}])
def test_a_wrong_distance_is_refused_in_words(off_m, tmp_path):
    folder, *_ = written(tmp_path, off_m=off_m)
    result = midspan.estimate(folder)
    assert result.pose is None
    (note,) = said(result)
    assert note.code == "geometry-wrong"
    assert "Measure the distance" in note


def test_a_fourth_target_shows_that_none_moves_on_its_own(tmp_path):
    folder, time_s, true = written(tmp_path, targets={"wall": (850, 60, 5.0), **THREE}, off_m={})
    result = midspan.estimate(folder)
    error, std = errors(result, time_s, true)
    assert np.all(np.mean(np.abs(error) < 1.96 * std, axis=0) > 0.93)
    assert not any(one.code == "pose-unchecked" for one in result.warnings)


def test_while_one_of_four_is_hidden_the_band_holds_what_wrong_distances_make(tmp_path):
    four = {"wall": (850, 60, 5.0), **THREE}
    folder, time_s, true = written(tmp_path, targets=four, off_m={"2": 0.018, "far": 0.05}, lost=[("2", 200, 400)])
    result = midspan.estimate(folder)
    error, std = errors(result, time_s, true)
    hidden = (result.time_s > 11.0) & (result.time_s < 19.0)
    assert np.all(np.mean(np.abs(error[hidden]) < 1.96 * std[hidden], axis=0) > 0.9)
    assert np.mean(result.displacement_std_mm[hidden]) > 1.1 * np.mean(result.displacement_std_mm[~hidden])
    assert any(line.code == "lost" and " 2;" in line for line in result.warnings)


def test_one_of_four_that_moves_is_refused_and_one_of_five_is_named(tmp_path):
    four = {"wall": (850, 60, 5.0), **THREE}
    folder, *_ = written(tmp_path / "four", targets=four, off_m={}, drift_px=0.5)
    with pytest.raises(UntrustedError, match="A further target shows which"):
        midspan.estimate(folder)
    folder, *_ = written(tmp_path / "five", targets={"pole": (300, 700, 7.0), **four}, off_m={}, drift_px=0.5)
    with pytest.raises(UntrustedError, match="Without far the others agree"):
        midspan.estimate(folder)


def test_three_targets_are_said_to_be_no_more_than_needed(three):
    assert [one.code for one in three[0].warnings if one.code == "pose-unchecked"] == ["pose-unchecked"]


def test_distances_that_are_not_declared_follow_from_the_others(tmp_path):
    folder, time_s, true = written(tmp_path, off_m={}, declared=("1", "far"))
    error, std = errors(midspan.estimate(folder), time_s, true)
    assert np.all(np.mean(np.abs(error) < 1.96 * std, axis=0) > 0.93)


def test_the_camera_moves_besides_its_accelerometer_by_the_lever(tmp_path):
    folder, time_s, true = written(tmp_path, off_m={}, lever_m=(0.4, 0.0, -0.3))
    error, std = errors(midspan.estimate(folder), time_s, true)
    own = error - np.mean(error, axis=0)
    assert np.std(own[:, 1]) < bound()[1]
    assert np.all(np.mean(np.abs(error) < 1.96 * std, axis=0) > 0.93)


@pytest.fixture(scope="module")
def rendered(tmp_path_factory):
    short = {"six-degrees": replace(SCENARIOS["six-degrees"], duration_s=20.0)}
    return write("six-degrees", tmp_path_factory.mktemp("six") / "recording", seed=3, scenarios=short)


def test_a_rendered_recording_end_to_end(rendered):
    result = midspan.estimate(rendered)
    truth = np.genfromtxt(rendered / "truth.csv", delimiter=",", names=True)
    true = np.column_stack([truth[name] for name in NAMES])
    error, std = errors(result, truth["time_s"], true / UNITS)
    own = error - np.mean(error, axis=0)
    known = json.loads((rendered / "known.json").read_text())["camera"]
    # A tracker of a first frame reaches 1.5 times the Cramér-Rao bound of a picture.
    noise_px = 1.5 * np.mean(known["cramer_rao_std_px"]["x"])
    setup = SixDegrees()
    rows, columns = setup.shape
    places = [(r.x + 0.5 * (r.width - 1), r.y + 0.5 * (r.height - 1)) for r in setup.regions()]
    least = bound(dict(zip("123", ((*p, d) for p, d in zip(places, setup.distances_m, strict=True)), strict=True)),
                  (columns, rows), setup.focal_px) * noise_px / NOISE_PX  # fmt: skip
    assert np.all(np.std(own, axis=0) < 1.3 * least)
    assert np.mean(np.abs(error) < 1.96 * std) > 0.9
    off = result.displacement_mm - np.interp(result.time_s, truth["time_s"], truth["displacement_mm"])
    assert np.std(off) < 0.005
    assert np.mean(np.abs(off) < 1.96 * result.displacement_std_mm) > 0.9
    assert said(result) == []


@pytest.mark.parametrize(("hertz", "frame_hz"), [(1.1, 20.0), (2.1, 20.0), (0.02, 20.0), (0.25, 30.0)])
def test_a_smoothed_motion_has_an_honest_band_within_gaps_too(hertz, frame_hz):
    rows_s, inside, bridged = np.arange(0.0, 60.0, 0.01), [], []
    for seed in range(3):
        rng = np.random.default_rng(seed)
        motion, std_m = waves(rng, (0.95 * hertz, 1.05 * hertz, 1e-3)), 1e-5
        time_s = np.arange(0.05, 60.0, 1.0 / frame_hz)
        value = motion(time_s)[0] + rng.normal(0.0, std_m, len(time_s))
        # Two seconds without a measurement.
        value[(time_s > 20.0) & (time_s < 22.0)] = np.nan
        block = Displacement(nanoseconds(time_s), value, np.full(len(value), std_m**2), np.ones(len(value), np.uint8))
        found, variance = smoothed(block, nanoseconds(rows_s))
        error, gap = np.abs(found - motion(rows_s)[0]) / np.sqrt(variance), (rows_s > 19.9) & (rows_s < 22.1)
        inside.append(error[~gap] < 1.96)
        bridged.append(error[gap] < 1.96)
    # A motion of one frequency is smoother than one of white acceleration: the band is a little too wide.
    assert 0.94 < np.mean(inside) <= 1.0
    assert np.mean(bridged) > 0.85


def test_inspect_says_whether_the_targets_show_all_six(rendered, tmp_path):
    (said,) = (one for one in inspect_recording(open_recording(rendered))["camera"]["notes"] if "six degrees" in one)
    assert "all are seen" in said
    two, *_ = written(tmp_path, duration_s=2.0, targets={name: THREE[name] for name in ("1", "far")})
    assert "Add a camera.target" in six_degrees(open_recording(two).cameras[0])


def test_with_a_given_calibration_the_displacement_is_the_translation(tmp_path):
    # A roll of 10 mdeg moves targets 1600 px apart by 0.3 px: their difference alone errs by 0.1 mm.
    folder, time_s, true = written(tmp_path, off_m={})
    calibration = midspan.calibrate(folder)
    assert len(calibration.camera.targets) == 3
    result = midspan.estimate(folder, calibration)
    error, std = errors(result, time_s, true)
    assert np.all(np.std(error, axis=0)[[0, 2, 3, 4, 5]] < 1.5 * bound()[[0, 2, 3, 4, 5]])
    assert np.all(np.mean(np.abs(error) < 1.96 * std, axis=0) > 0.93)
    np.testing.assert_allclose(result.pose.value[:, 1], -result.estimate.displacement_m, atol=1e-12)
