"""Where a campaign's results go: under readable names, and as the recordings that it names, neither more nor less."""

import os
import shutil
import sys

import pandas as pd
import pytest
from campaign_runs import NAMES, rows_of

import midspan
from midspan.cli.main import run
from midspan.errors import UsageError
from midspan.scale.jobs import jobs_of
from midspan.scale.places import folder_name
from midspan.settings.campaign import load_campaign


def test_names_stay_readable_and_short_enough_for_a_folder():
    assert folder_name("Мост/опора 1") == "Мост%2Fопора%201"
    assert folder_name("2026-01/a=b") == "2026-01%2Fa%3Db"
    for name in ("桥梁" * 60, "м" * 120, "/" * 120):
        short = folder_name(name)
        assert len(short.encode()) <= 200
        assert short != folder_name(f"{name}1")


@pytest.mark.skipif(sys.platform == "win32", reason="its paths are shorter")
def test_recordings_in_long_folders_of_any_script_are_estimated(campaign):
    names = ["2026-03/" + "мост" * 30, "2026-03/" + "桥" * 80]
    for name in names:
        shutil.copytree(campaign / NAMES[0], campaign / name)
    found = midspan.batch(campaign, runner="local")
    assert found.exit_code == 0
    assert {*names} <= {*pd.read_csv(campaign / "results" / "summary.csv")["recording"]}
    assert rows_of(campaign)["recording"].nunique() == len(NAMES) + len(names)
    assert midspan.batch(campaign, runner="local").outcomes == found.outcomes


def test_what_the_campaign_names_no_more_goes_and_nothing_else(campaign):
    midspan.batch(campaign, runner="local")
    results = campaign / "results"
    (results / "rows" / "mine").mkdir()
    (results / "rows" / "recording=mine").mkdir()
    (results / "rows" / "recording=mine" / "notes.txt").write_text("kept")
    os.rename(campaign / NAMES[1], campaign / "2026-01" / "c")
    found = midspan.batch(campaign, runner="local")
    assert found.warnings[0].endswith("removed: 2026-01%2Fb.")
    assert (results / "rows" / "mine").is_dir()
    notes = results / "rows" / "recording=mine" / "notes.txt"
    assert notes.read_text() == "kept"
    notes.unlink()
    assert sorted(rows_of(campaign)["recording"].dropna().unique()) == ["2026-01/a", "2026-01/c", "2026-02/a"]
    assert sorted(one.stem for one in (results / "done").iterdir()) == ["2026-01%2Fa", "2026-01%2Fc", "2026-02%2Fa"]


def test_two_campaigns_do_not_share_an_output(campaign):
    midspan.batch(campaign, runner="local")
    before = rows_of(campaign)
    other = campaign / "OTHER.toml"
    other.write_text(f'recordings = ["{NAMES[0]}"]\noutput = "results"\n')
    with pytest.raises(UsageError, match=r"has the results of another campaign, \.\./CAMPAIGN\.toml"):
        midspan.batch(other)
    pd.testing.assert_frame_equal(rows_of(campaign), before)
    (campaign / "strange" / "rows").mkdir(parents=True)
    other.write_text(f'recordings = ["{NAMES[0]}"]\noutput = "strange"\n')
    with pytest.raises(UsageError, match="has a folder rows that no campaign made"):
        midspan.batch(other)


@pytest.mark.parametrize("bytes_kept", [0, 1000])
def test_rows_that_were_cut_short_are_made_again(bytes_kept, campaign):
    midspan.batch(campaign, runner="local")
    before = rows_of(campaign)
    part = campaign / "results" / "rows" / f"recording={folder_name(NAMES[0])}" / "part.parquet"
    os.truncate(part, bytes_kept)
    assert midspan.batch(campaign, runner="local").exit_code == 0
    pd.testing.assert_frame_equal(rows_of(campaign), before)


@pytest.mark.skipif(sys.platform != "linux", reason="other systems refuse such names")
def test_a_name_that_is_no_text_fails_in_a_sentence(campaign, capsys):
    os.rename(campaign / NAMES[1], os.fsencode(campaign / "2026-01") + b"/caf\xe9")
    for runner in ("local", "process"):
        outcomes = midspan.batch(campaign, runner=runner, workers=1).outcomes
        assert [one.exit_code for one in outcomes] == [0, 3, 0]
        assert "its name is not in UTF-8. Rename the folder." in outcomes[1].message
    assert run(["batch", str(campaign), "--runner", "local", "--json"]) == 3
    assert "caf\\\\udce9" in capsys.readouterr().out


def test_another_output_is_relative_to_where_the_command_is_given(campaign, tmp_path, monkeypatch):
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    assert run(["batch", str(campaign), "--runner", "local", "-o", "mine", "--quiet"]) == 0
    assert (tmp_path / "elsewhere" / "mine" / "summary.csv").is_file()
    assert not (campaign / "results").exists()


REFUSED = {
    'recordings = ["2026-*/*"]\noutput = "r"\nmethd = "kalman"': "Known: recordings, table, output, method, tracker",
    'recordings = ["2026-*/*"]\noutput = "r"\nmethod = "kalmann"': "method = 'kalmann': must be one of smoother",
    'recordings = ["2026-*/*"]\noutput = "s3://bucket/r"': "must be a folder of this machine, not a URL",
    'recordings = ["2026-*/*"]\noutput = "r"\ncalibration = "none.json"': "none.json: cannot be read",
    'table = "none.csv"\noutput = "r"': "none.csv: cannot be read (No such file or directory)",
    'recordings = ["2026-*/*", "2026-09/a"]\noutput = "r"': "2026-09/a: has no recording.toml",
    'recordings = ["memory://nothing/a"]\noutput = "r"': "memory://nothing/a: has no recording.toml",
    'recordings = ["none*"]\noutput = "r"': "no recording matches none*",
}


@pytest.mark.parametrize("text", REFUSED)
@pytest.mark.parametrize("command", ["batch", "check-config"])
def test_a_wrong_campaign_ends_at_once_with_a_sentence(command, text, campaign, capsys):
    file = campaign / "CAMPAIGN.toml"
    file.write_text(text)
    assert run([command, str(file)]) == 2
    assert REFUSED[text] in capsys.readouterr().err
    assert not (campaign / "r").exists()


def test_a_recording_is_no_output_and_a_missing_file_no_campaign(campaign):
    with pytest.raises(UsageError, match="is the folder of a recording"):
        midspan.batch(campaign, output=campaign / NAMES[0])
    with pytest.raises(UsageError, match="not a URL"):
        midspan.batch(campaign, output="s3://bucket/results")
    with pytest.raises(UsageError, match="cannot be read"):
        midspan.batch(campaign / NAMES[0] / "none.toml")


def test_a_glob_without_a_recording_is_said(campaign, capsys):
    file = campaign / "CAMPAIGN.toml"
    file.write_text(f'recordings = ["{NAMES[0]}", "2027-*"]\noutput = "results"\n')
    assert run(["batch", str(file), "--runner", "local"]) == 0
    assert "'2027-*' in recordings matches no recording" in capsys.readouterr().err
    assert run(["check-config", str(campaign)]) == 0
    assert "valid, 1 recordings" in capsys.readouterr().out


@pytest.mark.parametrize("delimiter", [";", "\t", ","])
def test_a_table_of_a_spreadsheet_is_read(delimiter, campaign):
    lines = [["Accelerometer ", " VIDEO", "rate_hz"], ["a.csv", " b.csv ", "25.0"], ["", "", ""]]
    text = "\r\n".join(delimiter.join(line) for line in lines)
    (campaign / "pairs.csv").write_bytes(b"\xef\xbb\xbf" + text.encode())
    file = campaign / "CAMPAIGN.toml"
    file.write_text('table = "pairs.csv"\noutput = "results"\n')
    settings, _ = load_campaign(file)
    ((job,), _) = jobs_of(settings, campaign)
    assert (job.name, job.path.name, job.second.name, job.choices) == ("b", "a.csv", "b.csv", {"rate_hz": 25.0})
    for wrong in ("25,0 Hz", ""):
        (campaign / "pairs.csv").write_text(f"accelerometer;video;rate_hz\na.csv;{'b.csv' if wrong else ''};{wrong}\n")
        with pytest.raises(UsageError, match="row 1"):
            jobs_of(settings, campaign)


def test_messages_about_what_was_fetched_name_its_url(campaign):
    memory = pytest.importorskip("fsspec").filesystem("memory")
    memory.pipe("/wrong/a/recording.toml", b"[accelerometer]\nfil = 'a.csv'\n")
    (campaign / "CAMPAIGN.toml").write_text('recordings = ["memory://wrong/*"]\noutput = "results"\n')
    (outcome,) = midspan.batch(campaign, runner="local").outcomes
    assert outcome.message.startswith("memory:///wrong/a/recording.toml: accelerometer.fil")
