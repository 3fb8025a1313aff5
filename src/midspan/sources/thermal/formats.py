"""Radiometric sequences in any form: one table from suffix to reader."""

import zipfile
from pathlib import Path

from midspan.errors import DataError
from midspan.sources.camera.formats import open_frames
from midspan.sources.camera.frames import FrameRequest, FrameSource
from midspan.sources.camera.timing import check_request
from midspan.sources.thermal.flir import SUFFIXES, FlirFrames, natural_order
from midspan.sources.thermal.pictures import ThermalPictures
from midspan.sources.thermal.repaired import RepairedFrames
from midspan.sources.thermal.request import ThermalRequest

FORMATS = (
    ("FLIR radiometric sequence, folder or glob of frames", SUFFIXES, "midspan (csq with pyjpegls)"),
    ("16-bit TIFF or PNG of counts, float TIFF in °C", (".tif", ".tiff", ".png"), "OpenCV"),
    ("stack in °C (array celsius)", (".npy", ".npz"), "numpy"),
)
"""Rows of (name, suffixes, what it is read with)."""


def open_thermal(path: Path, request: ThermalRequest | None = None) -> FrameSource:
    """The frames at `path` as temperatures in °C (float32, all of them numbers: dead pixels are filled); pictures of
    8 bits as grey levels, told in its notes.

    `path`: a FLIR fff, seq or csq file, a folder or glob of fff files or pictures, a multi-page TIFF, an npy or npz
    stack. Raises UsageError for settings out of range or a missing decoder, DataError for a source that is missing,
    damaged or in another unit.
    """
    request = request or ThermalRequest()
    check_request(path, request.frames)
    files = _flir_files(path)
    if files:
        return RepairedFrames(FlirFrames(files, request), str(path))
    pictures = ThermalPictures(open_frames(path, request.frames), request, str(path))
    return RepairedFrames(pictures, str(path)) if pictures.info.radiometric else pictures


def is_thermal(path: Path) -> bool:
    """Whether a source can be nothing but temperatures: FLIR files, or a stack whose array is called `celsius`.

    Pictures of 16 bits can be of any camera. What cannot be read is not judged.
    """
    try:
        if _flir_files(path):
            return True
        if path.suffix.lower() != ".npz" or not path.is_file():
            return False
        with zipfile.ZipFile(path) as archive:
            return "celsius.npy" in archive.namelist()
    except (DataError, OSError, zipfile.BadZipFile):
        return False


def open_pictures(path: Path, request: FrameRequest) -> FrameSource:
    """The frames at `path`: temperatures where they can be nothing else, else of a camera of light."""
    return open_thermal(path, ThermalRequest(request)) if is_thermal(path) else open_frames(path, request)


def _flir_files(path: Path) -> list[Path]:
    """The FLIR files that `path` means: itself, those of a folder or glob; empty where it means something else."""
    if path.is_file():
        return [path] if path.suffix.lower() in SUFFIXES else []
    if path.is_dir():
        found = [file for file in path.iterdir() if file.suffix.lower() in SUFFIXES and not file.name.startswith(".")]
    elif any(sign in str(path) for sign in "*?["):
        folder = next(parent for parent in path.parents if not any(sign in str(parent) for sign in "*?["))
        found = [file for file in folder.glob(str(path.relative_to(folder))) if file.suffix.lower() in SUFFIXES]
    elif path.suffix.lower() in SUFFIXES:
        raise DataError(f"{path} does not exist. Correct the path; it is relative to recording.toml.")
    else:
        found = []
    return natural_order(found)
