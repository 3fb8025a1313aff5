"""What a command may write, checked before the work: no own file of a recording is ever overwritten."""

from pathlib import Path

import click

from midspan.recording.stored.calibration import CALIBRATION_FILE
from midspan.recording.streams.recording import Recording


def protect(recording: Recording, output: str | Path, *, result: bool = True) -> Path:
    """Refuse an output that is one of the recording's own files, or (for a result) its calibration; returns the path.

    A CSV has its metadata in a `.json` beside it, which must not replace anything else either.
    """
    path = Path(output)
    written = [path, *([path.with_suffix(".json")] if result and path.suffix.lower() == ".csv" else [])]
    kept = recording.own_files | ({(recording.folder / CALIBRATION_FILE).resolve()} if result else set())
    for target in written:
        if target.resolve() in kept:
            raise click.UsageError(
                f"-o {output}: would overwrite {target}, which belongs to the recording. Choose another name."
            )
    protect_side_file(path if result else None)
    return path


def protect_side_file(path: Path | None) -> None:
    """Refuse a CSV whose metadata file would replace a `.json` that midspan did not write beside a result."""
    if path is None or path.suffix.lower() != ".csv":
        return
    beside = path.with_suffix(".json")
    if beside.is_file() and '"midspan"' not in beside.read_text(encoding="utf-8", errors="replace"):
        raise click.UsageError(f"-o {path}: its metadata would overwrite {beside}. Choose another name.")


def report_path(path: str | None) -> Path | None:
    """The report's path, refused before the work where it could not be written."""
    if path is None:
        return None
    target = Path(path)
    if target.suffix.lower() not in (".html", ".htm"):
        raise click.UsageError(f"--report {path}: must end in .html.")
    folder = target.absolute().parent
    if not folder.is_dir():
        raise click.UsageError(f"--report {path}: the folder {folder} does not exist; make it first.")
    return target
