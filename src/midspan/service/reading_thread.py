"""A source that is read in a thread of its own, and opened again when it fails."""

import threading
from collections.abc import Callable, Iterable
from typing import Any

from midspan.service.pauses import Pauses
from midspan.sources.live.instants import SourceFault


class ReadingThread:
    """read: opens the source and gives what it brings, until it raises SourceFault.

    taken: called from the thread for each thing that it brings, and for each fault.
    """

    def __init__(self, name: str, read: Callable[[], Iterable[Any]], taken: Callable[[Any], None]) -> None:
        self._read, self._taken = read, taken
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._reading, daemon=True, name=name)

    def start(self) -> None:
        """Begin."""
        self._thread.start()

    def stop(self) -> None:
        """End; a source that is being waited for ends with the process."""
        self._ending.set()
        self._thread.join(timeout=0.5)

    def _reading(self) -> None:
        pauses = Pauses()
        while not self._ending.is_set():
            try:
                for item in self._read():
                    if self._ending.is_set():
                        return
                    pauses.worked()
                    self._taken(item)
            except SourceFault as fault:
                self._taken(fault)
            self._ending.wait(pauses.next_s())
