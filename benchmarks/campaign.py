"""Two hundred small recordings: `midspan batch` in processes against a loop of `midspan.estimate` in one process.

The loop's start is counted. --quick: forty recordings. --ray: two workers of Ray against one, once they have started.
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
from midspan.scale.jobs import jobs_of
from midspan.scale.runners import RayRunner
from midspan.scale.work import Task, work
from midspan.settings.campaign import load_campaign
from midspan.simulate.scenarios.write import write

COUNT, QUICK, DIFFERENT = 200, 40, 8
MAX_PROCESSOR, MAX_WALL, MAX_WALL_OF_TWO = 1.3, 0.7, 1.0 / 1.8
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


def campaign(root: Path, count: int) -> None:
    """A campaign of recordings of a GNSS and an accelerometer over a minute, of which some are the same."""
    for k in range(DIFFERENT):
        write("gnss", root / f"rec-{k:03d}", seed=k)
    for k in range(DIFFERENT, count):
        shutil.copytree(root / f"rec-{k % DIFFERENT:03d}", root / f"rec-{k:03d}")
    (root / "CAMPAIGN.toml").write_text('recordings = ["rec-*"]\noutput = "results"\n')


def batch(root: Path, runner: str, workers: int) -> tuple[float, float]:
    """What the command spends on all of a campaign, s: processor and wall."""
    shutil.rmtree(root / "results", ignore_errors=True)
    return spent([sys.executable, "-m", "midspan", "batch", str(root), "--runner", runner, "--workers", str(workers)])


def of_ray(root: Path, workers: int) -> float:
    """Wall time of a campaign on a cluster whose workers have done a few recordings before, s."""
    shutil.rmtree(root / "results", ignore_errors=True)
    settings, folder = load_campaign(root)
    tasks = [Task(job, root / settings.output) for job in jobs_of(settings, folder)]
    cluster = RayRunner(workers)
    try:
        list(RayRunner().run(work, tasks[:DIFFERENT]))
        shutil.rmtree(root / "results")
        begun_s = time.monotonic()
        list(RayRunner().run(work, tasks))
        return time.monotonic() - begun_s
    finally:
        cluster.close()


def main() -> None:
    """Both, one after the other."""
    ctypes.CDLL(None).prctl(PR_SET_CHILD_SUBREAPER, 1, 0, 0, 0)
    count = QUICK if "--quick" in sys.argv else COUNT
    with tempfile.TemporaryDirectory() as name:
        root = Path(name)
        campaign(root, count)
        if "--ray" in sys.argv:
            one_s, two_s = of_ray(root, 1), of_ray(root, 2)
            show(("workers of Ray", "wall s"), [("1", one_s), ("2", two_s)])
            goal(f"{count} recordings, wall time of 2 workers of Ray to 1", two_s / one_s, MAX_WALL_OF_TWO)
            return
        loop, processes = spent([sys.executable, "-c", LOOP, name]), batch(root, "process", 2)
    show(("", "processor s", "wall s"), [("loop", *loop), ("batch", *processes)])
    goal(f"{count} recordings, processor time", processes[0] / loop[0], MAX_PROCESSOR)
    goal(f"{count} recordings, wall time", processes[1] / loop[1], MAX_WALL)


if __name__ == "__main__":
    main()
