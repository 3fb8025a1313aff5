"""Where a campaign puts its results: names of folders, whose output it is, and what of earlier runs goes."""

import hashlib
import json
import os
import shutil
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from urllib.parse import quote

from midspan.errors import UsageError
from midspan.settings.load import RECORDING_FILE
from midspan.trees import TreeError, read_json
from midspan.writing import cannot_be_written, remove_remains, write_whole

ROWS, DONE, PIECES = "rows", "done", "pieces"
# The key of the partitions.
PARTITION = "recording="
# Whose output it is.
OWNER_FILE = "campaign.json"
# Bytes of a name, so that with what stands before and behind it a file system takes it, and of what a longer one keeps.
MAX_BYTES, KEPT_BYTES = 200, 160


def folder_name(name: str) -> str:
    """A recording's name as that of a folder: signs that mean something in a path or a partition as %XX, a long one
    cut, with a hash.
    """
    parts = [letter if not letter.isascii() and letter.isprintable() else quote(letter, safe="") for letter in name]
    if sum(len(part.encode()) for part in parts) <= MAX_BYTES:
        return "".join(parts)
    kept, size = list[str](), 0
    for part in parts:
        size += len(part.encode())
        if size > KEPT_BYTES:
            break
        kept.append(part)
    return f"{''.join(kept)}-{hashlib.sha256(name.encode()).hexdigest()[:16]}"


def take(output: Path, campaign_file: Path) -> None:
    """Make the folder of a campaign's results and say there whose it is; UsageError where it is another's."""
    if (output / RECORDING_FILE).exists():
        raise UsageError(f"{output}: is the folder of a recording. Choose another output.")
    try:
        output.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UsageError(f"{output}: cannot be made ({error.strerror}). Choose another output.") from None
    # Relative: both may move together.
    try:
        name = Path(os.path.relpath(campaign_file.resolve(), output.resolve())).as_posix()
    except ValueError:
        # On another drive.
        name = campaign_file.resolve().as_posix()
    file = output / OWNER_FILE
    owner = _owner(file)
    if owner is None and (output / ROWS).exists():
        raise UsageError(f"{output}: has a folder {ROWS} that no campaign made. Remove it, or choose another output.")
    if owner not in (None, name):
        raise UsageError(
            f"{output}: has the results of another campaign, {owner}. Choose another output, or remove {file} where "
            "this campaign's file has moved."
        )
    if owner is None:
        write_whole(file, json.dumps({"campaign": name}).encode())


def _owner(file: Path) -> str | None:
    try:
        return str(read_json(file)["campaign"])
    except FileNotFoundError:
        return None
    except (OSError, TreeError, KeyError, TypeError) as error:
        raise UsageError(f"{file}: cannot be read ({error}). Remove it, or choose another output.") from None


def sweep(output: Path, names: Sequence[str]) -> list[str]:
    """Remove what earlier runs wrote of recordings that the campaign does not name any more; their folders' names."""
    kept = {folder_name(name) for name in names}
    done = {file.stem: file for file in (output / DONE).glob("*.json") if file.stem not in kept}
    rows = list[str]()
    for folder in (output / ROWS).glob(f"{PARTITION}*"):
        name = folder.name.removeprefix(PARTITION)
        parts = [] if name in kept else list(folder.glob("part*.parquet"))
        if not parts:
            continue
        rows.append(name)
        with cannot_be_written(folder):
            for part in parts:
                part.unlink()
        remove_remains(folder)
        # Other files stay, and so does their folder.
        with suppress(OSError):
            folder.rmdir()
    for name in {*done, *rows}:
        shutil.rmtree(output / PIECES / name, ignore_errors=True)
    for file in done.values():
        with cannot_be_written(file):
            file.unlink()
    return sorted({*done, *rows})
