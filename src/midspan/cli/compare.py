"""`midspan compare RESULT REFERENCE`."""

from typing import Any

import click

from midspan.cli.console import Console, common_options

# As of `midspan.evaluate.metrics`, which would be slow to import for the options alone.
ALIGNMENTS = ("none", "zero", "zero+lag")


@click.command("compare")
@click.argument("result", type=click.Path())
@click.argument("reference", type=click.Path())
@click.option("--unit", help="Unit of the reference, if its file has none.")
@click.option("--axis", type=click.Choice(["x", "y"]), help="Image axis of a two-axis result. Default: the main one.")
@click.option(
    "--align", type=click.Choice(ALIGNMENTS), default=ALIGNMENTS[0], help="Which of the three errors is reported first."
)
@common_options
def command(result: str, reference: str, quiet: bool, as_json: bool, **options: str | None) -> None:
    """Compare a result with a reference over their common time span.

    REFERENCE is a file with time and displacement, or a recording with [reference], on the accelerometer's clock. The
    error is result minus reference: as recorded, with its mean (another zero) removed, and with the lag (another
    clock) removed as well.
    """
    from midspan.evaluate.result_file import compare as compare_results

    console = Console(quiet, as_json)
    align = options["align"] or ALIGNMENTS[0]
    figures = compare_results(result, reference, unit=options["unit"], axis=options["axis"], align=align).to_dict()
    show(console, figures)
    console.document(figures)


def show(console: Console, figures: dict[str, Any]) -> None:
    """Print the figures of a comparison: the headline, then each way of taking zero and lag off in a row."""

    from midspan.evaluate.metrics import ANOTHER_ZERO

    def number(value: float | None, unit: str, digits: int = 4) -> str:
        return "not defined" if value is None else f"{value:.{digits}g} {unit}".rstrip()

    def inside(found: dict[str, Any]) -> str:
        share = found["coverage_95"]
        return "" if share is None else f", {100 * share:.1f} % inside ±1.96 σ"

    extent = number(figures["normalised_rmse_percent"], "%", 3)
    zero, explained = figures["without_zero"], any(line.startswith(ANOTHER_ZERO) for line in figures["notes"])
    without = f"RMSE {number(zero['rmse_mm'], 'mm')}{inside(zero)}"
    worst = f"{number(figures['largest_error_mm'], 'mm')} at {figures['largest_error_at_s']:.3f} s"
    console.table(
        [
            ("compared", f"{figures['count']} samples from {figures['start_s']:.3f} to {figures['end_s']:.3f} s"),
            ("RMSE", f"{number(figures['rmse_mm'], 'mm')} ({extent} of the peak-to-peak){inside(figures)}"),
            ("bias", number(figures["bias_mm"], "mm")),
            *([("of it the zero", f"{number(zero['zero_mm'], 'mm')}; without it {without}")] if explained else []),
            ("largest error", worst),
            ("correlation", number(figures["correlation"], "", 7)),
            ("lag", f"{number(figures['lag_s'], 's')} (positive: the result is late)"),
            *(
                (label, f"RMSE {number(found['rmse_mm'], 'mm')}{inside(found)}")
                for label, key in (
                    ("as recorded", "plain"),
                    ("zero removed", "without_zero"),
                    ("zero and lag removed", "without_zero_and_lag"),
                )
                if (found := figures[key]) is not None
            ),
        ]
    )
    console.warn(figures["notes"])
