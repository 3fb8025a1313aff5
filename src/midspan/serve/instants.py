"""Times in requests: ISO 8601 (UTC where no zone is given) or whole nanoseconds since 1970."""

import re
import time
from datetime import UTC, datetime
from typing import Annotated

from fastapi import Query

from midspan.records import NANOSECONDS
from midspan.serve.problems import Problem

# What is asked for where nothing is said, s.
USUAL_S = 600.0
# From 1970 to 2200.
MAX_NS = 7_258_118_400 * NANOSECONDS
PATTERN = r"^(\d{1,19}|\d{4}-\d\d-\d\d([T ]\d\d(:\d\d(:\d\d(\.\d{1,9})?)?)?(Z|[+-]\d\d:?\d\d)?)?)$"
ISO = re.compile(r"(?P<whole>[^.]*?)(\.(?P<part>\d{1,9}))?(?P<zone>Z|[+-]\d\d:?\d\d)?")

From = Annotated[
    str | None,
    Query(
        alias="from", pattern=PATTERN, description="first instant: ISO 8601 (UTC without a zone) or whole ns",
        examples=["2026-11-22T10:00:00Z"],
    ),
]  # fmt: skip
To = Annotated[str | None, Query(pattern=PATTERN, description="end (exclusive); default: now")]


def instant_ns(text: str, name: str) -> int:
    """An instant in ns UTC. Raises Problem 422."""
    if text.isascii() and text.isdecimal():
        found = int(text)
    else:
        match = ISO.fullmatch(text)
        try:
            assert match is not None
            zoned = datetime.fromisoformat(
                match["whole"] + (match["zone"] or "+00:00" if len(match["whole"]) > 10 else "")
            )
        except (ValueError, AssertionError):
            text = f"{name}: must be an instant like 2026-11-22T10:00:00Z or whole ns since 1970; received {text!r}."
            raise Problem(422, text) from None
        zoned = zoned if zoned.tzinfo else zoned.replace(tzinfo=UTC)
        found = round(zoned.timestamp()) * NANOSECONDS + int((match["part"] or "0").ljust(9, "0"))
    if not 0 <= found < MAX_NS:
        raise Problem(422, f"{name}: must be between 1970 and 2200; received {text!r}.")
    return found


def span_ns(begin: str | None, end: str | None, usual_s: float = USUAL_S) -> tuple[int, int]:
    """First instant and end of a request; left out, the newest `usual_s`. Raises Problem 422."""
    end_ns = time.time_ns() if end is None else instant_ns(end, "to")
    first_ns = max(end_ns - round(usual_s * NANOSECONDS), 0) if begin is None else instant_ns(begin, "from")
    if first_ns >= end_ns:
        raise Problem(422, "from, to: `to` must be after `from`.")
    return first_ns, end_ns
