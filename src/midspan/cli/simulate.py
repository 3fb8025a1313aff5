"""`midspan simulate SCENARIO -o DIR`."""

import click

from midspan.cli.console import Console, common_options


@click.command("simulate")
@click.argument("scenario", required=False)
@click.option("-o", "--output", type=click.Path(), help="Folder to write, new or of an older recording.")
@click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True, help="Same seed, same recording.")
@click.option(
    "--break",
    "breaks",
    multiple=True,
    metavar="NAME[,NAME…]",
    help="Violate the model in a way that --list names; the truth is unchanged.",
)
@click.option("--list", "listed", is_flag=True, help="List scenarios and breaks.")
@common_options
def command(
    scenario: str | None,
    output: str | None,
    seed: int,
    breaks: tuple[str, ...],
    listed: bool,
    quiet: bool,
    as_json: bool,
) -> None:
    """Write a recording folder with its truth (truth.csv)."""
    from midspan.checks import option
    from midspan.papers.scenes import PAPER_NAMES, chosen_here, write_scene
    from midspan.simulate.scenarios.breaks import BREAKS
    from midspan.simulate.scenarios.table import NAMES

    console = Console(quiet, as_json)
    names = NAMES | PAPER_NAMES
    if listed:
        console.table(names.items(), indent=0)
        console.say("\n--break:")
        console.table([(name, one.line) for name, one in BREAKS.items()], indent=0)
        console.document(names)
        return
    if scenario is None or output is None:
        raise click.UsageError("give a SCENARIO and -o DIR; --list names the scenarios.")
    option("SCENARIO", scenario, names)
    wanted = [name.strip() for text in breaks for name in text.split(",")]
    folder = write_scene(
        scenario,
        output,
        seed=seed,
        breaks=wanted,
        progress=lambda done, total: console.progress(done, total, "rendering"),
    )
    console.done()
    console.say(f"{folder}: {names[scenario]}")
    if free := chosen_here(scenario):
        console.say(f"Not printed in the paper, chosen here: {free}.")
    document = {"folder": str(folder), "scenario": scenario, "seed": seed}
    console.document(document | ({"broken": wanted} if wanted else {}))
