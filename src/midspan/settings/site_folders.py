"""The folders of a site, and whether they can be written: those of the store, the archive and captured recordings."""

import os
import tempfile
from pathlib import Path

from midspan.errors import UsageError
from midspan.settings.site import Site


def captures_of(site: Site) -> Path:
    """The folder below which each point has its captured recordings."""
    own = site.settings.store.captures
    if own is not None:
        return site.file.parent / own
    return Path(site.store) / "captures" if site.settings.store.path else site.file.parent / f"{site.name}-captures"


def require_folders(site: Site) -> None:
    """Raises UsageError with the key for a store, an archive or captures in a folder that is a file or cannot be made.

    A folder that this user may not write is refused too: the service's user has to be the one who asks.
    """
    store = site.settings.store
    captures = store.captures or (None if store.path else str(captures_of(site)))
    for key, given in (("path", store.path), ("archive", store.archive), ("captures", captures)):
        if given is not None and (wrong := _why_not(site.file.parent / given)):
            raise UsageError(
                f"{site.file}: store.{key} = {given!r}: must be a folder that can be made and written; {wrong}. "
                "Give another folder, or let the user of midspan write this one."
            )


def _why_not(folder: Path) -> str:
    """Why files cannot be written into a folder, which is not made; empty where they can."""
    there = folder.absolute()
    try:
        there = next(place for place in (there, *there.parents) if place.exists())
        if not there.is_dir():
            return f"{there} is a file"
        if there == folder.absolute():
            # Another process may write into it: nothing is touched.
            return "" if os.access(there, os.W_OK | os.X_OK) else f"{there} may not be written"
        tempfile.TemporaryDirectory(prefix=".midspan-", dir=there).cleanup()
    except OSError as error:
        return f"{there}: {error.strerror}"
    return ""
