"""Tracking of an uncompressed stack compared with OpenCV, pyidi and scikit-image, and the share of decoding in a 1080p
video.

All run on one thread, on the same frames, after a warm-up; rounds take turns and the best of each counts. Rates are by
processor time, which a busy machine hardly changes. "from the start" includes making template and kernels, which a
record pays once; "later" is what every further frame costs.
pyidi is only needed here. It would replace OpenCV's wheel without a display by the one with, so it is installed alone:

    pip install --no-deps pyidi==1.4.0 pyMRAW==0.33.0 xmltodict==1.0.4 psutil==7.2.2
    OPENBLAS_NUM_THREADS=1 python -m benchmarks video_peers
"""

import contextlib
import io
import os
import tempfile
import time
import warnings
from collections.abc import Callable, Iterator
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.table import goal, show
from midspan.recording.tracking.track import track
from midspan.records import Floats, Frame, Region
from midspan.sources.camera.formats import open_frames
from midspan.sources.camera.frames import FrameRequest
from midspan.vision.tracker import open_tracker

FRAMES, SIDE, RATE_HZ = 240, 256, 100.0
REGION = Region(64, 64, 128, 128)
SEARCH_PX = 4
ROUNDS = 3
HD, HD_LENGTHS, HD_PERIOD, HD_RATE = (1080, 1920), (60, 600), 60, Fraction(30)
Stack = NDArray[np.uint8]


def motion() -> Floats:
    """Translation (n, 2: x, y) in px: two sines across and one down."""
    t = np.arange(FRAMES) / RATE_HZ
    x = 1.5 * np.sin(2 * np.pi * 3.1 * t) + 0.45 * np.sin(2 * np.pi * 17.3 * t)
    return np.stack([x, 0.8 * np.sin(2 * np.pi * 5.3 * t)], axis=1)


def _texture(shape: tuple[int, int], rng: np.random.Generator) -> tuple[NDArray[np.complex128], Floats, Floats]:
    """Spectrum of a band-limited texture of 35 DN, with its frequencies down and across in cycles/px."""
    down, across = np.fft.fftfreq(shape[0])[:, None], np.fft.rfftfreq(shape[1])
    radius = np.hypot(down, across)
    weight = np.exp(-0.5 * (radius / 0.07) ** 2) * (radius < 0.18)
    spectrum = np.fft.rfft2(rng.standard_normal(shape)) * weight
    spectrum[0, 0] = 0.0
    return spectrum * (35.0 / np.fft.irfft2(spectrum, s=shape).std()), down, across


def stacks() -> dict[str, Stack]:
    """The same motion three times: still light, light that comes and goes, a pillar that passes before the target."""
    rng = np.random.default_rng(3)
    spectrum, down, across = _texture((SIDE, SIDE), rng)
    column = np.arange(SIDE)
    found: dict[str, list[Stack]] = {"plain": [], "light": [], "pillar": []}
    for k, (x, y) in enumerate(motion()):
        moved = 128 + np.fft.irfft2(spectrum * np.exp(-2j * np.pi * (across * x + down * y)), s=(SIDE, SIDE))
        turn = np.sin(2 * np.pi * 0.7 * k / RATE_HZ)
        pillar = np.where(np.abs(column - (40 + 180 * k / FRAMES)) < 8, 40.0, np.nan)
        changed = {
            "plain": moved,
            "light": moved * (1 + 0.2 * turn) + 12 * turn,
            "pillar": np.where(np.isfinite(pillar), pillar, moved) if k else moved,
        }
        for name, image in changed.items():
            noisy = image + rng.normal(0, 2.0, image.shape)
            found[name].append(np.clip(np.rint(noisy), 0, 255).astype(np.uint8))
    return {name: np.stack(images) for name, images in found.items()}


class Pushes:
    """Frames in memory pushed into one tracker after another; with `later` into the same one, on and on."""

    def __init__(self, stack: Stack, name: str, *, later: bool) -> None:
        self.stack, self.name, self.later = stack, name, later
        self.tracker = open_tracker(name, Frame(0, stack[0]), REGION)
        self.pushed = 0

    def __call__(self) -> Floats:
        if not self.later:
            self.tracker, self.pushed = open_tracker(self.name, Frame(0, self.stack[0]), REGION), 0
        rows = []
        for image in self.stack:
            rows.append(self.tracker.push(Frame(round(1e9 * self.pushed / RATE_HZ), image, self.pushed)))
            self.pushed += 1
        return np.array([(row.x_px, row.y_px) for row in rows])


def by_midspan_file(path: Path, name: str) -> Floats:
    """`midspan track` as a function, from a file."""
    found = track(path, roi=REGION, tracker=name, rate_hz=RATE_HZ).track
    return np.stack([found.x_px, found.y_px], axis=1)


def by_opencv(stack: Stack) -> Floats:
    """matchTemplate (zero-mean normalised) over ±4 px and a parabola along each axis."""
    import cv2

    r = REGION
    template = stack[0][r.y : r.y + r.height, r.x : r.x + r.width]
    rows = []
    for image in stack:
        part = image[r.y - SEARCH_PX : r.y + r.height + SEARCH_PX, r.x - SEARCH_PX : r.x + r.width + SEARCH_PX]
        surface = cv2.matchTemplate(part, template, cv2.TM_CCOEFF_NORMED)
        _, _, _, (i, j) = cv2.minMaxLoc(surface)
        rows.append((i - SEARCH_PX + _top(surface[j], i), j - SEARCH_PX + _top(surface[:, i], j)))
    return np.array(rows)


def _top(line: NDArray[Any], place: int) -> float:
    """Place of a parabola's top together with the largest of three values."""
    if not 0 < place < len(line) - 1:
        return np.nan
    before, at, after = (float(v) for v in line[place - 1 : place + 2])
    return 0.5 * (before - after) / (before - 2 * at + after)


def by_scikit_image(stack: Stack) -> Floats:
    """Up-sampled cross-correlation to 1/100 px."""
    from skimage.registration import phase_cross_correlation

    part = np.s_[REGION.y : REGION.y + REGION.height, REGION.x : REGION.x + REGION.width]
    rows = []
    for image in stack:
        found, _, _ = phase_cross_correlation(image[part], stack[0][part], upsample_factor=100, normalization=None)
        rows.append((float(found[1]), float(found[0])))
    return np.array(rows)


def by_pyidi(stack: Stack) -> Floats:
    """Lucas-Kanade of one subset as large as the region (an odd side), its compiled kernel."""
    import pyidi

    side = REGION.width - 1
    centre = np.array([[REGION.y + side // 2, REGION.x + side // 2]])
    with _quiet_folder():
        video = pyidi.VideoReader(stack, root=".")
        method = pyidi.LucasKanade(video)
        method.set_points(centre)
        method.configure(roi_size=(side, side), verbose=0, show_pbar=False, processes=1)
        found = method.get_displacements(autosave=False)
    moved: Floats = np.asarray(found, dtype=np.float64)[0]
    rows = moved[:, ::-1]  # rows, columns → x, y
    return np.concatenate([np.zeros((len(stack) - len(rows), 2)), rows])


@contextlib.contextmanager
def _quiet_folder() -> Iterator[None]:
    """A folder of its own for what a library leaves behind, and its prints and warnings kept away."""
    before = Path.cwd()
    with tempfile.TemporaryDirectory() as place, contextlib.redirect_stdout(io.StringIO()), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        os.chdir(place)
        try:
            yield
        finally:
            os.chdir(before)


def peers(stack: Stack, path: Path) -> dict[str, Callable[[], Floats]]:
    """What is compared, by name; pyidi only where it is installed."""
    found: dict[str, Callable[[], Floats]] = {}
    for name in ("registration", "template", "hybrid"):
        found[f"{name}, from the start"] = Pushes(stack, name, later=False)
        found[f"{name}, later"] = Pushes(stack, name, later=True)
    for name in ("registration", "template"):
        found[f"{name}, track(file)"] = lambda name=name: by_midspan_file(path, name)
    found["matchTemplate + parabola"] = lambda: by_opencv(stack)
    found["scikit-image"] = lambda: by_scikit_image(stack)
    try:
        import pyidi  # noqa: F401
    except ImportError as error:
        print(f"pyidi is left out: {error}. The command to install it stands in this file.")
    else:
        found["pyidi"] = lambda: by_pyidi(stack)
    return found


def measured(found: dict[str, Callable[[], Floats]]) -> dict[str, tuple[float, float]]:
    """RMSE without the mean in px (both axes) and frames a second of each; rounds take turns."""
    truth, best, error = motion(), dict.fromkeys(found, np.inf), {}
    for _ in range(ROUNDS + 1):
        for name, work in found.items():
            start = time.process_time()
            rows = work()
            took = time.process_time() - start
            best[name] = min(best[name], took) if name in error else np.inf  # the first round only warms up
            away = rows - truth
            error[name] = float(np.sqrt(np.mean(np.square(away - away.mean(axis=0)))))
    return {name: (error[name], FRAMES / best[name]) for name in found}


def alongside_peers(folder: Path) -> None:
    """The three stacks."""
    for case, stack in stacks().items():
        path = folder / f"{case}.npy"
        np.save(path, stack)
        found = measured(peers(stack, path))
        matched = found["matchTemplate + parabola"]
        peer = found.get("pyidi")
        show(
            [case, "error px", "frames/s", "of matchTemplate's", "of pyidi's"],
            [
                [name, error, rate, rate / matched[1], rate / peer[1] if peer else float("nan")]
                for name, (error, rate) in found.items()
            ],
        )
        for name in ("registration, later", "template, later"):
            error, rate = found[name]
            goal(f"{case}: {name}, over matchTemplate", rate / matched[1], 5.0, unit="times", at_least=True)
            goal(f"{case}: {name}, error over matchTemplate's", error / matched[0], 1.0)
            if peer:
                goal(f"{case}: {name}, over pyidi", rate / peer[1], 20.0, unit="times", at_least=True)
                goal(f"{case}: {name}, error over pyidi's", error / peer[0], 1.0)


def write_hd(path: Path, count: int) -> None:
    """Frames of 1920 by 1080 as a camera writes them: H.264, crf 20, two threads; the motion repeats every 2 s."""
    import av

    rng = np.random.default_rng(4)
    spectrum, down, _ = _texture(HD, rng)
    planes: list[Stack] = []
    with av.open(str(path), "w") as container:
        stream: Any = container.add_stream("libx264", rate=HD_RATE, options={"crf": "20", "preset": "veryfast"})
        stream.height, stream.width, stream.pix_fmt = *HD, "yuv420p"
        stream.codec_context.thread_count = 2
        grey = np.full((HD[0] // 2, HD[1]), 128, dtype=np.uint8)
        for k in range(count):
            if k < HD_PERIOD:
                y = 3.0 * np.sin(2 * np.pi * 3 * k / HD_PERIOD)
                image = 128 + np.fft.irfft2(spectrum * np.exp(-2j * np.pi * down * y), s=HD) + rng.normal(0, 2.0, HD)
                planes.append(np.concatenate([np.clip(np.rint(image), 0, 255).astype(np.uint8), grey]))
            frame = av.VideoFrame.from_ndarray(planes[k % HD_PERIOD], format="yuv420p")
            frame.pts, frame.time_base = k, 1 / HD_RATE
            container.mux(stream.encode(frame))
        container.mux(stream.encode())


def decoding_share(folder: Path, count: int) -> None:
    """Wall time of `midspan track` on a 1080p file, and what of it is not decoding."""
    path = folder / f"hd{count}.mkv"
    write_hd(path, count)
    region = Region(896, 476, 128, 128)

    def decode() -> int:
        return sum(1 for _ in open_frames(path, FrameRequest()).frames())

    best = np.full((2, 2), np.inf)  # track and decoding alone; wall and processor time, s
    for _ in range(ROUNDS):
        for k, work in enumerate((lambda: track(path, roi=region, tracker="registration"), decode)):
            start = time.perf_counter(), time.process_time()
            work()
            best[k] = np.minimum(best[k], np.array([time.perf_counter(), time.process_time()]) - start)
    for clock, (whole, alone) in zip(("wall", "processor"), best.T, strict=True):
        print(f"1080p, {count} frames, {clock}: track {whole:.3f} s, decoding {alone:.3f} s ({count / alone:.0f}/s)")
        share = 100 * (1 - alone / whole)
        goal(f"1080p, {count} frames: share of track's {clock} time that is not decoding", share, 10.0, unit="%")


def main() -> None:
    import cv2

    cv2.setNumThreads(1)
    with tempfile.TemporaryDirectory() as name:
        alongside_peers(Path(name))
        for count in HD_LENGTHS:
            decoding_share(Path(name), count)
