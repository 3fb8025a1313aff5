"""How the shards of a site stand: all are asked at once, each at its own address."""

import json
import socket
import ssl
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from http.client import HTTPException
from typing import Any, NamedTuple
from urllib.error import HTTPError, URLError
from urllib.request import urlopen

from midspan.scale.fleet import Fleet, ShardState
from midspan.settings.shard import shard_of
from midspan.settings.site import ServiceSettings, Shard, Site, is_loopback

# For all of them together, s.
ANSWER_S = 5.0
# Addresses to listen on that stand for all of a machine, and the one at which it asks itself.
EVERYWHERE = {"0.0.0.0": "127.0.0.1", "[::]": "[::1]", "": "127.0.0.1"}


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


class Answer(NamedTuple):
    """Whether a service is ready, and what is wrong."""

    ready: bool
    text: str


def shard_reports(site: Site, count: int, fleet: Fleet | None) -> list[ShardReport]:
    """How all shards of a site stand; fleet: what its driver wrote last."""
    states = {} if fleet is None else {one.shard: one for one in fleet.shards}
    numbers = range(1, count + 1)
    services = [shard_of(site, Shard(number, count)).settings.service for number in numbers]
    addresses = [address_of(one.listen, states.get(number)) for number, one in zip(numbers, services, strict=True)]
    answers = at_once([partial(_ask, *of) for of in zip(addresses, services, strict=True)])
    reports = []
    for number, address, service, answer in zip(numbers, addresses, services, answers, strict=True):
        state = states.get(number)
        counted = (None, None) if state is None else (state.restarts, state.pid)
        reports.append(ShardReport(number, address or service.listen, answer.ready, answer.text, *counted))
    return reports


def address_of(listen: str, state: ShardState | None) -> str | None:
    """The HOST:PORT at which a shard answers this machine; None where it listens on loopback of another one."""
    host, _, port = listen.rpartition(":")
    if state is None or state.host in ("", socket.gethostname()):
        return f"{EVERYWHERE.get(host, host)}:{port}"
    if host in EVERYWHERE:
        return f"[{state.address}]:{port}" if ":" in state.address else f"{state.address}:{port}"
    return None if is_loopback(listen) else listen


def at_once(questions: Sequence[Callable[[], Answer]]) -> list[Answer]:
    """The answers of questions that are asked at once, of those that take too long that there is none."""
    answers = [Answer(False, f"no answer within {ANSWER_S:g} s")] * len(questions)

    def ask(place: int) -> None:
        answers[place] = questions[place]()

    # What takes longer does not hold up the end of the process.
    threads = [threading.Thread(target=ask, args=(place,), daemon=True) for place in range(len(questions))]
    for thread in threads:
        thread.start()
    until_s = time.monotonic() + ANSWER_S
    for thread in threads:
        thread.join(max(until_s - time.monotonic(), 0.0))
    return answers.copy()


def _ask(address: str | None, service: ServiceSettings) -> Answer:
    if address is None:
        return Answer(
            False, "it answers its own machine alone: set service.listen to 0.0.0.0 with tls_cert, or ask there"
        )
    return asked(address, tls=service.tls_cert is not None)


def asked(address: str, *, tls: bool) -> Answer:
    """What the service at HOST:PORT answers."""
    # Nothing secret is asked: a certificate for the outside need not have this name.
    context = ssl._create_unverified_context() if tls else None
    try:
        url = f"{'https' if tls else 'http'}://{address}/readyz"
        try:
            answer = urlopen(url, timeout=ANSWER_S, context=context)
        except HTTPError as error:
            # Of one that is not ready: it says why.
            answer = error
        with answer:
            return _read(answer.read())
    except (URLError, OSError, HTTPException) as error:
        return Answer(False, f"no answer ({getattr(error, 'reason', None) or error or type(error).__name__})")


def _read(body: bytes) -> Answer:
    try:
        tree: dict[str, Any] = json.loads(body)
        wrong = [one for key in ("sources", "points") for one in tree.get(key, []) if one.get("reason")]
        names = [f"{one.get('point') or one.get('source') or one.get('name', '')}: {one['reason']}" for one in wrong]
        return Answer(bool(tree.get("ready")), ", ".join(dict.fromkeys(names)))
    except (ValueError, AttributeError, TypeError):
        return Answer(False, "an answer that is none")
