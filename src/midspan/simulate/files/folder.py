"""Writing of simulated recordings: tables, lossless video, and a folder that appears whole or not at all."""

import zipfile
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from fractions import Fraction
from pathlib import Path
from typing import TypeVar

import numpy as np

from midspan.errors import UsageError
from midspan.records import Floats
from midspan.simulate.scene.camera import Pixels
from midspan.simulate.scene.scene import Image
from midspan.writing import replacing_folder, settle_folder

MARK = "known.json"  # the file by which a folder written here is known again
OWN_FILES = frozenset(
    {MARK, "recording.toml", "accel.csv", "camera.mkv", "camera_times.csv", "gnss.csv", "truth.csv", "calibration.json"}
    | {"adc_data.bin", "radar.cfg", "radar.h5", "infrared.npz"}
)
MILLISECONDS = 1000  # Matroska's time stamps are whole milliseconds


Progress = Callable[[int, int], None]  # frames done, in all
T = TypeVar("T")


def counted(blocks: Iterable[T], size: Callable[[T], int], done: Callable[[int], None]) -> Iterator[T]:
    """The blocks as they are; `done` is called after each with the sum of all sizes so far."""
    total = 0
    for block in blocks:
        yield block
        total += size(block)
        done(total)


def write_table(path: Path, columns: dict[str, Floats], *, decimals: dict[str, int]) -> None:
    """A CSV of equal columns (n,) with this many decimals each; NaN becomes an empty field."""
    texts = [[_number(value, decimals[name]) for value in column.tolist()] for name, column in columns.items()]
    lines = [",".join(columns), *(",".join(row) for row in zip(*texts, strict=True))]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def _number(value: float, decimals: int) -> str:
    # Adding zero turns the -0.0 that rounding leaves of a tiny negative number into 0.0.
    return "" if np.isnan(value) else f"{round(value, decimals) + 0.0:.{decimals}f}"


def exact_in_video(stamps_s: Floats) -> bool:
    """Whether the stamps (n,) are whole milliseconds from 0 on, so that the video file itself can carry them."""
    return bool(
        stamps_s[0] == 0.0 and np.all(np.abs(stamps_s * MILLISECONDS - np.rint(stamps_s * MILLISECONDS)) < 1e-6)
    )


def write_video(
    path: Path, frames: Iterable[Pixels], *, stamps_s: Floats, rate_hz: float, done: Callable[[int], None]
) -> None:
    """A lossless video (FFV1 in Matroska) of grey frames (rows, columns) uint8 or uint16, stamped to the millisecond.

    `done` is called with the number of frames written after each one.
    """
    import av

    base = Fraction(1, MILLISECONDS)
    with av.open(str(path), "w") as container:
        stream = container.add_stream("ffv1", rate=Fraction(rate_hz).limit_denominator(1001))
        for count, (pixels, stamp) in enumerate(zip(frames, stamps_s, strict=True), start=1):
            layout = "gray" if pixels.dtype == np.uint8 else "gray16le"
            if count == 1:
                stream.height, stream.width = pixels.shape
                stream.pix_fmt = layout
                stream.codec_context.time_base = base
            frame = av.VideoFrame.from_ndarray(pixels, format=layout)
            frame.pts, frame.time_base = round(stamp * MILLISECONDS), base
            container.mux(stream.encode(frame))
            done(count)
        container.mux(stream.encode())


def check_free(folder: Path) -> None:
    """Raise UsageError unless `folder` is absent, empty, or holds nothing but a simulated recording."""
    if not folder.exists():
        return
    if not folder.is_dir():
        raise UsageError(f"{folder} is a file; a recording is a folder. Choose another name.")
    if Path.cwd().is_relative_to(folder.resolve()):
        # A folder is replaced as a whole, and a shell that stands in it would be left in one that is gone.
        raise UsageError(f"{folder} is the current folder, or one above it; call from its parent and give its name.")
    held = {entry.name for entry in folder.iterdir()}
    foreign = sorted(held - OWN_FILES) if MARK in held else sorted(held)
    if foreign:
        raise UsageError(
            f"{folder} holds {foreign[0]!r}, which the simulation did not write; it would be lost. "
            "Choose another folder or empty this one."
        )


@contextmanager
def whole_folder(folder: Path) -> Iterator[Path]:
    """A temporary folder that takes the name `folder` when the block ends well, and is removed when it does not.

    Raises UsageError where `folder` holds anything that was not written here, or cannot be written.
    """
    # A link stays, and the folder that it names is replaced.
    folder = folder.resolve() if folder.is_symlink() else folder
    settle_folder(folder)
    check_free(folder)
    with replacing_folder(folder) as partial:
        yield partial
        check_free(folder)


def write_celsius(path: Path, pictures: Iterable[Image], stamps_s: Floats, size_px: tuple[int, int]) -> None:
    """An npz of `celsius` (n, rows, columns), float32 in °C rounded to 1/64 K, and `time_s` (n,), n stamps."""
    # 1/64 K adds a hundredth to the noise of a good camera, and half the bytes are zeros.
    steps = np.float32(64.0)
    form = {"descr": "<f4", "fortran_order": False, "shape": (len(stamps_s), *size_px)}
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        with archive.open("time_s.npy", "w") as file:
            np.lib.format.write_array(file, np.asarray(stamps_s, dtype=np.float64), allow_pickle=False)
        with archive.open("celsius.npy", "w", force_zip64=True) as file:
            np.lib.format.write_array_header_1_0(file, form)
            for picture in pictures:
                rounded = np.rint(picture * steps) / steps
                file.write(rounded.astype("<f4").tobytes())
