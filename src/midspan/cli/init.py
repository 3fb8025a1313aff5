"""`midspan init ACCEL VIDEO`."""

import os
from pathlib import Path

import click

from midspan.cli.console import Console, common_options


@click.command("init")
@click.argument("accel", type=click.Path())
@click.argument("video", type=click.Path())
@click.option("-o", "--output", type=click.Path(), help="Folder to write into. Default: that of ACCEL.")
@click.option("--value", help="Channel along the motion. Default: the only or the vertical one.")
@click.option("--unit", help="Unit of the channel, if the file has none.")
@click.option("--direction", type=click.Choice(["x", "y"]), help="Image axis of the motion. Default: y.")
@common_options
def command(accel: str, video: str, quiet: bool, as_json: bool, **options: str | None) -> None:
    """Write a commented recording.toml for an accelerometer file and a video, with channels, units and rates."""
    from midspan.errors import UsageError
    from midspan.settings.load import RECORDING_FILE
    from midspan.settings.two_files import draft
    from midspan.writing import write_whole

    console = Console(quiet, as_json)
    folder = Path(options["output"] or Path(accel).parent)
    target = folder / RECORDING_FILE
    if target.exists():
        raise UsageError(f"{target}: exists already and is not overwritten. Remove it, or give another folder (-o).")
    found = draft(Path(accel), Path(video), options["value"], options["unit"], options["direction"], choose=True)
    folder.mkdir(parents=True, exist_ok=True)
    for section, own in found.sections.items():
        if "file" in own:
            found.sections[section]["file"] = Path(os.path.relpath(own["file"], folder)).as_posix()
    write_whole(target, found.text().encode())
    console.say(f"{target}: written. Check it, then run `midspan estimate {folder}`.")
    for key in found.needed:
        console.say(f"  {key}: not found in the files. Add it first.")
    console.document({"written": str(target), "settings": found.sections})
