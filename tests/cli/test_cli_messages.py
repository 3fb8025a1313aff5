"""What the commands say of mistakes that everybody makes once, and of what they print for a person."""

import ast
import json
import re
from pathlib import Path

import numpy as np
import pytest

import midspan
from midspan.cli.main import run
from recording_edits import acceleration


def refused(arguments: list[str], capsys: pytest.CaptureFixture[str], code: int = 2) -> str:
    capsys.readouterr()
    assert run(arguments) == code
    return capsys.readouterr().err


def written(folder: Path, text: str) -> str:
    (folder / "recording.toml").write_text(text, encoding="utf-8")
    return str(folder)


@pytest.mark.parametrize(("typed", "meant"), [("estimat", "estimate"), ("compere", "compare"), ("tracks", "track")])
def test_a_mistyped_command_is_answered_with_the_nearest(
    typed: str, meant: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert f"Did you mean {meant!r}?" in refused([typed, "."], capsys)


@pytest.mark.parametrize("key", ["fps", "frame_rate"])
def test_the_words_of_other_programs_lead_to_the_key(
    key: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = written(tmp_path, f'[accelerometer]\nfile = "a.csv"\n[camera]\nfile = "c.mkv"\n{key} = 30\n')
    assert f"camera.{key}: is not a known key. Did you mean 'rate_hz'?" in refused(["check-config", folder], capsys)


def test_the_name_of_a_family_of_trackers_leads_to_the_tracker(
    footbridge: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    reported = refused(["calibrate", str(footbridge), "--tracker", "lucas-kanade"], capsys)
    assert "Did you mean 'registration'?" in reported


def test_a_decimal_comma_in_toml_is_explained(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = written(tmp_path, '[camera]\nfile = "c.mkv"\nexposure_s = 0,004  # of the phone\n')
    reported = refused(["check-config", folder], capsys)
    assert "at line 3" in reported
    assert "The decimal sign is a point: 0.004." in reported


def test_a_region_beyond_the_picture_is_no_valid_setting(
    footbridge_copy: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = footbridge_copy / "recording.toml"
    text = re.sub(r"roi = \[[^]]*\]\n", "", file.read_text())
    file.write_text(text.replace("[camera]", "[camera]\nroi = [1800, 8, 64, 64]"))
    reported = refused(["check-config", str(footbridge_copy)], capsys)
    assert "camera.roi: must lie inside the image" in reported
    assert "received [1800, 8, 64, 64]" in reported
    # What cannot be looked at is not judged.
    (footbridge_copy / "camera.mkv").unlink()
    assert run(["check-config", str(footbridge_copy)]) == 0


def test_a_windows_path_between_double_quotes_is_explained(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = written(tmp_path, '[accelerometer]\nfile = "C:\\Users\\me\\a.csv"\n')
    reported = refused(["check-config", folder], capsys)
    assert "at line 2" in reported
    assert "write / in Windows paths, or put them in single quotes" in reported
    assert "need quotes" not in reported


def test_a_value_without_quotes_is_explained(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = written(tmp_path, "[accelerometer]\nfile = a.csv\n")
    assert "Text values need quotes" in refused(["check-config", folder], capsys)


def test_a_section_that_is_missing_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = written(tmp_path, '[accelerometer]\nfile = "a.csv"\n')
    reported = refused(["estimate", folder], capsys)
    assert "has [accelerometer] only. Add the section" in reported
    assert "[camera]" in reported
    assert "settings:" not in reported
    folder = written(tmp_path, '[radar]\nfile = "r.h5"\n')
    assert "has no [accelerometer]. Add the section" in refused(["estimate", folder], capsys)


def test_a_camera_alone_is_led_to_track(footbridge_copy: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = written(footbridge_copy, '[camera]\nfile = "camera.mkv"\n')
    for command in ("calibrate", "estimate"):
        reported = refused([command, folder], capsys)
        assert "has no [accelerometer]" in reported
        assert "midspan track" in reported


def test_check_config_ends_with_its_verdict_and_writes_values_as_toml(
    footbridge_copy: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(["check-config", str(footbridge_copy)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[-1] == f"{footbridge_copy / 'recording.toml'}: valid."
    shown = "\n".join(lines)
    for word in ("False", "True", "()", "None"):
        assert word not in shown
    assert re.search(r"fusion\.literal +false", shown)
    # A key without a value says nothing, and has no row.
    assert all(len(line.split()) > 1 for line in lines)
    for name in ("accel.csv", "camera.mkv"):
        (footbridge_copy / name).unlink()
    assert run(["check-config", str(footbridge_copy)]) == 0
    assert capsys.readouterr().out.splitlines()[-1].endswith("valid, but 2 files are missing.")


def test_a_result_that_is_missing_is_looked_for_where_the_command_runs(
    footbridge: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    reported = refused(["compare", "result.csv", str(footbridge)], capsys, code=3)
    assert str(tmp_path) in reported
    assert "recording.toml" not in reported


def test_inspect_shows_values_in_the_unit_of_the_file(
    footbridge_copy: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """An accelerometer in g and a reference in mm: numbers and unit of a row belong together."""
    time_s, value = acceleration(footbridge_copy)
    in_g = value / 9.80665
    rows = "".join(f"{t:.6f},{a:.9f}\n" for t, a in zip(time_s, in_g, strict=True))
    (footbridge_copy / "accel.csv").write_text("time_s,accel [g]\n" + rows, encoding="utf-8")
    settings = footbridge_copy / "recording.toml"
    text = re.sub(r'unit = "m/s\^2"\n', "", settings.read_text(encoding="utf-8")).replace(
        'value = "accel"', 'value = "accel [g]"'
    )
    settings.write_text(text, encoding="utf-8")
    assert run(["inspect", str(footbridge_copy)]) == 0
    shown = capsys.readouterr().out
    low, high = (float(part) for part in re.search(r"values +(\S+) … (\S+) g,", shown).groups())  # type: ignore[union-attr]
    # Four significant digits are shown.
    np.testing.assert_allclose((low, high), (in_g.min(), in_g.max()), rtol=1e-3)
    assert re.search(r"values +\S+ … \S+ mm,", shown)
    assert run(["inspect", str(footbridge_copy), "--json"]) == 0
    tree = json.loads(capsys.readouterr().out)["accelerometer"]
    assert tree["value_unit"] == "m/s^2"
    np.testing.assert_allclose(tree["largest"], value.max(), atol=1e-8)


def test_inspect_names_only_channels_of_the_right_unit(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rows = "".join(f"{k / 100:.2f};{k % 3};{k % 5};{k % 7};20\n" for k in range(300))
    header = "Zeit [s];Beschl X [g];Beschl Y [g];Beschl Z [g];Temp [°C]\n"
    (tmp_path / "a.csv").write_text(header + rows, encoding="utf-8")
    folder = written(tmp_path, '[accelerometer]\nfile = "a.csv"\n[camera]\nfile = "c.mkv"\n')
    reported = refused(["inspect", folder], capsys, code=2)
    assert "'Beschl X', 'Beschl Y', 'Beschl Z' (all in g)" in reported
    assert "Temp" not in reported


def test_an_estimate_ends_in_eight_lines_with_the_three_worst_warnings(
    footbridge: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    from dataclasses import replace

    from midspan import estimate
    from midspan.cli.console import Console
    from midspan.cli.estimate import show
    from midspan.notices import Notice

    codes = ("tilt", "outliers", "lens", "frozen", "unit-doubtful")
    result = replace(estimate(footbridge), warnings=tuple(Notice(code, f"camera: {code}.") for code in codes))
    capsys.readouterr()
    show(Console(False, False), result, ["result.csv"])
    out, err = capsys.readouterr()
    assert len((out + err).splitlines()) <= 8
    assert out.splitlines()[0].strip() == result.verdict
    assert re.findall(r"\[(.*)\]", err) == ["unit-doubtful", "outliers", "lens"]
    assert "and 2 more" in err
    show(Console(False, False), result, ["result.csv"], verbose=True)
    out, err = capsys.readouterr()
    assert re.findall(r"\[(.*)\]", err) == ["unit-doubtful", "outliers", "lens", "frozen", "tilt"]
    assert all(line in out for line in result.not_in_band)
    show(Console(False, True), result, ["result.csv"])
    document = json.loads(capsys.readouterr().out)
    assert document["verdict"] == result.verdict
    assert document["warnings"] == list(result.warnings)


def test_small_mistakes_in_a_recording_are_explained(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    camera = '[accelerometer]\nfile = "a.csv"\n[camera]\nfile = "b.mkv"\n'
    reported = refused(["check-config", written(tmp_path, f"{camera}roi = 8, 8, 64, 64\n")], capsys)
    assert "needs brackets" in reported
    reported = refused(["check-config", written(tmp_path, f'{camera}start_s = "1,10"\n')], capsys)
    assert "without quotes and with a decimal point: 1.10" in reported


def test_a_name_with_blanks_that_is_not_quoted_is_explained(capsys: pytest.CaptureFixture[str]) -> None:
    assert "need quotes" in refused(["estimate", "a.csv", "b.mkv", "--value", "Voie", "3"], capsys)


# On the terminal the name of the command and of one or two files come before it, where to look after it: 60 in all.
MAX_WORDS = 52


def _literal(part: ast.expr) -> str:
    """The words of a text, one for each figure or name that is put into it."""
    if isinstance(part, ast.BinOp):
        return _literal(part.left) + _literal(part.right)
    if isinstance(part, ast.JoinedStr):
        return "".join(_literal(one) for one in part.values)
    return part.value if isinstance(part, ast.Constant) and isinstance(part.value, str) else "figure"


def test_a_refusal_is_short_and_the_rest_is_for_verbose() -> None:
    long = []
    for file in Path(midspan.__file__).parent.rglob("*.py"):
        for call in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if not (isinstance(call, ast.Call) and isinstance(call.func, ast.Name) and call.args):
                continue
            if call.func.id.endswith("Error") and (count := len(_literal(call.args[0]).split())) > MAX_WORDS:
                long.append(f"{file.name}:{call.lineno}: {count} words")
    assert long == []
