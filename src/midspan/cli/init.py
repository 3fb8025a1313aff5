"""`midspan init ACCEL FILE2`."""

import os
from pathlib import Path
from typing import Any

import click

from midspan.cli.console import Console, common_options


@click.command("init")
@click.argument("accel", type=click.Path())
@click.argument("file2", type=click.Path(), required=False)
@click.option("-o", "--output", type=click.Path(), help="Folder to write into. Default: that of ACCEL.")
@click.option("--value", help="Channel along the motion. Default: the only or the vertical one.")
@click.option("--unit", help="Unit of the channel, if the file has none.")
@click.option("--direction", type=click.Choice(["x", "y"]), help="Image axis of the motion. Default: y.")
@click.option("--rate-hz", type=float, help="Rate of FILE2, if it has no times.")
@click.option("--displacement-value", metavar="NAME", help="Displacement channel of FILE2.")
@click.option("--displacement-unit", help="Unit of that channel, if the file has none.")
@common_options
def command(accel: str, file2: str | None, output: str | None, quiet: bool, as_json: bool, **options: Any) -> None:
    """Write a commented recording.toml for an accelerometer file and FILE2, with channels, units and rates.

    FILE2 is a video, or the table of a displacement sensor. A phone's log (folder or zip of
    Sensor Logger or phyphox) may hold its video.
    """
    from midspan.errors import UsageError
    from midspan.settings.load import RECORDING_FILE
    from midspan.settings.two_files import Choices, draft
    from midspan.writing import write_whole

    console = Console(quiet, as_json)
    folder = Path(output or (accel if Path(accel).is_dir() else Path(accel).parent))
    target = folder / RECORDING_FILE
    if target.exists():
        raise UsageError(f"{target}: exists already and is not overwritten. Remove it, or give another folder (-o).")
    found = draft(Path(accel), None if file2 is None else Path(file2), Choices(**options), choose=True)
    folder.mkdir(parents=True, exist_ok=True)
    for section, own in found.sections.items():
        if "file" in own:
            found.sections[section]["file"] = Path(os.path.relpath(own["file"], folder)).as_posix()
    write_whole(target, found.text().encode())
    console.say(f"{target}: written. Check it, then run `midspan estimate {folder}`.")
    for line in found.said:
        console.say(f"  {line}")
    for key in found.needed:
        console.say(f"  {key}: not found in the files. Add it first.")
    console.document({"written": str(target), "settings": found.sections})
