"""A file inside a zip, named by both: `walk.zip/Gyroscope.csv`. It is unpacked alone, into a folder that is removed."""

import shutil
import weakref
import zipfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path, PurePosixPath, PureWindowsPath
from tempfile import TemporaryDirectory, mkdtemp

from midspan.errors import DataError, MidspanError
from midspan.records import Frame, Nanoseconds
from midspan.sources.boundary import reading, shown_bytes
from midspan.vision.frame_source import FrameInfo, FrameSource

SUFFIX = ".zip"
# A recording has tens of files; a film of an hour at 50 Mbit/s has 22 GB.
MAX_MEMBERS, MAX_BYTES = 10_000, 32 << 30
# Tables of numbers shrink to a tenth. More is looked at only where there is enough of it to fill a disk.
MAX_RATIO, RATIO_FROM_BYTES = 200, 64 << 20
ENCRYPTED = 0x1


def zip_of(path: Path) -> Path | None:
    """The zip that a path is or leads into; None where there is none, or a file or folder of that name."""
    try:
        return next((one for one in (path, *path.parents) if one.suffix.lower() == SUFFIX and one.is_file()), None)
    except (OSError, ValueError):
        return None


def is_inside(path: Path) -> bool:
    """Whether a path leads to a file inside a zip."""
    archive = zip_of(path)
    return archive is not None and archive != path and _name(path, archive) in members(archive)


def members(archive: Path) -> tuple[str, ...]:
    """The names of the files in a zip. DataError where it is damaged, or is none that an app writes."""
    with reading(archive, "a zip archive"), zipfile.ZipFile(archive) as opened:
        found = [one for one in opened.infolist() if not one.is_dir()]
    if len(found) > MAX_MEMBERS:
        raise DataError(f"{archive} has {len(found)} files, {MAX_MEMBERS} at most are read. Give a smaller archive.")
    for one in found:
        windows, posix = PureWindowsPath(one.filename), PurePosixPath(one.filename)
        if windows.anchor or posix.is_absolute() or ".." in windows.parts:
            raise DataError(
                f"{archive} has a file whose name leads out of it, {one.filename!r}. Export the archive again."
            )
    return tuple(one.filename for one in found)


def unpack(path: Path, folder: Path) -> Path:
    """Write the file inside a zip that a path leads to into `folder`.

    Raises DataError for one that is damaged, encrypted, or grows beyond what a recording has.
    """
    archive = zip_of(path)
    assert archive is not None
    name = _name(path, archive)
    if name not in members(archive):
        raise DataError(f"{path}: {archive.name} has no file {name!r}. Correct the path.")
    target = folder / path.name
    with reading(path, "a file in a zip archive"), zipfile.ZipFile(archive) as opened:
        one = opened.getinfo(name)
        if one.flag_bits & ENCRYPTED:
            raise DataError(f"{path} is encrypted. Export the archive without a password.")
        free = min(MAX_BYTES, shutil.disk_usage(folder).free)
        swollen = one.file_size > max(RATIO_FROM_BYTES, MAX_RATIO * one.compress_size)
        if swollen or one.file_size > free:
            raise DataError(
                f"{path} grows from {shown_bytes(one.compress_size)} to {shown_bytes(one.file_size)}, more than a "
                "recording has or the disk holds. Unpack the archive and give its folder."
            )
        with opened.open(one) as packed, target.open("wb") as file:
            # No more than the header declares is read.
            shutil.copyfileobj(packed, file)
    return target


def _name(path: Path, archive: Path) -> str:
    return path.relative_to(archive).as_posix()


@contextmanager
def on_disk(path: Path) -> Iterator[Path]:
    """The file itself, or what was unpacked of a file inside a zip, which is removed afterwards."""
    archive = zip_of(path)
    if archive in (None, path):
        yield path
        return
    with TemporaryDirectory(prefix="midspan-") as folder, _named(Path(folder) / path.name, path):
        yield unpack(path, Path(folder))


@contextmanager
def _named(unpacked: Path, path: Path) -> Iterator[None]:
    """Let refusals name the path that was given, not what was unpacked."""
    try:
        yield
    except MidspanError as error:
        error.args = (str(error).replace(str(unpacked), str(path)),)
        raise


class ZippedFrames(FrameSource):
    """Frames of a film inside a zip; what is unpacked is removed with them."""

    def __init__(self, path: Path, opened: Callable[[Path], FrameSource]) -> None:
        folder = mkdtemp(prefix="midspan-")
        weakref.finalize(self, shutil.rmtree, folder, ignore_errors=True)
        self._given, self._unpacked = path, Path(folder) / path.name
        with _named(self._unpacked, path):
            self._source = opened(unpack(path, Path(folder)))

    @property
    def info(self) -> FrameInfo:
        """What is known of the source."""
        with _named(self._unpacked, self._given):
            return self._source.info

    def times_ns(self) -> Nanoseconds:
        """Time stamps of the source."""
        with _named(self._unpacked, self._given):
            return self._source.times_ns()

    def frames(self, start: int = 0, stop: int | None = None) -> Iterator[Frame]:
        """Frames of the source."""
        with _named(self._unpacked, self._given):
            yield from self._source.frames(start, stop)
