"""A campaign: every recording estimated, what is done skipped, a summary of all."""

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from midspan.checks import instance, option, path_of, refuse
from midspan.errors import MidspanError, UsageError
from midspan.progress import Progress, silent
from midspan.scale.jobs import jobs_of
from midspan.scale.pieces import join, pieces_of, work_piece
from midspan.scale.places import sweep, take
from midspan.scale.remote import is_url
from midspan.scale.runners import RUNNERS, Died
from midspan.scale.summary import frame_of, write_summary
from midspan.scale.work import INTERNAL, Cut, Outcome, Task, work
from midspan.settings.campaign import NO_URL, load_campaign

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True, slots=True, repr=False)
class Campaign:
    """What came of a campaign: the folder of its results, the outcomes in the order of their names, and warnings, as of
    results that were removed.
    """

    output: Path
    outcomes: tuple[Outcome, ...]
    warnings: tuple[str, ...] = ()

    def __repr__(self) -> str:
        done = sum(not outcome.exit_code for outcome in self.outcomes)
        return f"Campaign({str(self.output)!r}: {done} of {len(self.outcomes)} recordings done)"

    def _repr_html_(self) -> str:
        """What a notebook shows: the summary."""
        return self.to_pandas().to_html(index=False, na_rep="")

    @property
    def exit_code(self) -> int:
        """0 where all are done, 3 where some failed or were refused."""
        return 3 if any(outcome.exit_code for outcome in self.outcomes) else 0

    def to_pandas(self) -> "pd.DataFrame":
        """One row a recording, with the columns of summary.csv."""
        return frame_of(self.outcomes)


def batch(
    campaign: str | Path,
    *,
    runner: str = "process",
    workers: int | None = None,
    output: str | Path | None = None,
    progress: Progress = silent,
) -> Campaign:
    """Estimate all recordings of a CAMPAIGN.toml (or its folder).

    runner: "local" (in this process), "process" (long-lived processes of this machine) or "ray" (a cluster); workers:
    how many, left out: one a processor; output: folder of the results, left out: the campaign's. Recordings whose
    files, choices and version are those of an earlier run are not estimated again. One that fails does not stop the
    rest: its exit code, as of `midspan estimate`, and message are in the summary. Writes rows/ (a Parquet set
    partitioned by `recording`) and summary.csv, .parquet and .html to the output. Raises UsageError for a campaign that
    cannot be read or names what is not there.
    """
    option("runner", runner, RUNNERS)
    if workers is not None and instance("workers", workers, int, "a whole number") < 1:
        raise UsageError(f"workers: must be at least 1; received {workers}.")
    settings, file = load_campaign(path_of("campaign", campaign))
    # A worker of a cluster runs in another folder.
    folder = file.parent.absolute() if runner == "ray" else file.parent
    if output is not None and is_url(str(output)):
        raise refuse("output", NO_URL, str(output))
    place = folder / settings.output if output is None else path_of("output", output).absolute()
    jobs, warnings = jobs_of(settings, folder)
    take(place, file)
    if swept := sweep(place, [job.name for job in jobs]):
        warnings.append(f"{place}: what the campaign does not name any more is removed: {', '.join(swept)}.")
    tasks = [Task(job, place) for job in jobs]
    shown = _Shown(len(tasks), progress)
    outcomes: list[Outcome | None] = [None] * len(tasks)
    cuts = dict[int, Cut]()
    for number, result in _run(runner, workers, work, tasks):
        if isinstance(result, Cut):
            cuts[number] = result
            continue
        outcomes[number] = _outcome(tasks[number], result)
        shown.one_more()
    for number, result in _in_pieces(runner, workers, cuts):
        outcomes[number] = _outcome(tasks[number], result)
        shown.one_more()
    whole = tuple(outcome for outcome in outcomes if outcome is not None)
    write_summary(place, whole)
    return Campaign(place, whole, tuple(warnings))


def _run(
    runner: str, workers: int | None, function: Callable[[Any], Any], tasks: Sequence[Any]
) -> Iterator[tuple[int, Any]]:
    """Number and result of each task; a MidspanError, as of a full disk, ends all."""
    if not tasks:
        return
    with closing(RUNNERS[runner](workers).run(function, tasks)) as results:  # type: ignore[type-var]
        for number, result in results:
            if isinstance(result, MidspanError):
                raise result
            yield number, result


def _in_pieces(runner: str, workers: int | None, cuts: Mapping[int, Cut]) -> Iterator[tuple[int, Any]]:
    """The outcomes of long recordings by their numbers: all pieces of all, then each joined."""
    pieces = [piece for cut in cuts.values() for piece in pieces_of(cut)]
    died = {}
    for number, result in _run(runner, workers, work_piece, pieces):
        if isinstance(result, Died):
            died[pieces[number].cut.key] = result
    yield from ((number, died[cut.key]) for number, cut in cuts.items() if cut.key in died)
    numbers = [number for number, cut in cuts.items() if cut.key not in died]
    for number, result in _run(runner, workers, join, [cuts[number] for number in numbers]):
        yield numbers[number], result


def _outcome(task: Task, result: Any) -> Outcome:
    if isinstance(result, Died):
        return Outcome(task.job.name, INTERNAL, message=str(result))
    assert isinstance(result, Outcome)
    return result


class _Shown:
    """Progress with a rate and the time at which all is done."""

    def __init__(self, total: int, progress: Progress, clock: Callable[[], float] = time.time) -> None:
        self._total, self._progress, self._clock = total, progress, clock
        self._done, self._begun_s = 0, clock()
        progress(0, total, "recordings")

    def one_more(self) -> None:
        """One recording is done."""
        self._done += 1
        rate = self._done / max(self._clock() - self._begun_s, 1e-3)
        end_s = self._clock() + (self._total - self._done) / rate
        end = time.strftime("%H:%M", time.localtime(end_s))
        self._progress(self._done, self._total, f"recordings, {60.0 * rate:.3g} a minute, done at {end}")


__all__: Sequence[str] = ("Campaign", "batch")
