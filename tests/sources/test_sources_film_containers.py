"""Films whose container says more than its frames: trimmed, with frames dropped, slowed down."""

import json
import struct
from fractions import Fraction
from pathlib import Path

import av
import numpy as np
import pytest

from midspan.cli.main import run
from midspan.errors import DataError
from midspan.sources.camera.formats import open_frames
from midspan.sources.camera.frames import FrameRequest

RATE_HZ = 30
COUNT = 90
BAR = 8


def bars(numbers: range | list[int]) -> np.ndarray:
    """A bright bar whose column tells the frame's number (modulo 56), above a texture that is static."""
    frames = np.full((len(numbers), 48, 64), 60, dtype=np.uint8)
    frames[:, 16:] = np.kron(np.random.default_rng(1).integers(40, 200, (8, 16)), np.ones((4, 4)))
    for image, number in zip(frames, numbers, strict=True):
        image[:16, number % 56 : number % 56 + BAR] = 200
    return frames


def write_film(
    path: Path,
    numbers: range | list[int],
    codec: str = "libx264",
    *,
    tags: dict[str, str] | None = None,
    rate_hz: int = RATE_HZ,
    options: dict[str, str] | None = None,
) -> Path:
    """A film of the frames of these numbers, each at its number's time."""
    with av.open(str(path), "w", options=options or {}) as container:
        container.metadata.update(tags or {})
        stream = container.add_stream(codec, rate=rate_hz)
        stream.width, stream.height = 64, 48
        stream.pix_fmt = "yuvj420p" if codec == "mjpeg" else "yuv420p"
        stream.options = {"bf": "2", "g": "30"} if codec == "libx264" else {}
        for number, image in zip(numbers, bars(numbers), strict=True):
            picture = av.VideoFrame.from_ndarray(image, format="gray").reformat(format=stream.pix_fmt)
            picture.pts, picture.time_base = number - numbers[0], Fraction(1, rate_hz)
            container.mux(stream.encode(picture))
        container.mux(stream.encode(None))
    return path


def trimmed(source: Path, target: Path, hidden: int) -> Path:
    """The packets of a film with its first frames hidden by an edit list, as a phone trims without coding again."""
    options = {"avoid_negative_ts": "disabled", "movflags": "faststart"}
    with av.open(str(source)) as film, av.open(str(target), "w", options=options) as cut:
        old = film.streams.video[0]
        new = cut.add_stream_from_template(old)
        shift = round(Fraction(hidden, RATE_HZ) / old.time_base)
        for packet in film.demux(old):
            if packet.dts is not None:
                packet.pts, packet.dts, packet.stream = packet.pts - shift, packet.dts - shift, new
                cut.mux(packet)
    return target


def number_of(pixels: np.ndarray) -> int:
    return int(np.flatnonzero(pixels[:16].mean(axis=0) > 130)[0])


@pytest.mark.parametrize("hidden", [7, 45])
def test_a_trimmed_film_gives_the_frames_that_players_show(tmp_path: Path, hidden: int) -> None:
    path = trimmed(write_film(tmp_path / "whole.mp4", range(COUNT)), tmp_path / "trimmed.mp4", hidden)
    source = open_frames(path, FrameRequest())
    # The stamps begin at the first frame shown, to a tick of the container (1/15360 s, rounded to ns).
    np.testing.assert_allclose(source.times_ns(), np.arange(COUNT - hidden) * 1e9 / RATE_HZ, atol=1.0)
    assert [number_of(frame.pixels) for frame in source.frames()] == [k % 56 for k in range(hidden, COUNT)]
    assert number_of(next(source.frames(30)).pixels) == (hidden + 30) % 56
    assert source.info.damage == ()
    assert f"{hidden} of 90 frames are left out by an edit list (trimmed) or" in " ".join(source.info.notes)


def test_an_avi_keeps_its_clock_where_the_recorder_dropped_frames(tmp_path: Path) -> None:
    kept = [k for k in range(COUNT) if k % 20 != 7]
    source = open_frames(write_film(tmp_path / "a.avi", kept, "mjpeg"), FrameRequest())
    np.testing.assert_allclose(source.times_ns(), np.array(kept) * 1e9 / RATE_HZ, atol=1.0)
    assert [number_of(frame.pixels) for frame in source.frames()] == [k % 56 for k in kept]
    assert "5 of 90 frames are left out" in " ".join(source.info.notes)
    assert source.info.damage == ()


@pytest.mark.parametrize("name", ["whole.mp4", "trimmed.mp4", "dropped.avi"])
def test_one_that_broke_off_is_still_refused(tmp_path: Path, name: str) -> None:
    if name == "dropped.avi":
        path = write_film(tmp_path / name, [k for k in range(COUNT) if k % 20 != 7], "mjpeg")
    else:
        path = write_film(tmp_path / "whole.mp4", range(COUNT), options={"movflags": "faststart"})
        path = trimmed(path, tmp_path / name, 15) if name == "trimmed.mp4" else path
    # The index stands before the pictures of the MP4s: what is cut off are pictures alone.
    data = path.read_bytes()
    pictures = data.index(b"mdat" if path.suffix == ".mp4" else b"movi")
    path.write_bytes(data[: pictures + (len(data) - pictures) * 6 // 10])
    with pytest.raises(DataError, match=r"truncated: \d+ of 90 frames that its header declares are not in it"):
        open_frames(path, FrameRequest()).times_ns()


def slow(path: Path, taken_hz: float, options: dict[str, str] | None = None) -> Path:
    options = {"movflags": "use_metadata_tags"} if options is None else options
    return write_film(path, range(60), tags={"com.android.capture.fps": f"{taken_hz:.6f}"}, options=options)


def sony(path: Path) -> Path:
    """A film with the XML in which Sony's cameras tell both rates, in a box of its own behind the others."""
    write_film(path, range(60), rate_hz=25)
    xml = b'<VideoFormat><VideoFrame videoCodec="AVC" captureFps="100.00p" formatFps="25.00p"/></VideoFormat>'
    path.write_bytes(path.read_bytes() + struct.pack(">I4s", len(xml) + 8, b"meta") + xml)
    return path


@pytest.mark.parametrize(
    ("film", "settings", "true_hz", "words"),
    [
        ("slow.mp4", {}, 240.0, "capture at 240 Hz and playback at 30 Hz; the capture times at 240 Hz are used"),
        ("slow.mkv", {}, 240.0, "capture at 240 Hz and playback at 30 Hz; the capture times at 240 Hz are used"),
        ("sony.mp4", {}, 100.0, "capture at 100 Hz and playback at 25 Hz; the capture times at 100 Hz are used"),
        ("lapse.mp4", {}, 2.0, "capture at 2 Hz and playback at 30 Hz; the capture times at 2 Hz are used"),
        ("slow.mp4", {"rate_hz": 120.0}, 120.0, "the times are at rate_hz = 120 Hz as set"),
        # In poor light a phone takes fewer frames than it declares: which one it is only the user can tell.
        ("dim.mp4", {}, 30.0, "the playback times are used. If they are 2 times too long, give rate_hz = 60"),
        ("dim.mp4", {"rate_hz": 60.0}, 60.0, "the times are at rate_hz = 60 Hz as set"),
    ],
)
def test_slow_motion_is_timed_as_it_was_taken_and_both_rates_are_reported(
    tmp_path: Path, film: str, settings: dict[str, float], true_hz: float, words: str
) -> None:
    if film == "sony.mp4":
        path = sony(tmp_path / film)
    else:
        taken_hz = {"slow.mp4": 240.0, "slow.mkv": 240.0, "dim.mp4": 60.0, "lapse.mp4": 2.0}[film]
        path = slow(tmp_path / film, taken_hz, {} if film.endswith("mkv") else None)
    source = open_frames(path, FrameRequest(**settings))
    np.testing.assert_allclose(source.times_ns(), np.arange(60) * 1e9 / true_hz, atol=1.0)
    (notice,) = source.info.notices
    assert notice.code == "slow-motion"
    assert words in notice


@pytest.mark.parametrize("taken_hz", [30.0, 29.97])
def test_an_ordinary_film_that_declares_its_rate_is_left_alone(tmp_path: Path, taken_hz: float) -> None:
    source = open_frames(slow(tmp_path / "a.mp4", taken_hz), FrameRequest())
    assert source.times_ns()[-1] == round(59e9 / RATE_HZ)
    assert source.info.notices == ()


def test_a_file_of_times_wins_over_what_the_container_declares(tmp_path: Path) -> None:
    (tmp_path / "t.csv").write_text("time_s\n" + "".join(f"{0.01 * k:.2f}\n" for k in range(60)))
    source = open_frames(slow(tmp_path / "a.mp4", 240.0), FrameRequest(times=tmp_path / "t.csv"))
    assert source.times_ns()[-1] == 590_000_000
    assert source.info.notices == ()


def test_inspect_and_track_say_that_a_film_is_slow_motion(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = slow(tmp_path / "a.mp4", 240.0)
    assert run(["inspect", str(path)]) == 0
    assert "capture at 240 Hz and playback at 30 Hz" in capsys.readouterr().out
    track = tmp_path / "t.csv"
    assert run(["track", str(path), "--roi", "12,20,40,20", "--tracker", "template", "-o", str(track), "--json"]) == 0
    notices = json.loads(capsys.readouterr().out)["notices"]
    assert [one["code"] for one in notices if "240 Hz" in one["text"]] == ["slow-motion"]
    assert np.loadtxt(track, delimiter=",", skiprows=1, usecols=0)[-1] == pytest.approx(59 / 240, abs=1e-6)
