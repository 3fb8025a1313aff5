"""Writes the versions that are installed here as pins: constraints.txt what users get, constraints-dev.txt the rest.

Names and versions only, no addresses. Call it with the virtual environment's Python; `make lock` does.
"""

import re
import subprocess
import sys
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path

from packaging.requirements import Requirement

# The extras that users install; all others are tools of the developers.
EXTRAS = ("", "csq", "live", "seismic")
ROOT = Path(__file__).resolve().parents[1]


def normal(name: str) -> str:
    """A package's name as indexes compare it."""
    return re.sub(r"[-_.]+", "-", name).lower()


def needed(name: str, extras: tuple[str, ...], found: set[str]) -> set[str]:
    """Normal names of a package and all that it needs here, added to `found`."""
    if normal(name) in found and not any(extras):
        return found
    try:
        requires = distribution(name).requires or []
    except PackageNotFoundError:
        return found
    found.add(normal(name))
    for text in requires:
        requirement = Requirement(text)
        if requirement.marker is None or any(requirement.marker.evaluate({"extra": extra}) for extra in extras):
            needed(requirement.name, ("", *requirement.extras), found)
    return found


def main() -> None:
    """Write both files."""
    command = [sys.executable, "-m", "pip", "freeze", "--exclude-editable", "--exclude", "midspan"]
    lines = subprocess.run(command, check=True, capture_output=True, text=True).stdout.splitlines()
    pins = [line for line in lines if "==" in line]
    users = needed("midspan", EXTRAS, set())
    for file, chosen in (("constraints.txt", True), ("constraints-dev.txt", False)):
        kept = [line for line in pins if (normal(line.split("==")[0]) in users) is chosen]
        (ROOT / file).write_text("\n".join(kept) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
