"""Addresses that give one file once: a browser saves, or opens, what it goes to, and sends no token of a page along."""

import secrets
import time
from dataclasses import dataclass
from pathlib import Path

# From the page's answer to the browser's request there are milliseconds; a person's question in between takes more, s.
VALID_S = 60.0


@dataclass(frozen=True, slots=True)
class Ticket:
    """file: what is given; media: its type; name: under which it is saved, "" for what is shown; is_made: for this
    alone, so that it is removed afterwards.
    """

    file: Path
    media: str
    name: str = ""
    is_made: bool = False


class Tickets:
    """Those that wait to be used."""

    def __init__(self) -> None:
        self._waiting: dict[str, tuple[float, Ticket]] = {}

    def put(self, ticket: Ticket) -> str:
        """The number of a ticket: 256 random bits."""
        number = secrets.token_urlsafe(32)
        self._waiting[number] = (time.monotonic() + VALID_S, ticket)
        return number

    def take(self, number: str) -> Ticket | None:
        """A ticket, which is used up; None for one that is no more, or never was."""
        until_s, ticket = self._waiting.pop(number, (0.0, None))
        return ticket if time.monotonic() < until_s else None
