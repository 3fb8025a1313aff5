"""Commands on damaged files, many in one forked child, with bounded time and memory; what came of each.

The child has midspan imported already and runs the command's own entry, `midspan.cli.main.run`. Time is limited by
timers whose signals end the child, memory by its address space; the parent notes which case it was and goes on behind
it in another child.
"""

import gc
import json
import os
import re
import resource
import shutil
import signal
import sys
import traceback
import warnings
from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from random import Random

from fuzz.damage import damaged
from fuzz.world import FILE, Seed

# A case that computes longer than this hangs, s of processor time, whatever else the machine does.
MAX_CPU_S = 20.0
# One that only waits is ended after this, s: ten times more, because a busy machine makes everybody wait.
MAX_WALL_S = 200.0
# Memory that a case may use over what the whole file needs, and address space that is granted to it, bytes: a reader
# that asks for more than it is granted is refused by the system.
MAX_BYTES, GRANTED_BYTES = 2 * 1024**3, 3 * 1024**3
# Files that are read again and again at the end of a reader's cases, how often in each round, and the most rounds: the
# buffers of a decoder with threads settle later on a busy machine.
REPEATED_FILES, REPEATS, ROUNDS = 2, 2, 48
# Growth of one such reading from each round to the next, bytes: a leak grows in every round, what an allocator
# settles does so in some. A frame of the smallest videos has 3 kB, and a reading keeps all of them or none.
MAX_GROWTH_BYTES = 16 * 1024
# What is said where the system gave no more memory: such a case has asked for more than GRANTED_BYTES.
NO_MEMORY = re.compile(
    "not enough memory for this|needs more memory than is available|Unable to allocate|malloc of size"
    "|Insufficient memory|Cannot allocate memory"
)
# A traceback, an error in a destructor or a warning of a library: nothing that a user should see.
NOT_FOR_USERS = re.compile(r"Traceback \(most recent|Exception ignored|^\S+:\d+: \w*Warning", re.MULTILINE)
# The number of the case that reads damaged files again and again.
GROWTH = -1
GOOD_CODES = (0, 2, 3, 4)
ENDED_BY = {signal.SIGPROF: "hang", signal.SIGALRM: "hang"}


@dataclass(frozen=True)
class Outcome:
    """What came of one case: the worst exit code of its commands, and in `fault` what must not be, else empty."""

    seed: str
    reader: str
    number: int
    kind: str
    code: int
    fault: str = ""
    detail: str = ""


def case(seed: Seed, data: bytes, number: int, run: str) -> tuple[str, bytes]:
    """The damage number `number` to a seed's file: always the same for the same `run`."""
    return damaged(data, Random(f"{run}/{seed.name}/{number}"), seed.text)


def outcomes(seed: Seed, numbers: Iterable[int], place: Path, run: str) -> Iterator[Outcome]:
    """Damage a seed in the folder `place`, which holds it whole, once for each number, and say what came of each."""
    left = list(numbers)
    while left:
        log = place.with_name(f"{place.name}.log")
        log.write_bytes(b"")
        child = os.fork()
        if child == 0:
            _child(seed, left, place, log, run)
        _, status = os.waitpid(child, 0)
        lines = [json.loads(line) for line in log.read_text(encoding="utf-8").splitlines()]
        done = [Outcome(**line) for line in lines if "code" in line]
        yield from done
        begun = [line["number"] for line in lines if "code" not in line]
        if len(begun) > len(done):
            yield _ended(seed, begun[-1], lines[-1]["kind"], status)
        elif len(begun) < len(left):
            raise RuntimeError(f"{seed.name}: the child ended with {status} on the whole file; see {log}.out")
        left = left[len(begun) :]


def _ended(seed: Seed, number: int, kind: str, status: int) -> Outcome:
    number_of = os.WTERMSIG(status) if os.WIFSIGNALED(status) else 0
    fault = ENDED_BY.get(signal.Signals(number_of), "crash") if number_of else "crash"
    detail = signal.Signals(number_of).name if number_of else f"exit {os.WEXITSTATUS(status)}"
    return Outcome(seed.name, seed.reader, number, kind, -number_of, fault, detail)


def _child(seed: Seed, numbers: list[int], place: Path, log: Path, run: str) -> None:
    """Run the cases in a copy of the seed's folder and leave without the parent's exit handlers."""
    code = 1
    try:
        work = place.with_name(f"{place.name}.work")
        shutil.rmtree(work, ignore_errors=True)
        shutil.copytree(place, work)
        os.chdir(work)
        output = os.open(f"{log}.out", os.O_RDWR | os.O_CREAT | os.O_TRUNC)
        for stream in (1, 2):
            os.dup2(output, stream)
        sys.stdout, sys.stderr = (open(n, "w", encoding="utf-8", closefd=False) for n in (1, 2))  # noqa: SIM115
        with log.open("a", encoding="utf-8", buffering=1) as lines:
            _cases(seed, numbers, run, lines, output)
        code = 0
    except BaseException:
        traceback.print_exc(file=sys.__stderr__)
    finally:
        os._exit(code)


def _cases(seed, numbers, run, lines, output):
    whole = Path(seed.file).read_bytes()
    # A warning that Python shows to users is printed every time, not only where it first comes up.
    for category in (RuntimeWarning, UserWarning, FutureWarning):
        warnings.simplefilter("always", category)
    # The first run compiles or loads what is compiled, and opens what libraries keep open.
    for _ in range(2):
        code, _, detail = _commands(seed, output)
        if code != 0:
            raise RuntimeError(f"{seed.name} must be read while it is whole; received exit {code}, {detail}")
    # The collector looks through what comes from here on only, which saves 0.1 s each time that it is called.
    gc.collect()
    gc.freeze()
    used = 1024 * _kilobytes("VmSize")
    resource.setrlimit(resource.RLIMIT_AS, (used + GRANTED_BYTES, used + GRANTED_BYTES))
    for number in numbers:
        kind = "repeated" if number == GROWTH else case(seed, whole, number, run)[0]
        lines.write(json.dumps({"number": number, "kind": kind}) + "\n")
        signal.setitimer(signal.ITIMER_PROF, MAX_CPU_S)
        signal.setitimer(signal.ITIMER_REAL, MAX_WALL_S)
        found = _grown(seed, whole, run, output) if number == GROWTH else _one(seed, whole, number, run, output)
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.setitimer(signal.ITIMER_REAL, 0)
        lines.write(json.dumps(asdict(found)) + "\n")


def _one(seed: Seed, whole: bytes, number: int, run: str, output: int) -> Outcome:
    """Damage the file once and run the commands on it."""
    kind, data = case(seed, whole, number, run)
    Path(seed.file).write_bytes(data)
    handles = _handles()
    Path("/proc/self/clear_refs").write_text("5", encoding="ascii")  # the peak begins anew
    start = _kilobytes("VmRSS")
    code, fault, detail = _commands(seed, output)
    used = _kilobytes("VmHWM") - start
    if not fault and used > MAX_BYTES // 1024:
        fault, detail = "memory", f"{used / 1024**2:.1f} GiB"
    if not fault and _handles() > handles:
        # What only a cycle of objects holds is let go by the collector.
        gc.collect()
        if _handles() > handles:
            fault, detail = "leak", f"{_handles() - handles} file descriptors stay open"
    return Outcome(seed.name, seed.reader, number, kind, code, fault, detail)


def _grown(seed: Seed, whole: bytes, run: str, output: int) -> Outcome:
    """Read the same damaged files again and again: memory must settle."""
    files = [case(seed, whole, number, run)[1] for number in range(REPEATED_FILES)]
    growth, before = float("inf"), None
    for _ in range(ROUNDS):
        for data in REPEATS * files:
            Path(seed.file).write_bytes(data)
            _commands(seed, output)
        gc.collect()
        after = 1024 * _kilobytes("VmRSS")
        growth = growth if before is None else min(growth, (after - before) / (REPEATS * len(files)))
        before = after
        if growth <= MAX_GROWTH_BYTES:
            break
    fault = "growth" if growth > MAX_GROWTH_BYTES else ""
    return Outcome(seed.name, seed.reader, GROWTH, "repeated", 0, fault, f"{growth:.0f} bytes a reading")


def _kilobytes(key: str) -> int:
    with open("/proc/self/status", encoding="ascii") as file:
        return next(int(line.split()[1]) for line in file if line.startswith(key + ":"))


def _handles() -> int:
    return len(os.listdir("/proc/self/fd"))


def _commands(seed: Seed, output: int) -> tuple[int, str, str]:
    """Run a seed's commands: the worst exit code, the worst fault and what it was."""
    worst, fault, detail = 0, "", ""
    for arguments in seed.commands:
        os.ftruncate(output, 0)
        os.lseek(output, 0, os.SEEK_SET)
        code, where = _command([seed.file if word == FILE else word for word in arguments])
        for stream in (sys.stdout, sys.stderr):
            stream.flush()
        size = min(os.fstat(output).st_size, 100_000)
        said = os.pread(output, size, 0).decode("utf-8", "replace")
        if code not in GOOD_CODES:
            fault, detail = "uncaught", where or _short(said)
        elif found := NOT_FOR_USERS.search(said):
            fault, detail = fault or "printed", detail or _short(said[found.start() :])
        elif found := NO_MEMORY.search(said):
            fault, detail = fault or "memory", detail or _short(said)
        worst = code if code not in GOOD_CODES else max(worst, code)
    return worst, fault, detail


def _short(text: str) -> str:
    return " | ".join(line.strip() for line in text.splitlines()[:4])[:300]


def _command(arguments: list[str]) -> tuple[int, str]:
    """The exit code of a command, and for an exception that it let through what it was and where."""
    from midspan.cli.main import run

    try:
        return run(arguments), ""
    except BaseException as error:
        frames = traceback.extract_tb(error.__traceback__)
        own = [
            frame
            for frame in frames
            if f"{os.sep}midspan{os.sep}" in frame.filename and "/tests/" not in frame.filename
        ]
        place = f"{Path(own[-1].filename).name}:{own[-1].lineno}" if own else "?"
        return 1, f"{type(error).__module__}.{type(error).__name__} at {place}: {_short(str(error))}"
