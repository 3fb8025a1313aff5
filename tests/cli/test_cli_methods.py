"""`midspan estimate --method all` and `midspan methods --papers`: methods compared, and their papers."""

import json
import shutil
import tomllib
from pathlib import Path

import pytest

from midspan.cli.main import run
from midspan.engine.camera import CameraChain
from midspan.fusion.methods import METHODS
from midspan.papers.published import PAPERS
from midspan.settings.load import validate
from midspan.vision.tracker import TRACKERS
from recording_edits import set_keys


@pytest.fixture(scope="module")
def compared(footbridge: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[str]]:
    """The command's JSON document and picture; and the frames that were tracked, one entry each."""
    folder, tracked = tmp_path_factory.mktemp("all"), list[str]()
    push = CameraChain.push

    def counted(self, frame, *predictions):  # type: ignore[no-untyped-def]
        # Without predictions a tracker learns from the first frames, before it tracks.
        tracked.extend(str(frame.index) for _ in predictions)
        return push(self, frame, *predictions)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(CameraChain, "push", counted)
        calibration = folder / "calibration.json"
        assert run(["calibrate", str(footbridge), "-o", str(calibration), "--quiet"]) == 0
        tracked.clear()
        # The choice of a region tracks several places: with a calibration there is none.
        arguments = ["estimate", str(footbridge), "-c", str(calibration), "--method", "all"]
        assert run([*arguments, "-o", str(folder / "all.png"), "-q"]) == 0
    return folder, tracked


def document(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> dict:  # type: ignore[type-arg]
    capsys.readouterr()
    assert run([*arguments, "--json"]) == 0
    return json.loads(capsys.readouterr().out)  # type: ignore[no-any-return]


def test_all_methods_rest_on_one_tracking_pass(compared: tuple[Path, list[str]]) -> None:
    tracked = compared[1]
    assert len(tracked) == len(set(tracked))
    assert len(tracked) > 200
    assert (compared[0] / "all.png").stat().st_size > 10_000


def test_the_table_has_every_method_with_error_coverage_and_delay(
    footbridge: Path, compared: tuple[Path, list[str]], capsys: pytest.CaptureFixture[str]
) -> None:
    calibration = str(compared[0] / "calibration.json")
    picture = str(compared[0] / "again.svg")
    found = document(["estimate", str(footbridge), "-c", calibration, "--method", "all", "-o", picture], capsys)
    rows = {(row["method"], row["literal"]): row for row in found["methods"]}
    assert set(rows) == {(name, False) for name in METHODS} | {(n, True) for n, row in METHODS.items() if row.guarded}
    assert found["written"] == picture
    rmse = {key: row["comparison"]["rmse_without_bias_mm"] for key, row in rows.items()}
    # The smoother knows both sides of a sample, the filter one; a paper's filter as printed holds the acceleration
    # between its samples, which costs far more than noise here.
    assert rmse["smoother", False] < rmse["kalman", False] < rmse["adaptive-kalman", True]
    for name in ("smoother", "kalman", "lag"):
        # 95 %, of some twenty independent errors of the slowest part: the share scatters by five in a hundred.
        assert rows[name, False]["comparison"]["coverage_95"] > 0.8
    assert rows["kalman", False]["delay_s"] == 0.0
    assert rows["lag", False]["delay_s"] == 0.5
    assert rows["smoother", False]["delay_s"] is None
    # The least transition band of 0.5 Hz needs filters of seconds.
    assert 1.0 < rows["two-stage-fir", False]["delay_s"] < 10.0
    assert all(row["took_s"] > 0.0 for row in rows.values())


def test_two_files_are_compared_with_a_file_and_a_recording_without_reference_says_so(
    footbridge_copy: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    set_keys(footbridge_copy, "camera", roi=[16, 16, 57, 57])
    settings = footbridge_copy / "recording.toml"
    text = settings.read_text(encoding="utf-8")
    settings.write_text(text[: text.index("[reference]")], encoding="utf-8")
    assert run(["estimate", str(footbridge_copy), "--method", "all"]) == 0
    shown = capsys.readouterr().out
    assert "RMSE" not in shown
    assert "--reference FILE" in shown
    assert (footbridge_copy / "methods.png").is_file()
    truth, picture = str(footbridge_copy / "truth.csv"), str(tmp_path / "m.pdf")
    arguments = ["estimate", str(footbridge_copy), "--method", "all", "--reference", truth, "-o", picture]
    assert run(arguments) == 0
    heading, *lines = capsys.readouterr().out.splitlines()
    assert "inside ±1.96 σ  without zero  inside" in heading
    # Both shares of the rows of methods that were not refused.
    assert sum(line.count(" %") == 2 for line in lines) > len(METHODS) // 2


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--method", "all", "-o", "x.csv"], "the picture's suffix must be one of .png, .svg, .pdf"),
        (["--method", "all", "--report", "x.html"], "--report: needs one method"),
        (["--method", "kalman", "--reference", "x.csv"], "--reference: needs --method all"),
    ],
)
def test_what_does_not_go_with_all_methods_is_refused_before_the_work(
    footbridge: Path, arguments: list[str], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(["estimate", str(footbridge), *arguments]) == 2
    assert said in capsys.readouterr().err


def test_the_five_papers_are_named_with_trackers_methods_and_settings_that_exist(
    capsys: pytest.CaptureFixture[str],
) -> None:
    papers = document(["methods", "--papers"], capsys)["papers"]
    assert len(papers) == len(PAPERS) == 5
    for paper in PAPERS:
        assert METHODS[paper.method].literal
        assert paper.tracker in TRACKERS if paper.tracker else "camera" not in paper.sensors
        tree = {"accelerometer": {"file": "a.csv"}, **{name: {"file": "x"} for name in paper.sensors}}
        tree["fusion"] = {"method": paper.method, "literal": True}
        for key, value in paper.settings.items():
            section, name = key.split(".")
            tree[section][name] = tomllib.loads(f"value = {value}")["value"]
        validate(tree, paper.name)
    assert run(["methods", "--papers"]) == 0
    shown = capsys.readouterr().out
    assert all(paper["command"] in shown for paper in papers)
    heads = [line.split(":")[0] for line in shown.splitlines() if line and line[0].isdigit()]
    assert heads == [f"{paper.key} {paper.name}" for paper in PAPERS]


@pytest.mark.parametrize("paper", [one for one in PAPERS if one.sensors == ("camera",)], ids=lambda paper: paper.name)
def test_the_commands_of_the_camera_papers_run(paper, footbridge: Path, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    folder = shutil.copytree(footbridge, tmp_path / "site")
    arguments = paper.command.replace("RECORDING", str(folder)).split()[1:]
    assert run([*arguments, "--quiet"]) == 0
    assert (folder / "result.csv").is_file()
