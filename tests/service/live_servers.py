"""Ports and processes for the tests of live sites."""

import socket
import sys
import time


def free_port():
    """A port of loopback that nothing listens on."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        return server.getsockname()[1]


def wait_for(port, seconds=20.0):
    """Wait until something listens on a port."""
    until_s = time.monotonic() + seconds
    while time.monotonic() < until_s:
        try:
            socket.create_connection(("127.0.0.1", port), timeout=1.0).close()
        except OSError:
            time.sleep(0.1)
        else:
            return
    raise TimeoutError(port)


def command(*arguments):
    """The midspan command as a process of its own."""
    return [sys.executable, "-c", "from midspan.cli.main import main; main()", *map(str, arguments)]
