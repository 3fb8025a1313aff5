"""Run the benchmarks named on the command line, or all of them: `python -m benchmarks [NAME …] [--quick]`.

What begins with -- is read by the benchmark itself.
"""

import importlib
import sys
import time
from pathlib import Path

SUPPORT = {"__init__", "__main__", "cases", "peer_work", "radar_loop", "table"}


def names() -> list[str]:
    """The benchmarks' names: every module of this folder that holds a `main`."""
    return sorted(path.stem for path in Path(__file__).parent.glob("*.py") if path.stem not in SUPPORT)


def run(name: str) -> None:
    """Run one benchmark under its headline."""
    module = importlib.import_module(f"benchmarks.{name}")
    print(f"\n## {name}: {(module.__doc__ or '').splitlines()[0]}", flush=True)
    start = time.perf_counter()
    module.main()
    print(f"({time.perf_counter() - start:.1f} s)", flush=True)


def main(wanted: list[str]) -> int:
    """Run what is wanted; returns the exit code."""
    wanted = [name for name in wanted if not name.startswith("--")]
    unknown = sorted(set(wanted) - set(names()))
    if unknown:
        print(f"unknown: {', '.join(unknown)}; known: {', '.join(names())}", file=sys.stderr)
        return 2
    for name in wanted or names():
        run(name)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
