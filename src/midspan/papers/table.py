"""The papers' experiments in one table, and how they are run."""

from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import FIRST_COMPLETED, ProcessPoolExecutor, wait
from dataclasses import dataclass
from importlib import import_module
from multiprocessing import active_children, get_context

from midspan.papers.claims import Curve, Effort, Experiment, Measured, Row, judged
from midspan.progress import Progress

# Key of a paper → module with its EXPERIMENTS.
MODULES = {
    "000": "midspan.papers.entries_000",
    "001": "midspan.papers.entries_001",
    "002": "midspan.papers.entries_002",
    "003": "midspan.papers.entries_003",
    "004": "midspan.papers.entries_004",
}
QUICK_SEEDS, SEEDS = 1, 3
# Name, what is measured, how much is spent.
Job = tuple[str, Callable[[Effort], Measured], Effort]


@dataclass(frozen=True, slots=True)
class Outcome:
    """Rows of one experiment, its figures of the first seed, and what the paper leaves open."""

    experiment: Experiment
    rows: tuple[Row, ...]
    curves: tuple[Curve, ...]


def experiments(papers: Iterable[str]) -> list[Experiment]:
    """The experiments of these papers, keys of MODULES."""
    return [one for key in papers for one in import_module(MODULES[key]).EXPERIMENTS]


def repeat(
    wanted: Sequence[Experiment], *, quick: bool, seeds: Sequence[int], progress: Progress, processes: int = 1
) -> list[Outcome]:
    """Run the experiments with each seed; rows are judged on the mean. processes: how many run at the same time.

    With less noise each runs with the first seed alone.
    """
    jobs: list[Job] = []
    for one in wanted:
        name = f"{one.paper} {one.name}"
        jobs += [(name, one.measure, Effort(seed, quick)) for seed in seeds]
        jobs += [(name, one.cleaner, Effort(seeds[0], quick))] if one.cleaner is not None else []
    found = iter(_measured(jobs, progress, processes))
    outcomes = []
    for one in wanted:
        own = [next(found) for _ in seeds]
        cleaner = [next(found)] if one.cleaner is not None else []
        outcomes.append(Outcome(one, tuple(judged(one, own, cleaner)), own[0].curves))
    return outcomes


def _measured(jobs: Sequence[Job], progress: Progress, processes: int) -> list[Measured]:
    """What each measurement gives, in their order."""
    if processes < 2 or len(jobs) < 2:
        found = []
        for done, (name, measure, effort) in enumerate(jobs):
            progress(done, len(jobs), name)
            found.append(measure(effort))
        progress(len(jobs), len(jobs), "done")
        return found
    # A process that is forked would inherit threads of the libraries that are loaded.
    with ProcessPoolExecutor(min(processes, len(jobs)), get_context("spawn")) as pool:
        futures = [pool.submit(measure, effort) for _, measure, effort in jobs]
        try:
            waiting = set(futures)
            while waiting:
                progress(len(jobs) - len(waiting), len(jobs), "repeating the experiments")
                ended, waiting = wait(waiting, timeout=0.5, return_when=FIRST_COMPLETED)
                for future in ended:
                    future.result()
        except BaseException:
            for process in active_children():
                process.terminate()
            pool.shutdown(wait=False, cancel_futures=True)
            raise
        progress(len(jobs), len(jobs), "done")
        return [future.result() for future in futures]
