"""Where a campaign's results go: under readable names, and as the recordings that it names, neither more nor less."""

import os
import shutil
import sys

import pandas as pd
import pytest
from campaign_runs import NAMES, rows_of

import midspan
from midspan.errors import UsageError
from midspan.scale.places import folder_name


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
