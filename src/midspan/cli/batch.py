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
    found = batch(campaign, runner=runner, workers=workers, output=output, progress=console.progress)
    console.done()
    bad = [one for one in found.outcomes if one.exit_code]
    console.warn(list(found.warnings))
    for one in bad:
        console.warn([f"{one.recording}: {one.message}"])
    done = len(found.outcomes) - len(bad)
    console.say(f"  {done} of {len(found.outcomes)} recordings done, {len(bad)} failed or refused; see summary.html")
    console.say(f"  written  {found.output}")
    recordings = [asdict(one) for one in found.outcomes]
    console.document({"output": str(found.output), "warnings": found.warnings, "recordings": recordings})
    return found.exit_code
