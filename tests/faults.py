"""Faults while files are written: a kill before the n-th call of the system, a disk that is full."""

import os
import resource
import signal
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

# Every way in which midspan, tempfile and shutil change files through the module os.
CALLS = ("open", "write", "fsync", "replace", "rename", "mkdir", "unlink", "rmdir")


def in_child(action: Callable[[], object]) -> int:
    """Run `action` in a copy of this process; returns the signal that ended it, 0 where it came to its end."""
    with warnings.catch_warnings():
        # Newer Pythons warn of threads; nothing in the child waits for one.
        warnings.simplefilter("ignore")
        child = os.fork()
    if child == 0:
        try:
            action()
        finally:
            os._exit(0)
    return os.WTERMSIG(os.waitpid(child, 0)[1])


def killed_before(step: int, action: Callable[[], object], calls: tuple[str, ...] = CALLS) -> bool:
    """Run `action` in a child that is killed before the `step`-th (from 1) of these calls; whether it came so far."""

    def counted() -> None:
        made = 0

        def instead(real: Callable[..., Any]) -> Callable[..., Any]:
            def call(*arguments: Any, **keywords: Any) -> Any:
                nonlocal made
                made += 1
                if made == step:
                    os.kill(os.getpid(), signal.SIGKILL)
                return real(*arguments, **keywords)

            return call

        for name in calls:
            setattr(os, name, instead(getattr(os, name)))
        action()

    return in_child(counted) == signal.SIGKILL


@contextmanager
def largest_file(size_bytes: int) -> Iterator[None]:
    """No file grows beyond this size inside the block, as on a full disk."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size_bytes, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
