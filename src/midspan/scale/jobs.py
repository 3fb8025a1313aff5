"""The recordings of a campaign, one job each: what is estimated, under which name, and what its result depends on."""

import hashlib
import io
import itertools
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

from midspan._version import __version__
from midspan.checks import refuse
from midspan.errors import DataError, UsageError
from midspan.scale.remote import is_url, parts_of, recordings
from midspan.settings.campaign import CampaignSettings
from midspan.settings.load import RECORDING_FILE, load_settings
from midspan.settings.recording import RecordingSettings
from midspan.settings.stored.calibration import load_calibration
from midspan.settings.two_files import Choices
from midspan.trees import read_text

if TYPE_CHECKING:
    import pandas as pd

# Columns of a table's row besides the options of `estimate`.
ACCELEROMETER, VIDEO = "accelerometer", "video"
# Keys of sections that name files.
FILE_KEYS = ("file", "times", "config")
# What makes a name a glob.
SIGNS = "*?["


@dataclass(frozen=True, slots=True)
class Job:
    """One recording: its name in the campaign, its recording.toml, or an accelerometer's file and a second one with the
    choices of two files; method, tracker and calibration (a path) over its own; url: where it is fetched from, if it
    has no path of this machine.
    """

    name: str
    path: Path
    second: Path | None = None
    choices: dict[str, Any] = field(default_factory=dict)
    method: str | None = None
    tracker: str | None = None
    calibration: Path | None = None
    url: str = ""


def jobs_of(campaign: CampaignSettings, folder: Path) -> tuple[tuple[Job, ...], list[str]]:
    """The jobs in the order of their names, and a line on each glob without any; UsageError where there is none at all,
    where what the campaign names is not there, or two have one name.
    """
    calibration = None if campaign.calibration is None else folder / campaign.calibration
    if calibration is not None:
        try:
            load_calibration(calibration)
        except DataError as error:
            raise UsageError(f"calibration: {error}") from None
    more: dict[str, Any] = {"method": campaign.method, "tracker": campaign.tracker, "calibration": calibration}
    matches: dict[str, list[Any]] = {
        pattern: recordings(pattern) if is_url(pattern) else _recordings(pattern, folder)
        for pattern in campaign.recordings
    }
    every = dict.fromkeys(itertools.chain.from_iterable(matches.values()))
    jobs = [Job(_name(path, folder), path, **more) for path in every if isinstance(path, Path)]
    jobs += [Job(url, Path(RECORDING_FILE), url=url, **more) for url in every if isinstance(url, str)]
    if campaign.table is not None:
        jobs += [Job(**{**more, **row}) for row in _rows(folder / campaign.table, folder)]
    if not jobs:
        named = ", ".join(campaign.recordings) or campaign.table
        raise UsageError(f"{folder}: no recording matches {named}. A recording is a folder with a {RECORDING_FILE}.")
    names = [job.name for job in jobs]
    if twice := sorted({name for name in names if names.count(name) > 1}):
        raise UsageError(f"The campaign names {', '.join(twice)} twice. Name each recording once.")
    warnings = [f"{pattern!r} in recordings matches no recording." for pattern, files in matches.items() if not files]
    return tuple(sorted(jobs, key=lambda job: job.name)), warnings


def _recordings(pattern: str, folder: Path) -> list[Path]:
    """Each recording.toml of a glob or a folder; UsageError where a name that is no glob has none."""
    path = folder / pattern
    is_glob = any(sign in pattern for sign in SIGNS)
    if not is_glob and not (path.is_file() or (path / RECORDING_FILE).is_file()):
        raise UsageError(f"{path}: has no {RECORDING_FILE}. Correct the name in the campaign, or remove it.")
    matches = sorted(folder.glob(pattern)) if is_glob and not Path(pattern).is_absolute() else [path]
    files = [match / RECORDING_FILE if match.is_dir() else match for match in matches]
    return [file for file in files if file.name == RECORDING_FILE and file.is_file()]


def _name(path: Path, folder: Path) -> str:
    """A recording's folder relative to the campaign."""
    parent = path.parent.resolve()
    base = folder.resolve()
    return utf8(parent.relative_to(base).as_posix() if parent.is_relative_to(base) else parent.as_posix())


def is_utf8(name: str) -> bool:
    """Whether a name from a file system is text."""
    return utf8(name) == name


def utf8(name: str) -> str:
    """The name with what is no text as \\uNNNN."""
    return name.encode(errors="backslashreplace").decode()


def _rows(table: Path, folder: Path) -> Iterator[dict[str, Any]]:
    """Name, files and choices of each row of a table."""
    import pandas as pd

    frame = _table(table).dropna(how="all")
    options, choices = [option.name for option in fields(Choices)], ["method", "tracker"]
    missing = sorted({ACCELEROMETER, VIDEO} - {*frame.columns})
    unknown = sorted({*map(str, frame.columns)} - {ACCELEROMETER, VIDEO, *options, *choices})
    if missing or unknown:
        wrong = f"has no column {missing[0]}" if missing else f"has an unknown column {unknown[0]}"
        raise UsageError(f"{table}: {wrong}. Its columns are accelerometer, video, {', '.join([*options, *choices])}.")
    for number, row in enumerate(frame.to_dict("records"), start=1):
        if absent := [key for key in (ACCELEROMETER, VIDEO) if pd.isna(row[key])]:
            raise UsageError(f"{table}: row {number} has no {absent[0]}. Name a file, or remove the row.")
        chosen = {key: row[key] for key in options if key in row and not pd.isna(row[key])}
        if "rate_hz" in chosen:
            chosen["rate_hz"] = _number(chosen["rate_hz"], f"{table}: row {number}: rate_hz")
        second = folder / str(row[VIDEO])
        yield {
            "name": Path(row[VIDEO]).with_suffix("").as_posix(),
            "path": folder / str(row[ACCELEROMETER]),
            "second": second,
            "choices": chosen,
            **{key: row[key] for key in choices if key in row and not pd.isna(row[key])},
        }


def _table(table: Path) -> "pd.DataFrame":
    """A table with names and texts without blanks around them; of a text the delimiter that its heading has most."""
    import pandas as pd

    try:
        if table.suffix.lower() == ".parquet":
            frame = pd.read_parquet(table)
        else:
            text = read_text(table)
            delimiter = max(",;\t", key=text.partition("\n")[0].count)
            frame = pd.read_csv(io.StringIO(text), dtype=str, sep=delimiter)
    except (OSError, ValueError) as error:
        raise UsageError(f"{table}: cannot be read ({getattr(error, 'strerror', None) or error}).") from None
    frame.columns = [str(name).strip().lower() for name in frame.columns]
    return frame.map(lambda value: (value.strip() or None) if isinstance(value, str) else value)


def _number(value: Any, where: str) -> float:
    try:
        return float(value)
    except (TypeError, ValueError):
        raise refuse(where, "a number with a decimal point", value) from None


def files_of(job: Job) -> list[Path]:
    """The files that a job's result depends on; of a sequence of images all."""
    files = [job.path] if job.second is None else [job.path, job.second]
    if job.second is None:
        settings = load_settings(job.path)
        files += [path for name in named_files(settings) for path in _matching(job.path.parent, name)]
    return [*files, *([] if job.calibration is None else [job.calibration])]


def named_files(settings: RecordingSettings) -> list[str]:
    """What the sections of a recording name as files."""
    parts: list[Any] = [settings.reference, *(section for _, _, section in settings.streams)]
    parts += [getattr(part, "lens", None) for part in parts]
    return [name for part in parts for key in FILE_KEYS if (name := getattr(part, key, None))]


def _matching(folder: Path, name: str) -> list[Path]:
    path = folder / name
    if path.is_dir():
        return sorted(file for file in path.iterdir() if file.is_file())
    if any(sign in name for sign in SIGNS):
        return sorted(folder.glob(name))
    return [path]


def key_of(job: Job) -> str:
    """A hash of what the result follows from: the files' contents, what is chosen, and the version."""
    digest = hashlib.sha256(f"{__version__}\n".encode())
    chosen = {key: value for key, value in asdict(job).items() if key not in ("name", "path", "second", "calibration")}
    digest.update(repr(sorted(chosen.items(), key=lambda item: item[0])).encode())
    if job.url:
        digest.update("\n".join(parts_of(job.url)).encode())
        return digest.hexdigest()
    for path in files_of(job):
        digest.update(f"\n{path.name}\n".encode())
        if path.is_file():
            with path.open("rb") as file:
                digest.update(hashlib.file_digest(file, "sha256").digest())
    return digest.hexdigest()
