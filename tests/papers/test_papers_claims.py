"""The papers' claims, repeated: which hold, which do not, and what the command prints of them."""

import json

import numpy as np
import pytest
from click.testing import CliRunner

from midspan.cli.group import commands
from midspan.evaluate.papers import entries_000, entries_001, entries_002, entries_003, entries_004, two_stage_003
from midspan.evaluate.papers.claims import Claim, Effort, Entry, Experiment, Measured, Verdict, judged
from midspan.evaluate.papers.table import repeat
from midspan.report.papers import write_papers

# Claims that do not hold, each with its reason in `Entry.because`; every other one does.
FAILING = {
    ("000", "Table 1"), ("000", "Table 2"), ("000", "Fig. 16"),
    ("003", "Table 3"), ("003", "Fig. 16 (b)"), ("003", "Fig. 20, 21"), ("003", "Fig. 22"),
    ("003", "Fig. 23"), ("003", "Fig. 24"), ("002", "Table 1"),
}  # fmt: skip


def verdicts(experiments, seeds):
    outcomes = repeat(experiments, quick=True, seeds=seeds, progress=lambda done, total, what: None)
    return {(row.paper, row.entry.where): row.verdict for one in outcomes for row in one.rows}


def expected(experiments):
    keys = [(one.paper, entry.where) for one in experiments for entry in one.entries]
    return {key: Verdict.FAILS if key in FAILING else Verdict.HOLDS for key in keys}


def test_the_claims_of_the_two_stage_paper_on_the_mean_of_three_seeds():
    assert verdicts(entries_003.EXPERIMENTS, 3) == expected(entries_003.EXPERIMENTS)


def test_the_claims_of_the_radar_paper():
    some = (entries_002.WALL, entries_002.BRIDGE)
    assert verdicts(some, 1) == expected(some)


# Here as many as a minute allows; `python -m benchmarks papers` repeats all of them with three seeds.
@pytest.mark.slow
def test_the_claims_of_the_paper_on_phase():
    films = (entries_000.INDOOR, entries_000.BRIDGE)
    assert verdicts(films, 1) == expected(films)


@pytest.mark.slow
def test_the_claims_of_the_paper_on_feature_matching():
    films = (entries_004.STOREY,)
    assert verdicts(films, 1) == expected(films)


def test_the_claims_of_the_paper_on_infrared_that_need_no_long_film():
    few = (entries_001.SCALE, entries_001.LIGHT)
    assert verdicts(few, 1) == expected(few)


def test_a_claim_is_an_inequality_that_must_hold_in_every_case():
    values = {"a": np.array([1.0, 2.0]), "b": np.array([3.0, 3.0]), "none": np.array([np.nan, 1.0])}
    assert Claim("", "a", 1.0, "b").holds(values)
    assert not Claim("", "a", 0.5, "b").holds(values)
    assert Claim("", "b", 1.4, "a", above=True).holds(values)
    assert Claim("", "a", 2.5).holds(values)
    # What was not measured proves nothing, in either direction.
    assert not Claim("", "none", 5.0).holds(values)
    assert not Claim("", "none", 0.0, above=True).holds(values)


def test_rows_are_judged_on_the_mean_of_the_seeds_and_give_the_factor():
    entry = Entry("T", "w", "p", ("a at 1 Hz",), ("b at 1 Hz",), (Claim("c", "a at 1 Hz", 1.5),), errors=True)
    untried = Entry("U", "w", "p", because="no film of it")
    found = [Measured({"a at 1 Hz": value, "b at 1 Hz": 0.5}) for value in (0.5, 1.5, 2.0)]
    held, left = judged(Experiment("003", "x", lambda effort: found[0], (entry, untried)), found)
    assert (held.verdict, left.verdict) == (Verdict.HOLDS, Verdict.UNTRIED)
    assert held.factor == pytest.approx((4.0 / 3.0) / 0.5)
    assert held.printed == "a 1.33 mm"
    assert left.why == "no film of it"


def test_the_alias_formula_is_what_a_spectrum_of_samples_shows():
    for rate_hz in (3.0, 5.0, 6.0, 10.0):
        for tone_hz in two_stage_003.TONES_HZ:
            seen = two_stage_003.sampled_alias_hz(tone_hz, rate_hz)
            assert two_stage_003.alias_hz(tone_hz, rate_hz) == pytest.approx(seen, abs=0.01)  # 100 s: 0.01 Hz


def test_measuring_again_with_the_same_seed_gives_the_same_numbers():
    first, second = (two_stage_003.pushed(Effort(3, True)).values for _ in range(2))
    assert first == second


def test_the_command_prints_every_row_and_writes_its_tables_and_figures(tmp_path):
    text = tmp_path / "papers.md"
    (tmp_path / "images").mkdir()
    ran = CliRunner().invoke(commands, ["papers", "--only", "003", "--quick", "--report", str(text), "--json"])
    assert ran.exit_code == 0, ran.output
    found = json.loads(ran.stdout)
    entries = [entry for one in entries_003.EXPERIMENTS for entry in one.entries]
    assert [row["where"] for row in found["rows"]] == [entry.where for entry in entries]
    assert all(row["why"] for row in found["rows"])
    assert text.read_text(encoding="utf-8").count("does not hold") == sum(key[0] == "003" for key in FAILING)
    assert all((tmp_path / "images" / name).exists() for name in ("paper_003_fig16a.png", "paper_003_fig27c.png"))


def test_it_speaks_to_people_and_is_silent_when_asked(monkeypatch):
    monkeypatch.setattr(entries_003, "EXPERIMENTS", (entries_003.ALIASES,))
    told, silent = (CliRunner().invoke(commands, ["papers", "--only", "003", *more]) for more in ((), ("--quiet",)))
    assert "003 Table 3" in told.stdout
    assert "0 holds, 1 does not hold" in told.stdout
    assert (silent.exit_code, silent.stdout) == (0, "")


def test_the_page_needs_no_network_and_holds_every_row(tmp_path):
    some = (entries_003.ALIASES, entries_003.BEAM)
    outcomes = repeat(some, quick=True, seeds=1, progress=lambda done, total, what: None)
    html = write_papers(outcomes, tmp_path / "papers.html", "midspan papers").read_text(encoding="utf-8")
    assert "Content-Security-Policy" in html
    assert "http://" not in html.replace("http://www.w3.org", "")
    assert all(entry.where in html for one in some for entry in one.entries)
    assert html.count("<figure") == 2


def test_a_report_of_another_kind_is_refused_before_anything_runs(tmp_path):
    ran = CliRunner().invoke(commands, ["papers", "--report", str(tmp_path / "x.pdf")])
    assert ran.exit_code == 2
    assert ".html or .md" in ran.output
