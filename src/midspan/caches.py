"""Where compiled code and fonts are kept when neither the package nor the user's home can be written.

Numba keeps compiled code in the package, else in the user's cache folder; without either (a hardened container, a
service with a protected home) it fails, and matplotlib warns. Then a private folder below a temporary one serves both.
"""

import os
import sys
from contextlib import suppress

TYPE_CHECKING = False  # see `cli/main.py`
if TYPE_CHECKING:
    from typing import Any

_PACKAGE = os.path.dirname(os.path.abspath(__file__))
# The last one is there where a service may write nothing but its own folder.
_TEMPORARY = (os.environ.get("TMPDIR", ""), os.environ.get("TEMP", ""), "/tmp", "/var/tmp", "/dev/shm")
_PRIVATE_BITS = 0o077  # what group and others may do


def prepare() -> None:
    """Set NUMBA_CACHE_DIR and MPLCONFIGDIR to a private folder where their own places cannot be written.

    To be called before Numba compiles anything. What the user has set stays.
    """
    home = os.path.expanduser("~")
    if "NUMBA_CACHE_DIR" not in os.environ and not any(map(_writable, (_in_package(), _numba_home(home)))):
        _use_private("NUMBA_CACHE_DIR", "numba")
        _tolerate_failures()
    if "MPLCONFIGDIR" not in os.environ and not all(map(_writable, _matplotlib_home(home))):
        _use_private("MPLCONFIGDIR", "matplotlib")


def _tolerate_failures() -> None:
    """Let Numba go on where compiled code cannot be kept: without any place, or on a full disk."""
    import importlib

    numba: Any = importlib.import_module("numba")
    caching: Any = importlib.import_module("numba.core.caching")
    if "NUMBA_CACHE_DIR" not in os.environ:
        importlib.import_module("numba.core.dispatcher").Dispatcher.enable_caching = lambda self: None
        return
    # Where it was imported before midspan it has read its settings already.
    numba.config.CACHE_DIR = os.environ["NUMBA_CACHE_DIR"]
    save = caching.Cache.save_overload

    def save_if_possible(self: "Any", *given: "Any") -> None:
        with suppress(OSError):
            save(self, *given)

    caching.Cache.save_overload = save_if_possible


def _in_package() -> str:
    """The folder of compiled code next to one of the modules that have any; the others are written with it."""
    return os.path.join(_PACKAGE, "fusion", "__pycache__")


def _numba_home(home: str) -> str:
    if sys.platform != "linux":
        return home
    return os.path.join(os.environ.get("XDG_CACHE_HOME") or os.path.join(home, ".cache"), "numba")


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


def _use_private(variable: str, name: str) -> None:
    """Let `variable` name a subfolder of the private folder; without a place for one it stays unset."""
    for place in _TEMPORARY:
        if place and os.path.isdir(place) and _writable(place):
            try:
                path = os.path.join(_private_folder(place), name)
                os.makedirs(path, mode=0o700, exist_ok=True)
            except OSError:
                continue
            os.environ[variable] = path
            return


def _private_folder(place: str) -> str:
    """A folder in `place` that nobody else may read or write, kept from run to run."""
    if not hasattr(os, "getuid"):
        path = os.path.join(place, "midspan")
        os.makedirs(path, exist_ok=True)
        return path
    path = os.path.join(place, f"midspan-{os.getuid()}")
    if not os.path.lexists(path):
        _make(path)
    found = os.lstat(path)
    if os.path.islink(path) or found.st_uid != os.getuid() or found.st_mode & _PRIVATE_BITS:
        # Somebody else has taken the name, and code that he compiled must not be run: a new folder each time.
        return _passing_folder(place)
    return path


def _make(path: str) -> None:
    try:
        os.mkdir(path, 0o700)
    except FileExistsError:
        # Another process of this user was quicker, or of another one: the owner is looked at next.
        return


def _passing_folder(place: str) -> str:
    import atexit
    import shutil
    import tempfile

    path = tempfile.mkdtemp(prefix="midspan-", dir=place)
    atexit.register(shutil.rmtree, path, ignore_errors=True)
    return path
