"""Where matplotlib keeps its list of fonts when the user's home cannot be written (a container, a hardened service)."""

import os
import sys
from contextlib import suppress


def prepare() -> None:
    """Set MPLCONFIGDIR to a folder of this process where matplotlib's own places cannot be written.

    To be called before matplotlib is imported, which warns otherwise. What the user has set stays.
    """
    if "MPLCONFIGDIR" in os.environ or all(map(_writable, _matplotlib_home(os.path.expanduser("~")))):
        return
    import atexit
    import shutil
    import tempfile

    # Without any place it stays unset.
    with suppress(OSError):
        path = tempfile.mkdtemp(prefix="midspan-")
        atexit.register(shutil.rmtree, path, ignore_errors=True)
        os.environ["MPLCONFIGDIR"] = path


def _matplotlib_home(home: str) -> tuple[str, ...]:
    if sys.platform != "linux":
        return (home,)
    named = (("XDG_CONFIG_HOME", ".config"), ("XDG_CACHE_HOME", ".cache"))
    return tuple(os.path.join(os.environ.get(name) or os.path.join(home, place), "matplotlib") for name, place in named)


def _writable(path: str) -> bool:
    """Whether a folder can be written, or made where it does not exist yet."""
    while not os.path.lexists(path):
        above = os.path.dirname(path)
        if above == path:
            return False
        path = above
    return os.path.isdir(path) and os.access(path, os.W_OK | os.X_OK)
