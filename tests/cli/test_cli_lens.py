"""`midspan lens` and [camera.lens]: what is written, what is refused, and that nothing is left behind."""

import json

import pytest

from lens_cases import PINHOLE, SIZE, write_pictures
from midspan.cli.main import run
from midspan.errors import DataError, UsageError
from midspan.recording.streams.recording import open_recording
from midspan.recording.tracking.opening import lens_of
from midspan.settings.load import validate
from midspan.sources.camera.lens import load_lens
from midspan.vision.lens import Lens


@pytest.fixture(scope="module")
def pictures(tmp_path_factory):
    """Eleven pictures of a board, two of them nearly the same, and one without."""
    return write_pictures(tmp_path_factory.mktemp("lens") / "pictures", 10, 2)


def test_a_lens_is_written_and_used(pictures, tmp_path, capsys):
    file, drawn = tmp_path / "lens.json", tmp_path / "lens.png"
    assert run(["lens", str(pictures), "-o", str(file), "--picture", str(drawn), "--json"]) == 0
    tree = json.loads(capsys.readouterr().out)
    assert (tree["pictures"], tree["boards_found"], tree["boards"]) == (12, 11, 10)
    assert tree["rms_px"] < 0.07
    # Ten views of corners known to 0.04 px; the fit itself says 0.0003.
    assert tree["matrix"][:2] == pytest.approx(PINHOLE["matrix"][:2], rel=0.002)
    assert any("15 to 30" in line for line in tree["warnings"])
    assert drawn.read_bytes().startswith(b"\x89PNG")
    lens = load_lens(file)
    assert lens.matrix == tuple(tree["matrix"])
    assert (lens.model, lens.size) == ("pinhole", SIZE)
    (tmp_path / "recording.toml").write_text(
        '[accelerometer]\nfile = "a.csv"\n[camera]\nfile = "c.mkv"\nlens = {file = "lens.json"}\n', encoding="utf-8"
    )
    recording = open_recording(tmp_path)
    assert lens_of(recording) == lens
    assert file.resolve() in recording.own_files


def test_the_words_say_how_well_it_is_known(pictures, tmp_path, capsys):
    assert run(["lens", str(pictures / "*.png"), "-o", str(tmp_path / "lens.json")]) == 0
    said = capsys.readouterr()
    for word in ("12, board found in 11", "px rms", "focal length", "coverage", "written to"):
        assert word in said.out
    assert "warning: 10 views" in said.err


REFUSED = {
    "another board": (["--columns", "8"], 4, "inner corners"),
    "too few": (["--every", "3"], 4, "at least 8"),
    "model unknown": (["--model", "fish"], 2, "'fisheye'"),
    "square of nothing": (["--square-mm", "0"], 2, "--square-mm"),
    "no json": (["-o", "lens.txt"], 2, ".json"),
    "folder missing": (["-o", "nowhere/lens.json"], 2, "nowhere"),
    "drawing of nothing": (["--picture", "lens.xyz"], 2, ".png"),
    "drawing among the pictures": (["--picture", "{pictures}/lens.png"], 2, "outside the folder of the images"),
    "rows of two": (["--rows", "2"], 2, "--rows"),
}


@pytest.mark.parametrize("name", list(REFUSED))
def test_what_cannot_be_trusted_or_done_is_one_message(name, pictures, tmp_path, monkeypatch, capsys):
    arguments, code, word = REFUSED[name]
    monkeypatch.chdir(tmp_path)
    assert run(["lens", str(pictures), *(a.format(pictures=pictures) for a in arguments)]) == code
    said = capsys.readouterr().err
    assert word in said
    assert "Traceback" not in said
    assert list(tmp_path.iterdir()) == []
    assert len(list(pictures.iterdir())) == 12


def test_a_folder_that_is_not_there_is_one_message(tmp_path, capsys):
    assert run(["lens", str(tmp_path / "nowhere"), "-o", str(tmp_path / "lens.json")]) == 3
    assert "nowhere" in capsys.readouterr().err


GOOD = {"matrix": [900.0, 900.0, 319.5, 239.5], "distortion": [-0.3, 0.1, 0.0, 0.0], "size": [640, 480]}


def checked(lens):
    return validate({"accelerometer": {"file": "a"}, "camera": {"file": "c", "lens": lens}}, "recording.toml")


def test_the_numbers_of_a_lens_can_stand_in_the_recording():
    assert checked(GOOD).camera.lens.lens() == Lens(
        "pinhole", (900.0, 900.0, 319.5, 239.5), (-0.3, 0.1, 0.0, 0.0), (640, 480)
    )
    assert checked({**GOOD, "model": "fisheye"}).camera.lens.lens().model == "fisheye"


@pytest.mark.parametrize(
    ("lens", "words"),
    [
        ({}, ["camera.lens", "missing: distortion, matrix, size"]),
        ({"file": "lens.json", **GOOD}, ["camera.lens", "must have either file or the numbers"]),
        ({**GOOD, "matrix": [900.0, 900.0]}, ["camera.lens.matrix", "fx, fy, cx, cy"]),
        ({**GOOD, "distortion": [0.1]}, ["camera.lens", "4 or 5 or 8 or 12"]),
        ({**GOOD, "size": [640]}, ["camera.lens.size", "2 numbers"]),
        ({**GOOD, "model": "fisheyes"}, ["camera.lens.model", "'fisheye'"]),
        ({**GOOD, "distorsion": [0.1]}, ["camera.lens.distorsion", "'distortion'"]),
        ("lens.json", ["camera.lens", "section"]),
    ],
)
def test_a_lens_section_that_cannot_be_is_refused(lens, words):
    with pytest.raises(UsageError) as caught:
        checked(lens)
    for word in words:
        assert word in str(caught.value)


@pytest.mark.parametrize(
    "text",
    ["", "[]", "{}", json.dumps({**GOOD}), json.dumps({**GOOD, "model": "pinhole", "matrix": [0, 0, 0, 0]})],
)
def test_a_damaged_lens_file_is_bad_data(text, tmp_path):
    (tmp_path / "lens.json").write_text(text, encoding="utf-8")
    with pytest.raises(DataError, match=r"lens\.json: is no lens file.*midspan lens"):
        load_lens(tmp_path / "lens.json")


def test_a_missing_lens_file_is_bad_data(tmp_path):
    with pytest.raises(DataError, match="midspan lens"):
        load_lens(tmp_path / "lens.json")
