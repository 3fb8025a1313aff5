"""`midspan run SITE.toml`."""

import click

from midspan.cli.console import Console, common_options


@click.command("run")
@click.argument("site", type=click.Path())
@click.option("--for", "for_s", type=click.FloatRange(0.0, min_open=True), help="Seconds; left out: until stopped.")
@common_options
def command(site: str, for_s: float | None, quiet: bool, as_json: bool) -> None:
    """Run a live site, a SITE.toml or the folder that holds it: sources to estimates to the store, MQTT and /readyz."""
    import asyncio
    import faulthandler
    import json
    import signal
    import sys
    from datetime import UTC, datetime

    console = Console(quiet, as_json)
    from midspan.service.run import Service
    from midspan.settings.site import load_site, require_folders

    loaded = load_site(site)
    require_folders(loaded)

    def note(record: dict[str, object]) -> None:
        """A line of the log for programs."""
        if as_json and not quiet:
            click.echo(json.dumps(record), err=True)

    def say(line: str) -> None:
        """A line of the log for people, with its time (UTC)."""
        console.say(f"{datetime.now(UTC):%Y-%m-%dT%H:%M:%SZ} {line}")

    async def main() -> dict[str, object]:
        service = Service(loaded, say, note)
        for number in (signal.SIGINT, signal.SIGTERM):
            asyncio.get_running_loop().add_signal_handler(number, service.stop)
        return await service.run(for_s)

    if sys.__stderr__ is not None:
        # A crash of the interpreter says where every thread was.
        faulthandler.enable(sys.__stderr__)
    last = asyncio.run(main())
    say(f"{loaded.name}: stopped; everything that came is kept.")
    console.document(last)
