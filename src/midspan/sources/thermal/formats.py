"""Radiometric sequences in any form: one table from suffix to reader."""

import zipfile
from dataclasses import replace
from pathlib import Path

from midspan.errors import DataError
from midspan.sources.boundary import reading
from midspan.sources.camera.formats import GuardedFrames, listed, open_frames
from midspan.sources.camera.frames import FrameRequest
from midspan.sources.thermal.fff import JPEG_SUFFIXES, is_flir_jpeg, is_jpeg, refuse_dji
from midspan.sources.thermal.flir import SUFFIXES, FlirFrames
from midspan.sources.thermal.temperatures import RepairedFrames, ThermalPictures, ThermalRequest
from midspan.vision.frame_source import FrameSource

FORMATS = (
    ("FLIR radiometric sequence, folder or glob of frames", SUFFIXES, "midspan (csq with pyjpegls)"),
    ("FLIR radiometric JPEG, folder or glob of them", JPEG_SUFFIXES, "midspan"),
    ("16-bit TIFF or PNG of counts, float TIFF in °C", (".tif", ".tiff", ".png"), "OpenCV"),
    ("stack in °C (array celsius)", (".npy", ".npz"), "numpy"),
)
"""Rows of (name, suffixes, what it is read with)."""


def open_thermal(path: Path, request: ThermalRequest | None = None) -> FrameSource:
    """The frames at `path` as temperatures in °C (float32, all of them numbers: dead pixels are filled); pictures of
    8 bits as grey levels, reported in its notes.

    `path`: a FLIR fff, seq or csq file, a radiometric JPEG, a folder or glob of fff files, such JPEG or pictures, a
    multi-page TIFF, an npy or npz stack, a table of a track. Raises UsageError for settings out of range or a missing
    decoder, DataError for a source that is missing, damaged or in another unit.
    """
    request = request or ThermalRequest()
    request.frames.check(path)
    with reading(path, "temperatures"):
        files = _flir_files(path)
        if files:
            left_out = sum(is_jpeg(file) for file in listed(path)) - len(files) if is_jpeg(files[0]) else 0
            frames = FlirFrames(files, request, left_out)
            return RepairedFrames(GuardedFrames(frames, path, "FLIR frames"), str(path))
        for file in listed(path):
            refuse_dji(file)
        # Missing values are filled, and frames of too many passed over, once all is in °C.
        raw = open_frames(path, replace(request.frames, with_missing=True))
        if raw.tracks:
            return raw
        pictures = ThermalPictures(raw, request, str(path))
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
    """The FLIR files among those that `path` means, in their order; empty where it means something else."""
    files = listed(path)
    return [file for file in files if file.suffix.lower() in SUFFIXES] or [file for file in files if is_flir_jpeg(file)]
