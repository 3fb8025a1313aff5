"""Is the error band honest, and are refusals right? Recordings that obey the model and recordings that break it."""

import argparse
import os
import re
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

from benchmarks.honest.judge import Outcome, measured, read, write
from benchmarks.honest.kinds import KINDS, Kind
from benchmarks.honest.tables import report

PROCESSES = 2


def run_here(kinds: Sequence[Kind], options: argparse.Namespace) -> None:
    """Measure every recording of this process, from number `options.part` on; outcomes are written as they come."""
    tasks = [(kind, seed) for kind in kinds for seed in seeds(kind, options)]
    found: list[Outcome] = []
    for kind, seed in tasks[options.part :: options.processes]:
        with tempfile.TemporaryDirectory() as name:
            folder = Path(options.keep or name) / f"{kind.label}-{seed}"
            folder.mkdir(parents=True, exist_ok=True)
            found += measured(kind, seed, folder)
        write(Path(options.table), found)
    write(Path(options.table), found)


def seeds(kind: Kind, options: argparse.Namespace) -> Sequence[int]:
    """The seeds of a kind's recordings."""
    return options.seed or range(options.seeds or (1 if options.quick else kind.count))


def run_apart(folder: Path, processes: int) -> list[Outcome]:
    """Run the same command line in several processes of one thread each, and read what they wrote."""
    one_thread = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")
    folder.mkdir(parents=True, exist_ok=True)
    tables = [folder / f"{part}.csv" for part in range(processes)]
    command = [sys.executable, "-m", "benchmarks.honesty", *(word for word in sys.argv[1:] if word != "honesty")]
    children = [
        subprocess.Popen([*command, "--part", str(part), "--table", str(table)], env=os.environ | one_thread)
        for part, table in enumerate(tables)
    ]
    codes = [child.wait() for child in children]
    if any(codes):
        raise SystemExit("a process of the benchmark ended with an error")
    order = {kind.label: number for number, kind in enumerate(KINDS)}
    found = [one for table in tables for one in read(table)]
    return sorted(found, key=lambda one: (order[one.kind], one.seed, one.method))


def main() -> None:
    """`python -m benchmarks honesty [--quick]`; alone (`python -m benchmarks.honesty`) also with the other options."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.honesty", description=__doc__)
    parser.add_argument("--quick", action="store_true", help="one recording of each kind")
    parser.add_argument("--only", default="", help="kinds whose name holds this pattern")
    parser.add_argument("--outdoors", action="store_true", help="only the troubles of outdoor installations")
    parser.add_argument("--seed", type=int, action="append", help="this seed alone; may be repeated")
    parser.add_argument("--seeds", type=int, help="so many recordings of each kind")
    parser.add_argument("--processes", type=int, default=PROCESSES, help="how many at a time")
    parser.add_argument("--csv", help="file for the outcomes, one a row")
    parser.add_argument("--table", help=argparse.SUPPRESS)
    parser.add_argument("--keep", help="folder in which recordings and outcomes stay")
    parser.add_argument("--part", type=int, help=argparse.SUPPRESS)
    options, _ = parser.parse_known_args()
    if options.part is not None:
        kinds = [kind for kind in KINDS if kind.outdoors or not options.outdoors]
        run_here([kind for kind in kinds if re.search(options.only, kind.label)], options)
        return
    with tempfile.TemporaryDirectory() as name:
        found = run_apart(Path(options.keep or name), options.processes)
    if options.csv:
        write(Path(options.csv), found)
    report(found)


if __name__ == "__main__":
    main()
