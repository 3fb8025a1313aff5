"""How long work tells how far it is: a function of (done, total, what)."""

from collections.abc import Callable

Progress = Callable[[int, int, str], None]


def silent(done: int, total: int, what: str) -> None:
    """Say nothing."""
