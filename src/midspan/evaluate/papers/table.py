"""The papers' experiments in one table, and how they are run."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from importlib import import_module

from midspan.evaluate.papers.claims import Curve, Effort, Experiment, Row, judged

# Key of a paper → module with its EXPERIMENTS.
MODULES = {
    "000": "midspan.evaluate.papers.entries_000",
    "001": "midspan.evaluate.papers.entries_001",
    "002": "midspan.evaluate.papers.entries_002",
    "003": "midspan.evaluate.papers.entries_003",
    "004": "midspan.evaluate.papers.entries_004",
}
QUICK_SEEDS, SEEDS = 1, 3

Progress = Callable[[int, int, str], None]  # measurements done, in all, the experiment's name


@dataclass(frozen=True, slots=True)
class Outcome:
    """Rows of one experiment, its figures of the first seed, and what the paper leaves open."""

    experiment: Experiment
    rows: tuple[Row, ...]
    curves: tuple[Curve, ...]


def experiments(papers: Iterable[str]) -> list[Experiment]:
    """The experiments of these papers, keys of MODULES."""
    return [one for key in papers for one in import_module(MODULES[key]).EXPERIMENTS]


def repeat(wanted: Sequence[Experiment], *, quick: bool, seeds: int, progress: Progress) -> list[Outcome]:
    """Run the experiments over `seeds` seeds; rows are judged on their mean."""
    outcomes, done, total = [], 0, seeds * len(wanted)
    for one in wanted:
        found = []
        for seed in range(seeds):
            progress(done, total, f"{one.paper} {one.name}")
            found.append(one.measure(Effort(seed, quick)))
            done += 1
        outcomes.append(Outcome(one, tuple(judged(one, found)), found[0].curves))
    progress(total, total, "done")
    return outcomes
