"""What a command may write, checked before the work: nothing that midspan did not write is ever lost."""

import mmap
from collections.abc import Iterable
from pathlib import Path

import click

from midspan.errors import MidspanError
from midspan.recording.streams.recording import Recording, open_recording
from midspan.settings.load import RECORDING_FILE
from midspan.settings.stored.calibration import CALIBRATION_FILE
from midspan.sinks.metadata import partner
from midspan.store.store import is_address
from midspan.trees import TreeError, read_json

# Pictures that can say who wrote them.
PICTURES = (".png", ".svg", ".pdf")
# What a file of midspan's holds somewhere: JSON of its metadata, a text where its format has room, a station's name.
_MARKS = (b'"midspan": "', b"written by midspan", b"FDSN:XX_MIDSP__", b"D MIDSP  ")
# The keys of the JSON files that midspan writes: each kind may be replaced by its own kind only.
_CALIBRATION, _LENS, _METADATA = {"version", "created", "accelerometer"}, {"midspan", "created"}, {"midspan"}


def check_result(output: str | Path, *recordings: Recording, option: str = "-o") -> Path:
    """Refuse a result, track, report or picture in place of anything but its like; returns the path.

    `recordings` are those that the command reads. The one in whose folder the output would lie is protected, too, and
    so are the calibrations of all. The same holds for the `.json` of a CSV.
    """
    path = Path(output)
    pair = path.suffix.lower() == ".csv"
    written = [path, partner(path)] if pair else [path]
    owners = [*recordings, *_recordings_at(path)]
    calibrations = {(owner.folder / CALIBRATION_FILE).resolve() for owner in owners}
    for target in written:
        _refuse_kept(f"{option} {output}", target, owners, calibrations)
    known = _keys(partner(path)) >= _METADATA and not _keys(partner(path)) >= _LENS if pair else _is_marked(path)
    kind = f"not a midspan result (which has a {partner(path).name})" if pair else "no file of midspan's"
    for target in written:
        _refuse_foreign(f"{option} {output}", target, kind, known=known)
    return path


def require_place(option: str, path: Path, suffixes: tuple[str, ...], what: str) -> None:
    """Refuse a file of another format, and one in a folder that does not exist."""
    if path.suffix.lower() not in suffixes:
        raise click.UsageError(f"{option} {path}: the {what}'s suffix must be one of {', '.join(suffixes)}.")
    folder = path.absolute().parent
    if not folder.is_dir():
        raise click.UsageError(f"{option} {path}: the folder {folder} does not exist. Create it first.")


def check_picture(output: str | Path, option: str, *recordings: Recording) -> Path:
    """Refuse a picture of another format, and one in place of anything but its like; returns the path."""
    require_place(option, Path(output), PICTURES, "picture")
    return check_result(output, *recordings, option=option)


def check_calibration(output: str | Path, recording: Recording) -> Path:
    """Refuse a calibration in place of anything but a calibration; a folder gets a file of the usual name."""
    path = Path(output) / CALIBRATION_FILE if Path(output).is_dir() else Path(output)
    _refuse_kept(f"-o {output}", path, [recording, *_recordings_at(path)], set())
    _refuse_foreign(f"-o {output}", path, "no calibration", known=_keys(path) >= _CALIBRATION)
    return path


def check_lens(output: str | Path) -> Path:
    """Refuse a lens file in place of anything but a lens file."""
    path = Path(output)
    _refuse_foreign(f"-o {output}", path, "no lens file", known=_keys(path) >= _LENS)
    return path


def check_store(where: str) -> None:
    """Refuse a store in the place of anything else: in a recording's own folder, or of a file."""
    path = Path(where)
    if not is_address(where) and (path / RECORDING_FILE).is_file():
        raise click.UsageError(f"-o {where}: is a recording's folder. Choose another folder for the store.")
    if not is_address(where) and path.exists() and not path.is_dir():
        raise click.UsageError(f"-o {where}: is a file. Give a folder for the store.")


def _recordings_at(path: Path) -> list[Recording]:
    """The recording in whose folder a file would lie, by its name and by where links lead."""
    found = []
    for folder in {path.absolute().parent, path.resolve().parent}:
        if (folder / RECORDING_FILE).is_file():
            try:
                found.append(open_recording(folder))
            except MidspanError:
                # Settings that cannot be read name no files; what midspan did not write is kept all the same.
                continue
    return found


def _refuse_kept(what: str, target: Path, owners: Iterable[Recording], kept: set[Path]) -> None:
    own = kept.union(*(owner.own_files for owner in owners))
    if target.resolve() in own or target.name == RECORDING_FILE:
        raise click.UsageError(
            f"{what}: would overwrite {target}, which belongs to the recording. Choose another name."
        )


def _refuse_foreign(what: str, target: Path, kind: str, *, known: bool) -> None:
    """Refuse to replace a file that midspan did not write; one without content is no loss."""
    if target.is_file() and target.stat().st_size > 0 and not known:
        raise click.UsageError(
            f"{what}: would overwrite {target}, which is {kind}. Choose another name, or remove that file first."
        )


def _keys(path: Path) -> set[str]:
    """The keys of a JSON file's tree; none where it is no JSON."""
    try:
        tree = read_json(path)
    except (OSError, TreeError):
        return set()
    return set(tree) if isinstance(tree, dict) else set()


def _is_marked(path: Path) -> bool:
    """Whether a file says that midspan wrote it."""
    try:
        with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as content:
            return any(content.find(mark) >= 0 for mark in _MARKS)
    except (OSError, ValueError):
        return False


def report_path(path: str | None) -> Path | None:
    """The report's path, refused before the work where it could not be written."""
    if path is None:
        return None
    require_place("--report", Path(path), (".html", ".htm"), "report")
    return check_result(path, option="--report")
