"""`midspan batch CAMPAIGN.toml`."""

from dataclasses import asdict

import click

from midspan.cli.console import Console, common_options


@click.command("batch")
@click.argument("campaign", type=click.Path())
@click.option(
    "--runner",
    type=click.Choice(["local", "process", "ray"]),
    default="process",
    help="Where recordings are estimated.",
)
@click.option("--workers", type=click.IntRange(1), help="How many at once. Default: one a processor.")
@click.option("-o", "--output", type=click.Path(), help="Folder of the results. Default: the campaign's.")
@common_options
def command(campaign: str, runner: str, workers: int | None, output: str | None, quiet: bool, as_json: bool) -> int:
    """Estimate all recordings of a campaign; what is done is skipped.

    CAMPAIGN is a CAMPAIGN.toml or its folder. The output has rows/, a Parquet set partitioned by recording, and
    summary.csv, .parquet and .html. Exit code: 0 all done, 3 some failed or were refused.
    """
    from midspan.scale.batch import batch

    console = Console(quiet, as_json)
    results = batch(campaign, runner=runner, workers=workers, output=output, progress=console.progress)
    console.done()
    bad = [outcome for outcome in results.outcomes if outcome.exit_code]
    console.warn(list(results.warnings))
    for outcome in bad:
        console.warn([f"{outcome.recording}: {outcome.message}"])
    done = len(results.outcomes) - len(bad)
    console.say(f"  {done} of {len(results.outcomes)} recordings done, {len(bad)} failed or refused; see summary.html")
    console.say(f"  written  {results.output}")
    recordings = [asdict(outcome) for outcome in results.outcomes]
    console.document({"output": str(results.output), "warnings": results.warnings, "recordings": recordings})
    return results.exit_code
