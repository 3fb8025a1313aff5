"""`midspan papers [--only KEY]`."""

import os
from pathlib import Path
from typing import TYPE_CHECKING

import click

from midspan.cli.console import Console, common_options
from midspan.papers.published import PAPERS

if TYPE_CHECKING:
    from midspan.papers.claims import Row


@click.command("papers")
@click.option("--only", type=click.Choice(sorted(paper.key for paper in PAPERS)), help="One paper; left out: all.")
@click.option("--quick", is_flag=True, help="One seed, short records, few points: some two minutes.")
@click.option("--seeds", type=click.IntRange(min=1), help="Draws of everything random.  [default: 3; 1 with --quick]")
@click.option("--report", type=click.Path(), help="Also write one page with the figures: .html, or .md with its "
              "figures in a folder next to it.")  # fmt: skip
@common_options
def command(only: str | None, quick: bool, seeds: int | None, report: str | None, quiet: bool, as_json: bool) -> None:
    """Repeat the papers' experiments in simulation: what they print, as printed here, our default, their claims.

    Each claim is an inequality of measured numbers, judged on the mean of the seeds. Known truth, the papers' geometry,
    rates and chirps; what they do not print is chosen here and named.
    """
    from midspan.papers.table import MODULES, QUICK_SEEDS, SEEDS, experiments, repeat

    console = Console(quiet, as_json)
    path = _report_file(report)
    wanted = experiments([only] if only else MODULES)
    count = seeds or (QUICK_SEEDS if quick else SEEDS)
    outcomes = repeat(wanted, quick=quick, seeds=range(count), progress=console.progress, processes=os.cpu_count() or 1)
    console.done()
    for paper in PAPERS:
        _show(console, paper.key, [row for one in outcomes if one.experiment.paper == paper.key for row in one.rows])
    rows = [row for one in outcomes for row in one.rows]
    console.say(_counted(rows))
    document = {"seeds": count, "quick": quick, "rows": [row.to_dict() for row in rows]}
    if path is not None:
        from midspan.papers.page import write_papers

        given = [f" --only {only}"] * bool(only) + [" --quick"] * quick
        write_papers(outcomes, path, f"midspan papers{''.join(given)} --seeds {count}")
        console.say(f"{path}: the page")
        document["report"] = str(path)
    # What the papers do not print, by experiment.
    free = {f"{one.experiment.paper} {one.experiment.name}": one.experiment.free for one in outcomes}
    console.document(document | {"chosen_here": free})


def _report_file(report: str | None) -> Path | None:
    if report is None:
        return None
    path = Path(report)
    if path.suffix not in (".html", ".md"):
        raise click.UsageError(f"--report must end in .html or .md; received {report!r}. Give one of these endings.")
    if not path.parent.is_dir():
        raise click.UsageError(
            f"--report {report}: the folder {path.parent} does not exist. Make it or choose another."
        )
    pictures = path.parent / "images"
    if path.is_dir() or not os.access(path.parent, os.W_OK):
        raise click.UsageError(f"--report {report}: cannot be written there. Choose another file or folder.")
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


def _counted(rows: "list[Row]") -> str:
    from midspan.papers.claims import Verdict

    verdicts = ", ".join(f"{sum(row.verdict is verdict for row in rows)} {verdict.value}" for verdict in Verdict)
    compared = [row for row in rows if row.compared]
    return (
        f"{verdicts}; our default errs more than a method as printed in {sum(row.worse for row in compared)} of "
        f"{len(compared)} rows"
    )
