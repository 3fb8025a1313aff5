"""What a worker does with one job: estimate, write the rows, then what came of it. Whatever is wrong is an outcome."""

import json
import shutil
import time
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

from midspan.errors import DataError, MidspanError
from midspan.scale.confined import require_confined
from midspan.scale.jobs import SIGNS, Job, is_utf8, key_of, utf8
from midspan.scale.places import DONE, PARTITION, PIECES, ROWS, folder_name
from midspan.scale.remote import fetched
from midspan.sources.zipped import is_inside
from midspan.trees import TreeError, read_json
from midspan.writing import cannot_be_written, write_whole

if TYPE_CHECKING:
    from midspan.recording.pieces import Span
    from midspan.recording.result import Result
    from midspan.recording.streams.recording import Recording
    from midspan.settings.stored.calibration import Calibration

INTERNAL = 1


@dataclass(frozen=True, slots=True)
class Outcome:
    """What came of a recording: exit_code as of `midspan estimate`; rows; rmse_mm against its reference, None without
    one; warnings by code; seconds that it took; message of what went wrong; key: see `key_of`; size of its rows' files,
    bytes.
    """

    recording: str
    exit_code: int
    rows: int = 0
    rmse_mm: float | None = None
    warnings: Mapping[str, int] = field(default_factory=dict)
    seconds: float = 0.0
    message: str = ""
    key: str = ""
    size: int = 0


@dataclass(frozen=True, slots=True)
class Task:
    """A job and the folder of the results."""

    job: Job
    output: Path

    @property
    def rows_folder(self) -> Path:
        """Where the rows go: a part of a set that is partitioned by `recording`."""
        return self.output / ROWS / f"{PARTITION}{folder_name(self.job.name)}"

    @property
    def rows_file(self) -> Path:
        """The file of the rows; of a recording that was cut there are several."""
        return self.rows_folder / "part.parquet"

    def size(self) -> int:
        """Bytes of the rows on the disk."""
        return sum(part.stat().st_size for part in self.rows_folder.glob("part*.parquet"))

    @property
    def pieces_folder(self) -> Path:
        """Where the pieces of a long recording go until all are there."""
        return self.output / PIECES / folder_name(self.job.name)

    @property
    def done_file(self) -> Path:
        """Where the outcome goes, after the rows."""
        return self.output / DONE / f"{folder_name(self.job.name)}.json"


@dataclass(frozen=True, slots=True)
class Cut:
    """A task that is done in pieces: its key, the calibration of the whole, the pieces' spans; seconds so far."""

    task: Task
    key: str
    calibration: "Calibration"
    spans: "tuple[Span, ...]"
    seconds: float

    @property
    def folder(self) -> Path:
        """Where the pieces go."""
        return self.task.pieces_folder / self.key[:32]


def finished(task: Task, key: str) -> Outcome | None:
    """The outcome of an earlier run that followed from the same files, choices and version; None: there is none."""
    try:
        tree = read_json(task.done_file)
        earlier = Outcome(**tree)
        whole = earlier.key == key and earlier.size == task.size() and (earlier.size > 0 or earlier.exit_code != 0)
    except (OSError, TreeError, TypeError):
        return None
    return earlier if whole and earlier.exit_code != INTERNAL else None


def work(task: Task) -> Outcome | Cut:
    """Estimate a job whose files changed since it was done; its rows and outcome are on the disk afterwards.

    Of a long recording only what its pieces need. Raises UsageError where these cannot be written, as on a full disk:
    no other job could go on either.
    """
    begun_s, key = time.monotonic(), ""
    try:
        if not is_utf8(str(task.job.path)):
            raise DataError(f"{task.job.name}: its name is not in UTF-8. Rename the folder.")
        key = key_of(task.job)
        if (earlier := finished(task, key)) is not None:
            return earlier
        with _at_hand(task.job) as job:
            require_confined(job)
            recording = opened(job)
            calibration, spans = _cut(recording, task.job)
            if calibration is not None and spans:
                return Cut(task, key, calibration, spans, time.monotonic() - begun_s)
            result, rmse_mm = _estimated(recording, job, calibration)
    except Exception as error:
        return record(task, failed(task, key, error), begun_s)
    return record(task, written(task, key, result, rmse_mm), begun_s)


def work_whole(cut: Cut) -> Outcome:
    """The same of a recording that was to be cut, without pieces."""
    begun_s = time.monotonic() - cut.seconds
    try:
        result, rmse_mm = _estimated(opened(cut.task.job), cut.task.job, cut.calibration)
    except Exception as error:
        return record(cut.task, failed(cut.task, cut.key, error), begun_s)
    return record(cut.task, written(cut.task, cut.key, result, rmse_mm), begun_s)


def failed(task: Task, key: str, error: Exception) -> Outcome:
    """The outcome where something is wrong, without rows of earlier files; what is not the user's fault is tried again
    by the next run.
    """
    shutil.rmtree(task.rows_folder, ignore_errors=True)
    text = utf8(" ".join(str(error).split()))
    if isinstance(error, MidspanError):
        return Outcome(task.job.name, error.exit_code, message=text, key=key)
    return Outcome(task.job.name, INTERNAL, message=f"internal error ({type(error).__name__}: {text})")


def written(task: Task, key: str, result: "Result", rmse_mm: float | None) -> Outcome:
    """The outcome of an estimate, with its rows on the disk."""
    with cannot_be_written(task.rows_file):
        task.rows_file.parent.mkdir(parents=True, exist_ok=True)
    result.save(task.rows_file)
    # Of an earlier run that had the recording in pieces.
    for other in task.rows_folder.glob("part-*.parquet"):
        with cannot_be_written(other):
            other.unlink()
    return Outcome(task.job.name, 0, len(result.time_s), rmse_mm, codes_of(result), key=key)


def record(task: Task, outcome: Outcome, begun_s: float) -> Outcome:
    """Write what came of a task that was begun then (of `time.monotonic`)."""
    with cannot_be_written(task.done_file):
        outcome = replace(outcome, seconds=time.monotonic() - begun_s, size=task.size())
        task.done_file.parent.mkdir(parents=True, exist_ok=True)
    write_whole(task.done_file, json.dumps(asdict(outcome), ensure_ascii=False).encode())
    return outcome


def codes_of(result: "Result") -> dict[str, int]:
    """How often each notice is among a result's warnings."""
    return dict(sorted(Counter(str(getattr(line, "code", "")) or "other" for line in result.warnings).items()))


@contextmanager
def _at_hand(job: Job) -> Iterator[Job]:
    """The job with files of this machine."""
    if not job.url:
        yield job
        return
    with fetched(job.url) as path:
        try:
            yield replace(job, path=path, url="")
        except MidspanError as error:
            error.args = (str(error).replace(str(path.parent), job.url),)
            raise


def opened(job: Job) -> "Recording":
    """A job's recording, or its two files as one, with the tracker that is chosen where there is something to track."""
    from midspan.recording.streams.recording import Recording, open_with_cameras
    from midspan.settings.two_files import DISPLACEMENT, Choices, draft, settings_of

    chosen = {} if job.tracker is None else {"tracker": job.tracker}
    if job.second is None:
        return open_with_cameras(job.path, chosen)
    for path in (job.path, job.second):
        if not (path.exists() or is_inside(path) or any(sign in path.name for sign in SIGNS)):
            raise DataError(f"{path}: no such file. Correct its name in the campaign's table.")
    settings = draft(job.path, job.second, Choices(**job.choices))
    if settings.second != DISPLACEMENT.section:
        settings.sections[settings.second] |= chosen
    return Recording(*settings_of(settings))


def _cut(recording: "Recording", job: Job) -> "tuple[Calibration | None, tuple[Span, ...]]":
    """The calibration of a recording that may be cut, and its pieces; without both it is estimated whole.

    What has to be fetched stays whole, and what is estimated with a calibration of another record: whether that fits
    shows in the whole.
    """
    from midspan.recording.pieces import calibrated, may_be_cut

    if job.url or job.calibration is not None or not may_be_cut(recording, job.method):
        return None, ()
    return calibrated(recording)


def _estimated(recording: "Recording", job: Job, calibration: "Calibration | None") -> tuple["Result", float | None]:
    """The result, and its error against the recording's reference, mm rms, None without one.

    calibration: this recording's, where it has been made.
    """
    from midspan.evaluate.result_file import compare
    from midspan.recording.estimate import estimate
    from midspan.settings.stored.calibration import load_calibration

    given = job.calibration is not None
    if job.calibration is not None:
        calibration = load_calibration(job.calibration)
    result = estimate(recording, calibration, method=job.method, given=given)
    if not recording.has("reference"):
        return result, None
    return result, float(compare(result, job.path).to_dict()["rmse_mm"])
