"""`midspan inspect --picture`: what a camera sees, and where it could be tracked, before anything is estimated."""

import json
from pathlib import Path

import av
import numpy as np
import pytest

from midspan.cli.main import run
from midspan.progress import silent
from midspan.recording.streams.recording import open_recording
from midspan.report.first_look import look_at_file, look_at_recording
from recording_edits import set_keys


def document(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> dict:  # type: ignore[type-arg]
    capsys.readouterr()
    assert run([*arguments, "--json"]) == 0
    return json.loads(capsys.readouterr().out)  # type: ignore[no-any-return]


def test_the_places_of_a_recording_have_scores_and_verdicts_and_the_best_is_what_calibrate_takes(
    footbridge: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    target = tmp_path / "look.png"
    tree = document(["inspect", str(footbridge), "--picture", str(target)], capsys)
    assert target.read_bytes().startswith(b"\x89PNG")
    found = tree["regions"]
    assert tree["camera"]["frames_used"] > 0
    assert found["given"] == []
    first = found["places"][0]
    assert found["chosen"] == [first["roi"]]
    assert first["verdict"].startswith("taken")
    assert all(place["predicted_std_px"] > 0.0 for place in found["places"])
    calibration = document(["calibrate", str(footbridge), "-o", str(tmp_path / "c.json")], capsys)
    assert calibration["camera"]["roi"] == first["roi"]


def test_a_given_region_is_drawn_and_other_places_are_tried_all_the_same(footbridge_copy: Path) -> None:
    set_keys(footbridge_copy, "camera", roi=[16, 16, 57, 57])
    found = look_at_recording(open_recording(footbridge_copy), silent)
    (given,) = found.given
    assert (given.region.x, given.region.y, given.region.width) == (16, 16, 57)
    assert len(found.places) >= 1
    # The strip goes through the given region, over the first eight seconds at 10 frames/s.
    assert found.strip.shape[0] == 57
    assert 75 <= found.strip.shape[1] <= 81
    assert found.strip_s[0] == 0.0


def test_the_strip_shows_the_motion_of_the_image(footbridge: Path) -> None:
    """A line of the image through a region: its shift between two frames is that of the structure, to a pixel."""
    found = look_at_recording(open_recording(footbridge), silent)
    truth = np.genfromtxt(footbridge / "truth.csv", delimiter=",", names=True)
    late_s = json.loads((footbridge / "known.json").read_text(encoding="utf-8"))["camera"]["time_offset_s"]
    mm = np.interp(found.strip_s + late_s, truth["time_s"], truth["displacement_mm"])
    late = int(np.argmax(np.abs(mm - mm[0])))
    wanted_px = (mm[late] - mm[0]) / -1.5
    shifts = np.arange(-6, 7)
    inner = slice(8, -8)
    score = [np.corrcoef(np.roll(found.strip[:, 0], s)[inner], found.strip[inner, late])[0, 1] for s in shifts]
    # Half a pixel of the whole shifts that are tried, and as much for the exposure and the motion at the first frame.
    assert abs(shifts[int(np.argmax(score))] - wanted_px) <= 1.0


def test_a_camera_without_accelerometer_and_a_video_alone_are_judged_by_the_image(
    footbridge_copy: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (footbridge_copy / "recording.toml").write_text('[camera]\nfile = "camera.mkv"\nrate_hz = 10.0\n')
    alone = look_at_recording(open_recording(footbridge_copy), silent)
    of_file = look_at_file(footbridge_copy / "camera.mkv", silent)
    assert alone.chosen == of_file.chosen
    assert len(alone.chosen) == 1
    tree = document(
        ["inspect", str(footbridge_copy / "camera.mkv"), "--picture", str(footbridge_copy / "l.svg")], capsys
    )
    assert tree["picture"].endswith("l.svg")
    assert tree["frames"]["width"] > 0


def test_an_image_without_texture_is_drawn_with_the_reason(tmp_path: Path) -> None:
    path = tmp_path / "grey.mkv"
    with av.open(str(path), "w") as container:
        stream = container.add_stream("ffv1", rate=10, options={"level": "3"})
        stream.width, stream.height, stream.pix_fmt = 160, 120, "gray"
        for _ in range(20):
            frame = av.VideoFrame.from_ndarray(np.full((120, 160), 90, dtype=np.uint8), format="gray")
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))
    target = tmp_path / "look.png"
    assert run(["inspect", str(path), "--picture", str(target), "--quiet"]) == 0
    found = look_at_file(path, silent)
    assert found.chosen == ()
    assert "texture" in found.notes[0]
    assert target.stat().st_size > 1000


@pytest.mark.parametrize(
    ("name", "said"),
    [("look.doc", "the picture's suffix must be one of .png, .svg, .pdf"), ("none/look.png", "does not exist")],
)
def test_a_picture_that_cannot_be_written_is_refused_before_the_work(
    footbridge: Path, tmp_path: Path, name: str, said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(["inspect", str(footbridge), "--picture", str(tmp_path / name)]) == 2
    shown = capsys.readouterr()
    assert said in shown.err
    assert shown.out == ""


def test_a_recording_without_images_has_no_picture(
    gnss: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(["inspect", str(gnss), "--picture", str(tmp_path / "look.png")]) == 2
    assert "must have a [camera] or [infrared] with images" in capsys.readouterr().err
