"""Recordings in a store that `fsspec` reads (S3 and others): listed where they are, fetched by the worker."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from midspan.errors import DataError, UsageError
from midspan.settings.load import RECORDING_FILE


def is_url(pattern: str) -> bool:
    """Whether a pattern names a place that is no folder of this machine."""
    return "://" in pattern


def recordings(pattern: str) -> list[str]:
    """The folders with a recording.toml that a URL matches, as URLs; UsageError where one that is no glob has none."""
    system, path = _opened(pattern)
    is_glob = any(sign in path for sign in "*?[")
    try:
        matches = system.glob(path) if is_glob else [path]
        folders = [file.removesuffix(f"/{RECORDING_FILE}") for file in matches]
        kept = [folder for folder in folders if system.exists(f"{folder}/{RECORDING_FILE}")]
    except OSError as error:
        raise UsageError(f"{pattern}: cannot be listed ({error}). Correct it in the campaign, or remove it.") from None
    if not kept and not is_glob:
        raise UsageError(f"{pattern}: has no {RECORDING_FILE}. Correct it in the campaign, or remove it.")
    return [str(system.unstrip_protocol(folder)) for folder in dict.fromkeys(kept)]


def parts_of(url: str) -> list[str]:
    """What tells that a recording's files are those of before: names with what the store keeps as their state."""
    system, path = _opened(url)
    try:
        return [f"{file.removeprefix(path)} {system.ukey(file)}" for file in sorted(system.find(path))]
    except OSError as error:
        raise DataError(f"{url}: cannot be listed ({error}).") from None


@contextmanager
def fetched(url: str) -> Iterator[Path]:
    """The recording.toml of a copy, which goes at the end."""
    system, path = _opened(url)
    with TemporaryDirectory(prefix="midspan-") as folder:
        try:
            system.get(f"{path.rstrip('/')}/", folder, recursive=True)
        except OSError as error:
            raise DataError(f"{url}: cannot be read ({error}).") from None
        recordings = sorted(Path(folder).rglob(RECORDING_FILE))
        if not recordings:
            raise DataError(f"{url}: has no {RECORDING_FILE} any more.")
        yield recordings[0]


def _opened(url: str) -> tuple[Any, str]:
    try:
        import fsspec
    except ImportError:
        raise UsageError(f'{url}: needs fsspec. Install it with `pip install "midspan[campaign]"`.') from None
    try:
        system, path = fsspec.core.url_to_fs(url)
    except (ImportError, ValueError) as error:
        raise UsageError(f"{url}: cannot be opened ({error}).") from None
    return system, str(path)
