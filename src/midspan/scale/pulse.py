"""Whether a shard lives, by what its service sends to systemd and is heard here; and the pauses before a new start."""

import socket
import tempfile
import time
from contextlib import suppress
from pathlib import Path

# A service that measures says so once a second. Of one that starts, camera points open for a minute without a word.
SILENT_S = 120.0
# A shard that ended starts again after this pause, doubled each time it ended soon.
FIRST_PAUSE_S, MAX_PAUSE_S, SOON_S = 1.0, 60.0, 60.0


class Pulse:
    """A socket for NOTIFY_SOCKET, and when something last came there."""

    def __init__(self) -> None:
        self._folder = tempfile.TemporaryDirectory(prefix="midspan-")
        self.address = str(Path(self._folder.name) / "notify")
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC)
        self._socket.bind(self.address)
        self._socket.setblocking(False)
        self._heard_s = time.monotonic()

    def begin(self) -> None:
        """A service begins: what the one before it said counts no more."""
        self.silent_s()
        self._heard_s = time.monotonic()

    def silent_s(self) -> float:
        """For how long nothing came."""
        # Several threads may look.
        with suppress(BlockingIOError):
            while self._socket.recv(4096):
                self._heard_s = time.monotonic()
        return time.monotonic() - self._heard_s

    def close(self) -> None:
        """Remove the socket."""
        self._socket.close()
        self._folder.cleanup()


class Pauses:
    """How long to wait before the next start."""

    def __init__(self) -> None:
        self._pause_s, self._begun_s = FIRST_PAUSE_S, time.monotonic()

    def begun(self) -> None:
        """It starts now."""
        self._begun_s = time.monotonic()

    def ended(self) -> float:
        """It ended: the pause."""
        if time.monotonic() - self._begun_s >= SOON_S:
            self._pause_s = FIRST_PAUSE_S
        pause_s, self._pause_s = self._pause_s, min(2.0 * self._pause_s, MAX_PAUSE_S)
        return pause_s
