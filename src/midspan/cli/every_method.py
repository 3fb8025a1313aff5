"""`midspan estimate --method all`: the methods compared, in place of a result."""

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from midspan.cli.console import Console

if TYPE_CHECKING:
    from midspan.evaluate.methods import MethodRun
    from midspan.recording.streams.recording import Recording

# What stands for all methods, as the value of --method.
ALL = "all"
HEADINGS = ("method", "RMSE", "without zero", "inside ±1.96 σ", "σ", "delay", "takes")


def compare_methods(opened: "Recording", console: Console, options: dict[str, Any]) -> None:
    """Run all methods on a recording, print the table, and write the picture."""
    from midspan.cli.targets import check_picture
    from midspan.evaluate.methods import reference_of, run_all
    from midspan.report.methods_figure import draw_methods
    from midspan.settings.stored.calibration_file import load_calibration

    if options["report"]:
        raise click.UsageError("--report: is of one method. Name it with --method, or leave --report out.")
    target = check_picture(options["output"] or opened.folder / "methods.png", "-o", opened)
    given = None if options["reference"] is None else Path(options["reference"])
    reference = reference_of(opened, given, options["reference_unit"])
    calibration = load_calibration(options["calibration_file"]) if options["calibration_file"] else None
    runs = list(run_all(opened, calibration, reference=reference, progress=console.progress))
    console.done()
    draw_methods(runs, reference, target)
    console.columns(HEADINGS, [_row(run) for run in runs])
    for run in runs:
        if run.refused:
            console.say(f"  {run.name}: refused. {run.refused}")
    if reference is None:
        console.say("No reference: --reference FILE, or [reference] in the recording, gives errors and coverage.")
    console.say(f"{target}: written.")
    console.document({"methods": [run.to_dict() for run in runs], "written": str(target)})


def _row(run: "MethodRun") -> tuple[str, ...]:
    """A method's row; empty cells where there is no figure."""
    if run.result is None:
        return (run.name, *[""] * (len(HEADINGS) - 1))
    found, against = run.result, run.comparison
    compared = ("", "", "")
    if against is not None:
        share = against.plain.coverage_95
        inside = "" if share is None else f"{100 * share:.1f} %"
        compared = (f"{against.plain.rmse_mm:.3g} mm", f"{against.without_zero.rmse_mm:.3g} mm", inside)
    delay = {0.0: "none", math.inf: "whole record"}.get(found.delay_s, f"{found.delay_s:.2g} s")
    return (run.name, *compared, f"{found.figures()['median_std_mm']:.3g} mm", delay, f"{run.took_s:.2g} s")
