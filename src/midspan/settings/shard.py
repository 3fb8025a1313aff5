"""A fixed part of a site, which a process of its own runs: a shard."""

import re
from dataclasses import replace
from urllib.parse import urlsplit

from pydantic import SecretStr

from midspan.errors import UsageError
from midspan.settings.site import ServiceSettings, Shard, Site, StoreSettings

# Points of groups that a shard has, where nobody says how many shards there are: half of a processor.
POINTS_A_SHARD = 5000
MAX_PORT = 65_535


def parse_shard(text: str) -> Shard:
    """The shard K/N. Raises UsageError for another text."""
    found = re.fullmatch(r"(\d{1,6})/(\d{1,6})", text, re.ASCII)
    if found is None or not 1 <= int(found[1]) <= int(found[2]):
        raise UsageError(f"--shard: must be K/N, 1 ≤ K ≤ N, such as 1/4; received {text!r}.")
    return Shard(int(found[1]), int(found[2]))


def points_in(site: Site) -> int:
    """How many places a site's file has: its [[point]]s, then the points of its groups."""
    return _sections(site) + sum(plan.settings.points for plan in site.groups)


def usual_shards(site: Site) -> int:
    """How many shards a site is run as."""
    return max(1, -(-sum(plan.settings.points for plan in site.groups) // POINTS_A_SHARD))


def shard_of(site: Site, shard: Shard) -> Site:
    """The part of a whole site that a shard runs: each N-th place of the file, from the K-th on. It listens K - 1 ports
    further, and keeps its rows in a folder of its own in the store's, or under a name of its own in the same database.

    Raises UsageError for more shards than places, and for a port that there is not.
    """
    if shard.count > (places := points_in(site)):
        raise UsageError(
            f"{site.file}: shards: must be at most as many as the file has points, {places}; received {shard.count}."
        )
    points = tuple(plan for plan in site.points if plan.place % shard.count == shard.number - 1)
    groups, offset = [], _sections(site)
    for plan in site.groups:
        first = (shard.number - 1 - offset) % shard.count
        own = replace(plan, numbers=range(first, plan.settings.points, shard.count))
        groups += [own] if own.numbers else []
        offset += plan.settings.points
    settings = site.settings.model_copy(
        update={"store": _store(site.settings.store, shard), "service": _service(site, shard)}
    )
    return replace(site, settings=settings, points=points, groups=tuple(groups), shard=shard)


def _sections(site: Site) -> int:
    return 1 + max((plan.place for plan in site.points), default=-1)


def _store(settings: StoreSettings, shard: Shard) -> StoreSettings:
    if settings.path is not None:
        return settings.model_copy(update={"path": f"{settings.path}/{shard.name}"})
    assert settings.url is not None
    url = settings.url.get_secret_value()
    sign = "&" if urlsplit(url).query else "?"
    named = SecretStr(f"{url}{sign}application_name=midspan-{shard.name}")
    return settings.model_copy(update={"url": named})


def _service(site: Site, shard: Shard) -> ServiceSettings:
    host, _, port = site.settings.service.listen.rpartition(":")
    own = int(port) + shard.number - 1 if int(port) else 0
    if own > MAX_PORT:
        raise UsageError(
            f"{site.file}: service.listen: shard {shard.number} would listen on port {own}; ports end with {MAX_PORT}. "
            "Give a lower one."
        )
    return site.settings.service.model_copy(update={"listen": f"{host}:{own}"})
