"""Photron recordings: raw frames with a text header."""

from pathlib import Path

import numpy as np
import pytest

from midspan.errors import DataError
from midspan.sources.camera.formats import open_frames
from midspan.sources.camera.frames import FrameRequest

HEADER = """#Camera Information Header
Record Rate(fps) : {rate}
Total Frame : {count}
Image Width : {width}
Image Height : {height}
Color Type : {colour}
Color Bit : {bits}
"""


def packed(frames: np.ndarray, bits: int) -> bytes:
    """Frames (n, rows, columns) as bits, written without regard to how the reader works."""
    if bits == 8:
        return frames.astype(np.uint8).tobytes()
    if bits == 16:
        return frames.astype("<u2").tobytes()
    out = b""
    for frame in frames:
        line = "".join(format(int(v), "012b") for v in frame.ravel())
        line += "0" * (-len(line) % 8)
        out += bytes(int(line[k : k + 8], 2) for k in range(0, len(line), 8))
    return out


def written(folder: Path, frames: np.ndarray, bits: int, **changed: object) -> Path:
    """A recording of the frames; returns its header file."""
    count, height, width = frames.shape
    values = {"rate": 500, "count": count, "width": width, "height": height, "colour": "Mono", "bits": bits}
    (folder / "run.cih").write_text(HEADER.format(**{**values, **changed}))
    (folder / "run.mraw").write_bytes(packed(frames, bits))
    return folder / "run.cih"


@pytest.mark.parametrize("bits", [8, 12, 16])
@pytest.mark.parametrize("shape", [(4, 6, 10), (3, 5, 7)], ids=["even", "odd"])
def test_frames_of_all_depths_come_back_as_they_were_written(
    tmp_path: Path, bits: int, shape: tuple[int, int, int]
) -> None:
    truth = np.random.default_rng(bits).integers(0, 2**bits, shape)
    source = open_frames(written(tmp_path, truth, bits).with_suffix(".mraw"), FrameRequest())
    found = list(source.frames())
    assert len(found) == shape[0]
    for frame, expected in zip(found, truth, strict=True):
        np.testing.assert_array_equal(frame.pixels, expected)
    np.testing.assert_array_equal(source.times_ns(), np.arange(shape[0]) * 2_000_000)


def test_every_and_start_apply_to_stamps_and_frames_alike(tmp_path: Path) -> None:
    truth = np.random.default_rng(0).integers(0, 255, (7, 4, 8))
    source = open_frames(written(tmp_path, truth, 8), FrameRequest(start_s=1.0, every=3))
    found = list(source.frames(1))
    assert [frame.time_ns for frame in found] == [1_006_000_000, 1_012_000_000]
    np.testing.assert_array_equal(found[1].pixels, truth[6])


def test_a_truncated_file_gives_the_frames_it_holds_and_says_so(tmp_path: Path) -> None:
    truth = np.zeros((5, 4, 8))
    source = open_frames(written(tmp_path, truth, 8, count=9), FrameRequest())
    assert source.info.frame_count == 5
    assert "declares 9" in source.info.damage[0]


@pytest.mark.parametrize(
    ("changed", "reported"),
    [({"colour": "Bayer"}, "monochrome"), ({"rate": "none"}, "Record Rate"), ({"width": 999}, "bytes")],
)
def test_headers_that_do_not_fit_are_refused_with_their_key(
    tmp_path: Path, changed: dict[str, object], reported: str
) -> None:
    file = written(tmp_path, np.zeros((2, 4, 8)), 8, **changed)
    with pytest.raises(DataError, match=reported):
        open_frames(file, FrameRequest())


def test_a_header_without_its_frames_is_an_error_that_names_the_missing_file(tmp_path: Path) -> None:
    file = written(tmp_path, np.zeros((2, 4, 8)), 8)
    file.with_suffix(".mraw").unlink()
    with pytest.raises(DataError, match=r"run\.mraw: not found"):
        open_frames(file, FrameRequest())
