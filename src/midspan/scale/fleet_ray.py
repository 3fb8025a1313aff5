"""Shards as actors on a cluster of Ray: named and detached, so that they outlive their driver, which finds them again.

An actor whose process or node is lost is started anew by Ray. It keeps nothing: what it knows is in the store.
"""

import os
import secrets
import socket
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from typing import Any

from midspan.scale.fleet import LOOK_S, ShardState
from midspan.scale.pulse import SILENT_S, Pauses, Pulse
from midspan.scale.ray_cluster import RayCluster

NAMESPACE = "midspan"
# What Ray counts for a shard: thousands of points without camera take less than half a processor.
PROCESSORS = 0.5
ANSWER_S, END_S = 10.0, 30.0
# Runs shard K of N of a site's file until the event is set.
Work = Callable[[str, int, int, threading.Event], None]


class ShardActor:
    """What runs in an actor: the service in a thread, started again where it ends; the process ends where it hangs."""

    def __init__(self, work: Work, site_file: str, number: int, count: int) -> None:
        self._arguments = (site_file, number, count)
        self._work, self._number = work, number
        self._life, self._restarts, self._text = secrets.token_hex(4), 0, ""
        self._stop, self._pulse = threading.Event(), Pulse()
        os.environ["NOTIFY_SOCKET"] = self._pulse.address
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()
        threading.Thread(target=self._watch, daemon=True).start()

    def state(self) -> dict[str, Any]:
        """How it stands; life: another one in each process."""
        from ray.util import get_node_ip_address

        return {
            "life": self._life, "pid": os.getpid(), "restarts": self._restarts, "host": socket.gethostname(),
            "text": self._text, "address": str(get_node_ip_address()),
        }  # fmt: skip

    def stop(self) -> None:
        """End the service; what it received is stored."""
        self._stop.set()
        self._thread.join(END_S)

    def _run(self) -> None:
        pauses = Pauses()
        while not self._stop.is_set():
            pauses.begun()
            self._pulse.begin()
            try:
                self._work(*self._arguments, self._stop)
                why = "it ended"
            except Exception as error:
                why = f"it ended ({type(error).__name__}: {error})"
            if self._stop.is_set():
                return
            pause_s = pauses.ended()
            self._text = f"{why}; it is started again after {pause_s:.0f} s."
            self._restarts += 1
            until_s = time.monotonic() + pause_s
            while time.monotonic() < until_s and not self._stop.wait(LOOK_S):
                self._pulse.begin()

    def _watch(self) -> None:
        while not self._stop.wait(LOOK_S):
            if self._pulse.silent_s() > SILENT_S:
                os._exit(1)


class RayShards:
    """All shards of a site; name: of the site, under which its actors are found."""

    def __init__(self, work: Work, site_file: str, name: str, count: int) -> None:
        self._cluster = RayCluster(max(os.cpu_count() or 1, count), namespace=NAMESPACE)
        self._ray, self._work = self._cluster.ray, work
        self._site_file, self._name, self._count = site_file, name, count
        self._lives: dict[int, set[str]] = {k: set() for k in range(1, count + 1)}
        self._known = {k: ShardState(k) for k in range(1, count + 1)}
        self._asked: dict[int, tuple[Any, Any, float]] = {}
        self._answered_s = dict.fromkeys(self._known, time.monotonic())

    def look(self) -> list[ShardState]:
        """Create those that there are not, ask all how they stand; Ray starts those whose process ended."""
        for number in self._known:
            try:
                self._look_at(number)
            except self._ray.exceptions.RayError as error:
                self._no_answer(number, f"the cluster does not answer ({type(error).__name__})")
        return list(self._known.values())

    def stop(self) -> None:
        """End all; what they received is stored."""
        try:
            with suppress(self._ray.exceptions.RayError):
                handles = [one for one in map(self._found, self._known) if one is not None]
                stopping = [handle.stop.remote() for handle in handles]
                self._ray.wait(stopping, num_returns=len(stopping), timeout=END_S) if stopping else None
                for handle in handles:
                    self._ray.kill(handle, no_restart=True)
        finally:
            self._cluster.close()

    def _look_at(self, number: int) -> None:
        """Take the answer of a shard that was asked before, or ask it."""
        if number not in self._asked:
            handle = self._actor(number)
            self._asked[number] = handle, handle.state.remote(), time.monotonic()
        handle, asked, asked_s = self._asked[number]
        done, _ = self._ray.wait([asked], timeout=0.0)
        if not done and time.monotonic() - self._answered_s[number] > SILENT_S:
            self._ray.kill(handle, no_restart=False)
            self._answered_s[number] = time.monotonic()
            self._no_answer(number, f"it gave no answer for {SILENT_S:.0f} s and is started again")
            return
        if not done:
            if time.monotonic() - asked_s > ANSWER_S:
                self._no_answer(number, "it does not answer")
            return
        del self._asked[number]
        try:
            found = self._ray.get(asked)
        except self._ray.exceptions.RayError as error:
            self._no_answer(number, f"its actor was lost ({type(error).__name__}) and is started again")
            return
        self._answered_s[number] = time.monotonic()
        lives = self._lives[number]
        lives.add(found["life"])
        restarts = len(lives) - 1 + found["restarts"]
        text = found["text"] or self._known[number].text
        self._known[number] = ShardState(number, found["pid"], restarts, found["host"], text, found["address"])

    def _no_answer(self, number: int, why: str) -> None:
        self._asked.pop(number, None)
        before = self._known[number]
        self._known[number] = replace(before, pid=None, text=f"{why}.")

    def _found(self, number: int) -> Any:
        """The actor of a shard; None where there is none."""
        try:
            return self._ray.get_actor(self._actor_name(number), namespace=NAMESPACE)
        except ValueError:
            return None

    def _actor_name(self, number: int) -> str:
        return f"{self._name} {number} of {self._count}"

    def _actor(self, number: int) -> Any:
        """The actor of a shard, which is created where there is none."""
        return self._ray.remote(ShardActor).options(
            name=self._actor_name(number), namespace=NAMESPACE, get_if_exists=True, lifetime="detached",
            max_restarts=-1, num_cpus=PROCESSORS, max_concurrency=4, scheduling_strategy="SPREAD",
        ).remote(self._work, self._site_file, number, self._count)  # fmt: skip
