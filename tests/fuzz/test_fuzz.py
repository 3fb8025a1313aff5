"""Damaged files, settings and results never end in a traceback, a crash, a hang, gigabytes or growth.

The same machinery as `make fuzz`, with 20 inputs for each reader: what 14 % of the damage brings up is found with
a probability of 95 % (1 - 0.86^20); the 210 of `make fuzz` find 1.4 %. The limits are of processor time; only a case
that waits for something is ended by wall time, after 200 s.
"""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

# Memory, address space and open files of a child are read in /proc.
pytestmark = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="needs Linux")
INPUTS = 20
# A thermal camera's settings take two thirds of the time of all: `make fuzz` has them.
SEEDS = {
    "settings": [
        f"{kind}-{file}" for kind in ("camera", "radar", "displacement") for file in ("recording", "calibration")
    ]
}
TESTS = Path(__file__).parents[1]


def python(*arguments: str) -> subprocess.CompletedProcess[str]:
    """A fresh interpreter, which forks its children before it has started a thread."""
    places = [str(TESTS), str(TESTS / "sources"), os.environ.get("PYTHONPATH", "")]
    return subprocess.run(
        [sys.executable, *arguments],
        env={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, places))},
        capture_output=True,
        text=True,
        check=False,
    )


@pytest.mark.parametrize("group", ["tables", "cameras", "infrared", "radar", "settings", "results"])
def test_damaged_inputs_end_in_a_message_and_an_exit_code(group: str, tmp_path: Path) -> None:
    given = ["--groups", group, "--inputs", str(INPUTS), "--workers", "1", "--folder", str(tmp_path / "fuzz")]
    done = python("-m", "fuzz", *given, "--seeds", *SEEDS.get(group, []))
    assert done.returncode == 0, f"{done.stdout}\n{done.stderr[-2000:]}"


# A command that does to a file of one digit what the digit says, and what is found of it.
MISBEHAVING = """
import json, os, signal, sys, warnings
from pathlib import Path
import numpy as np
import midspan.cli.main
from fuzz import runs
from fuzz.world import FILE, Seed

kept = []

def run(arguments):
    digit = int(Path(arguments[0]).read_bytes())
    if digit == 1:
        raise ValueError("not foreseen")
    if digit == 2:
        os.kill(os.getpid(), signal.SIGSEGV)
    while digit == 3:
        pass
    if digit == 4:
        np.ones(3 << 24)
    if digit == 5:
        print("cannot be read: Unable to allocate 80 GiB")
    if digit == 6:
        kept.append(open(os.devnull))
    if digit == 7:
        warnings.warn("of a library", RuntimeWarning)
    if digit == 8:
        kept.append(np.ones(50_000))
    return 1 if digit == 9 else 0

midspan.cli.main.run = run
runs.MAX_CPU_S, runs.MAX_BYTES = 2.0, 1 << 28
runs.case = lambda seed, data, number, word: ("digit", str(8 if digits == [runs.GROWTH] else number).encode())
digits = json.loads(sys.argv[2])
place = Path(sys.argv[1])
place.mkdir(exist_ok=True)
(place / "digit").write_bytes(b"0")
seed = Seed("digits", "digits", "digit", lambda folder: None, commands=((FILE,),))
print(json.dumps([found.fault for found in runs.outcomes(seed, digits, place, "1")]))
"""
FAULTS = ["", "uncaught", "crash", "hang", "memory", "memory", "leak", "printed", "", "uncaught"]


@pytest.mark.parametrize(("digits", "faults"), [(list(range(10)), FAULTS), ([-1], ["growth"])])
def test_every_fault_is_found_and_nothing_else(digits: list[int], faults: list[str], tmp_path: Path) -> None:
    done = python("-c", MISBEHAVING, str(tmp_path / "seed"), json.dumps(digits))
    assert json.loads(done.stdout or "[]") == faults, done.stderr
