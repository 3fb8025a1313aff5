"""The shards of a site: started, watched and replaced, as processes of this machine or as actors on a cluster of Ray.

A shard is `midspan run SITE.toml --shard K/N`. Its state is in the store and at the broker, so that one that is started
again goes on without a row lost or doubled, wherever it is.
"""

import json
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import IO, Protocol

from midspan.errors import MidspanError, UsageError
from midspan.store.database import lock_file
from midspan.trees import TreeError, read_json
from midspan.writing import write_whole

# The shards are looked at so often, s.
LOOK_S = 0.25


@dataclass(frozen=True, slots=True)
class ShardState:
    """How a shard stands: shard, from 1; pid of its process, None while there is none; restarts; host that it is on,
    empty for this machine; text of what last ended it; address of the host in its network.
    """

    shard: int
    pid: int | None = None
    restarts: int = 0
    host: str = ""
    text: str = ""
    address: str = ""


class Shards(Protocol):
    """The shards of a site in some place."""

    def look(self) -> list[ShardState]:
        """Start those that ended, or hang; how all stand."""
        ...

    def stop(self) -> None:
        """End all; what they received is stored."""
        ...


@dataclass(frozen=True, slots=True)
class Fleet:
    """What a driver wrote last of its shards; time_s: when."""

    runner: str
    count: int
    time_s: float
    shards: tuple[ShardState, ...]


def fleet_file(site_file: Path) -> Path:
    """Where a driver says how its shards stand."""
    return site_file.with_name(f".{site_file.name}.fleet")


def driver_lock(site_file: Path) -> IO[bytes] | None:
    """What one driver of a site has while it runs, None in a folder that cannot be written.

    Raises UsageError where another driver runs.
    """
    try:
        lock = lock_file(fleet_file(site_file).with_suffix(".lock"))
    except OSError:
        return None
    if lock is None:
        raise UsageError(f"{site_file}: another `midspan fleet` runs its shards. Stop that one first.")
    return lock


def read_fleet(site_file: Path) -> Fleet | None:
    """What the last driver of a site wrote; None without one."""
    try:
        tree = read_json(fleet_file(site_file))
        shards = tuple(ShardState(**one) for one in tree.pop("shards"))
        return Fleet(**tree, shards=shards)
    except (OSError, TreeError, KeyError, TypeError):
        return None


def watch(
    shards: Shards, fleet: Fleet, site_file: Path, *, say: Callable[[str], None], stopped: Callable[[float], bool]
) -> Fleet:
    """Look after shards until `stopped`, which waits for this many seconds, says so; then end them. How they stood."""
    known: list[ShardState] = []
    try:
        while True:
            states = shards.look()
            if states != known:
                for one in _news(known, states):
                    say(one)
                known = states
                fleet = Fleet(fleet.runner, fleet.count, time.time(), tuple(states))
                _keep(fleet, site_file, say)
            if stopped(LOOK_S):
                return fleet
    finally:
        try:
            shards.stop()
        finally:
            fleet_file(site_file).unlink(missing_ok=True)


def _keep(fleet: Fleet, site_file: Path, say: Callable[[str], None]) -> None:
    try:
        write_whole(fleet_file(site_file), json.dumps(asdict(fleet)).encode())
    except (MidspanError, OSError) as error:
        say(f"fleet: {error}")


def _news(before: list[ShardState], after: list[ShardState]) -> list[str]:
    """What has changed, in sentences."""
    known = {one.shard: one for one in before}
    lines = []
    for one in after:
        old = known.get(one.shard, ShardState(one.shard))
        if one.text and (one.text, one.restarts) != (old.text, old.restarts):
            lines.append(f"shard {one.shard}: {one.text}")
        if one.pid is not None and one.pid != old.pid:
            place = f" on {one.host}" if one.host else ""
            lines.append(f"shard {one.shard}: runs as process {one.pid}{place}.")
    return lines
