"""A shard of a site in a thread: what an actor of a cluster runs."""

import asyncio
import threading

from midspan.service.supervise import Supervisor, settings_of
from midspan.settings.site import Shard

LOOK_S = 0.25


def run_part(site_file: str, number: int, count: int, stop: threading.Event) -> None:
    """Run shard `number` of `count` of a site's file until the event is set; its lines go to standard output, which the
    cluster keeps. Raises as `midspan run` does.
    """
    settings = settings_of(site_file, Shard(number, count))

    async def main() -> None:
        supervisor = Supervisor(settings, _say)
        running = asyncio.create_task(supervisor.run())
        while not running.done():
            if stop.is_set():
                supervisor.stop()
            await asyncio.wait([running], timeout=LOOK_S)
        running.result()

    asyncio.run(main())


def _say(line: str) -> None:
    print(line, flush=True)
