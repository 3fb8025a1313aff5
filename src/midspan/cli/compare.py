"""`midspan compare RESULT REFERENCE`."""

from typing import Any

import click

from midspan.cli.console import Console, common_options


@click.command("compare")
@click.argument("result", type=click.Path())
@click.argument("reference", type=click.Path())
@click.option("--unit", help="Unit of the reference's values where its file does not say, for example mm.")
@click.option("--axis", type=click.Choice(["x", "y"]), help="Image axis of a result that has both; left out: its main "
              "columns.")  # fmt: skip
@common_options
def command(result: str, reference: str, quiet: bool, as_json: bool, **options: str | None) -> None:
    """Compare a result with a reference over their common time span.

    REFERENCE is a file with time and displacement, or a recording with a [reference] section. Both must be on the
    accelerometer's clock. The error is result minus reference.
    """
    from midspan.evaluate.result_file import compare as compare_results

    console = Console(quiet, as_json)
    figures = compare_results(result, reference, unit=options["unit"], axis=options["axis"]).to_dict()
    show(console, figures)
    console.document(figures)


def show(console: Console, figures: dict[str, Any]) -> None:
    """Print the figures of a comparison."""

    def number(name: str, unit: str, digits: int = 4) -> str:
        value = figures[name]
        return "not defined" if value is None else f"{value:.{digits}g} {unit}".rstrip()

    worst = f"{number('largest_error_mm', 'mm')} at {figures['largest_error_at_s']:.3f} s"
    rows = [
        ("compared", f"{figures['count']} instants from {figures['start_s']:.3f} to {figures['end_s']:.3f} s"),
        ("RMSE", f"{number('rmse_mm', 'mm')} ({number('normalised_rmse_percent', '%', 3)} of the peak-to-peak)"),
        ("bias", number("bias_mm", "mm")),
        ("RMSE without the bias", number("rmse_without_bias_mm", "mm")),
        ("largest error", worst),
        ("correlation", number("correlation", "", 7)),
        ("lag", f"{number('lag_s', 's')} (positive: the result is late)"),
    ]
    if figures["coverage_95"] is not None:
        rows.append(("inside ±1.96 σ", f"{100 * figures['coverage_95']:.1f} %"))
    console.table(rows)
    console.warn(figures["notes"])
