"""A campaign of short recordings, the command that runs it, and what that has started."""

import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pandas as pd

COUNT = 6
# Those of a campaign in two folders.
NAMES = ("2026-01/a", "2026-01/b", "2026-02/a")
# A command starts, and a worker has done a recording, within this on a busy machine, s.
PATIENCE_S = 120.0
WITHOUT_TASKS = ("ray::DashboardAgent", "ray::RuntimeEnvAgent", "default_worker.py")


class Campaign:
    """A campaign of several short recordings in a folder."""

    def __init__(self, folder: Path, recording: Path) -> None:
        self.folder, self.results = folder, folder / "results"
        for number in range(COUNT):
            shutil.copytree(recording, folder / f"rec-{number}")
        (folder / "CAMPAIGN.toml").write_text('recordings = ["rec-*"]\noutput = "results"\n')

    def started(self, runner: str, **how: object) -> subprocess.Popen:
        """The command, in a process of its own."""
        command = [sys.executable, "-m", "midspan", "batch", str(self.folder), "--runner", runner, "--workers", "2"]
        pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
        return subprocess.Popen([*command, "--quiet"], **pipes, **how)

    def until_done(self, count: int) -> None:
        """Wait until so many recordings are done."""
        end_s = time.monotonic() + PATIENCE_S
        while len(list((self.results / "done").glob("*.json"))) < count:
            assert time.monotonic() < end_s, "no recording was done"
            time.sleep(0.02)

    def same_as(self, other: "Campaign") -> None:
        """Whether results are those of another run to the last bit, with nothing else there."""
        for read in (lambda one: pd.read_parquet(one.results / "rows"), summary_of):
            pd.testing.assert_frame_equal(read(self), read(other), check_exact=True)
        names = [sorted(path.relative_to(one.results) for path in one.results.rglob("*")) for one in (self, other)]
        assert names[0] == names[1]

    def whole_files(self) -> int:
        """How many files have rows; all of them can be read, and all that are said to be done are there."""
        parts = list((self.results / "rows").glob("*/*.parquet"))
        assert all(len(pd.read_parquet(part)) for part in parts)
        done = {path.stem for path in (self.results / "done").glob("*.json")}
        assert done <= {part.parent.name.removeprefix("recording=") for part in parts}
        return len(parts)


def rows_of(folder: Path) -> pd.DataFrame:
    """The rows of the campaign of a folder."""
    return pd.read_parquet(folder / "results" / "rows")


def summary_of(campaign: Campaign) -> pd.DataFrame:
    """A campaign's summary without the time that it took."""
    return pd.read_parquet(campaign.results / "summary.parquet").drop(columns="seconds")


def descendants(process: int) -> dict[int, str]:
    """Processes that a process has started, and theirs, with their command lines."""
    parents = dict[int, list[int]]()
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            try:
                stat = (entry / "stat").read_text()
            except OSError:
                continue
            parents.setdefault(int(stat.rpartition(")")[2].split()[1]), []).append(int(entry.name))
    found, pending = dict[int, str](), [process]
    while pending:
        for child in parents.get(pending.pop(), ()):
            pending.append(child)
            try:
                found[child] = (Path("/proc") / str(child) / "cmdline").read_text()
            except OSError:
                continue
    return found


def killed_with_all(process: subprocess.Popen) -> None:
    """Kill a command (SIGKILL); all that it has started ends by itself.

    What of Ray has no task, its agents and a worker that begins, looks for its cluster for another minute.
    """
    started = descendants(process.pid).items()
    children = {child: line for child, line in started if not any(name in line for name in WITHOUT_TASKS)}
    assert children
    process.send_signal(signal.SIGKILL)
    process.communicate()
    end_s = time.monotonic() + 20.0
    while any(_lives(child) for child in children):
        assert time.monotonic() < end_s, [line for child, line in children.items() if _lives(child)]
        time.sleep(0.05)


def _lives(process: int) -> bool:
    try:
        return ") Z " not in Path(f"/proc/{process}/stat").read_text()
    except OSError:
        return False
