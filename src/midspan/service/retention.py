"""Days that are over: archived, and then removed once they are too old."""

import asyncio
import time
from collections.abc import Callable
from contextlib import closing

from midspan.errors import MidspanError
from midspan.records import NANOSECONDS
from midspan.service.keeping import Keeper
from midspan.settings.site import Site
from midspan.store.archive import archive
from midspan.store.store import open_store

DAY_S = 86_400.0
# Between the end of a sweep and the next one, s.
SWEEP_S = 3600.0


async def sweeping(site: Callable[[], Site], keeper: Keeper, say: Callable[[str], None]) -> None:
    """Archive days and remove old ones, one sweep after another, until this is cancelled. site: with its settings as
    they are now.
    """
    while True:
        try:
            now = site()
            await asyncio.to_thread(archive_days, now, say)
            old_s = time.time() - DAY_S * now.settings.store.keep_days
            await asyncio.to_thread(keeper.forget_before, round(old_s * NANOSECONDS))
        except Exception as error:
            # Whatever it is, the points go on; no day is removed that may not be in the archive.
            text = str(error) if isinstance(error, MidspanError | OSError) else f"{type(error).__name__}: {error}"
            say(f"archive: {text}; midspan retries in an hour.")
        await asyncio.sleep(SWEEP_S)


def archive_days(site: Site, say: Callable[[str], None]) -> None:
    """Archive the days of a site that are over, where it has an archive."""
    folder = site.settings.store.archive
    if folder is not None:
        with closing(open_store(site.store)) as store:
            for place in archive(store, site.file.parent / folder, time.time_ns()):
                say(f"archive: {place.parent.name}, {place.name}.")
