"""The workers of the server: what is left of them when it ends."""

import asyncio
from multiprocessing import resource_tracker

from midspan.serve.serving import Worker, process


def test_a_worker_that_ends_leaves_no_semaphores(monkeypatch):
    """The server's process ends without clearing up: what is left then is a warning of Python's on the terminal."""
    left = set()
    monkeypatch.setattr(resource_tracker, "register", lambda name, kind: left.add(name))
    monkeypatch.setattr(resource_tracker, "unregister", lambda name, kind: left.remove(name))
    worker = Worker(process)
    assert asyncio.run(worker.run(abs, -1)) == 1
    assert left
    worker.close()
    assert not left
