"""`midspan methods`."""

import click

from midspan.cli.console import Console, common_options


@click.command("methods")
@common_options
def command(quiet: bool, as_json: bool) -> None:
    """Trackers and fusion methods, and when to use each."""
    from midspan.fusion.methods import DEFAULT_METHOD, METHODS
    from midspan.vision.tracker import DEFAULT_TRACKER, TRACKERS

    console = Console(quiet, as_json)
    trackers = {name: entry.use for name, entry in TRACKERS.items()}
    methods = {name: row.use for name, row in METHODS.items()}
    for title, table, default in (("trackers", trackers, DEFAULT_TRACKER), ("fusion methods", methods, DEFAULT_METHOD)):
        console.say(f"{title} (default: {default}):")
        console.table(table.items())
        console.say()
    console.document(
        {
            "trackers": trackers,
            "default_tracker": DEFAULT_TRACKER,
            "methods": methods,
            "default_method": DEFAULT_METHOD,
        }
    )
