"""`midspan fleet SITE.toml`."""

from typing import TYPE_CHECKING

import click

from midspan.cli.console import Console, common_options

if TYPE_CHECKING:
    from midspan.scale.fleet import Shards
    from midspan.settings.site import Site


@click.command("fleet")
@click.argument("site", type=click.Path())
@click.option("--shards", "count", type=click.IntRange(1), help="How many. Default: one for 5000 points of groups.")
@click.option("--runner", type=click.Choice(["process", "ray"]), default="process", help="Where shards run.")
@click.option(
    "--for", "for_s", type=click.FloatRange(0.0, min_open=True), help="Seconds to run. Default: until stopped."
)
@click.option("--status", is_flag=True, help="Show how the shards stand; exit code 3 where one is not ready.")
@common_options
def command(
    site: str, count: int | None, runner: str, for_s: float | None, status: bool, quiet: bool, as_json: bool
) -> int:
    """Run a live site as shards: start and watch them, start again what ends or hangs.

    Each shard is a `midspan run --shard K/N`. With `--runner ray` they run on the cluster in RAY_ADDRESS.
    """
    from dataclasses import asdict

    from midspan.scale.fleet import driver_lock, read_fleet
    from midspan.scale.fleet_status import shard_reports
    from midspan.settings.shard import shard_of, usual_shards
    from midspan.settings.site import Shard, load_site

    console = Console(quiet, as_json)
    whole = load_site(site)
    running = read_fleet(whole.file)
    if status:
        shards = count or (usual_shards(whole) if running is None else running.count)
        reports = shard_reports(whole, shards, running)
        for one in reports:
            state = "ready" if one.ready else "not ready"
            again = "" if not one.restarts else f", restarts: {one.restarts}"
            console.say(f"  shard {one.shard}  {one.address}  {state}{again}  {one.text}".rstrip())
        console.document({"shards": [asdict(one) for one in reports]})
        return 0 if all(one.ready for one in reports) else 3
    shards = count or usual_shards(whole)
    for number in range(1, shards + 1):
        shard_of(whole, Shard(number, shards))
    lock = driver_lock(whole.file)
    last = _run(whole, shards, runner, for_s, console)
    if lock is not None:
        lock.close()
    console.document(last)
    return 0


def _run(whole: "Site", count: int, runner: str, for_s: float | None, console: Console) -> dict[str, object]:
    """Run shards until a signal comes, or the time is over."""
    import signal
    import threading
    import time
    from dataclasses import asdict
    from datetime import UTC, datetime

    from midspan.scale.fleet import Fleet, watch

    stop = threading.Event()
    until_s = float("inf") if for_s is None else time.monotonic() + for_s

    def stopped(wait_s: float) -> bool:
        """Whether to stop; waits a little."""
        return stop.wait(wait_s) or time.monotonic() >= until_s

    def say(line: str) -> None:
        console.say(f"{datetime.now(UTC):%Y-%m-%dT%H:%M:%SZ} {line}")

    shards = _shards(whole, count, runner, quiet=console.quiet)
    # Afterwards: Ray has handlers of its own, which end the process.
    for name in (signal.SIGINT, signal.SIGTERM):
        signal.signal(name, lambda *_: stop.set())
    last = watch(shards, Fleet(runner, count, time.time(), ()), whole.file, say=say, stopped=stopped)
    say("stopped; all received data are stored.")
    return asdict(last)


def _shards(whole: "Site", count: int, runner: str, *, quiet: bool) -> "Shards":
    site_file = str(whole.file.absolute())
    if runner == "process":
        from midspan.scale.fleet_processes import ProcessShards

        return ProcessShards(site_file, count, ["--quiet"] * quiet)
    from midspan.scale.fleet_ray import RayShards
    from midspan.service.part import run_part

    return RayShards(run_part, site_file, whole.name, count)
