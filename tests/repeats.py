"""Cases that repeat a fact with another seed, size or sensor: `make slow` runs them, `make test` leaves them out."""

from typing import Any

import pytest


def slow(*cases: Any) -> list[Any]:
    """Cases of `pytest.mark.parametrize` that are marked as slow; a tuple holds several arguments."""
    return [
        pytest.param(*(case if isinstance(case, tuple) else (case,)), marks=pytest.mark.slow, id=None) for case in cases
    ]
