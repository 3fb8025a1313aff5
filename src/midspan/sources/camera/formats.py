"""Frames of a video, a folder or glob of images, or a stack: one table from suffix to reader."""

import importlib
import os
import re
from collections.abc import Iterator
from functools import partial
from pathlib import Path

from midspan.errors import DataError, UsageError
from midspan.records import Frame, Nanoseconds
from midspan.sources.accelerometer.formats import FORMATS as TABLE_FORMATS
from midspan.sources.boundary import reading, require_file
from midspan.sources.camera.frames import FrameRequest
from midspan.sources.zipped import ZippedFrames, is_inside
from midspan.vision.frame_source import FrameInfo, FrameSource


def _suffixes(names: str) -> tuple[str, ...]:
    return tuple(f".{name}" for name in names.split())


_VIDEO = _suffixes(
    "mp4 mov avi mkv webm m4v mpg mpeg ts mts m2ts wmv flv 3gp mjpeg mjpg ogv y4m h264 h265 hevc gif nut"
)
IMAGES = _suffixes("png tif tiff jpg jpeg bmp pgm pnm")
_STACKS, _PHOTRON = _suffixes("npy npz"), _suffixes("cih mraw")

# Name, suffixes, what it is read with; then what messages call it, the module and the class that read it.
_READERS = (
    ("video", _VIDEO, "PyAV (FFmpeg)", "a video", "video", "VideoFrames"),
    ("folder or glob of images, multi-page TIFF", IMAGES, "OpenCV", "images", "images", "ImageFrames"),
    ("stack (frames, rows, columns)", _STACKS, "numpy", "a NumPy stack", "stack", "StackFrames"),
    ("Photron high-speed recording", _PHOTRON, "midspan", "a Photron recording", "photron", "PhotronFrames"),
)
FORMATS = tuple(row[:3] for row in _READERS)
"""Rows of (name, suffixes, what it is read with)."""

_TABLES = {suffix for _, suffixes, _ in TABLE_FORMATS for suffix in suffixes} - set(_STACKS)
_EXAMPLES = ", ".join(_VIDEO[:8] + IMAGES + _STACKS + _PHOTRON)


def is_video(path: Path) -> bool:
    """Whether a file is a video by its name."""
    return path.suffix.lower() in _VIDEO


def is_table(path: Path) -> bool:
    """Whether a file is a table of numbers by its name; arrays of NumPy can be tables or frames."""
    return path.suffix.lower() in _TABLES


def is_stack(path: Path) -> bool:
    """Whether a file is an array of NumPy that can be frames by its header."""
    if path.suffix.lower() not in _STACKS or not path.is_file():
        return False
    from midspan.sources.camera.stack import holds_stack

    return holds_stack(path)


def open_frames(path: Path, request: FrameRequest) -> FrameSource:
    """The frames at `path`: a folder or a glob of images, a multi-page TIFF, an npy or npz stack, a Photron
    recording, else a video.

    Raises UsageError for settings out of range, DataError for a missing or unreadable source.
    """
    request.check(path)
    if is_inside(path):
        return ZippedFrames(path, partial(open_frames, request=request))
    if (is_table(path) or path.suffix.lower() == ".npz") and path.is_file():
        from midspan.sources.camera.track_table import TrackFrames, holds_tracks

        if holds_tracks(path):
            return TrackFrames(path, request)
    if is_table(path) and path.is_file():
        # Decided by the name: a damaged table is no reason to try it as a video.
        raise UsageError(
            f"{path} is a table of numbers, neither frames nor a track (columns x_px and y_px); known suffixes are "
            f"{_EXAMPLES} …"
        )
    require_readable(path)
    suffix = IMAGES[0] if _is_glob(path) or path.is_dir() else path.suffix.lower()
    *_, kind, module, reader = next((row for row in _READERS if suffix in row[1]), _READERS[0])
    with reading(path, kind):
        frames = getattr(importlib.import_module(f"midspan.sources.camera.{module}"), reader)
        try:
            return GuardedFrames(frames(path, request), path, kind)
        except DataError as error:
            if any(suffix in row[1] for row in _READERS):
                raise
            raise UsageError(
                f"{path} cannot be read as a video, image or stack; known suffixes are {_EXAMPLES} …"
            ) from error


class GuardedFrames(FrameSource):
    """Frames of another source; what its library raises, also while it is read, is a DataError that names the file."""

    def __init__(self, source: FrameSource, path: Path, kind: str) -> None:
        self._source, self._path, self._kind = source, path, kind

    @property
    def info(self) -> FrameInfo:
        """What is known of the source."""
        with reading(self._path, self._kind):
            return self._source.info

    def times_ns(self) -> Nanoseconds:
        """Time stamps of the source."""
        with reading(self._path, self._kind):
            return self._source.times_ns()

    def frames(self, start: int = 0, stop: int | None = None) -> Iterator[Frame]:
        """Frames of the source."""
        with reading(self._path, self._kind):
            yield from self._source.frames(start, stop)


def require_readable(path: Path) -> None:
    """Raise DataError for a path that is missing, or no regular file or folder: a pipe would be waited for."""
    if not _is_glob(path) and not is_inside(path):
        require_file(path, folder=True)


def listed(path: Path) -> list[Path]:
    """The files that `path` means, itself, those of a folder or of a glob, in natural order: img2 before img10."""
    if path.is_file():
        return [path]
    require_readable(path)
    if path.is_dir():
        files = [file for file in path.iterdir() if file.is_file() and not file.name.startswith(".")]
    else:
        folder = next(parent for parent in path.parents if not any(sign in str(parent) for sign in "*?["))
        files = [file for file in folder.glob(str(path.relative_to(folder))) if file.is_file()]
    return sorted(files, key=lambda file: [int(t) if t.isdigit() else t.lower() for t in re.split(r"(\d+)", str(file))])


def _is_glob(path: Path) -> bool:
    """Whether a path is a pattern for several files; a file whose name holds the signs of one is that file."""
    return any(sign in str(path) for sign in "*?[") and not os.path.exists(path)
