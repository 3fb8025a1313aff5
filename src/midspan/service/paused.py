"""Sources that are left out on purpose, with the reason: kept next to the store, so that a restart does not forget."""

import json
from contextlib import suppress
from pathlib import Path

from midspan.writing import write_whole

PAUSED_FILE = "paused.json"


class Paused:
    """reasons: by the sources' names, POINT.KIND."""

    def __init__(self, folder: Path) -> None:
        self._file = folder / PAUSED_FILE
        self.reasons: dict[str, str] = {}
        with suppress(OSError, ValueError):
            tree = json.loads(self._file.read_text(encoding="utf-8"))
            self.reasons = {str(name): str(reason) for name, reason in tree.items()}

    def put(self, source: str, reason: str | None) -> None:
        """Pause a source, or None: use it again. Raises UsageError where that cannot be written."""
        reasons = {name: text for name, text in self.reasons.items() if name != source}
        if reason is not None:
            reasons[source] = reason
        write_whole(self._file, json.dumps(reasons).encode())
        self.reasons = reasons
