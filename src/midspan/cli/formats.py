"""`midspan formats`."""

import click

from midspan.cli.console import Console, common_options


@click.command("formats")
@common_options
def command(quiet: bool, as_json: bool) -> None:
    """File formats that midspan reads and writes."""
    from midspan.sinks.write import FORMATS as WRITTEN
    from midspan.sources.accelerometer.formats import FORMATS as CHANNELS
    from midspan.sources.accelerometer.phone import FORMATS as PHONES
    from midspan.sources.camera.formats import FORMATS as CAMERAS
    from midspan.sources.radar.formats import FORMATS as RADARS
    from midspan.sources.thermal.formats import FORMATS as THERMAL

    console = Console(quiet, as_json)
    groups = {
        "accelerometer, displacement, reference": CHANNELS,
        "phone's log (folder or zip)": PHONES,
        "camera": CAMERAS,
        "infrared": THERMAL,
        "radar": RADARS,
        "results": WRITTEN,
    }
    tree = {}
    for title, rows in groups.items():
        console.say(f"{title}:")
        console.table((" ".join(suffixes) or "any", f"{name} (by {library})") for name, suffixes, library in rows)
        console.say()
        tree[title] = [{"name": name, "suffixes": list(suffixes), "by": library} for name, suffixes, library in rows]
    console.document(tree)
