"""How the shards of a site stand, asked of each at its own address."""

import json
import ssl
from dataclasses import dataclass
from typing import Any
from urllib.error import HTTPError, URLError
from urllib.request import urlopen

ANSWER_S = 5.0


@dataclass(frozen=True, slots=True)
class ShardReport:
    """A shard's number, address, whether it answers and all its points give rows, what is wrong, how often it was
    started again (None: nobody counts), and its process.
    """

    shard: int
    address: str
    ready: bool
    text: str
    restarts: int | None = None
    pid: int | None = None


def asked(address: str, *, tls: bool) -> tuple[bool, str]:
    """Whether the service at HOST:PORT is ready, and what is wrong."""
    host, _, port = address.rpartition(":")
    host = {"0.0.0.0": "127.0.0.1", "[::]": "[::1]", "": "127.0.0.1"}.get(host, host)
    # Nothing secret is asked: a certificate for the outside need not have this name.
    context = ssl._create_unverified_context() if tls else None
    try:
        url = f"{'https' if tls else 'http'}://{host}:{port}/readyz"
        with urlopen(url, timeout=ANSWER_S, context=context) as answer:
            return _read(answer.read())
    except HTTPError as error:
        return _read(error.read())
    except (URLError, OSError) as error:
        return False, f"no answer ({getattr(error, 'reason', error)})"


def _read(body: bytes) -> tuple[bool, str]:
    try:
        tree: dict[str, Any] = json.loads(body)
        wrong = [one for key in ("sources", "points") for one in tree.get(key, []) if one.get("reason")]
        names = [f"{one.get('point') or one.get('source') or one.get('name', '')}: {one['reason']}" for one in wrong]
        return bool(tree.get("ready")), ", ".join(dict.fromkeys(names))
    except (ValueError, AttributeError, TypeError):
        return False, "an answer that is none"
