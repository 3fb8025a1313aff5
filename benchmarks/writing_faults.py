"""Files written under kills, signals and full disks, 50 moments each: the old or the new one is whole.

The next run works, and leaves nothing but its files.

Kills stand before the n-th call of the system that changes files (all of them, or 50 evenly spread), and at random
moments of the whole command. The full disk is a small tmpfs where this machine lets us mount one.
"""

import os
import random
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import midspan
from benchmarks.table import goal, show

MOMENTS = 50
# Every way in which midspan and shutil change files through the module os.
CALLS = ("open", "write", "fsync", "replace", "rename", "mkdir", "unlink", "rmdir")
SUFFIXES = (".csv", ".parquet", ".h5", ".mat", ".mseed", ".uff")
COMMAND = "from midspan.cli.main import main; main()"
Contents = dict[str, bytes]


@dataclass(frozen=True)
class Work:
    """What is written: a name, and the function that writes it into a folder."""

    name: str
    write: Callable[[Path], object]


@dataclass
class Found:
    """How many moments ended in which way; `wrong` is to stay at zero."""

    counts: Counter[str] = field(default_factory=Counter)
    wrong: int = 0

    def judge(self, place: Path, old: Contents, new: Contents) -> None:
        """Count what a fault has left: every file old or new, and what the killed process could not take away."""
        found = contents(place)
        self.wrong += any(found.get(name) not in (old.get(name), new[name]) for name in new)
        self.counts["new" if all(found.get(name) == new[name] for name in new) else "old"] += 1
        self.counts["remains"] += bool(set(found) - set(old) - set(new))

    def judge_next(self, place: Path, new: Contents) -> None:
        """After the next run there are the new files and nothing else."""
        self.wrong += contents(place) != new

    def row(self, *names: str) -> tuple[object, ...]:
        return (*names, *(self.counts[name] for name in ("old", "new", "remains")), self.wrong)


def contents(folder: Path) -> Contents:
    """Every file's bytes by its path; folders without files count as well."""
    return {str(path.relative_to(folder)): path.read_bytes() if path.is_file() else b"" for path in folder.rglob("*")}


def in_child(action: Callable[[], object]) -> int:
    """Run `action` in a copy of this process; returns the status of `os.waitpid`."""
    child = os.fork()
    if child == 0:
        code = 1
        try:
            action()
            code = 0
        except midspan.UsageError:
            code = 2
        finally:
            os._exit(code)
    return os.waitpid(child, 0)[1]


def counted(step: int, fault: Callable[[], None], action: Callable[[], object]) -> int:
    """Run `action` and let `fault` come before the `step`-th call (0: never); returns the number of calls made."""
    made = 0

    def instead(real: Callable[..., Any]) -> Callable[..., Any]:
        def call(*arguments: Any, **keywords: Any) -> Any:
            nonlocal made
            made += 1
            if made == step:
                fault()
            return real(*arguments, **keywords)

        return call

    for name in CALLS:
        setattr(os, name, instead(getattr(os, name)))
    action()
    return made


def steps_of(action: Callable[[], object]) -> int:
    """How many of these calls `action` makes."""
    reading, writing = os.pipe()
    in_child(lambda: os.write(writing, str(counted(0, lambda: None, action)).encode()))
    os.close(writing)
    with os.fdopen(reading) as file:
        return int(file.read())


def spread(last: int) -> list[int]:
    """All steps from 1 to `last`, or 50 of them evenly spread."""
    count = min(last, MOMENTS)
    return sorted({round(1 + k * (last - 1) / max(count - 1, 1)) for k in range(count)})


@contextmanager
def prepared(old: Path) -> Iterator[Path]:
    """A folder that holds a copy of the old files."""
    with tempfile.TemporaryDirectory() as name:
        place = Path(name) / "place"
        shutil.copytree(old, place)
        yield place


def killed(work: Work, number: int, old: Path, new: Contents) -> tuple[object, ...]:
    """The signal before the n-th call."""
    found, was = Found(), contents(old)
    with prepared(old) as place:
        last = steps_of(lambda: work.write(place))
    for step in spread(last):
        with prepared(old) as place:
            in_child(lambda step=step, place=place: counted(  # type: ignore[misc]
                step, lambda: os.kill(os.getpid(), number), lambda: work.write(place)))  # fmt: skip
            settled = not any(path.name.endswith(".midspan-older") for path in place.iterdir())
            if settled:
                found.judge(place, was, new)
            else:
                # Killed between two renames of a folder: the next run puts the old one back, or replaces it.
                found.counts["aside"] += 1
            in_child(lambda place=place: work.write(place))  # type: ignore[misc]
            found.judge_next(place, new)
    return found.row(work.name, signal.Signals(number).name)


def limited(work: Work, old: Path, new: Contents) -> tuple[object, ...]:
    """No file beyond this many bytes: 50 limits below the largest file's size."""
    found, was, largest = Found(), contents(old), max(map(len, new.values()))
    for k in range(MOMENTS):
        size = round(k * (largest - 1) / (MOMENTS - 1))

        def full(place: Path, size: int = size) -> object:
            resource.setrlimit(resource.RLIMIT_FSIZE, (size, size))
            return work.write(place)

        with prepared(old) as place:
            status = in_child(lambda place=place, full=full: full(place))  # type: ignore[misc]
            found.judge(place, was, new)
            # Refused with a sentence, and nothing left over.
            found.wrong += os.waitstatus_to_exitcode(status) != 2 or contents(place) != was
            work.write(place)
            found.judge_next(place, new)
    return found.row(work.name, "RLIMIT_FSIZE")


def full_disk(work: Work, old: Path, new: Contents) -> tuple[object, ...] | None:
    """A disk with room for the old files and a part of the new ones: 50 sizes."""
    found, was = Found(), contents(old)
    kept, wanted = (sum(-(-len(data) // 4096) + 1 for data in tree.values()) for tree in (was, new))
    for k in range(MOMENTS):
        blocks = kept + 2 + round(k * max(wanted - 3, 0) / (MOMENTS - 1))
        with tempfile.TemporaryDirectory() as name:
            mount = ["mount", "-t", "tmpfs", "-o", f"nr_blocks={blocks}", "none", name]
            if subprocess.run(mount, capture_output=True, check=False).returncode:
                return None
            try:
                place = Path(name) / "place"
                shutil.copytree(old, place)
                status = os.waitstatus_to_exitcode(in_child(lambda place=place: work.write(place)))  # type: ignore[misc]
                found.judge(place, was, new)
                found.wrong += status not in (0, 2) or (status == 2 and contents(place) != was)
                subprocess.run(["mount", "-o", "remount,size=64m", name], check=True)
                work.write(place)
                found.judge_next(place, new)
            finally:
                subprocess.run(["umount", name], check=True)
    return found.row(work.name, "full disk")


def at_random(recording: Path, number: int) -> tuple[object, ...]:
    """The signal at random moments of `midspan estimate` over a result of another method, from start to end."""
    found, rng = Found(), random.Random(number)
    with tempfile.TemporaryDirectory() as name:
        known, place, old = Path(name) / "c.json", Path(name) / "place", Path(name) / "old"
        place.mkdir()
        midspan.calibrate(midspan.open_recording(recording)).save(known)
        command = [sys.executable, "-c", COMMAND, "estimate", str(recording), "-c", str(known), "-q"]
        command += ["-o", str(place / "r.csv")]
        subprocess.run([*command, "--method", "kalman"], check=True)
        shutil.copytree(place, old)
        start = time.perf_counter()
        subprocess.run(command, check=True)
        length_s, new = time.perf_counter() - start, contents(place)
        for _ in range(MOMENTS):
            shutil.rmtree(place)
            shutil.copytree(old, place)
            running = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
            time.sleep(rng.uniform(0.0, length_s))
            running.send_signal(number)
            said = running.communicate()[1]
            found.judge(place, contents(old), new)
            found.wrong += "Traceback" in said or "internal error" in said
            subprocess.run(command, check=True)
            found.judge_next(place, new)
    return found.row("estimate, whole command", f"{signal.Signals(number).name}, random")


def works(recording: Path) -> list[Work]:
    """Every file format of a result, a calibration (a report is written likewise) and a simulated recording."""
    from midspan.simulate.scenarios.write import write

    result = midspan.estimate(midspan.open_recording(recording))

    return [
        *(Work(suffix, lambda place, end=suffix: result.save(place / f"r{end}")) for suffix in SUFFIXES),  # type: ignore[misc]
        Work("calibration", lambda place: result.calibration.save(place / "calibration.json")),
        Work("simulate", lambda place: write("gnss", place / "g", seed=2)),
    ]


def prepare_old(work: Work, recording: Path, old: Path, fresh: Path) -> Contents:
    """The old files of a work, and the new ones."""
    fresh.mkdir()
    work.write(fresh)
    if work.name == "simulate":
        shutil.copytree(recording, old / "g")
    else:
        old.mkdir()
        for path in fresh.iterdir():
            (old / path.name).write_bytes(b"old")
    return contents(fresh)


def main() -> None:
    from midspan.simulate.scenarios.write import write

    rows: list[tuple[object, ...]] = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        recording = write("gnss", folder / "recording")
        for number, work in enumerate(works(recording)):
            old = folder / f"old{number}"
            new = prepare_old(work, recording, old, folder / f"fresh{number}")
            rows.append(killed(work, signal.SIGKILL, old, new))
            rows.append(limited(work, old, new))
            on_disk = full_disk(work, old, new)
            rows += [] if on_disk is None else [on_disk]
            print(f"{work.name} done", file=sys.stderr, flush=True)
        for number in (signal.SIGKILL, signal.SIGTERM, signal.SIGINT):
            rows.append(at_random(recording, number))
    show(("written", "fault", "old", "new", "remains", "wrong"), rows)
    goal("moments that left half a file, lost both or spoiled the next run", sum(int(str(row[-1])) for row in rows), 0)
