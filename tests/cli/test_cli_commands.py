"""The commands as a user or a script calls them: output, JSON, quiet, exit codes, files."""

import itertools
import json
import os
import subprocess
import sys

import numpy as np
import pytest

from lens_cases import write_pictures
from midspan.cli.main import COMMANDS, run
from recording_edits import append, error_mm, read_columns, set_keys
from repeats import slow

FORMATS = [".csv", ".parquet", ".h5", ".mat", ".xlsx", ".tdms", ".mseed", ".uff"]
RESULT_COLUMNS = "time_s,displacement_mm,displacement_std_mm,velocity_mm_s,source,status"
TRACK_COLUMNS = "time_s,x_px,y_px,std_x_px,std_y_px,status"


def one_document(text):
    """The single JSON document that `text` is, without NaN or Infinity, which JSON does not know."""

    def refuse(word):
        raise AssertionError(f"{word} is not JSON")

    return json.loads(text, parse_constant=refuse)


@pytest.fixture(scope="module")
def done(footbridge, tmp_path_factory):
    """A folder with a result in CSV, its track and the calibration of `footbridge`, and pictures of a checkerboard."""
    folder = tmp_path_factory.mktemp("done")
    assert run(["calibrate", str(footbridge), "-o", str(folder / "calibration.json"), "--quiet"]) == 0
    assert run(["estimate", str(footbridge), "-o", str(folder / "result.csv"), "--quiet"]) == 0
    assert run(["track", str(footbridge), "-o", str(folder / "track.csv"), "--quiet"]) == 0
    write_pictures(folder / "boards", 8, 2)
    store = ["replay", str(footbridge), "-o", str(folder / "store"), "-c", str(folder / "calibration.json")]
    assert run([*store, "--quiet"]) == 0
    return folder


# Each user of a store needs a name of its own.
NUMBERS = itertools.count()


def calls(footbridge, done, target):
    """Every command of NAMES as it is typed."""
    return {
        "simulate": ["simulate", "gnss", "-o", f"{target}/simulated"],
        "inspect": ["inspect", f"{footbridge}"],
        "calibrate": ["calibrate", f"{footbridge}", "-o", f"{target}/calibration.json"],
        "estimate": ["estimate", f"{footbridge}", "-o", f"{target}/result.csv"],
        "fleet": ["fleet", f"{site(footbridge, target)}", "--shards", "1", "--for", "3"],
        "batch": ["batch", f"{campaign(footbridge, target)}", "--runner", "local"],
        "track": ["track", f"{footbridge}", "-o", f"{target}/track.csv"],
        "lens": ["lens", f"{done}/boards", "-o", f"{target}/lens.json"],
        "compare": ["compare", f"{done}/result.csv", f"{footbridge}/truth.csv"],
        "init": ["init", f"{footbridge}/accel.csv", f"{footbridge}/camera.mkv", "-o", f"{target}/made"],
        "spectrum": ["spectrum", f"{done}/result.csv"],
        "formats": ["formats"],
        "methods": ["methods"],
        "check-config": ["check-config", f"{footbridge}"],
        "help": ["help", "fusion"],
        "open": ["open", f"{footbridge}", "--no-browser", "--for", "0.5"],
        "run": ["run", f"{site(footbridge, target)}", "--for", "1"],
        "serve": ["serve", f"{done}/store", "--listen", "127.0.0.1:0", "--for", "0.5"],
        "access": ["access", f"{done}/store", "add-user", f"user-{next(NUMBERS)}", "--scope", "read"],
        "store": ["store", f"{done}/store", "check"],
        "replay": ["replay", f"{footbridge}", "-o", f"{target}/store", "-c", f"{done}/calibration.json"],
        "export": ["export", f"{done}/store", "-o", f"{target}/rows.csv"],
    }


def campaign(footbridge, target):
    """A CAMPAIGN.toml of one recording."""
    file = target / "CAMPAIGN.toml"
    file.write_text(f'recordings = ["{footbridge}"]\noutput = "results"\n')
    return file


def site(footbridge, target):
    """A SITE.toml of one point that replays a recording, on a port that is free."""
    file = target / "SITE.toml"
    file.write_text(
        'name = "site"\n[store]\npath = "store"\n[service]\nlisten = "127.0.0.1:0"\n[[point]]\nname = "p"\n'
        f'[point.accelerometer]\nsource = "replay:{footbridge}"\n'
        f'[point.camera]\nsource = "replay:{footbridge}"\ndirection = "y"\n'
    )
    return file


# `papers` runs for long: tests/papers/test_papers_claims.py has the same three tests of it.
NAMES = [name for name in COMMANDS if name not in ("demo", "papers")]
LONG = ("fleet", "lens", "open", "run", "serve")
QUICK = [name for name in NAMES if name not in LONG]


@pytest.mark.parametrize("name", NAMES)
def test_json_is_one_document_on_standard_output_and_nothing_else(name, footbridge, done, tmp_path, capsys):
    assert run([*calls(footbridge, done, tmp_path)[name], "--json"]) == 0
    assert isinstance(one_document(capsys.readouterr().out), dict)


@pytest.mark.parametrize("name", [*QUICK, *slow(*LONG)])
def test_quiet_says_nothing(name, footbridge, done, tmp_path, capsys):
    assert run([*calls(footbridge, done, tmp_path)[name], "--quiet"]) == 0
    said = capsys.readouterr()
    assert (said.out, said.err) == ("", "")


@pytest.mark.parametrize("name", [*QUICK, *slow(*LONG)])
def test_without_options_a_command_speaks_to_people(name, footbridge, done, tmp_path, capsys):
    assert run(calls(footbridge, done, tmp_path)[name]) == 0
    assert len(capsys.readouterr().out) > 20


@pytest.mark.parametrize("name", list(COMMANDS))
def test_every_command_explains_itself_and_has_the_common_options(name, capsys):
    assert run([name, "--help"]) == 0
    text = capsys.readouterr().out
    assert "--json" in text
    assert "--quiet" in text


@pytest.mark.parametrize("name", list(COMMANDS))
def test_an_unknown_option_is_wrong_use_in_words_and_in_json(name, capsys):
    assert run([name, "--nonsense", "--json"]) == 2
    said = capsys.readouterr()
    assert one_document(said.out)["exit_code"] == 2
    assert "--nonsense" in said.err


@pytest.mark.parametrize(
    "name", ["inspect", "calibrate", "estimate", "track", "lens", "compare", "check-config", "simulate"]
)
def test_a_missing_argument_is_wrong_use(name, capsys):
    assert run([name]) == 2
    assert name in capsys.readouterr().err


def test_an_unknown_command_is_wrong_use(capsys):
    assert run(["nonsense"]) == 2
    assert "nonsense" in capsys.readouterr().err
    assert run([]) == 2


@pytest.mark.parametrize("command", [["estimate"], ["calibrate"], ["inspect"], ["check-config"]])
def test_an_error_with_json_is_one_document_too(command, tmp_path, capsys):
    assert run([*command, str(tmp_path / "nowhere"), "--json"]) == 3
    said = capsys.readouterr()
    document = one_document(said.out)
    assert document["exit_code"] == 3
    assert "nowhere" in document["error"]
    assert "nowhere" in said.err


def test_the_installed_command_returns_the_exit_code_and_no_traceback(tmp_path):
    code = "from midspan.cli.main import main; main()"
    arguments = [sys.executable, "-c", code, "estimate", str(tmp_path / "nowhere")]
    called = subprocess.run(arguments, capture_output=True, text=True, check=False)
    assert called.returncode == 3
    assert called.stdout == ""
    assert "Traceback" not in called.stderr
    assert called.stderr.startswith("midspan: ")


def test_the_version_is_reported(capsys):
    assert run(["--version"]) == 0
    assert capsys.readouterr().out.startswith("midspan ")


def test_calibrate_writes_into_the_recording_and_prints_the_keys_that_are_relied_on(footbridge_copy, capsys):
    assert run(["calibrate", str(footbridge_copy), "--json"]) == 0
    printed = one_document(capsys.readouterr().out)
    written = one_document((footbridge_copy / "calibration.json").read_text(encoding="utf-8"))
    for tree in (printed, written):
        assert tree["camera"]["scale_mm_per_px"] == pytest.approx(-1.5, rel=3e-3)
        assert tree["camera"]["time_offset_s"] == pytest.approx(0.137, abs=1e-3)
        assert {"scale_std_mm_per_px", "time_offset_std_s", "roi"} <= set(tree["camera"])
        assert tree["accelerometer"]["noise_std_m_s2"] > 0
        assert {"version", "created", "warnings"} <= set(tree)


def test_estimate_writes_csv_with_the_columns_and_json_beside_it(done):
    lines = (done / "result.csv").read_text(encoding="utf-8").splitlines()
    assert lines[0] == RESULT_COLUMNS
    companions = one_document((done / "result.json").read_text(encoding="utf-8"))
    assert {"midspan", "settings", "calibration", "method"} <= set(companions)
    assert (done / "track.csv").read_text(encoding="utf-8").splitlines()[0] == TRACK_COLUMNS


@pytest.fixture(scope="module")
def repeated(footbridge, done, tmp_path_factory):
    """A result.csv with the calibration from its file."""
    target = tmp_path_factory.mktemp("repeated") / "result.csv"
    assert run(["estimate", str(footbridge), "-c", str(done / "calibration.json"), "-o", str(target), "--quiet"]) == 0
    return target


@pytest.mark.parametrize("suffix", FORMATS)
def test_every_format_holds_the_same_displacement(suffix, footbridge, done, repeated, tmp_path, capsys):
    target = tmp_path / f"ergebnis ü{suffix}"
    arguments = ["estimate", str(footbridge), "-c", str(done / "calibration.json"), "-o", str(target), "--quiet"]
    assert run(arguments) == 0
    assert run(["compare", str(target), str(repeated), "--json"]) == 0
    figures = one_document(capsys.readouterr().out)
    # CSV keeps a picometre.
    assert figures["rmse_mm"] < 1e-6
    assert figures["count"] == len(read_columns(done / "result.csv"))
    assert figures["coverage_95"] == 1.0


def test_compare_prints_the_figures_of_the_error(footbridge, done, capsys):
    assert run(["compare", str(done / "result.csv"), str(footbridge), "--json"]) == 0
    figures = one_document(capsys.readouterr().out)
    rows = np.genfromtxt(done / "result.csv", delimiter=",", skip_header=1, usecols=(0, 1))
    error = error_mm(footbridge, rows[:, 0], rows[:, 1])
    # The truth stands at the result's own instants, so a spline and a straight line through it agree there.
    assert figures["rmse_mm"] == pytest.approx(np.sqrt(np.mean(error**2)), rel=1e-6)
    assert figures["bias_mm"] == pytest.approx(np.mean(error), rel=1e-6)
    assert figures["largest_error_mm"] == pytest.approx(np.max(np.abs(error)), rel=1e-6)
    assert figures["correlation"] > 0.9999
    assert abs(figures["lag_s"]) < 1e-3


def test_compare_says_first_that_the_zero_alone_differs(done, tmp_path, capsys):
    with (done / "result.csv").open(encoding="utf-8") as lines:
        rows = [line.split(",")[:2] for line in lines if line[0].isdigit()]
    moved = "".join(f"{time},{float(value) + 12.5}\n" for time, value in rows)
    (tmp_path / "moved.csv").write_text("time_s,displacement_mm\n" + moved)
    assert run(["compare", str(done / "result.csv"), str(tmp_path / "moved.csv"), "--unit", "mm"]) == 0
    lines = capsys.readouterr().out.splitlines()
    (said,) = (line for line in lines if "of it the zero" in line)
    assert "-12.5 mm; without it RMSE " in said
    assert "100.0 % inside" in said
    assert lines.index(said) < 5


def test_compare_takes_the_unit_of_a_reference_that_does_not_say_it(footbridge, done, tmp_path, capsys):
    known = read_columns(footbridge / "truth.csv")
    table = np.column_stack((known[:, 0], known[:, 1] / 10.0))
    np.savetxt(tmp_path / "level.csv", table, delimiter=",", header="time,level", comments="", fmt="%.8f")
    arguments = ["compare", str(done / "result.csv"), str(tmp_path / "level.csv"), "--unit", "cm", "--json"]
    assert run(arguments) == 0
    assert one_document(capsys.readouterr().out)["rmse_mm"] < 0.03


def test_the_method_of_the_command_line_wins_over_the_file(footbridge_copy, capsys):
    set_keys(footbridge_copy, "fusion", method="smoother")
    assert run(["estimate", str(footbridge_copy), "--method", "kalman", "--json"]) == 0
    assert one_document(capsys.readouterr().out)["method"] == "kalman"
    assert (footbridge_copy / "result.csv").is_file()


def test_the_default_output_is_in_the_recording(footbridge_copy):
    assert run(["estimate", str(footbridge_copy / "recording.toml"), "--quiet"]) == 0
    assert (footbridge_copy / "result.csv").is_file()
    assert (footbridge_copy / "result.json").is_file()


@pytest.mark.usefixtures("undrawn")
def test_a_report_is_one_file_that_needs_no_other(footbridge, done, tmp_path):
    pytest.importorskip("midspan.report.report")
    target = tmp_path / "bericht ü.html"
    arguments = ["estimate", str(footbridge), "-o", str(tmp_path / "r.csv"), "--report", str(target), "--quiet"]
    assert run(arguments) == 0
    text = target.read_text(encoding="utf-8")
    assert text.lstrip().lower().startswith("<!doctype html>")
    for outside in ('src="http', 'href="http', "@import", "url(http"):
        assert outside not in text
    assert sorted(os.listdir(tmp_path)) == ["bericht ü.html", "r.csv", "r.json"]


def test_simulate_gives_the_same_files_for_the_same_seed(tmp_path):
    for name, seed in (("a", 3), ("b", 3), ("c", 4)):
        assert run(["simulate", "gnss", "-o", str(tmp_path / name), "--seed", str(seed), "--quiet"]) == 0
    first, second, third = ((tmp_path / name / "accel.csv").read_bytes() for name in "abc")
    assert first == second != third
    assert (tmp_path / "a" / "truth.csv").is_file()


def test_simulate_breaks_what_it_is_reported_to_in_lists_or_repeated(tmp_path, capsys):
    words = ["simulate", "gnss", "-o", str(tmp_path / "a"), "--break", "gain,step", "--break", "colour", "--json"]
    assert run(words) == 0
    assert json.loads(capsys.readouterr().out)["broken"] == ["gain", "step", "colour"]
    assert set(json.loads((tmp_path / "a" / "known.json").read_text())["broken"]) == {"gain", "step", "colour"}
    assert run(["simulate", "gnss", "-o", str(tmp_path / "b"), "--break", "pattern"]) == 2
    assert "It fits day-and-night" in capsys.readouterr().err


def test_simulate_lists_its_scenarios(capsys):
    assert run(["simulate", "--list", "--json"]) == 0
    assert {"footbridge", "beam", "gnss", "no-excitation"} <= set(one_document(capsys.readouterr().out))


def test_track_takes_region_and_every(footbridge, tmp_path):
    target = tmp_path / "t.csv"
    arguments = ["track", str(footbridge / "camera.mkv"), "--roi", "16,16,57,57", "--every", "4", "-o", str(target)]
    assert run([*arguments, "--quiet"]) == 0
    assert len(target.read_text(encoding="utf-8").splitlines()) == 1 + 62
    assert one_document((tmp_path / "t.json").read_text(encoding="utf-8"))["roi"] == [16, 16, 57, 57]


def test_inspect_shows_a_recording_and_a_single_file(footbridge, capsys):
    assert run(["inspect", str(footbridge)]) == 0
    text = capsys.readouterr().out
    for word in ("accelerometer", "camera", "100 Hz", "10 Hz", "overlap", "gaps"):
        assert word in text
    assert run(["inspect", str(footbridge / "accel.csv")]) == 0
    assert "accel: 2500 samples" in capsys.readouterr().out


def test_check_config_prints_all_settings_and_tells_missing_files(footbridge_copy, capsys):
    (footbridge_copy / "accel.csv").unlink()
    assert run(["check-config", str(footbridge_copy), "--json"]) == 0
    document = one_document(capsys.readouterr().out)
    assert document["valid"] is True
    assert document["settings"]["camera"]["every"] == 1
    assert any("accel.csv" in line for line in document["warnings"])


def test_check_config_refuses_an_unknown_key(footbridge_copy, capsys):
    append(footbridge_copy, "[fusion]\nmetod = 'kalman'")
    assert run(["check-config", str(footbridge_copy)]) == 2
    assert "'method'" in capsys.readouterr().err


def test_methods_and_formats_name_what_the_settings_take(capsys):
    assert run(["methods", "--json"]) == 0
    methods = one_document(capsys.readouterr().out)
    assert {"smoother", "kalman"} <= set(methods["methods"])
    assert methods["default_tracker"] in methods["trackers"]
    assert run(["formats", "--json"]) == 0
    formats = one_document(capsys.readouterr().out)
    written = {suffix for row in formats["results"] for suffix in row["suffixes"]}
    assert set(FORMATS) <= written


def test_an_old_result_is_replaced_whole(footbridge, tmp_path):
    target = tmp_path / "result.csv"
    target.write_text("old\n" * 100_000, encoding="utf-8")
    target.with_suffix(".json").write_text('{"midspan": "0.0.1"}', encoding="utf-8")
    assert run(["estimate", str(footbridge), "-o", str(target), "--quiet"]) == 0
    text = target.read_text(encoding="utf-8")
    assert text.startswith(RESULT_COLUMNS)
    assert "old" not in text
    assert sorted(os.listdir(tmp_path)) == ["result.csv", "result.json"]


def test_a_signal_to_stop_leaves_nothing_half_written(footbridge, tmp_path, monkeypatch, capsys):
    from midspan.recording import estimate as module

    def interrupted(*arguments, **keywords):
        raise KeyboardInterrupt

    monkeypatch.setattr(module, "check", interrupted)
    assert run(["estimate", str(footbridge), "-o", str(tmp_path / "result.csv")]) == 130
    assert os.listdir(tmp_path) == []
    assert "interrupted" in capsys.readouterr().err


def test_demo_makes_a_recording_and_comes_close_to_the_bound(tmp_path, capsys):
    folder = tmp_path / "demo"
    assert run(["demo", "-o", str(folder), "--json"]) == 0
    figures = one_document(capsys.readouterr().out)
    # The zero rests on one frame: single recordings come out between 0.6 and 2 times the least error that the
    # simulated sensors' noise allows, 1.12 times in the root mean square (twelve held-out seeds, benchmark demo_bound).
    assert figures["ratio_to_bound"] < 2.0
    # Without the zero's part the error lies below that bound, which holds it.
    assert figures["rmse_without_bias_mm"] < figures["bound_mm"]
    assert figures["correlation"] > 0.9999
    assert {"recording", "report.html", "result.csv", "result.json"} <= {path.name for path in folder.iterdir()}
    assert (folder / "recording" / "calibration.json").is_file()
    # A minute at 100 Hz with all its rows and pictures can be sent by mail.
    assert (folder / "report.html").stat().st_size <= 1.5e6


def test_a_calibration_of_another_sensor_is_refused_by_name(gnss, done, tmp_path, capsys):
    arguments = ["estimate", str(gnss), "-c", str(done / "calibration.json"), "-o", str(tmp_path / "r.csv")]
    assert run(arguments) == 2
    assert "displacement" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []
