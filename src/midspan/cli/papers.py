"""`midspan papers [--only KEY]`."""

import os
from contextlib import suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

import click

from midspan.cli.console import Console, common_options
from midspan.errors import MidspanError
from midspan.papers.published import PAPERS

if TYPE_CHECKING:
    from midspan.papers.claims import Row

# This much of a test is played in real time for its latency, s: several times the longest delay.
LATENCY_S = 30.0


@click.command("papers")
@click.option("--only", type=click.Choice(sorted(paper.key for paper in PAPERS)), help="One paper. Default: all.")
@click.option("--quick", is_flag=True, help="One seed, short records: two minutes.")
@click.option("--seeds", type=click.IntRange(min=1), help="Number of random seeds.  [default: 3; 1 with --quick]")
@click.option("--report", type=click.Path(), help="Also write a page with the figures (.html, .md).")
@common_options
def command(only: str | None, quick: bool, seeds: int | None, report: str | None, quiet: bool, as_json: bool) -> None:
    """Repeat the papers' experiments in simulation: published figures, printed method, our default, claims.

    Each claim is an inequality of measured numbers, judged on the mean of the seeds.
    """
    from midspan.papers.table import MODULES, QUICK_SEEDS, SEEDS, experiments, repeat

    console = Console(quiet, as_json)
    path = _report_file(report)
    wanted = experiments([only] if only else MODULES)
    count = seeds or (QUICK_SEEDS if quick else SEEDS)
    outcomes = repeat(wanted, quick=quick, seeds=range(count), progress=console.progress, processes=os.cpu_count() or 1)
    late = {} if quick else _latencies([only] if only else list(MODULES), console)
    console.done()
    for paper in PAPERS:
        _show(console, paper.key, [row for one in outcomes if one.experiment.paper == paper.key for row in one.rows])
        if paper.key in late:
            console.table([(f"{paper.key} latency", late[paper.key])])
    rows = [row for one in outcomes for row in one.rows]
    console.say(_counted(rows))
    document = {"seeds": count, "quick": quick, "rows": [row.to_dict() for row in rows], "latency": late}
    if path is not None:
        from midspan.papers.page import write_papers

        given = [f" --only {only}"] * bool(only) + [" --quick"] * quick
        write_papers(outcomes, path, f"midspan papers{''.join(given)} --seeds {count}", late)
        console.say(f"{path}: the page")
        document["report"] = str(path)
    # What the papers do not print, by experiment.
    free = {f"{one.experiment.paper} {one.experiment.name}": one.experiment.free for one in outcomes}
    console.document(document | {"chosen_here": free})


def _latencies(keys: list[str], console: Console) -> dict[str, str]:
    """Of each paper the time from a sample and from a frame to its row, as printed, in real time."""
    from midspan.cli.estimate import as_in_paper
    from midspan.papers.scenes import write_scene
    from midspan.recording.calibrate import calibrate
    from midspan.service.replay import replay
    from midspan.store.store import open_store

    found = {}
    for number, paper in enumerate(one for one in PAPERS if one.key in keys):
        console.progress(number, len(keys), f"{paper.key} in real time")
        with TemporaryDirectory() as place, suppress(MidspanError):
            opened = as_in_paper(paper.key, str(write_scene(paper.scene, Path(place) / "recording")))
            calibration, store = calibrate(opened), open_store(Path(place) / "store", points=["latency"])
            method = opened.settings.fusion.method
            done = replay(
                opened, store, name="latency", calibration=calibration, method=method, speed=1.0, length_s=LATENCY_S
            )
            store.close()
            if done.from_sample is not None and done.from_frame is not None:
                sample, frame = (f"{1e3 * one.median_s:.3g} ms" for one in (done.from_sample, done.from_frame))
                found[paper.key] = f"{frame} from frame to row, {sample} from sample to row (medians)"
    return found


def _report_file(report: str | None) -> Path | None:
    if report is None:
        return None
    path = Path(report)
    if path.suffix not in (".html", ".md"):
        raise click.UsageError(f"--report must end in .html or .md; received {report!r}. Give one of these endings.")
    if not path.parent.is_dir():
        raise click.UsageError(
            f"--report {report}: the folder {path.parent} does not exist. Create it or choose another."
        )
    pictures = path.parent / "images"
    if path.is_dir() or not os.access(path.parent, os.W_OK):
        raise click.UsageError(f"--report {report}: is not writable. Choose another file or folder.")
    if path.suffix == ".md" and pictures.exists() and not pictures.is_dir():
        raise click.UsageError(
            f"--report {report}: the figures need a folder {pictures}, which is a file. Move it away."
        )
    return path


def _show(console: Console, key: str, rows: "list[Row]") -> None:
    for row in rows:
        console.say(f"{key} {row.entry.where}: {row.entry.what}")
        ours = f"{row.ours} ({row.compared})" if row.compared else row.ours
        lines = [("paper", row.entry.paper), ("as printed", row.printed), ("our default", ours)]
        console.table([(name, text) for name, text in lines if text])
        console.table([("claim", f"{row.verdict.value}: {row.why}")])
        if row.with_less_noise:
            console.table([("less noise", row.with_less_noise)])


def _counted(rows: "list[Row]") -> str:
    from midspan.papers.claims import Verdict

    verdicts = ", ".join(f"{sum(row.verdict is verdict for row in rows)} {verdict.value}" for verdict in Verdict)
    compared = [row for row in rows if row.compared]
    return (
        f"{verdicts}; our default has a larger error than the printed method in {sum(row.worse for row in compared)} "
        f"of {len(compared)} rows"
    )
