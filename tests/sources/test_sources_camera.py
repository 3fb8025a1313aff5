"""Frames of videos, images and stacks: the luma that was written, at the times that were meant."""

import os
import tracemalloc
from fractions import Fraction
from pathlib import Path

import av
import cv2
import numpy as np
import pytest

from midspan.errors import DataError, MidspanError, UsageError
from midspan.sources.camera.formats import open_frames
from midspan.sources.camera.frames import FrameRequest

DATA = Path(os.environ.get("MIDSPAN_DATA", Path(__file__).parents[3] / "shared" / "data"))
needs_data = pytest.mark.skipif(not DATA.is_dir(), reason=f"real data are not in {DATA} (set MIDSPAN_DATA)")
RNG = np.random.default_rng(3)


def noise(count: int, rows: int = 36, columns: int = 50, dtype: type = np.uint8, top: int = 256) -> np.ndarray:
    # 50 columns: no multiple of 16, so that lines of the decoder carry padding.
    return RNG.integers(0, top, (count, rows, columns)).astype(dtype)


def write_video(
    path: Path, frames: np.ndarray, codec: str = "ffv1", pixel_format: str = "gray", **keys: object
) -> None:
    """`ticks` are the frames' stamps in units of `time_base`; without them the frames follow each other at `rate`."""
    rate = Fraction(keys.get("rate", 10))  # type: ignore[arg-type]
    ticks = keys.get("ticks")
    with av.open(str(path), "w") as container:
        stream = container.add_stream(codec, rate=rate)
        stream.width, stream.height, stream.pix_fmt = frames.shape[2], frames.shape[1], pixel_format
        stream.options = keys.get("options", {})  # type: ignore[assignment]
        stream.time_base = stream.codec_context.time_base = keys.get("time_base", 1 / rate)  # type: ignore[assignment]
        for k, image in enumerate(frames):
            source = "gray" if frames.dtype == np.uint8 else "gray16le"
            picture = av.VideoFrame.from_ndarray(image, format=source)
            if pixel_format != source:
                picture = picture.reformat(format=pixel_format)
            picture.pts = k if ticks is None else int(ticks[k])  # type: ignore[index]
            picture.time_base = stream.codec_context.time_base
            container.mux(stream.encode(picture))
        container.mux(stream.encode(None))


@pytest.mark.parametrize("suffix", [".avi", ".mkv", ".nut"])
def test_a_lossless_grey_video_gives_back_every_pixel(tmp_path: Path, suffix: str) -> None:
    frames = noise(7)
    write_video(tmp_path / f"a{suffix}", frames)
    source = open_frames(tmp_path / f"a{suffix}", FrameRequest())
    for k, frame in enumerate(source.frames()):
        np.testing.assert_array_equal(frame.pixels, frames[k])
        assert frame.pixels.flags.c_contiguous
        assert (frame.index, frame.time_ns) == (k, k * 100_000_000)
    info = source.info
    assert (info.width, info.height, info.bit_depth, info.frame_count, info.lossless) == (50, 36, 8, 7, True)


@pytest.mark.parametrize(
    ("pixel_format", "bits"), [("gray10le", 10), ("gray12le", 12), ("gray16le", 16), ("yuv420p10le", 10)]
)
def test_deep_video_keeps_its_bits(tmp_path: Path, pixel_format: str, bits: int) -> None:
    frames = noise(3, dtype=np.uint16, top=1 << 16)
    write_video(tmp_path / "a.mkv", frames, pixel_format=pixel_format)
    source = open_frames(tmp_path / "a.mkv", FrameRequest())
    found = [frame.pixels for frame in source.frames()]
    with av.open(str(tmp_path / "a.mkv")) as container:
        # Another route: the library's own unpacking of the planes.
        pictures = [picture.to_ndarray() for picture in container.decode(video=0)]
    for pixels, picture in zip(found, pictures, strict=True):
        np.testing.assert_array_equal(pixels, (picture[0] if picture.ndim == 3 else picture)[:36, :50])
        assert pixels.dtype == np.uint16
        assert pixels.max() < 1 << bits
    assert source.info.bit_depth == bits


@pytest.mark.parametrize(
    ("codec", "pixel_format", "suffix"),
    [
        ("mpeg4", "yuv420p", ".avi"),
        ("libx264", "yuv420p", ".mp4"),
        ("mjpeg", "yuvj422p", ".avi"),
        ("libx264", "nv12", ".mkv"),
    ],
)
def test_lossy_video_gives_its_luma_plane_in_order_of_presentation(
    tmp_path: Path, codec: str, pixel_format: str, suffix: str
) -> None:
    path = tmp_path / f"a{suffix}"
    # A bright bar that moves one column a frame: its place tells the frame's number.
    frames = np.full((40, 48, 64), 60, dtype=np.uint8)
    for k in range(40):
        frames[k, :, k : k + 8] = 200
    options = {"bf": "3", "b_strategy": "0"} if codec == "libx264" else {}
    write_video(path, frames, codec, pixel_format, options=options)
    source = open_frames(path, FrameRequest())
    found = list(source.frames())
    centre = [float(np.flatnonzero(f.pixels.mean(axis=0) > 130).mean()) for f in found]
    # The bar has sharp edges; the codec may smear them by less than half a column.
    np.testing.assert_allclose(np.diff(centre), 1.0, atol=0.5)
    np.testing.assert_array_equal(source.times_ns(), np.arange(40) * 100_000_000)
    assert source.info.lossless is False
    with av.open(str(path)) as container:
        planes = [np.asarray(p.reformat(format="yuv420p").to_ndarray()[:48]) for p in container.decode(video=0)]
    if pixel_format == "yuv420p":
        for frame, plane in zip(found, planes, strict=True):
            np.testing.assert_array_equal(frame.pixels, plane)


def test_any_start_gives_the_same_frames_as_the_whole_pass(tmp_path: Path) -> None:
    frames = noise(50)
    write_video(tmp_path / "a.mp4", frames, "libx264", "yuv420p", options={"bf": "3", "g": "12"})
    source = open_frames(tmp_path / "a.mp4", FrameRequest(every=3))
    whole = list(source.frames())
    assert len(whole) == 17
    for start, stop in [(0, 1), (4, 9), (5, 6), (13, None), (16, 17), (2, 99), (-2, None)]:
        part = list(source.frames(start, stop))
        assert [f.index for f in part] == [f.index for f in whole[start:stop]]
        for frame, expected in zip(part, whole[start:stop], strict=True):
            np.testing.assert_array_equal(frame.pixels, expected.pixels)
            assert frame.time_ns == expected.time_ns


def test_uneven_stamps_are_taken_from_the_container(tmp_path: Path) -> None:
    ticks = np.cumsum(RNG.integers(20, 60, 30))
    write_video(tmp_path / "a.mkv", noise(30), ticks=ticks, time_base=Fraction(1, 1000))
    source = open_frames(tmp_path / "a.mkv", FrameRequest(start_s=2.0, rate_hz=25.0))
    np.testing.assert_array_equal(source.times_ns(), ticks * 1_000_000 + 2_000_000_000)


@pytest.mark.parametrize("rate", [Fraction(30), Fraction(30000, 1001), Fraction(24000, 1001), Fraction(60)])
def test_stamps_rounded_to_milliseconds_are_put_back_on_the_exact_grid(tmp_path: Path, rate: Fraction) -> None:
    count = 200
    write_video(tmp_path / "a.mkv", noise(count, 16, 16), rate=rate)
    source = open_frames(tmp_path / "a.mkv", FrameRequest())
    exact = [round(Fraction(k) / rate * 1_000_000_000) for k in range(count)]
    # One nanosecond: rounding of a half may go either way.
    np.testing.assert_allclose(source.times_ns(), exact, atol=1, rtol=0)
    assert any("rounded to 0.001 s" in note for note in source.info.notes)


def test_a_transport_stream_starts_at_zero(tmp_path: Path) -> None:
    write_video(tmp_path / "a.ts", noise(5, 32, 32), "mpeg2video", "yuv420p", rate=25)
    source = open_frames(tmp_path / "a.ts", FrameRequest(start_s=3.0))
    np.testing.assert_array_equal(source.times_ns(), 3 * 10**9 + np.arange(5) * 40_000_000)


@pytest.mark.parametrize(("codec", "pixel_format"), [("rawvideo", "rgb24"), ("utvideo", "gbrp"), ("huffyuv", "rgb24")])
def test_colour_video_becomes_luma(tmp_path: Path, codec: str, pixel_format: str) -> None:
    path = tmp_path / "a.mov" if codec == "rawvideo" else tmp_path / "a.avi"
    colours = RNG.integers(0, 256, (3, 36, 50, 3)).astype(np.uint8)
    with av.open(str(path), "w") as container:
        stream = container.add_stream(codec, rate=10)
        stream.width, stream.height, stream.pix_fmt = 50, 36, pixel_format
        for k, image in enumerate(colours):
            picture = av.VideoFrame.from_ndarray(image, format="rgb24").reformat(format=pixel_format)
            picture.pts = k
            container.mux(stream.encode(picture))
        container.mux(stream.encode(None))
    found = [frame.pixels.astype(float) for frame in open_frames(path, FrameRequest()).frames()]
    # Rounding of the weighted sum to whole grey values.
    np.testing.assert_allclose(found, colours @ np.array([0.299, 0.587, 0.114]), atol=0.51)


def test_a_file_of_times_comes_before_the_containers_stamps(tmp_path: Path) -> None:
    write_video(tmp_path / "a.mkv", noise(6))
    times_s = np.array([0.05, 0.15, 0.27, 0.35, 0.45, 0.55])
    (tmp_path / "t.csv").write_text("frame,time_s\n" + "".join(f"{k},{t}\n" for k, t in enumerate(times_s)))
    source = open_frames(tmp_path / "a.mkv", FrameRequest(times=tmp_path / "t.csv", every=2))
    np.testing.assert_array_equal(source.times_ns(), [50_000_000, 270_000_000, 450_000_000])
    (tmp_path / "t.csv").write_text("time_s\n0\n0.1\n0.2\n")
    with pytest.raises(DataError, match=r"t\.csv must have one row for each frame.*3 rows and there are 6 frames"):
        open_frames(tmp_path / "a.mkv", FrameRequest(times=tmp_path / "t.csv")).times_ns()


def test_a_rate_that_contradicts_the_container_is_reported(tmp_path: Path) -> None:
    write_video(tmp_path / "a.avi", noise(6))
    source = open_frames(tmp_path / "a.avi", FrameRequest(rate_hz=25.0))
    assert source.times_ns()[1] == 100_000_000
    assert any("rate_hz = 25 Hz not used" in note and "10 Hz" in note for note in source.info.notes)


@pytest.mark.parametrize("suffix", [".avi", ".mkv"])
def test_a_truncated_video_is_refused_with_what_is_missing(tmp_path: Path, suffix: str) -> None:
    whole, cut = tmp_path / f"a{suffix}", tmp_path / f"cut{suffix}"
    write_video(whole, noise(40))
    cut.write_bytes(whole.read_bytes()[: whole.stat().st_size * 6 // 10])
    with pytest.raises(DataError, match=r"truncated: .* declares are not in it") as caught:
        open_frames(cut, FrameRequest(rate_hz=10)).times_ns()
    assert str(cut) in str(caught.value)


def test_a_video_that_breaks_off_behind_its_first_frame_says_so(tmp_path: Path) -> None:
    whole, cut = tmp_path / "a.mkv", tmp_path / "cut.mkv"
    write_video(whole, noise(40))
    content = whole.read_bytes()
    # The first cluster begins with this element, and all frames are in clusters: one and a part of the second are left.
    cut.write_bytes(content[: content.index(b"\x1f\x43\xb6\x75") + 3 * len(content) // (2 * 40)])
    with pytest.raises(DataError, match=r"its header declares 4\.\d s, and one frame is in it\. Copy it again\.$"):
        open_frames(cut, FrameRequest(rate_hz=10)).times_ns()


@pytest.mark.parametrize(("codec", "pixel_format"), [("mpeg4", "yuv420p"), ("libx264", "yuv420p")])
def test_a_frame_that_does_not_decode_is_passed_over_and_counted(tmp_path: Path, codec: str, pixel_format: str) -> None:
    path = tmp_path / "a.mkv"
    write_video(path, noise(20), codec, pixel_format, options={"g": "1", "bf": "0"})
    expected = [frame.pixels for frame in open_frames(path, FrameRequest()).frames()]
    with av.open(str(path)) as container:
        payload = [bytes(packet) for packet in container.demux(video=0) if packet.size]
    data = path.read_bytes()
    # Every frame is a key frame, so that the loss of one cannot touch another.
    path.write_bytes(data.replace(payload[9], bytes(len(payload[9]))))
    source = open_frames(path, FrameRequest())
    found = list(source.frames())
    assert [frame.index for frame in found] == [k for k in range(20) if k != 9]
    for frame in found:
        np.testing.assert_array_equal(frame.pixels, expected[frame.index])
        assert frame.time_ns == frame.index * 100_000_000
    assert "1 frames are damaged and were skipped: frame 9" in source.info.damage


def test_a_long_video_is_read_with_bounded_memory(tmp_path: Path) -> None:
    base = noise(1, 120, 160)[0]
    write_video(tmp_path / "a.mkv", np.stack([np.roll(base, k % 160, axis=1) for k in range(3000)]), "mpeg4", "yuv420p")
    source = open_frames(tmp_path / "a.mkv", FrameRequest())
    source.times_ns()
    tracemalloc.start()
    count = sum(1 for _ in source.frames())
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert count == 3000
    # All frames together are 58 MB; a few of 19 kB and the stamps of 24 kB may be held.
    assert peak < 4e6


def test_images_come_in_natural_order_of_their_names(tmp_path: Path) -> None:
    for k in (10, 2, 1, 33):
        cv2.imwrite(str(tmp_path / f"img{k}.png"), np.full((4, 5), k, dtype=np.uint8))
    (tmp_path / "notes.txt").write_text("no image")
    for path in (tmp_path, tmp_path / "img*.png"):
        source = open_frames(path, FrameRequest(rate_hz=4, start_s=1.0))
        assert [int(f.pixels[0, 0]) for f in source.frames()] == [1, 2, 10, 33]
        np.testing.assert_array_equal(source.times_ns(), [10**9, 1_250_000_000, 1_500_000_000, 1_750_000_000])
    assert [int(f.pixels[0, 0]) for f in open_frames(tmp_path, FrameRequest(rate_hz=4, every=2)).frames(1)] == [10]


@pytest.mark.parametrize("suffix", [".png", ".tif", ".pgm"])
def test_sixteen_bit_images_keep_their_bits(tmp_path: Path, suffix: str) -> None:
    frames = noise(3, dtype=np.uint16, top=1 << 16)
    for k, image in enumerate(frames):
        cv2.imwrite(str(tmp_path / f"f{k}{suffix}"), image)
    source = open_frames(tmp_path, FrameRequest(rate_hz=1))
    for frame, image in zip(source.frames(), frames, strict=True):
        np.testing.assert_array_equal(frame.pixels, image)


def test_colour_images_become_luma(tmp_path: Path) -> None:
    colours = RNG.integers(0, 256, (6, 7, 3)).astype(np.uint8)
    cv2.imwrite(str(tmp_path / "a.png"), colours)
    frame = next(open_frames(tmp_path, FrameRequest(rate_hz=1)).frames())
    expected = cv2.cvtColor(colours, cv2.COLOR_BGR2GRAY)
    # OpenCV computes the same weights in whole numbers of 2^-14: at most one grey value apart.
    np.testing.assert_allclose(frame.pixels.astype(int), expected.astype(int), atol=1)


def test_a_tiff_of_many_pages_is_a_sequence(tmp_path: Path) -> None:
    frames = noise(37, dtype=np.uint16, top=1 << 16)
    cv2.imwritemulti(str(tmp_path / "stack.tiff"), list(frames))
    source = open_frames(tmp_path / "stack.tiff", FrameRequest(rate_hz=1))
    for frame, image in zip(source.frames(), frames, strict=True):
        np.testing.assert_array_equal(frame.pixels, image)
    np.testing.assert_array_equal(next(source.frames(30)).pixels, frames[30])


@pytest.mark.parametrize(
    ("suffix", "options", "lossless"),
    [
        (".tif", [cv2.IMWRITE_TIFF_COMPRESSION, 1], True),
        (".tif", [cv2.IMWRITE_TIFF_COMPRESSION, 5], True),
        (".tif", [cv2.IMWRITE_TIFF_COMPRESSION, 7], False),
        (".png", [], True),
        (".bmp", [], True),
        (".jpg", [], False),
    ],
    ids=["TIFF plain", "TIFF LZW", "TIFF of JPEG", "PNG", "BMP", "JPEG"],
)
def test_pictures_say_whether_they_are_packed_with_a_loss(
    tmp_path: Path, suffix: str, options: list[int], lossless: bool
) -> None:
    cv2.imwrite(str(tmp_path / f"a{suffix}"), noise(1)[0], options)
    assert open_frames(tmp_path, FrameRequest(rate_hz=1)).info.lossless is lossless


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32])
def test_stacks_keep_numbers_and_type(tmp_path: Path, dtype: type) -> None:
    frames = noise(5).astype(dtype)
    np.save(tmp_path / "a.npy", frames)
    np.savez(tmp_path / "b.npz", frames=frames, time_s=np.arange(5) * 0.25)
    np.savez_compressed(tmp_path / "c.npz", anything=frames, time_s=np.arange(5) * 0.25)
    np.savez(tmp_path / "d.npz", celsius=np.asfortranarray(frames), other=frames[:2])
    for name in "a.npy", "b.npz", "c.npz", "d.npz":
        source = open_frames(tmp_path / name, FrameRequest(rate_hz=4))
        np.testing.assert_array_equal([f.pixels for f in source.frames(1, 4)], frames[1:4])
        np.testing.assert_array_equal(source.times_ns(), np.arange(5) * 250_000_000)
        assert next(source.frames()).pixels.dtype == dtype


def test_a_stored_npz_is_mapped_not_loaded(tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", frames=np.zeros((200, 100, 100)))
    tracemalloc.start()
    source = open_frames(tmp_path / "a.npz", FrameRequest(rate_hz=1))
    next(source.frames(150))
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 2e6, "the array of 16 MB must not be loaded"


def bad(folder: Path, name: str) -> tuple[Path, FrameRequest]:
    request = FrameRequest(rate_hz=10)
    path = folder / name
    if name == "text.mp4":
        path.write_text("no video")
    elif name == "sizes":
        path.mkdir()
        cv2.imwrite(str(path / "1.png"), np.zeros((4, 5), np.uint8))
        cv2.imwrite(str(path / "2.png"), np.zeros((4, 6), np.uint8))
    elif name == "torn":
        path.mkdir()
        cv2.imwrite(str(path / "1.png"), np.zeros((4, 5), np.uint8))
        (path / "2.png").write_bytes(b"no image")
    elif name == "hollow":
        path.mkdir()
    elif name == "flat.npy":
        np.save(path, np.zeros((4, 5)))
    elif name == "names.npz":
        np.savez(path, a=np.zeros((2, 3, 4)), b=np.zeros((2, 3, 4)))
    elif name == "pickle.npy":
        np.save(path, np.array([{}], dtype=object), allow_pickle=True)
    elif name in ("no_rate", "every", "rate"):
        path.mkdir()
        cv2.imwrite(str(path / "1.png"), np.zeros((4, 5), np.uint8))
        request = {
            "no_rate": FrameRequest(),
            "every": FrameRequest(rate_hz=1, every=0),
            "rate": FrameRequest(rate_hz=0),
        }[name]
    elif name == "cut.mp4":
        write_video(folder / "w.mp4", noise(20), "libx264", "yuv420p")
        path.write_bytes((folder / "w.mp4").read_bytes()[:2000])
    elif name == "sound.wav":
        path.write_bytes(
            b"RIFF$\x00\x00\x00WAVEfmt \x10\x00\x00\x00\x01\x00\x01\x00@\x1f\x00\x00\x80>\x00\x00\x02\x00\x10\x00data"
            + bytes(4)
        )
    return path, request


@pytest.mark.parametrize(
    ("name", "kind", "words"),
    [
        ("missing.mp4", DataError, ["missing.mp4", "does not exist"]),
        ("nothing*.png", DataError, ["nothing*.png", "no images", "glob"]),
        ("text.mp4", DataError, ["text.mp4", "cannot be opened as a video"]),
        ("cut.mp4", DataError, ["cut.mp4", "whole"]),
        ("sound.wav", UsageError, ["sound.wav", ".mp4"]),
        ("sizes", DataError, ["2.png", "6 x 4", "5 x 4", "Remove"]),
        ("torn", DataError, ["2.png", "cannot be read"]),
        ("hollow", DataError, ["no images"]),
        ("flat.npy", DataError, ["(frames, rows, columns)", "(4, 5)"]),
        ("names.npz", DataError, ["celsius", "a, b"]),
        ("pickle.npy", DataError, ["pickle.npy", "cannot be read"]),
        ("no_rate", UsageError, ["rate_hz"]),
        ("every", UsageError, ["every must be 1 or more", "0"]),
        ("rate", UsageError, ["rate_hz must be above zero"]),
    ],
)
def test_a_bad_source_is_refused_with_its_remedy(
    tmp_path: Path, name: str, kind: type[MidspanError], words: list[str]
) -> None:
    path, request = bad(tmp_path, name)
    with pytest.raises(kind) as caught:
        list(open_frames(path, request).frames())
    for word in words:
        assert word in str(caught.value)


@needs_data
@pytest.mark.parametrize(("name", "count", "shape"), [("contract-example/camera.avi", 395, (102, 88)),
                                                      ("pyidi/tacoma_bridge.mp4", 248, (250, 334))])  # fmt: skip
def test_real_videos_equal_the_librarys_own_decoding(name: str, count: int, shape: tuple[int, int]) -> None:
    source = open_frames(DATA / name, FrameRequest())
    frames = list(source.frames())
    assert len(frames) == source.times_ns().size == count
    with av.open(str(DATA / name)) as container:
        for frame, picture in zip(frames, container.decode(video=0), strict=True):
            np.testing.assert_array_equal(frame.pixels, picture.to_ndarray()[: shape[0]])


@needs_data
def test_real_images_are_read_in_order() -> None:
    source = open_frames(DATA / "dice-simple-tracking" / "images", FrameRequest(rate_hz=10))
    frames = list(source.frames())
    assert len(frames) == 56
    assert frames[0].pixels.shape == (480, 640)
    raw = next(open_frames(DATA / "flirpy" / "example_radiometric.tiff", FrameRequest(rate_hz=1)).frames()).pixels
    # 0.04 K a count, -3.4 to +9.9 °C (the data's description).
    celsius = raw * 0.04 - 273.15
    assert (round(float(celsius.min()), 1), round(float(celsius.max()), 1)) == (-3.4, 9.9)
