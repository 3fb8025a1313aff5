"""`midspan run SITE.toml`."""

import click

from midspan.cli.access import announce_admin
from midspan.cli.console import Console, common_options
from midspan.cli.process import stop_by_signals


@click.command("run")
@click.argument("site", type=click.Path())
@click.option(
    "--for", "for_s", type=click.FloatRange(0.0, min_open=True), help="Seconds to run. Default: until stopped."
)
@click.option("--serve/--no-serve", default=True, help="Serve page and REST interface on [service] listen.")
@click.option("--shard", metavar="K/N", help="Run part K of N of the points, with its own port and store.")
@common_options
def command(site: str, for_s: float | None, serve: bool, shard: str | None, quiet: bool, as_json: bool) -> None:
    """Run a live site (SITE.toml or its folder): estimate from live sources; write to store, page and MQTT.

    The first start makes the user `admin` and prints its password once (not with --quiet).
    """
    import asyncio
    import faulthandler
    import json
    import sys
    from datetime import UTC, datetime

    console = Console(quiet, as_json)
    from midspan.service.supervise import Supervisor, settings_of
    from midspan.settings.shard import parse_shard

    settings = settings_of(site, None if shard is None else parse_shard(shard))

    def note(record: dict[str, object]) -> None:
        """A line of the log for programs."""
        if as_json and not quiet:
            click.echo(json.dumps(record), err=True)

    def say(line: str) -> None:
        """A line of the log for people, with its time (UTC)."""
        who = "" if shard is None else f"shard {shard}: "
        console.say(f"{datetime.now(UTC):%Y-%m-%dT%H:%M:%SZ} {who}{line}")

    async def main() -> dict[str, object]:
        supervisor = Supervisor(
            settings, say, note, serve=serve, announce=lambda: announce_admin(settings.where, console, shard)
        )
        stop_by_signals(asyncio.get_running_loop(), supervisor.stop)
        return await supervisor.run(for_s)

    if sys.__stderr__ is not None:
        # A crash of the interpreter says where every thread was.
        faulthandler.enable(sys.__stderr__)
    last = asyncio.run(main())
    say("stopped; all received data are stored.")
    console.document(last)
