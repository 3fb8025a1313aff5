"""What a command must not write over: a recording's own files, and whatever midspan did not write itself."""

import json
import os
import shutil

import pytest

from lens_cases import write_pictures
from midspan.cli.main import run
from midspan.report.lens import draw_lens
from midspan.sources.camera.lens import LensRequest, lens_from_pictures
from midspan.vision.checkerboard import Board
from repeats import slow

RESULTS = [".csv", ".parquet", ".h5", ".mat", ".xlsx", ".tdms", ".mseed", ".uff"]


@pytest.fixture(scope="module")
def elsewhere(footbridge, tmp_path_factory):
    """A camera's video outside any recording."""
    folder = tmp_path_factory.mktemp("elsewhere")
    shutil.copy(footbridge / "camera.mkv", folder / "other.mkv")
    return folder / "other.mkv"


@pytest.fixture
def recording(gnss, tmp_path):
    """A copy of `gnss` that may be changed."""
    shutil.copytree(gnss, tmp_path / "recording")
    return tmp_path / "recording"


def contents(folder):
    return {str(path): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def refused(arguments, folder, capsys, *words):
    before = contents(folder)
    assert run([str(part) for part in arguments]) == 2
    said = capsys.readouterr().err
    for word in words:
        assert word in said
    assert contents(folder) == before


@pytest.mark.parametrize("name", ["accel.csv", "gnss.csv", "truth.csv", "calibration.csv"])
def test_a_track_of_another_source_spares_the_recording_in_whose_folder_it_is_written(
    name, elsewhere, recording, capsys
):
    if name == "calibration.csv":
        (recording / "calibration.json").write_text("{}", encoding="utf-8")
    refused(["track", elsewhere, "-o", recording / name], recording, capsys, "belongs to the recording", "another name")


def test_a_link_to_a_file_of_a_recording_is_spared_too(elsewhere, recording, tmp_path, capsys):
    (tmp_path / "link.csv").symlink_to(recording / "accel.csv")
    refused(["track", elsewhere, "-o", tmp_path / "link.csv"], tmp_path, capsys, "belongs to the recording")


@pytest.mark.parametrize("suffix", [".csv", ".parquet", ".h5", ".mat"])
def test_a_track_does_not_replace_a_file_that_midspan_did_not_write(suffix, elsewhere, tmp_path, capsys):
    (tmp_path / f"mine{suffix}").write_bytes(b"time_s,accel\n0.0,1.0\n")
    refused(
        ["track", elsewhere, "-o", tmp_path / f"mine{suffix}"], tmp_path, capsys, f"mine{suffix}", "remove that file"
    )


@pytest.mark.parametrize("suffix", [*RESULTS[:3], *slow(*RESULTS[3:])])
def test_an_estimate_replaces_its_own_result_and_an_empty_file_only(suffix, recording, tmp_path, capsys):
    target = tmp_path / f"r{suffix}"
    target.write_bytes(b"mine")
    refused(["estimate", recording, "-o", target], tmp_path, capsys, f"r{suffix}", "remove that file")
    target.write_bytes(b"")
    for _ in range(2):
        assert run(["estimate", str(recording), "-o", str(target), "--quiet"]) == 0


def test_the_metadata_of_a_result_replaces_no_other_json(recording, tmp_path, capsys):
    assert run(["calibrate", str(recording), "-o", str(tmp_path / "cal.json"), "--quiet"]) == 0
    refused(
        ["estimate", recording, "-c", tmp_path / "cal.json", "-o", tmp_path / "cal.csv"], tmp_path, capsys, "cal.json"
    )


def test_a_calibration_replaces_a_calibration_only(recording, tmp_path, capsys):
    (tmp_path / "mine.json").write_text('{"midspan": "0.1.0"}', encoding="utf-8")
    refused(["calibrate", recording, "-o", tmp_path / "mine.json"], tmp_path, capsys, "mine.json", "no calibration")
    for _ in range(2):
        assert run(["calibrate", str(recording), "-o", str(tmp_path / "c.json"), "--quiet"]) == 0
    # Under its own name in the recording it is renewed whatever it holds.
    (recording / "calibration.json").write_text("broken", encoding="utf-8")
    assert run(["calibrate", str(recording), "--quiet"]) == 0
    assert "accelerometer" in json.loads((recording / "calibration.json").read_text(encoding="utf-8"))


@pytest.mark.usefixtures("undrawn")
def test_a_report_replaces_a_report_only(recording, tmp_path, capsys):
    page = tmp_path / "page.html"
    page.write_text("<p>mine</p>", encoding="utf-8")
    refused(["estimate", recording, "--report", page], tmp_path, capsys, "page.html", "remove that file")
    page.unlink()
    assert run(["estimate", str(recording), "--report", str(page), "--quiet"]) == 0
    # The page is looked at before the calibration, whose absence is another error.
    assert run(["estimate", str(recording), "--report", str(page), "-c", "nowhere.json"]) == 3


@pytest.fixture(scope="module")
def boards(tmp_path_factory):
    """Pictures of a checkerboard, and the lens found in them."""
    folder = tmp_path_factory.mktemp("lens") / "boards"
    write_pictures(folder, 8, 2)
    return folder, lens_from_pictures(folder, LensRequest(Board(9, 6, 25.0)))


@pytest.mark.parametrize("suffix", [".png", *slow(".svg", ".pdf", ".jpg")])
def test_a_lens_and_its_picture_replace_their_like_only(suffix, boards, tmp_path, capsys):
    folder, found = boards
    lens, picture = tmp_path / "lens.json", tmp_path / f"drawn{suffix}"
    arguments = ["lens", folder, "-o", lens, "--picture", picture, "--model", "nonsense"]
    lens.write_text('{"mine": 1}', encoding="utf-8")
    refused(arguments, tmp_path, capsys, "lens.json", "no lens file")
    found.save(lens)
    picture.write_bytes(b"mine")
    refused(arguments, tmp_path, capsys, picture.name, "remove that file")
    draw_lens(found.fit, found.picture, picture)
    # With both in order the next thing to be refused is the model.
    refused(arguments, tmp_path, capsys, "--model")


def test_the_demo_spares_a_file_of_the_name_of_its_result(tmp_path, capsys):
    (tmp_path / "result.csv").write_text("mine", encoding="utf-8")
    refused(["demo", "-o", tmp_path], tmp_path, capsys, "result.csv")
    assert os.listdir(tmp_path) == ["result.csv"]
