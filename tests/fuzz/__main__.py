"""Many damaged files for every reader, with a table at the end: `make fuzz`, or `python -m fuzz --help`."""

import argparse
import importlib
import json
import os
import shlex
import shutil
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

# Before NumPy and the decoders: one thread each, so that a forked child inherits no lock that nobody will open.
for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")
# Arenas of memory of a thread each count against the address space long before they hold anything.
os.environ.setdefault("MALLOC_ARENA_MAX", "2")
# The command lets an unforeseen exception through, so that its place can be named.
os.environ["MIDSPAN_TRACEBACK"] = "1"

from fuzz.runs import GROWTH, Outcome, case, outcomes  # noqa: E402
from fuzz.seeds import GROUPS  # noqa: E402
from fuzz.world import FILE, Seed  # noqa: E402

FAULTS = ("uncaught", "crash", "hang", "memory", "leak", "growth", "printed")
# Imported once, before any child is forked.
IMPORTED = (
    "midspan.cli.inspect", "midspan.cli.calibrate", "midspan.cli.estimate", "midspan.cli.compare", "midspan.cli.track",
    "midspan.cli.check_config", "midspan.recording.estimate", "midspan.recording.calibrate",
    "midspan.recording.inspect", "midspan.sources.inspect", "midspan.evaluate.result_file",
)  # fmt: skip


def share(seeds: Sequence[Seed], inputs: int, first: int) -> list[tuple[Seed, list[int]]]:
    """The numbers of each seed's cases: every reader gets `inputs` of them, whatever the number of its seeds.

    Growth is measured with the first seed of a reader.
    """
    readers = Counter(seed.reader for seed in seeds)
    firsts = {seed.reader: seed.name for seed in reversed(seeds)}
    shares = []
    for seed in seeds:
        numbers = list(range(first, first + -(-inputs // readers[seed.reader])))
        shares.append((seed, [*numbers, GROWTH] if firsts[seed.reader] == seed.name else numbers))
    return shares


def made(seed: Seed, folder: Path) -> Path:
    """The folder of a whole seed, made in a child: what its writers start and keep stays there."""
    place = folder / seed.name
    place.mkdir()
    child = os.fork()
    if child == 0:
        code = 1
        try:
            seed.make(place)
            code = 0
        except BaseException as error:
            print(f"{seed.name}: {type(error).__name__}: {error}", file=sys.stderr, flush=True)
        finally:
            os._exit(code)
    if os.waitpid(child, 0)[1] != 0:
        raise RuntimeError(f"{seed.name} cannot be made")
    return place


def work(seed: Seed, numbers: list[int], folder: Path, run: str) -> None:
    """Make a seed, damage it once for each number and write what came of each to a file of its name."""
    place = made(seed, folder)
    with (folder / f"{seed.name}.jsonl").open("w", encoding="utf-8") as file:
        for found in outcomes(seed, numbers, place, run):
            file.write(json.dumps(asdict(found)) + "\n")
            if found.fault:
                keep(seed, found, place, run)


def keep(seed: Seed, found: Outcome, place: Path, run: str) -> None:
    """Copy the damaged recording to the folder of failures, with the commands that repeat it."""
    kept = place.parent / "failures" / f"{seed.name}-{found.number}-{found.fault}"
    shutil.copytree(place, kept)
    if found.number != GROWTH:
        (kept / seed.file).write_bytes(case(seed, (place / seed.file).read_bytes(), found.number, run)[1])
    lines = ['cd "$(dirname "$0")"']
    lines += [shlex.join(["midspan", *(seed.file if w == FILE else w for w in c)]) for c in seed.commands]
    text = "\n".join([f"# {found.fault} after {found.kind}: {found.detail}", *lines])
    (kept / "repeat.sh").write_text(text + "\n", encoding="utf-8")


def table(found: Sequence[Outcome]) -> str:
    """Inputs, exit codes and faults of each reader, as text."""
    heads = ("reader", "inputs", "0", "2", "3", "4", *FAULTS)
    readers = list(dict.fromkeys(one.reader for one in found))
    rows = [heads, *(_row(name, [one for one in found if one.reader == name]) for name in readers)]
    rows.append(_row("all", found))
    widths = [max(len(str(row[k])) for row in rows) for k in range(len(heads))]
    return "\n".join(
        "  ".join(
            f"{cell!s:<{w}}" if k == 0 else f"{cell!s:>{w}}"
            for k, (cell, w) in enumerate(zip(row, widths, strict=True))
        )
        for row in rows
    )


def _row(name: str, found: Sequence[Outcome]) -> tuple[object, ...]:
    # An exit code is counted where nothing else is wrong, so that a row adds up.
    codes = Counter(one.code for one in found if one.number != GROWTH and not one.fault)
    faults = Counter(one.fault for one in found)
    return (
        name,
        sum(one.number != GROWTH for one in found),
        *(codes[c] for c in (0, 2, 3, 4)),
        *(faults[f] for f in FAULTS),
    )


def fuzz(shares: Sequence[tuple[Seed, list[int]]], folder: Path, run: str, *, workers: int) -> list[Outcome]:
    """Damage every seed once for each of its numbers; `workers` processes at once, each a fork of this one."""
    (folder / "failures").mkdir()
    for name in IMPORTED:
        importlib.import_module(name)
    waiting, running, start, ends = list(shares), {}, time.monotonic(), []
    while waiting or running:
        while waiting and len(running) < workers:
            seed, numbers = waiting.pop(0)
            child = os.fork()
            if child == 0:
                code = 1
                try:
                    work(seed, numbers, folder, run)
                    code = 0
                except BaseException as error:
                    print(f"{seed.name}: {error}", file=sys.stderr, flush=True)
                finally:
                    os._exit(code)
            running[child] = seed
        child, status = os.wait()
        seed = running.pop(child)
        ends.append((seed, status))
        passed = time.monotonic() - start
        print(f"{len(ends)}/{len(shares)} {seed.name}, {passed:.0f} s", file=sys.stderr, flush=True)
    bad = [seed.name for seed, status in ends if status != 0]
    if bad:
        raise RuntimeError(f"{', '.join(bad)} could not be run to the end; see above")
    lines = [line for seed, _ in shares for line in (folder / f"{seed.name}.jsonl").read_text("utf-8").splitlines()]
    return [Outcome(**json.loads(line)) for line in lines]


def main(arguments: list[str]) -> int:
    """Run what is asked for; 1 where a fault was found."""
    parser = argparse.ArgumentParser(prog="fuzz", description=__doc__)
    parser.add_argument("--inputs", type=int, default=200, help="damaged inputs for each reader")
    parser.add_argument("--groups", nargs="*", choices=list(GROUPS), default=list(GROUPS))
    parser.add_argument("--seeds", nargs="*", help="names of seeds; left out: all of the groups")
    parser.add_argument("--first", type=int, default=0, help="number of the first input")
    parser.add_argument("--run", default="1", help="another word gives other damage")
    parser.add_argument("--workers", type=int, default=os.cpu_count())
    parser.add_argument("--folder", type=Path, help="where failures stay; left out: a new temporary folder")
    given = parser.parse_args(arguments)
    folder = given.folder or Path(tempfile.mkdtemp(prefix="midspan-fuzz-"))
    folder.mkdir(parents=True, exist_ok=True)
    seeds = [seed for name in given.groups for seed in GROUPS[name] if not given.seeds or seed.name in given.seeds]
    found = fuzz(share(seeds, given.inputs, given.first), folder, given.run, workers=given.workers)
    print(table(found))
    faults = [one for one in found if one.fault]
    for one in faults:
        print(f"{one.fault}: sh {folder}/failures/{one.seed}-{one.number}-{one.fault}/repeat.sh: {one.detail}")
    if not faults and given.folder is None:
        shutil.rmtree(folder)
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
