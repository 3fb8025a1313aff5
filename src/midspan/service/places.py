"""Where a store's service has its own files: who has access, the socket of the live rows, what is paused."""

import hashlib
import os
from pathlib import Path
from urllib.parse import parse_qs, urlsplit

from midspan.store.store import is_address


def place_of(where: str | Path) -> Path:
    """The store's folder; of a PostgreSQL store a folder of this user, named after its address without a password."""
    if not is_address(where):
        return Path(where)
    parts = urlsplit(str(where))
    known = f"{parts.hostname}:{parts.port or 5432}{parts.path}"
    # Each shard of a site has its own.
    named = parse_qs(parts.query).get("application_name", [""])[-1]
    known += named * named.startswith("midspan-shard-")
    state = Path(os.environ.get("XDG_STATE_HOME") or Path.home() / ".local" / "state")
    return state / "midspan" / hashlib.sha256(known.encode()).hexdigest()[:16]
