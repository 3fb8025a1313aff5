"""The messages to systemd."""

import os
import socket
from contextlib import suppress


def notify(text: str) -> None:
    """Send a line such as READY=1, WATCHDOG=1 or STOPPING=1 to systemd's socket in NOTIFY_SOCKET, if any."""
    address = os.environ.get("NOTIFY_SOCKET")
    if not address:
        return
    # An abstract address begins with @.
    name = f"\0{address[1:]}" if address.startswith("@") else address
    with suppress(OSError), socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC) as out:
        out.settimeout(1.0)
        out.sendto(text.encode(), name)
