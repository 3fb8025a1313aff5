"""Ray: the cluster at RAY_ADDRESS, or one of this machine alone that ends with whoever started it."""

import os
import secrets
import sys
from contextlib import ExitStack
from tempfile import TemporaryDirectory
from typing import Any

from midspan.errors import UsageError

# What Ray keeps between tasks, bytes: they take paths and give figures.
OBJECTS_BYTES = 100_000_000
# Read by Ray when it is imported; the last one has it listen on loopback, as on other systems.
OF_THIS_MACHINE = {
    "RAY_USAGE_STATS_ENABLED": "0",
    "RAY_AUTH_MODE": "token",
    "RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER": "0",
}


class RayCluster:
    """ray: the module, connected. Without RAY_ADDRESS the cluster is this machine, on loopback, with a token of its own
    and without dashboard and usage statistics; its files go at the end.

    Raises UsageError without Ray, and where no cluster answers at the address.
    """

    def __init__(self, processors: int, **options: Any) -> None:
        self._files, address = ExitStack(), os.environ.get("RAY_ADDRESS")
        if not address and "ray" not in sys.modules:
            os.environ |= OF_THIS_MACHINE
            os.environ.setdefault("RAY_AUTH_TOKEN", secrets.token_hex(32))
        try:
            import ray
        except ImportError:
            text = 'runner ray: Ray is not installed. Install it with `pip install "midspan[ray]"`.'
            raise UsageError(text) from None
        self.ray: Any = ray
        self._own = not self.ray.is_initialized()
        if self._own:
            how = {"address": address} if address else self._of_this_machine(processors)
            quiet = {"include_dashboard": False, "log_to_driver": False, "configure_logging": False}
            try:
                self.ray.init(**quiet, **how, **options)
            except ConnectionError as error:
                raise UsageError(f"runner ray: no cluster answers at RAY_ADDRESS = {address!r} ({error}).") from None

    def close(self) -> None:
        """Leave the cluster, or end it where it was started here."""
        if self._own:
            self.ray.shutdown()
        self._files.close()

    def _of_this_machine(self, processors: int) -> dict[str, Any]:
        folder = TemporaryDirectory(prefix="midspan-", ignore_cleanup_errors=True)
        return {
            "num_cpus": processors,
            "object_store_memory": OBJECTS_BYTES,
            "_node_ip_address": "127.0.0.1",
            "_temp_dir": self._files.enter_context(folder),
        }
