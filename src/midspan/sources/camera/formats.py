"""Frames of a video, a folder or glob of images, or a stack: one table from suffix to reader."""

import os
from collections.abc import Callable
from pathlib import Path

from midspan.errors import DataError, UsageError
from midspan.sources.accelerometer.formats import FORMATS as TABLE_FORMATS
from midspan.sources.boundary import reading, require_file
from midspan.sources.camera.frames import FrameRequest
from midspan.sources.camera.guarded import GuardedFrames
from midspan.sources.camera.timing import check_request
from midspan.vision.frame_source import FrameSource

_VIDEO: tuple[str, ...] = (
    ".mp4",
    ".mov",
    ".avi",
    ".mkv",
    ".webm",
    ".m4v",
    ".mpg",
    ".mpeg",
    ".ts",
    ".mts",
    ".m2ts",
    ".wmv",
    ".flv",
)
_VIDEO += (".3gp", ".mjpeg", ".mjpg", ".ogv", ".y4m", ".h264", ".h265", ".hevc", ".gif", ".nut")
_IMAGES = (".png", ".tif", ".tiff", ".jpg", ".jpeg", ".bmp", ".pgm", ".pnm")
_STACKS = (".npy", ".npz")
_PHOTRON = (".cih", ".mraw")

FORMATS = (
    ("video", _VIDEO, "PyAV (FFmpeg)"),
    ("folder or glob of images, multi-page TIFF", _IMAGES, "OpenCV"),
    ("stack (frames, rows, columns)", _STACKS, "numpy"),
    ("Photron high-speed recording", _PHOTRON, "midspan"),
)
"""Rows of (name, suffixes, what it is read with)."""


_TABLES = {suffix for _, suffixes, _ in TABLE_FORMATS for suffix in suffixes} - set(_STACKS)


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
    check_request(path, request)
    if (is_table(path) or path.suffix.lower() == ".npz") and path.is_file():
        from midspan.sources.camera.track_table import TrackFrames, holds_tracks

        if holds_tracks(path):
            return TrackFrames(path, request)
    if is_table(path) and path.is_file():
        # Decided by the name: a damaged table is no reason to try it as a video.
        raise UsageError(
            f"{path} is a table of numbers, neither frames nor a track (columns x_px and y_px); known suffixes are "
            f"{_known()} …"
        )
    kind, opened = _opener(path)
    with reading(path, kind):
        return GuardedFrames(opened(path, request), path, kind)


def is_glob(path: Path) -> bool:
    """Whether a path is a pattern for several files; a file whose name holds the signs of one is that file."""
    return any(sign in str(path) for sign in "*?[") and not os.path.exists(path)


def require_readable(path: Path) -> None:
    """Raise DataError for a path that is missing, or no regular file or folder: a pipe would be waited for."""
    if not is_glob(path):
        require_file(path, folder=True)


def _opener(path: Path) -> tuple[str, Callable[[Path, FrameRequest], FrameSource]]:
    """What a source is, in words, and what opens it."""
    require_readable(path)
    suffix = path.suffix.lower()
    if is_glob(path) or path.is_dir() or suffix in _IMAGES:
        from midspan.sources.camera.images import ImageFrames

        return "images", lambda path, request: ImageFrames(path, request, _IMAGES)
    if suffix in _STACKS:
        from midspan.sources.camera.stack import StackFrames

        return "a NumPy stack", StackFrames
    if suffix in _PHOTRON:
        from midspan.sources.camera.photron import PhotronFrames

        return "a Photron recording", PhotronFrames
    return "a video", _video


def _video(path: Path, request: FrameRequest) -> FrameSource:
    from midspan.sources.camera.video import VideoFrames

    try:
        return VideoFrames(path, request)
    except DataError as error:
        if path.suffix.lower() in _VIDEO:
            raise
        raise UsageError(
            f"{path} is no video, image or stack that can be read; known suffixes are {_known()} …"
        ) from error


def _known() -> str:
    return ", ".join(_VIDEO[:8] + _IMAGES + _STACKS + _PHOTRON)
