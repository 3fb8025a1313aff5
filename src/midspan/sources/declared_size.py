"""The size that a file's header declares, asked against the available memory before anything is allocated.

A header of a few bytes can declare any size, by damage or on purpose; without this check the system ends the process.
"""

from pathlib import Path

from midspan.errors import DataError

# Where the system does not say how much memory is available, bytes.
_ASSUMED_BYTES = 4 << 30
_CONTAINER = "/sys/fs/cgroup"


def require_memory(path: Path, declared_bytes: int, what: str) -> None:
    """Raise DataError where `declared_bytes`, what reading `what` of a file would allocate, exceed available memory."""
    limit = available_bytes()
    if declared_bytes > limit:
        raise DataError(
            f"{path}: {what} must fit into the available memory, {shown_bytes(limit)}; by the file it takes "
            f"{shown_bytes(declared_bytes)}. Check that the file is whole; if it is, split it, or read it on a machine "
            "with more memory."
        )


def available_bytes() -> int:
    """Memory that this process can still allocate: what system and container have left, within its own limit."""
    left = _after("/proc/meminfo", "MemAvailable:")
    free = _ASSUMED_BYTES if left is None else 1024 * left
    # Of a container (control groups, version 2); a limit that is not set is the word "max".
    most, taken = _after(f"{_CONTAINER}/memory.max", ""), _after(f"{_CONTAINER}/memory.current", "")
    free = free if most is None or taken is None else min(free, max(most - taken, 0))
    # Both in bytes and in kB, as the kernel writes them; a limit that is not set is no number.
    limit, used = _after("/proc/self/limits", "Max address space"), _after("/proc/self/status", "VmSize:")
    return free if limit is None or used is None else min(free, max(limit - 1024 * used, 0))


def _after(file: str, name: str) -> int | None:
    """The whole number behind a name at the start of a line; None where the file, the name or a number is missing."""
    try:
        lines = Path(file).read_text(encoding="ascii", errors="replace").splitlines()
    except OSError:
        return None
    words = next((line.removeprefix(name).split() for line in lines if line.startswith(name)), [])
    return int(words[0]) if words and words[0].isdigit() else None


def shown_bytes(count: int) -> str:
    """A count of bytes for a person."""
    return f"{count / 2**30:.1f} GiB" if count >= 2**30 else f"{count / 2**20:.1f} MiB"
