"""Two hundred small recordings: `midspan batch` in processes against a loop of `midspan.estimate` in one process.

The loop's start is counted. --quick: forty recordings.
"""

import ctypes
import os
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from benchmarks.table import goal, show
from midspan.simulate.scenarios.write import write

COUNT, QUICK, DIFFERENT = 200, 40, 8
MAX_PROCESSOR, MAX_WALL = 1.3, 0.7
PR_SET_CHILD_SUBREAPER = 36
LOOP = """
import sys, pathlib, midspan
for folder in sorted(pathlib.Path(sys.argv[1]).glob("rec-*")):
    midspan.estimate(folder).save(folder / "result.parquet")
"""


def spent(command: list[str]) -> tuple[float, float]:
    """Processor time of a command and all that it starts, and wall time, s."""
    before, begun_s = resource.getrusage(resource.RUSAGE_CHILDREN), time.monotonic()
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    wall_s = time.monotonic() - begun_s
    # What the command left behind belongs to this process, and ends by itself.
    while True:
        try:
            os.wait()
        except ChildProcessError:
            break
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime, wall_s


def main() -> None:
    """Both, one after the other."""
    ctypes.CDLL(None).prctl(PR_SET_CHILD_SUBREAPER, 1, 0, 0, 0)
    count = QUICK if "--quick" in sys.argv else COUNT
    with tempfile.TemporaryDirectory() as name:
        root = Path(name)
        for k in range(DIFFERENT):
            write("gnss", root / f"rec-{k:03d}", seed=k)
        for k in range(DIFFERENT, count):
            shutil.copytree(root / f"rec-{k % DIFFERENT:03d}", root / f"rec-{k:03d}")
        (root / "CAMPAIGN.toml").write_text('recordings = ["rec-*"]\noutput = "results"\n')
        loop = spent([sys.executable, "-c", LOOP, name])
        batch = spent([sys.executable, "-m", "midspan", "batch", name, "--runner", "process", "--workers", "2"])
    show(("", "processor s", "wall s"), [("loop", *loop), ("batch", *batch)])
    goal(f"{count} recordings, processor time", batch[0] / loop[0], MAX_PROCESSOR)
    goal(f"{count} recordings, wall time", batch[1] / loop[1], MAX_WALL)


if __name__ == "__main__":
    main()
