"""`midspan store STORE`: look through it, mend it, save it while it runs."""

from pathlib import Path

import click

from midspan.cli.console import Console, common_options

ACTIONS = ("check", "repair", "backup")


@click.command("store")
@click.argument("store")
@click.argument("action", type=click.Choice(ACTIONS))
@click.argument("target", metavar="[FILE]", required=False, type=click.Path())
@common_options
def command(store: str, action: str, target: str | None, quiet: bool, as_json: bool) -> None:
    """Check, repair or back up a store; backup works while it is written.

    check: all pages, chunks, logs and checkpoints; exit code 3 if anything is damaged. repair: replace
    damaged files by their readable parts; stop `midspan run` first. backup: a copy as the folder FILE, which is a
    store as well, or as FILE.tar.
    """
    from midspan.store import upkeep

    if (action == "backup") != (target is not None):
        raise click.UsageError(
            "FILE: is missing; backup needs one." if target is None else f"FILE: must not be given with {action}."
        )
    console = Console(quiet, as_json)
    if action == "check":
        found = upkeep.check(store)
        faults = [{"file": one.file, "fault": one.text} for one in found.faults]
        for one in found.faults:
            console.say(f"{one.file}: {one.text}")
        numbers = {"files": found.files, "chunks": found.chunks, "rows": found.rows}
        console.table([*((name, str(number)) for name, number in numbers.items()), ("faults", str(len(faults)))])
        console.document({**numbers, "faults": faults})
        if faults:
            console.say("`midspan store STORE repair` repairs what is readable.")
            raise click.exceptions.Exit(3)
    elif action == "repair":
        done = upkeep.repair(store)
        for line in done:
            console.say(line)
        console.table([("mended", str(len(done)))])
        console.document({"mended": done})
    elif target is not None:
        files = upkeep.backup(store, Path(target))
        console.table([("files", str(len(files))), ("written", target)])
        console.document({"files": files, "written": target})
