"""Damaged files of a camera, through the command: the exit code, one sentence that names the file, or a warning.

Every file is made here. What a decoder detects itself must be neither used nor kept quiet.
"""

import os
import zipfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import pytest
from damaged_files import (
    bmp_of,
    bomb_npz,
    flip,
    flip_in_frames,
    moving,
    npy_header,
    payloads,
    png_of,
    tiff,
    write_video,
)

from midspan.cli.main import run
from midspan.errors import MidspanError
from midspan.sources.camera.formats import open_frames
from midspan.sources.camera.frames import FrameRequest

AT_10 = FrameRequest(rate_hz=10.0)


def written(folder: Path, name: str, data: bytes) -> Path:
    (folder / name).write_bytes(data)
    return folder / name


def stored(folder: Path) -> Path:
    np.savez(folder / "stored.npz", frames=moving(), time_s=np.arange(24) / 10.0)
    return folder / "stored.npz"


def compressed(folder: Path) -> Path:
    np.savez_compressed(folder / "packed.npz", frames=moving())
    return folder / "packed.npz"


def stored_flip(folder: Path) -> Path:
    path = stored(folder)
    flip(path, path.stat().st_size // 2)
    return path


def compressed_flips(folder: Path) -> Path:
    path = compressed(folder)
    # In the first block: its table of codes is read before any pixel.
    for place in range(70, 80):
        flip(path, place)
    return path


def unknown_method(folder: Path) -> Path:
    path = compressed(folder)
    data = bytearray(path.read_bytes())
    for mark, place in ((b"PK\x01\x02", 10), (b"PK\x03\x04", 8)):
        data[data.index(mark) + place] = 77
    path.write_bytes(data)
    return path


def torn_header(folder: Path) -> Path:
    # A bracket that is not closed: NumPy splits the header into tokens.
    return written(
        folder, "torn.npy", npy_header((3, 4, 5)).replace(b"'shape': (3, 4, 5)", b"'shape': ((3, 4, 5") + bytes(60)
    )


def unknown_codec(folder: Path) -> Path:
    path = write_video(folder / "tag.mp4", moving(), "mpeg4", "yuv420p")
    data = path.read_bytes()
    # The name of the codec, and the number of its kind in the description of the stream.
    assert data.count(b"mp4v") == 1
    place = data.index(b"esds")
    data = (
        data[:place] + data[place : place + 60].replace(b"\x04\x80\x80\x80", b"\x44\x80\x80\x80") + data[place + 60 :]
    )
    path.write_bytes(data.replace(b"mp4v", b"zz\x01\xfe"))
    return path


def script(folder: Path) -> Path:
    write_video(folder / "inner.mkv", moving())
    return written(folder, "script.mp4", b"ffconcat version 1.0\nfile inner.mkv\n")


def playlist(folder: Path) -> Path:
    write_video(folder / "inner.ts", moving(), "mpeg2video", "yuv420p")
    return written(
        folder,
        "playlist.mp4",
        b"#EXTM3U\n#EXT-X-VERSION:3\n#EXT-X-TARGETDURATION:4\n#EXTINF:2.4,\ninner.ts\n#EXT-X-ENDLIST\n",
    )


def pipe(folder: Path) -> Path:
    os.mkfifo(folder / "pipe.mkv")
    return folder / "pipe.mkv"


def table_pipe(folder: Path) -> Path:
    os.mkfifo(folder / "pipe.csv")
    return folder / "pipe.csv"


def damaged_table(name: str) -> Callable[[Path], Path]:
    return lambda folder: written(folder, name, b"MATLAB 5.0 MAT-file" + bytes(range(256)) * 8)


@dataclass(frozen=True)
class Damaged:
    """make: writes the file into a folder and gives its path; words: in the one sentence of the message."""

    make: Callable[[Path], Path]
    words: tuple[str, ...]
    code: int = 3


REFUSED = {
    "npz stored, one bit": Damaged(stored_flip, ("stored.npz", "CRC-32", "frames", "Copy the file again")),
    "npz compressed, bits": Damaged(compressed_flips, ("packed.npz", "cannot be read as")),
    "npz of an unknown method": Damaged(unknown_method, ("packed.npz", "compression method")),
    "npy with a torn header": Damaged(torn_header, ("torn.npy", "cannot be read")),
    "npz that declares 10 TB": Damaged(
        lambda f: bomb_npz(f / "bomb.npz", "frames", (10**7, 1000, 1000), 10**13),
        ("bomb.npz", "available memory", "9313.2 GiB"),
    ),
    "npz whose times declare 10 TB": Damaged(
        lambda f: bomb_npz(f / "bomb.npz", "celsius", (10**13, 1, 1), 10**13), ("bomb.npz", "available memory")
    ),
    "npy that declares 10 TB": Damaged(
        lambda f: written(f, "bomb.npy", npy_header((10**7, 1000, 1000)) + bytes(1000)), ("bomb.npy",)
    ),
    "PNG that declares 32 TB": Damaged(
        lambda f: written(f, "bomb.png", png_of(2_000_000, 2_000_000)), ("bomb.png", "available memory")
    ),
    "BMP with a side that is too long": Damaged(
        lambda f: written(f, "long.bmp", bmp_of(3_000_000, 10)), ("long.bmp", "its header declares an impossible image")
    ),
    "BMP that declares a huge picture": Damaged(
        lambda f: written(f, "bomb.bmp", bmp_of(2_000_000_000, 2_000_000_000)), ("bomb.bmp", "available memory")
    ),
    "TIFF that declares a huge picture": Damaged(
        lambda f: written(f, "bomb.tif", tiff(1, size=(4_000_000_000, 4_000_000_000))), ("bomb.tif", "available memory")
    ),
    "TIFF whose pages lead back": Damaged(
        lambda f: written(f, "loop.tif", tiff(3, loop=True)), ("loop.tif", "from page 3 back to page 1")
    ),
    "codec that is not known": Damaged(unknown_codec, ("tag.mp4", "its codec is unknown")),
    "script named as a video": Damaged(script, ("script.mp4", "script or playlist")),
    "playlist named as a video": Damaged(playlist, ("playlist.mp4",)),
    "pipe": Damaged(pipe, ("pipe.mkv", "it is a pipe")),
    "pipe named as a table": Damaged(table_pipe, ("pipe.csv", "it is a pipe")),
    "MAT that is damaged": Damaged(damaged_table("a.mat"), ("a.mat",)),
    "Parquet that is damaged": Damaged(damaged_table("a.parquet"), ("a.parquet",)),
    "HDF5 that is damaged": Damaged(damaged_table("a.h5"), ("a.h5",)),
}


@pytest.mark.parametrize("case", REFUSED.values(), ids=REFUSED)
def test_a_damaged_file_is_one_sentence(tmp_path: Path, capsys: pytest.CaptureFixture[str], case: Damaged) -> None:
    assert run(["inspect", str(case.make(tmp_path))]) == case.code
    message = capsys.readouterr().err.strip()
    for word in case.words:
        assert word in message
    assert "defect" not in message
    assert "\n" not in message
    assert "video" not in message or "mat" not in message, "a table is not tried as a video"


@pytest.mark.parametrize("case", ["npz stored, one bit", "TIFF whose pages lead back"])
def test_the_same_holds_while_it_is_tracked(tmp_path: Path, capsys: pytest.CaptureFixture[str], case: str) -> None:
    path = REFUSED[case].make(tmp_path)
    assert run(["track", str(path), "-o", str(tmp_path / "o.csv"), "--rate-hz", "10"]) == 3
    assert "defect" not in capsys.readouterr().err
    assert not (tmp_path / "o.csv").exists()


def test_slices_whose_checksum_is_wrong_cost_their_frames_and_that_is_reported(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    frames = moving()
    path = write_video(tmp_path / "a.mkv", frames, g="1")
    flip_in_frames(path, (0, 7, 11))
    source = open_frames(path, FrameRequest())
    found = list(source.frames())
    assert [frame.index for frame in found] == [k for k in range(24) if k not in (0, 7, 11)]
    for frame in found:
        np.testing.assert_array_equal(frame.pixels, frames[frame.index])
        assert frame.time_ns == frame.index * 100_000_000
    assert run(["inspect", str(path)]) == 0
    assert "3 frames are damaged and were skipped: frame 0, 7, 11" in capsys.readouterr().out
    assert run(["track", str(path), "-o", str(tmp_path / "o.csv"), "--roi", "30,16,32,32"]) == 0
    assert "3 frames are damaged and were skipped: frame 0, 7, 11" in capsys.readouterr().err
    rows = (tmp_path / "o.csv").read_text().splitlines()[1:]
    assert not {"0.7", "1.1"} & {row.split(",")[0] for row in rows if not row.endswith(",lost")}


def test_what_a_damaged_slice_taught_the_decoder_is_not_used_up_to_the_next_key_frame(tmp_path: Path) -> None:
    frames = moving()
    path = write_video(tmp_path / "a.mkv", frames, g="12")
    flip_in_frames(path, (7,))
    source = open_frames(path, FrameRequest())
    found = list(source.frames())
    # Key frames are 0 and 12.
    assert [frame.index for frame in found] == [k for k in range(24) if not 7 <= k < 12]
    for frame in found:
        np.testing.assert_array_equal(frame.pixels, frames[frame.index])
    assert source.info.damage == ("5 frames are damaged and were skipped: frame 7, 8, 9, 10, 11",)


def test_the_log_of_the_decoder_is_as_it_was_after_reading(tmp_path: Path) -> None:
    from av import logging

    path = write_video(tmp_path / "a.mkv", moving())
    before = logging.get_level()
    list(open_frames(path, FrameRequest()).frames())
    assert logging.get_level() == before


def test_frames_that_build_on_a_damaged_one_are_reported(tmp_path: Path) -> None:
    path = write_video(tmp_path / "a.mkv", moving(), "mpeg4", "yuv420p", g="12", bf="0")
    data = path.read_bytes()
    lost = payloads(path)[3]
    path.write_bytes(data.replace(lost, bytes(len(lost))))
    source = open_frames(path, FrameRequest())
    list(source.frames())
    assert source.info.damage == (
        "1 frames are damaged and were skipped: frame 3",
        # Frames 4 to 11; frame 12 is a key frame.
        "8 frames after damaged ones, up to the next key frame, may be partly wrong",
    )


@pytest.mark.parametrize("name", ["2024-05-01T12:00:00.mkv", "cam1:take2.mkv"])
def test_a_name_with_a_colon_is_a_file_by_a_relative_path(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    write_video(tmp_path / "a.mkv", moving()).rename(tmp_path / name)
    monkeypatch.chdir(tmp_path)
    assert run(["inspect", name]) == 0


def test_metadata_in_another_encoding_are_no_damage(tmp_path: Path) -> None:
    path = write_video(tmp_path / "a.mkv", moving(), metadata={"title": "Bruecke im Sueden"})
    data = path.read_bytes()
    assert data.count(b"Bruecke") == 1
    path.write_bytes(data.replace(b"Bruecke", b"Br\xfccke "))
    assert run(["inspect", str(path)]) == 0


@pytest.mark.parametrize(
    ("name", "codec", "pixel_format", "words"),
    [
        ("a.y4m", "rawvideo", "yuv420p", "frame 21 has "),
        ("a.y4m", "rawvideo", "gray", "frame 21 has "),
        ("a.gif", "gif", "rgb8", "the byte that ends a GIF is missing"),
        ("a.ts", "mpeg2video", "yuv420p", "its last packet has "),
        ("a.wmv", "wmv2", "yuv420p", "bytes that its header declares are missing"),
        ("a.mkv", "ffv1", "gray", "bytes that its header declares are missing, about "),
    ],
)
def test_a_video_that_breaks_off_is_reported(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str, codec: str, pixel_format: str, words: str
) -> None:
    path = write_video(tmp_path / name, moving(), codec, pixel_format)
    assert run(["inspect", str(path)]) == 0
    assert "cut off" not in capsys.readouterr().out, "a whole file"
    whole = [frame.pixels for frame in open_frames(path, AT_10).frames()]
    path.write_bytes(path.read_bytes()[: 9 * path.stat().st_size // 10])
    assert run(["inspect", str(path)]) == 0
    out = capsys.readouterr().out
    assert "the file is cut off" in out
    assert words in out
    found = list(open_frames(path, AT_10).frames())
    # The last packets of wmv are padding: nothing but bytes is missing there.
    assert 10 < len(found) < (25 if name == "a.wmv" else 24)
    for frame in found:
        np.testing.assert_array_equal(frame.pixels, whole[frame.index])


def test_only_the_array_of_frames_is_loaded(tmp_path: Path) -> None:
    # The other array declares more than any machine has: to look for the frames must not load it.
    bomb = bomb_npz(tmp_path / "bomb.npz", "other", (10**13,), 10**13)
    np.savez_compressed(tmp_path / "a.npz", film=moving())
    with zipfile.ZipFile(bomb) as source, zipfile.ZipFile(tmp_path / "a.npz", "a") as target:
        raw = npy_header((10**13,)) + bytes(1000)
        target.writestr(source.infolist()[0].filename, raw)
    source_of_frames = open_frames(tmp_path / "a.npz", AT_10)
    np.testing.assert_array_equal([frame.pixels for frame in source_of_frames.frames()], moving())


def seeds(folder: Path) -> list[Path]:
    """Whole files, one for each reader and container."""
    frames = moving(count=6, rows=24, columns=32)
    found = [
        write_video(folder / "a.mkv", frames),
        write_video(folder / "a.mp4", frames, "libx264", "yuv420p"),
        write_video(folder / "a.avi", frames, "mjpeg", "yuvj420p"),
        write_video(folder / "a.ts", frames, "mpeg2video", "yuv420p"),
        write_video(folder / "a.gif", frames, "gif", "rgb8"),
        write_video(folder / "a.y4m", frames, "rawvideo", "gray"),
        write_video(folder / "a.wmv", frames, "wmv2", "yuv420p"),
    ]
    np.save(folder / "a.npy", frames)
    np.savez(folder / "s.npz", frames=frames, time_s=np.arange(6) / 10.0)
    np.savez_compressed(folder / "c.npz", frames=frames)
    cv2.imwritemulti(str(folder / "a.tif"), list(frames))
    for suffix in ("png", "bmp", "jpg", "pgm"):
        cv2.imwrite(str(folder / f"a.{suffix}"), frames[0])
    (folder / "a.cih").write_text(
        "Image Width : 32\nImage Height : 24\nTotal Frame : 6\nColor Bit : 8\nColor Type : Mono\n"
        "Record Rate(fps) : 1000\n"
    )
    (folder / "a.mraw").write_bytes(frames.tobytes())
    names = ("a.npy", "s.npz", "c.npz", "a.tif", "a.png", "a.bmp", "a.jpg", "a.pgm", "a.cih")
    return [*found, *(folder / name for name in names)]


@pytest.fixture(scope="module")
def whole_files(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    return seeds(tmp_path_factory.mktemp("seeds"))


def changed(data: bytes, rng: np.random.Generator) -> bytes:
    """Bytes with a damage: bits turned, a piece that is missing, doubled or zero, or the end cut off."""
    out = bytearray(data)
    # Headers are where a reader trusts its file most.
    top = min(len(out), 200) if rng.random() < 0.5 else len(out)
    place, count = int(rng.integers(top)), int(rng.integers(1, 40))
    match int(rng.integers(5)):
        case 0:
            for _ in range(int(rng.integers(1, 6))):
                out[int(rng.integers(top))] ^= 1 << int(rng.integers(8))
        case 1:
            del out[place : place + count]
        case 2:
            out[place:place] = out[place : place + count]
        case 3:
            out[place : place + count] = bytes(len(out[place : place + count]))
        case _:
            del out[max(place, 1) :]
    return bytes(out)


@pytest.mark.parametrize("number", range(16))
def test_whatever_is_wrong_with_a_file_it_is_an_error_of_midspan(
    tmp_path: Path, whole_files: list[Path], number: int
) -> None:
    whole = whole_files[number]
    if whole.suffix == ".cih":
        (tmp_path / "a.mraw").write_bytes(whole.with_suffix(".mraw").read_bytes())
    rng = np.random.default_rng(number)
    for _ in range(25):
        path = written(tmp_path, whole.name, changed(whole.read_bytes(), rng))
        said = what_is_wrong(path)
        assert said is None or (whole.stem in said and len(said.splitlines()) == 1)


def what_is_wrong(path: Path) -> str | None:
    """What midspan says of a file; None where it reads it. Any other exception fails the test."""
    try:
        source = open_frames(path, AT_10)
        shapes = {frame.pixels.shape for _, frame in zip(range(20), source.frames(), strict=False)}
        assert shapes <= {(source.info.height, source.info.width)}
    except MidspanError as error:
        return str(error)
    return None


def test_a_damaged_page_of_a_folder_is_named_with_its_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for k, picture in enumerate(moving()[:4]):
        cv2.imwrite(str(tmp_path / f"img{k}.tif"), picture)
    first = tmp_path / "img0.tif"
    # OpenCV writes the list of pages behind the pixels.
    first.write_bytes(first.read_bytes()[:-40])
    assert run(["track", str(tmp_path), "--rate-hz", "10", "-o", str(tmp_path / "o.csv")]) == 3
    assert "img0.tif is cut off" in capsys.readouterr().err
