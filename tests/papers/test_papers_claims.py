"""The papers' claims, repeated: which hold, which do not, and what the command prints of them."""

import json
import os
import re
from dataclasses import replace

import numpy as np
import pytest
from click.testing import CliRunner

from midspan.cli.console import commands
from midspan.papers import entries_000, entries_001, entries_002, entries_003, entries_004, two_stage_003
from midspan.papers.claims import Claim, Effort, Entry, Experiment, Measured, Verdict, judged
from midspan.papers.page import brief_cells, write_papers
from midspan.papers.table import MODULES, experiments, repeat

# Claims that do not hold, each with its reason in `Entry.because`.
FAILING = {
    ("000", "Table 1"), ("000", "Table 1, true factor"),
    ("003", "Table 3"), ("003", "Fig. 16 (b)"), ("003", "Fig. 20, 21"), ("003", "Fig. 22"),
    ("003", "Fig. 23"), ("003", "Fig. 24"), ("002", "Table 1"),
    ("001", "Fig. 12 (b), 13"), ("001", "Fig. 14"), ("001", "Fig. 12 to 14, per frame"), ("001", "Fig. 18"),
}  # fmt: skip
# Claims so near to their limit that three seeds do not settle them, and ratios of processor times.
EITHER = {
    ("000", "Fig. 9"), ("000", "Table 2"), ("000", "Table 2, true factor"), ("000", "Table 4"),
    ("000", "Table 4, true factor"), ("000", "Table 4, guarded"), ("000", "Table 6"),
    ("000", "Table 6, true factor"), ("000", "Table 6, guarded"), ("004", "Sec. 4.2, 4.3, time"),
    ("001", "Fig. 12, 13"),
}  # fmt: skip
UNTRIED = {("000", "Fig. 12")}
# On the first seed, and where that one contradicts, on the mean of three; infrared and radar, which cost most and hold
# by far, on the first alone. `python -m benchmarks papers` takes the mean of three everywhere.
THREE = (*entries_000.EXPERIMENTS, *entries_003.EXPERIMENTS, *entries_004.EXPERIMENTS)
ONE = (*entries_001.EXPERIMENTS, *entries_002.EXPERIMENTS)
EVERY = (*THREE, *ONE)
# A second or two each; the rest of 000, 001 and 004 takes minutes.
BRIEF = [one for one in EVERY if one.paper in ("002", "003") or one.name == "time of rejection"]
MODULES_OF_PAPERS = (entries_000, entries_001, entries_002, entries_003, entries_004)


def unheard(done, total, what):
    """Nobody is reported of progress."""


def expected(experiments):
    keys = {(one.paper, entry.where) for one in experiments for entry in one.entries} - EITHER
    other = dict.fromkeys(FAILING, Verdict.FAILS.value) | dict.fromkeys(UNTRIED, Verdict.UNTRIED.value)
    return {key: other.get(key, Verdict.HOLDS.value) for key in keys}


@pytest.mark.parametrize(
    "chosen", [pytest.param(BRIEF, id="brief"), pytest.param(EVERY, marks=pytest.mark.slow, id="every")]
)
def test_the_command_over_all_papers_and_its_claims(chosen, tmp_path, monkeypatch):
    """One test, so that the command runs once: its numbers are those of the first seed."""
    for module in MODULES_OF_PAPERS:
        monkeypatch.setattr(module, "EXPERIMENTS", tuple(one for one in module.EXPERIMENTS if one in chosen))
    page = tmp_path / "papers.md"
    ran = CliRunner().invoke(commands, ["papers", "--quick", "--json", "--report", str(page)])
    assert ran.exit_code == 0, ran.output
    reported = json.loads(ran.stdout)["rows"]
    entries = [(one.paper, entry.where) for one in experiments(MODULES) for entry in one.entries]
    assert [(row["paper"], row["where"]) for row in reported] == entries
    assert all(row["why"] for row in reported)
    # The short table leaves out the variants of a published figure: Fig. 10, true factor.
    shown = []
    for row in reported:
        before = shown[-1] if shown else {"published": None, "where": ""}
        if row["published"] != before["published"] or not row["where"].startswith(f"{before['where']}, "):
            shown.append(row)
    fails = sum(row["verdict"] == Verdict.FAILS.value for row in shown)
    assert len(re.findall(r"\| no(: [^|]+)? \|$", page.read_text(encoding="utf-8"), re.MULTILINE)) == fails
    assert all((tmp_path / "images" / name).exists() for name in ("paper_003_fig16a.png", "paper_003_fig27c.png"))
    first = {(row["paper"], row["where"]): row for row in reported}
    wanted = expected(chosen)
    found = {key: first[key]["verdict"] for key in wanted}
    # Our default never errs more than the best method as printed.
    factors = {key: row["factor"] for key, row in first.items() if row["factor"] is not None}

    def contradicts(one):
        keys = [(one.paper, entry.where) for entry in one.entries]
        return any(found.get(key) != wanted.get(key) or factors.get(key, 1.0) < 1.0 for key in keys)

    again = [one for one in THREE if one in chosen and contradicts(one)]
    for one in repeat(again, quick=True, seeds=(1, 2), progress=unheard, processes=os.cpu_count() or 1):
        for row in one.rows:
            key = row.paper, row.entry.where
            # The second and the third seed count as often as each.
            seeds = [Measured(first[key]["values"]), *2 * [Measured(row.values)]]
            [mean] = judged(replace(one.experiment, entries=(row.entry,)), seeds)
            found[key], factors[key] = mean.verdict.value, mean.factor
    assert {key: found[key] for key in wanted} == wanted
    assert not {key: factor for key, factor in factors.items() if factor is not None and factor < 1.0}


def test_a_row_shows_what_less_noise_gives_and_is_judged_without_it():
    entry = Entry("T", "w", "p", ("a",), ("b",), {"c": "b < 0.5 · a"}, errors=True)
    noisy, clean = Measured({"a": 3.0, "b": 1.0}), Measured({"a": 0.3, "b": 0.2})
    experiment = Experiment("000", "x", lambda effort: noisy, (entry,), cleaner=lambda effort: clean)
    (outcome,) = repeat([experiment], quick=True, seeds=(0, 1), progress=unheard)
    (row,) = outcome.rows
    assert row.verdict is Verdict.HOLDS
    assert row.with_less_noise == "a 0.3 mm; ours b 0.2 mm; does not hold"
    assert row.to_dict()["with_less_noise"] == row.with_less_noise


def test_a_claim_is_an_inequality_that_must_hold_in_every_case():
    values = {"a": np.array([1.0, 2.0]), "b": np.array([3.0, 3.0]), "none": np.array([np.nan, 1.0])}
    assert Claim.of("", "a < b").holds(values)
    assert not Claim.of("", "a < 0.5 · b").holds(values)
    assert Claim.of("", "b > 1.4 · a").holds(values)
    assert Claim.of("", "a < 2.5").holds(values)
    # What was not measured proves nothing, in either direction.
    assert not Claim.of("", "none < 5").holds(values)
    assert not Claim.of("", "none > 0").holds(values)


def test_rows_are_judged_on_the_mean_of_the_seeds_and_give_the_factor():
    entry = Entry("T", "w", "p", ("a at 1 Hz",), ("b at 1 Hz",), {"c": "a at 1 Hz < 1.5"}, errors=True)
    untried = Entry("U", "w", "p", because="no film of it")
    found = [Measured({"a at 1 Hz": value, "b at 1 Hz": 0.5}) for value in (0.5, 1.5, 2.0)]
    held, left = judged(Experiment("003", "x", lambda effort: found[0], (entry, untried)), found)
    assert (held.verdict, left.verdict) == (Verdict.HOLDS, Verdict.UNTRIED)
    assert held.factor == pytest.approx((4.0 / 3.0) / 0.5)
    assert held.printed == "a 1.33 mm"
    assert left.why == "no film of it"


def test_a_row_says_where_our_default_errs_more_and_gives_numbers_their_own_units():
    entry = Entry("T", "w", "p", ("a", "a off by (%)"), ("b",), {"c": "a < 9"}, errors=True)
    better, worse = (
        judged(Experiment("003", "x", unheard, (entry,)), [Measured({"a": 1.0, "a off by (%)": 0.1, "b": ours})])[0]
        for ours in (0.5, 2.0)
    )
    assert (better.compared, better.worse) == ("2 times less", False)
    assert (worse.compared, worse.worse) == ("WORSE: 2 times more", True)
    assert worse.printed == "a 1 mm; a off by 0.1 %"


def test_a_row_of_the_short_table_says_the_verdict_and_the_first_reason():
    entry = Entry(
        "Fig. 1", "w", "1 / 2", ("a",), ("b",), {"c": "a < 2"}, errors=True, because="It is late. Far too late."
    )
    small, large = Measured({"a": 1.0, "b": 0.5}), Measured({"a": [4.0, 3.0], "b": [1.0, 1.0]})
    held, failed, only_noisy = (
        judged(Experiment("003", "x", unheard, (entry,)), [first], cleaner)[0]
        for first, cleaner in ((small, []), (large, []), (small, [large]))
    )
    assert brief_cells(held) == ("Fig. 1: w", "1/2", "a 1 mm", "b 0.5 mm", "yes")
    assert brief_cells(failed) == ("Fig. 1: w", "1/2", "a 4/3 mm", "b 1/1 mm", "no: It is late")
    assert only_noisy.brief == "yes; with less noise no"


def test_the_first_sentence_of_a_reason_has_at_most_eight_words():
    entries = [entry for one in experiments(MODULES) for entry in one.entries]
    assert [entry.where for entry in entries if len(entry.because.split(". ")[0].split()) > 8] == []


def test_experiments_in_two_processes_are_those_in_one():
    some = (entries_003.ALIASES, entries_003.BEAM)
    alone, apart = (
        repeat(some, quick=True, seeds=(0, 1), progress=unheard, processes=processes) for processes in (1, 2)
    )
    shown = [[(row.entry.where, row.printed, row.ours) for one in run for row in one.rows] for run in (alone, apart)]
    assert shown[0] == shown[1]


def test_the_alias_formula_is_what_a_spectrum_of_samples_shows():
    for rate_hz in (3.0, 5.0, 6.0, 10.0):
        for tone_hz in two_stage_003.TONES_HZ:
            seen = two_stage_003.sampled_alias_hz(tone_hz, rate_hz)
            assert two_stage_003.alias_hz(tone_hz, rate_hz) == pytest.approx(seen, abs=0.01)  # 100 s: 0.01 Hz


def test_measuring_again_with_the_same_seed_gives_the_same_numbers():
    first, second = (two_stage_003.pushed(Effort(3, True)).values for _ in range(2))
    assert first == second


def test_it_speaks_to_people_and_is_silent_when_asked(monkeypatch):
    monkeypatch.setattr(entries_003, "EXPERIMENTS", (entries_003.ALIASES,))
    reported, silent = (
        CliRunner().invoke(commands, ["papers", "--quick", "--only", "003", *more]) for more in ((), ("--quiet",))
    )
    assert "003 Table 3" in reported.stdout
    assert "0 holds, 1 does not hold" in reported.stdout
    assert (silent.exit_code, silent.stdout) == (0, "")


def test_the_page_needs_no_network_and_holds_every_row(tmp_path):
    some = (entries_003.ALIASES, entries_003.BEAM)
    outcomes = repeat(some, quick=True, seeds=(0,), progress=unheard)
    html = write_papers(outcomes, tmp_path / "papers.html", "midspan papers").read_text(encoding="utf-8")
    assert "Content-Security-Policy" in html
    assert "http://" not in html.replace("http://www.w3.org", "")
    assert all(entry.where in html for one in some for entry in one.entries)
    assert html.count("<figure") == 2


@pytest.mark.parametrize(("name", "reported"), [("x.pdf", ".html or .md"), ("none/x.md", "does not exist")])
def test_a_report_that_cannot_be_written_is_refused_before_anything_runs(tmp_path, name, reported):
    ran = CliRunner().invoke(commands, ["papers", "--report", str(tmp_path / name)])
    assert ran.exit_code == 2
    assert reported in ran.output


def test_a_page_of_markdown_makes_the_folder_of_its_figures(tmp_path):
    outcomes = repeat((entries_003.BEAM,), quick=True, seeds=(0,), progress=unheard)
    text = write_papers(outcomes, tmp_path / "papers.md", "midspan papers").read_text(encoding="utf-8")
    assert all((tmp_path / name).exists() for name in re.findall(r"\]\((images/[^)]+)\)", text))
