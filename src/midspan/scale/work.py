"""What a worker does with one job: estimate, write the rows, then what came of it. Whatever is wrong is an outcome."""

import json
import time
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import quote

from midspan.errors import MidspanError
from midspan.scale.confined import require_confined
from midspan.scale.jobs import Job, key_of
from midspan.scale.remote import fetched
from midspan.trees import TreeError, read_json
from midspan.writing import cannot_be_written, write_whole

if TYPE_CHECKING:
    from midspan.recording.result import Result

ROWS, DONE = "rows", "done"
INTERNAL = 1


@dataclass(frozen=True, slots=True)
class Outcome:
    """What came of a recording: exit_code as of `midspan estimate`; rows; rmse_mm against its reference, None without
    one; warnings by code; seconds that it took; message of what went wrong; key: see `key_of`.
    """

    recording: str
    exit_code: int
    rows: int = 0
    rmse_mm: float | None = None
    warnings: Mapping[str, int] = field(default_factory=dict)
    seconds: float = 0.0
    message: str = ""
    key: str = ""


@dataclass(frozen=True, slots=True)
class Task:
    """A job and the folder of the results."""

    job: Job
    output: Path

    @property
    def rows_file(self) -> Path:
        """Where the rows go: a part of a set that is partitioned by `recording`."""
        return self.output / ROWS / f"recording={quote(self.job.name, safe='')}" / "part.parquet"

    @property
    def done_file(self) -> Path:
        """Where the outcome goes, after the rows."""
        return self.output / DONE / f"{quote(self.job.name, safe='')}.json"


def finished(task: Task, key: str) -> Outcome | None:
    """The outcome of an earlier run that followed from the same files, choices and version; None: there is none."""
    try:
        tree = read_json(task.done_file)
        known = Outcome(**tree)
    except (OSError, TreeError, TypeError):
        return None
    whole = known.key == key and (known.exit_code != 0 or task.rows_file.is_file())
    return known if whole and known.exit_code != INTERNAL else None


def work(task: Task) -> Outcome:
    """Estimate a job whose files changed since it was done; its rows and outcome are on the disk afterwards.

    Raises UsageError where these cannot be written, as on a full disk: no other job could go on either.
    """
    begun_s = time.monotonic()
    key, result, rmse_mm = "", None, None
    try:
        key = key_of(task.job)
        if (known := finished(task, key)) is not None:
            return known
        with _at_hand(task.job) as job:
            require_confined(job)
            result, rmse_mm = _estimated(job)
    except MidspanError as error:
        outcome = Outcome(task.job.name, error.exit_code, message=" ".join(str(error).split()), key=key)
    except Exception as error:
        outcome = Outcome(task.job.name, INTERNAL, message=f"internal error ({type(error).__name__}: {error})")
    if result is not None:
        with cannot_be_written(task.rows_file):
            task.rows_file.parent.mkdir(parents=True, exist_ok=True)
        result.save(task.rows_file)
        codes = Counter(str(getattr(line, "code", "")) or "other" for line in result.warnings)
        outcome = Outcome(task.job.name, 0, len(result.time_s), rmse_mm, dict(sorted(codes.items())), key=key)
    outcome = replace(outcome, seconds=time.monotonic() - begun_s)
    with cannot_be_written(task.done_file):
        task.done_file.parent.mkdir(parents=True, exist_ok=True)
    write_whole(task.done_file, json.dumps(asdict(outcome), ensure_ascii=False).encode())
    return outcome


@contextmanager
def _at_hand(job: Job) -> Iterator[Job]:
    """The job with files of this machine."""
    if not job.url:
        yield job
        return
    with fetched(job.url) as path:
        yield replace(job, path=path, url="")


def _estimated(job: Job) -> tuple["Result", float | None]:
    """The result, and its error against the recording's reference, mm rms, None without one."""
    from midspan.evaluate.result_file import compare
    from midspan.recording.estimate import estimate
    from midspan.recording.streams.recording import open_recording
    from midspan.settings.stored.calibration import load_calibration

    calibration = None if job.calibration is None else load_calibration(job.calibration)
    if job.second is not None:
        result = estimate(job.path, calibration, video=job.second, method=job.method, **job.choices)
    else:
        overrides = {} if job.tracker is None else {"camera": {"tracker": job.tracker}}
        result = estimate(open_recording(job.path, **overrides), calibration, method=job.method)
    if result.references()[0] is None:
        return result, None
    return result, float(compare(result, job.path).to_dict()["rmse_mm"])
