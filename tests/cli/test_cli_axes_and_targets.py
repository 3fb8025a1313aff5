"""Several targets and both axes on the command line and in the report."""

import json
import re

import pytest

from midspan.cli.main import run
from midspan.records import Region
from midspan.simulate.scenarios.table import sideways
from midspan.simulate.scene.disturbances import Panel
from midspan.simulate.scene.texture import textured_scene
from recording_edits import set_keys

NEAR, WALL = Region(14, 20, 48, 48), Region(84, 20, 48, 48)


def sign(rng):
    return (Panel(Region(4, 10, 68, 68), textured_scene("natural", (68, 68), rng=rng), 1.6),)


@pytest.fixture(scope="module")
def axes(simulated):
    return simulated("two axes", across=sideways)


@pytest.fixture(scope="module")
def targets(simulated):
    camera = {"size_px": (88, 144), "panels": sign, "targets": (("near", NEAR), ("wall", WALL))}
    return simulated("pair", duration_s=20.0, camera=camera)


def document(arguments, capsys):
    assert run([*arguments, "--json"]) == 0
    return json.loads(capsys.readouterr().out)


def test_estimate_tells_both_axes_and_the_report_draws_them(axes, tmp_path, capsys):
    result, report = tmp_path / "result.csv", tmp_path / "report.html"
    assert run(["estimate", str(axes), "-o", str(result), "--report", str(report)]) == 0
    said = capsys.readouterr().out
    assert re.search(r"mm along y, .* and by .* mm along x", said)
    page = report.read_text(encoding="utf-8")
    # Each axis has its own history, error and liveliest seconds; the second one's figures against its own reference.
    for title in ("Displacement along x", "Error along x", "Fastest motion along x", "Displacement"):
        assert f'alt="{title}"' in page
    found = document(["compare", str(result), str(axes), "--axis", "x"], capsys)
    # A frame's noise is 0.006 mm and the zero rests on the first one: four of those.
    assert found["rmse_mm"] < 0.024
    assert run(["compare", str(result), str(axes), "--axis", "z"]) == 2


def test_json_of_estimate_has_the_figures_of_both_axes(axes, tmp_path, capsys):
    found = document(["estimate", str(axes), "-o", str(tmp_path / "result.csv")], capsys)
    assert {"largest_mm", "largest_x_mm", "median_std_x_mm"} <= set(found["figures"])
    assert found["calibration"]["camera"]["axes"]["x"]["fused"] is True


def test_compare_refuses_an_axis_of_a_result_with_one(footbridge, tmp_path, capsys):
    result = tmp_path / "result.csv"
    assert run(["estimate", str(footbridge), "-o", str(result), "--quiet"]) == 0
    assert run(["compare", str(result), str(footbridge), "--axis", "x"]) == 2
    assert "one axis only" in capsys.readouterr().err


@pytest.mark.usefixtures("undrawn")
def test_calibrate_lists_every_target_and_the_report_has_their_table(targets, tmp_path, capsys):
    assert run(["calibrate", str(targets), "-o", str(tmp_path / "calibration.json")]) == 0
    said = capsys.readouterr().out
    assert "target near" in said
    assert "target wall" in said
    report = tmp_path / "report.html"
    assert run(["estimate", str(targets), "-o", str(tmp_path / "r.csv"), "--report", str(report), "--quiet"]) == 0
    page = report.read_text(encoding="utf-8")
    assert "<h3>Targets</h3>" in page
    assert f"{NEAR.x}, {NEAR.y}, 48 × 48" in page


def test_track_names_the_targets_and_one_region_wins_over_them(targets, tmp_path, capsys):
    found = document(["track", str(targets), "-o", str(tmp_path / "track.csv")], capsys)
    assert set(found["targets"]) == {"near", "wall"}
    header = (tmp_path / "track.csv").read_text(encoding="utf-8").splitlines()[0]
    assert header.endswith("x_px_wall,y_px_wall,std_x_px_wall,std_y_px_wall,status_wall")
    one = document(["track", str(targets), "--roi", "84,20,48,48", "-o", str(tmp_path / "one.csv")], capsys)
    assert "targets" not in one
    assert one["roi"] == [84, 20, 48, 48]


def test_track_shows_three_digits_of_a_deviation(targets, tmp_path, capsys):
    assert run(["track", str(targets), "--roi", "84,20,48,48", "-o", str(tmp_path / "one.csv")]) == 0
    text = capsys.readouterr().out
    shown = re.findall(r"standard deviation (\S+) px \(median\)", text)
    assert len(shown) == 2
    assert all(f"{float(value):.3g}" == value for value in shown)
    assert "x 84, y 20, 48 × 48 px" in text


def test_a_target_outside_the_image_is_wrong_use(targets, tmp_path, capsys):
    import shutil

    folder = shutil.copytree(targets, tmp_path / "site")
    set_keys(folder, "camera", target=[{"roi": [14, 20, 48, 48]}, {"roi": [120, 60, 48, 48]}])
    assert run(["calibrate", str(folder)]) == 2
    assert "144x88" in capsys.readouterr().err
