"""Frames of a video, a folder or glob of images, or a stack: one table from suffix to reader."""

from pathlib import Path

from midspan.errors import DataError, UsageError
from midspan.sources.camera.frames import FrameRequest, FrameSource
from midspan.sources.camera.timing import check_request

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


def open_frames(path: Path, request: FrameRequest) -> FrameSource:
    """The frames at `path`: a folder or a glob of images, a multi-page TIFF, an npy or npz stack, a Photron
    recording, else a video.

    Raises UsageError for settings out of range, DataError for a missing or unreadable source.
    """
    check_request(path, request)
    is_glob = any(sign in str(path) for sign in "*?[") and not path.exists()
    if not is_glob and not path.exists():
        raise DataError(f"{path} does not exist. Correct the path; it is relative to recording.toml.")
    if is_glob or path.is_dir() or path.suffix.lower() in _IMAGES:
        from midspan.sources.camera.images import ImageFrames

        return ImageFrames(path, request, _IMAGES)
    if path.suffix.lower() in _STACKS:
        from midspan.sources.camera.stack import StackFrames

        return StackFrames(path, request)
    if path.suffix.lower() in _PHOTRON:
        from midspan.sources.camera.photron import PhotronFrames

        return PhotronFrames(path, request)
    from midspan.sources.camera.video import VideoFrames

    try:
        return VideoFrames(path, request)
    except DataError as error:
        if path.suffix.lower() in _VIDEO:
            raise
        known = ", ".join(_VIDEO[:8] + _IMAGES + _STACKS + _PHOTRON)
        raise UsageError(
            f"{path} is no video, image or stack that can be read; known suffixes are {known} …"
        ) from error
