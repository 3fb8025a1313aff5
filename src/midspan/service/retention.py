"""Days that are over: archived, and then removed once they are too old."""

import time
from collections.abc import Callable
from contextlib import closing

from midspan.errors import MidspanError
from midspan.records import NANOSECONDS
from midspan.settings.site import Site
from midspan.store.archive import archive
from midspan.store.store import open_store

DAY_S = 86_400.0


def archived(site: Site, say: Callable[[str], None]) -> int | None:
    """Archive the days of a site that are over; the instant (ns UTC) before which days may be removed then, None where
    the archive failed.
    """
    folder = site.settings.store.archive
    try:
        if folder is not None:
            with closing(open_store(site.store)) as store:
                for place in archive(store, site.file.parent / folder, time.time_ns()):
                    say(f"archive: {place.parent.name}, {place.name}.")
    except (MidspanError, OSError) as error:
        say(f"archive: {error}; midspan retries in an hour.")
        return None
    return round((time.time() - DAY_S * site.settings.store.keep_days) * NANOSECONDS)
