"""Frames that change their size in mid-file: one message with the file, the frame and both sizes."""

from fractions import Fraction
from pathlib import Path

import av
import cv2
import numpy as np
import pytest

from midspan.errors import DataError
from midspan.sources.camera.formats import open_frames
from midspan.sources.camera.frames import FrameRequest
from midspan.sources.inspect import inspect_file
from midspan.vision.checkerboard import Board


def encoded(path: Path, codec: str, pixel_format: str, size: tuple[int, int]) -> Path:
    """Ten frames of one size."""
    rng = np.random.default_rng(1)
    with av.open(str(path), "w") as container:
        stream = container.add_stream(codec, rate=10)
        stream.width, stream.height, stream.pix_fmt = *size, pixel_format
        for _ in range(10):
            picture = rng.integers(0, 255, size[::-1], dtype=np.uint8)
            container.mux(
                stream.encode(av.VideoFrame.from_ndarray(picture, format="gray").reformat(format=pixel_format))
            )
        container.mux(stream.encode())
    return path


def changing(folder: Path, name: str) -> Path:
    """A video of ten frames of 64 x 48 px and ten of 32 x 24 px, in one stream."""
    if name.endswith(".ts"):
        parts = [encoded(folder / f"{k}.ts", "libx264", "yuv420p", s) for k, s in enumerate(((64, 48), (32, 24)))]
        (folder / name).write_bytes(b"".join(part.read_bytes() for part in parts))
        return folder / name
    parts = [encoded(folder / f"{k}.avi", "mjpeg", "yuvj420p", s) for k, s in enumerate(((64, 48), (32, 24)))]
    with av.open(str(folder / name), "w") as container:
        stream = container.add_stream("mjpeg", rate=10)
        stream.width, stream.height, stream.pix_fmt = 64, 48, "yuvj420p"
        count = 0
        for part in parts:
            with av.open(str(part)) as source:
                for read in source.demux(video=0):
                    if read.size:
                        packet = av.Packet(bytes(read))
                        packet.stream, packet.time_base = stream, Fraction(1, 10)
                        packet.pts = packet.dts = count
                        count += 1
                        container.mux(packet)
    return folder / name


NAMES = ["mixed.mkv", "mixed.avi", "mixed.ts"]


@pytest.mark.parametrize("name", NAMES)
def test_a_video_that_changes_its_size_is_refused_where_it_changes(name: str, tmp_path: Path) -> None:
    source = open_frames(changing(tmp_path, name), FrameRequest(rate_hz=10))
    seen = []
    with pytest.raises(DataError, match=rf"{name}: .*64x48 px.*frame 10 has 32x24 px.*Split the recording"):
        seen.extend(frame.pixels.shape for frame in source.frames())
    assert seen == [(48, 64)] * 10


def test_the_part_before_the_change_can_be_read(tmp_path: Path) -> None:
    source = open_frames(changing(tmp_path, "mixed.mkv"), FrameRequest(rate_hz=10))
    assert sum(1 for _ in source.frames(0, 10)) == 10


def test_starting_behind_the_change_is_refused_too_once_the_first_frame_was_seen(tmp_path: Path) -> None:
    source = open_frames(changing(tmp_path, "mixed.mkv"), FrameRequest(rate_hz=10))
    next(iter(source.frames(0, 1)))
    with pytest.raises(DataError, match=r"first \(64x48 px.*frame 12 has 32x"):
        next(iter(source.frames(12)))


def test_inspect_does_not_call_it_a_good_video(tmp_path: Path) -> None:
    with pytest.raises(DataError):
        inspect_file(changing(tmp_path, "mixed.mkv"))


def test_a_folder_of_images_of_two_sizes_is_refused_and_names_the_image(tmp_path: Path) -> None:
    for k, size in enumerate(((24, 32), (24, 32), (48, 64))):
        cv2.imwrite(str(tmp_path / f"{k}.png"), np.zeros(size, np.uint8))
    with pytest.raises(DataError, match=r"2\.png .*32 x 24.*64 x 48"):
        list(open_frames(tmp_path, FrameRequest(rate_hz=1)).frames())


def test_a_lens_is_not_calibrated_from_two_sizes(tmp_path: Path) -> None:
    from midspan.sources.camera.lens import LensRequest, lens_from_pictures

    with pytest.raises(DataError, match=r"64x48 px.*32x24 px"):
        lens_from_pictures(changing(tmp_path, "mixed.mkv"), LensRequest(Board()))
