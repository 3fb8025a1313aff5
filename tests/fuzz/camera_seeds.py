"""Videos, pictures and stacks of cameras of light and of heat."""

import json
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path

import av
import cv2
import numpy as np
from flir_files import black_body, block

from fuzz.world import (
    FRAMES,
    RECORDING,
    Seed,
    celsius,
    grey,
    recording,
)


def camera(write: Callable[[Path], None], file: str, lines: str = "", kind: str = "camera") -> Callable[[Path], None]:
    """A recording whose camera is the file, or the folder of the file, that `write` makes."""

    def make(folder: Path) -> None:
        path = folder / file
        path.parent.mkdir(exist_ok=True)
        write(path)
        name = file.split("/")[0]
        recording(folder, f'\n[{kind}]\nfile = "{name}"\n{lines}\n')

    return make


def video(codec, pixels="gray", **options):
    """A video of FRAMES frames."""

    def write(path):
        frames = grey()
        with av.open(str(path), "w", options={"fflags": "+bitexact"}) as container:
            stream = container.add_stream(codec, rate=Fraction(10))
            stream.width, stream.height, stream.pix_fmt = frames.shape[2], frames.shape[1], pixels
            stream.options = options
            stream.codec_context.time_base = Fraction(1, 10)
            for k, image in enumerate(frames):
                picture = av.VideoFrame.from_ndarray(image, format="gray").reformat(format=pixels)
                picture.pts, picture.time_base = k, Fraction(1, 10)
                container.mux(stream.encode(picture))
            container.mux(stream.encode(None))

    return write


def images(bits=8):
    """A folder of six pictures, of which the one that is damaged is in the middle."""

    def write(path):
        for k, frame in enumerate(grey(bits, count=6)):
            cv2.imwrite(str(path.with_name(f"f{k}{path.suffix}")), frame)

    return write


def _pages(path):
    cv2.imwritemulti(str(path), list(grey(16, count=6)))


def _photron(bits):
    def write(path):
        frames = grey(8 if bits == 8 else 16)
        head = (
            "#Camera Information Header\nDate : 2024/5/1\nRecord Rate(fps) : 50\nStart Frame : 0\n"
            f"Total Frame : {FRAMES}\n"
            f"Image Width : 64\nImage Height : 48\nColor Type : Mono\nColor Bit : {bits}\nFile Format : MRaw\n"
        )
        path.with_suffix(".cih").write_text(head)
        path.with_suffix(".mraw").write_bytes(frames.astype("<u2" if bits == 16 else "u1").tobytes())

    return write


def _timed(path):
    video("ffv1")(path.with_name("camera.mkv"))
    path.write_text("time_s\n" + "".join(f"{k / 10}\n" for k in range(FRAMES)))


def _times(folder):
    _timed(folder / "times.csv")
    recording(folder, '\n[camera]\nfile = "camera.mkv"\ntimes = "times.csv"\n')


LENS = {"model": "pinhole", "matrix": [60.0, 60.0, 31.5, 23.5], "distortion": [-0.05, 0.01, 0.0, 0.0], "size": [64, 48]}


def _lens(folder):
    video("ffv1")(folder / "camera.mkv")
    (folder / "lens.json").write_text(json.dumps(LENS, indent=1))
    recording(folder, '\n[camera]\nfile = "camera.mkv"\n\n[camera.lens]\nfile = "lens.json"\n')


AT_10 = "rate_hz = 10.0\n"
TRACKED = ("track", ".", "--roi", "8,8,48,32", "-o", "track.csv", "--quiet")
CAMERAS = (
    Seed("mkv", "video mkv", "a.mkv", camera(video("ffv1"), "a.mkv")),
    Seed("mkv-h264", "video mkv", "a.mkv", camera(video("libx264", "yuv420p"), "a.mkv")),
    Seed("mp4", "video mp4, mov", "a.mp4", camera(video("libx264", "yuv420p"), "a.mp4")),
    Seed("mov", "video mp4, mov", "a.mov", camera(video("mjpeg", "yuvj420p"), "a.mov")),
    Seed("avi", "video avi", "a.avi", camera(video("mjpeg", "yuvj420p"), "a.avi")),
    Seed("avi-mpeg4", "video avi", "a.avi", camera(video("mpeg4", "yuv420p"), "a.avi")),
    Seed("avi-ffv1", "video avi", "a.avi", camera(video("ffv1"), "a.avi")),
    Seed("gif", "video gif", "a.gif", camera(video("gif", "gray"), "a.gif")),
    Seed("y4m", "video y4m", "a.y4m", camera(video("wrapped_avframe", "gray"), "a.y4m")),
    Seed("ts", "video ts", "a.ts", camera(video("libx264", "yuv420p"), "a.ts")),
    Seed("wmv", "video wmv", "a.wmv", camera(video("wmv2", "yuv420p"), "a.wmv")),
    Seed("png", "image png", "pictures/f3.png", camera(images(), "pictures/f3.png", AT_10)),
    Seed("png16", "image png", "pictures/f3.png", camera(images(16), "pictures/f3.png", AT_10)),
    Seed("bmp", "image bmp", "pictures/f3.bmp", camera(images(), "pictures/f3.bmp", AT_10)),
    Seed("jpeg", "image jpeg", "pictures/f3.jpg", camera(images(), "pictures/f3.jpg", AT_10)),
    Seed("pgm", "image pgm", "pictures/f3.pgm", camera(images(), "pictures/f3.pgm", AT_10)),
    Seed("tiff", "image tiff", "pictures/f3.tif", camera(images(), "pictures/f3.tif", AT_10)),
    Seed("tiff-pages", "image tiff", "a.tif", camera(_pages, "a.tif", AT_10)),
    Seed("stack-npy", "stack npy", "a.npy", camera(lambda path: np.save(path, grey()), "a.npy", AT_10)),
    Seed("stack-npz", "stack npz", "a.npz",
         camera(lambda path: np.savez(path, frames=grey(), time_s=np.arange(FRAMES) / 10), "a.npz")),
    Seed("stack-npz-packed", "stack npz", "a.npz",
         camera(lambda path: np.savez_compressed(path, frames=grey(16), time_s=np.arange(FRAMES) / 10), "a.npz")),
    Seed("cih", "Photron cih", "a.cih", camera(_photron(8), "a.cih"), text=True),
    Seed("mraw", "Photron mraw", "a.mraw", camera(_photron(16), "a.mraw")),
    Seed("times", "camera times", "times.csv", _times, text=True, commands=RECORDING),
    Seed("lens", "lens", "lens.json", _lens, text=True, commands=(*RECORDING, TRACKED)),
)  # fmt: skip


def infrared(write, file, lines=""):
    """The same for a thermal camera."""
    return camera(write, file, lines, kind="infrared")


def _flir(packed=False):
    def write(path):
        parts = []
        for k, counts in enumerate(black_body(celsius())):
            coded = None
            if packed:
                import jpeg_ls

                coded = bytes(jpeg_ls.encode_array(counts))
            parts.append(block(counts, stamp_ms=1_700_000_000_000 + 100 * k, packed=coded))
            if path.suffix == ".fff":
                path.with_name(f"f{k}.fff").write_bytes(parts[-1])
        if path.suffix != ".fff":
            path.write_bytes(b"".join(parts))

    return write


def _centikelvin(path):
    counts = np.rint(100.0 * (celsius(count=6) + 273.15)).astype(np.uint16)
    for k, frame in enumerate(counts):
        cv2.imwrite(str(path.with_name(f"f{k}{path.suffix}")), frame)


def _float_pages(path):
    cv2.imwritemulti(str(path), list(celsius(count=6).astype(np.float32)))


def _celsius_npz(save):
    return lambda path: save(path, celsius=celsius().astype(np.float32), time_s=np.arange(FRAMES) / 10)


INFRARED = (
    Seed("fff", "FLIR fff", "pictures/f3.fff", infrared(_flir(), "pictures/f3.fff")),
    Seed("seq", "FLIR seq", "a.seq", infrared(_flir(), "a.seq")),
    Seed("csq", "FLIR csq", "a.csq", infrared(_flir(packed=True), "a.csq")),
    Seed("centikelvin", "thermal tiff", "pictures/f3.tif", infrared(_centikelvin, "pictures/f3.tif", AT_10)),
    Seed("celsius-tiff", "thermal tiff", "a.tif", infrared(_float_pages, "a.tif", AT_10)),
    Seed("celsius-npz", "thermal npz", "a.npz", infrared(_celsius_npz(np.savez), "a.npz")),
    Seed("celsius-npz-packed", "thermal npz", "a.npz", infrared(_celsius_npz(np.savez_compressed), "a.npz")),
)
