"""Captured recordings that nothing needs any more."""

import shutil
from pathlib import Path

# Of a point's calibrations the recordings that are kept: the one in force, and one that is offered.
KEPT = 2


def forget(folder: Path, settled_in: Path) -> None:
    """Remove a point's captured recordings from before the one it was opened from, but for the newest calibrations'."""
    before = settled_in.name.partition("-")[2]
    for kind, kept in (("opening", 0), ("calibration", KEPT)):
        older = sorted(one for one in folder.glob(f"{kind}-*") if one.name.partition("-")[2] < before)
        for one in older[: max(len(older) - kept, 0)]:
            shutil.rmtree(one, ignore_errors=True)
