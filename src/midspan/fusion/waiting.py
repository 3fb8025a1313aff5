"""Displacement that was pushed before the acceleration that covers its time."""

import numpy as np

from midspan.records import Displacement, joined, part


class Waiting:
    """Measurements in time order until they are due."""

    def __init__(self) -> None:
        self._blocks: list[Displacement] = []

    def push(self, record: Displacement) -> None:
        """Put a block in; blocks of several sensors may overlap in time."""
        if len(record.time_ns):
            self._blocks.append(record)

    def take(self, until_ns: int) -> Displacement | None:
        """The measurements up to and at `until_ns`, None where there are none; the later ones go on waiting."""
        if not self._blocks:
            return None
        waiting = joined(self._blocks)
        if len(self._blocks) > 1:
            waiting = part(waiting, np.argsort(waiting.time_ns, kind="stable"))
        due = int(np.searchsorted(waiting.time_ns, until_ns, side="right"))
        self._blocks = [part(waiting, slice(due, None))] if due < len(waiting.time_ns) else []
        return part(waiting, slice(due)) if due else None
